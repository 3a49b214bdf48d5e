"""Events: strings that go slack or taut and nodes that meet or leave the ground, and the smooth motion between two events.

A mode says of each string whether it pulls, and of each node whether the ground pushes it (1 or 0). Within a mode all forces are
smooth; where a switching function changes its sign, the mode changes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity
from tenscasadi.util.casadi_tools import sparse


def switching(model: Model) -> ca.Function | None:
    """(x, u) -> g (k,), m: positive where the mode is 1; strings first, then nodes. None where the scene has no events."""
    scene, mech = model.scene, model.mechanism
    strings, nodes = counts(model)
    if strings + nodes == 0:
        return None
    kind: Any = ca.MX if mech.large else ca.SX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    N, V, _ = model.unpack(x)
    rows = [forces.strings(replace(scene, slack=_Switching()), mech, N, V, u)[0]] if strings else []
    if scene.ground is not None:
        first = mech.first.tolist()
        depth, speed = _approach(scene.ground, N[:, first], V[:, first])
        rows.append(ca.fmin(depth, depth - scene.ground.damping / scene.ground.stiffness * speed))
    return ca.Function("switching", [x, u], ca.cse([ca.densify(ca.horzcat(*rows).T)]), ["x", "u"], ["g"])


def held_ode(model: Model, work: bool = False) -> ca.Function:
    """(z, w) -> zdot, the motion in the mode of w = (u, mode (k,)), whatever the switching functions say; z is x.

    With `work`, z has one entry more: the work of all forces, J. `potential` tells how much of it comes out of the model's energy: that
    has kinks of its own, where a damped string lets go while it is still stretched, and would spoil the order as an integrand.
    """
    mech = model.mechanism
    strings, nodes = counts(model)
    kind: Any = ca.MX if mech.large else ca.SX  # no calls of staged functions: they would not know the mode
    z, w = kind.sym("z", model.nx + work), kind.sym("w", model.nu + strings + nodes)
    N, V, time = model.unpack(z[: model.nx])
    u, taut, touching = w[: model.nu], w[model.nu : model.nu + strings].T, w[model.nu + strings :].T
    held = held_scene(model.scene, taut if strings else None, touching)
    acceleration = forward_dynamics(model, N, V, u, time, held)[0]
    parts = [model.pack(V, acceleration, 1)]
    if work:
        if model.scene.supports is None:
            push = forces.total(held, mech, N, V, u, time)
        else:  # reactions of moved supports work too
            push = ca.mtimes(acceleration, sparse(mech.M))
        parts.append(ca.sum2(ca.sum1(push * V)))
    return ca.Function("held", [z, w], ca.cse([ca.densify(ca.vertcat(*parts))]), ["z", "w"], ["zdot"])


def potential(model: Model) -> ca.Function:
    """(x, u) -> elastic and gravity energy, J."""
    kind: Any = ca.MX if model.mechanism.large else ca.SX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    total = ca.densify(sum(forces.potential(model.scene, model.mechanism, model.unpack(x)[0], u)))
    return ca.Function("potential", [x, u], [total], ["x", "u"], ["potential"])


def counts(model: Model) -> tuple[int, int]:
    """How many strings can go slack, and how many nodes can meet the ground."""
    scene = model.scene
    slack = isinstance(scene.slack, Clip) and not isinstance(scene.control, ForceDensity)
    return len(scene.modelled.strings) if slack else 0, len(model.mechanism.first) if scene.ground is not None else 0


def held_scene(scene: Scene, taut: Any | None, touching: Any) -> Scene:
    """The scene whose strings pull where `taut` is 1 (1×α; None: as they do), and whose ground pushes where `touching` is 1 (1×n)."""
    changes: dict[str, Any] = {}
    if taut is not None:
        changes["slack"] = Held(taut)
    if scene.ground is not None:
        own = {field.name: getattr(scene.ground, field.name) for field in fields(scene.ground)}
        changes["ground"] = _HeldGround(**own, touching=touching)
    return replace(scene, **changes)


def _approach(ground: Ground, N: Any, V: Any) -> tuple[Any, Any]:
    """Depth, m, and speed out of the ground, m/s (1×n)."""
    normal = ca.DM(ground.normal).T
    return ground.height - ca.mtimes(normal, N), ca.mtimes(normal, V)


class _Switching(Clip):
    """In place of γ a length: positive where a string is longer than at rest and its tension positive."""

    def force_density(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any) -> Any:
        length = ca.sqrt(squared + (1e-9 * unit) ** 2)
        stretch = length - rest
        if rate is None:
            return stretch
        elastic = ca.DM(np.where(stiffness.full() > 0, stiffness.full(), 1.0))
        return ca.fmin(stretch, (stiffness * stretch + rate / length) / elastic)


@dataclass(frozen=True, eq=False)
class Held(Clip):
    """The law of strings that pull where `taut` is 1 (1×α), whatever their length."""

    taut: Any

    def force_density(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any) -> Any:
        """γ, which pushes where a string that is held taut is too short."""
        safe = squared + (1e-9 * unit) ** 2
        gamma = stiffness * (1 - rest / ca.sqrt(safe))
        return self.taut * (gamma if rate is None else gamma + rate / safe)


@dataclass(frozen=True, eq=False)
class _HeldGround(Ground):
    """The ground under nodes that it pushes where `touching` is 1 (1×n), whatever their depth."""

    touching: Any = None

    def forces(self, N: Any, V: Any) -> Any:
        depth, speed = _approach(self, N, V)
        push = self.touching * (self.stiffness * depth - self.damping * speed)
        normal = ca.DM(self.normal)
        W = ca.mtimes(normal, push)
        if self.friction is not None:
            slip = V - ca.mtimes(normal, speed)
            W = W - slip * ca.repmat(self.friction * push / ca.sqrt(ca.sum1(slip * slip) + self.slip_speed**2), 3, 1)
        return W

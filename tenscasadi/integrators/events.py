"""Events: strings that go slack or taut and nodes that meet or leave the ground, and the smooth motion between two events.

A mode says of each string whether it pulls, and of each contact of a node with a ground whether it pushes (1 or 0). Within a mode all forces are
smooth; where a switching function changes its sign, the mode changes.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.binding import bind
from tenscasadi.util.casadi_tools import sparse


def build_switching(model: Model) -> ca.Function | None:
    """Return (x, u) -> g (k,), m: positive where the mode is 1; strings first, then contacts. None where the scene has no events."""
    scene, mech = model.scene, model.mechanism
    strings, contacts = count_switches(model)
    if strings + contacts == 0:
        return None
    x, u = model.symbols(not mech.large)
    N, V, _ = model.unpack(x)
    rows = [forces.string_gaps(scene, mech, N, V, u)] if strings else []
    rows += [ground.switching(N[:, columns], V[:, columns]) for ground, columns, _ in forces.contacts(bind(scene, u)[0], mech)]
    return ca.Function("switching", [x, u], ca.cse([ca.densify(ca.horzcat(*rows).T)]), ["x", "u"], ["g"])


def build_held_ode(model: Model, work: bool = False) -> ca.Function:
    """Return (z, w) -> zdot: the motion in the mode of w = (u, mode (k,)), whatever the switching functions say; z is x.

    With `work`, z has one entry more: the work of all forces, J. `potential` tells how much of it comes out of the model's energy: that
    has kinks of its own, where a damped string lets go while it is still stretched, and would spoil the order as an integrand.
    """
    kind: Any = ca.MX if model.mechanism.large else ca.SX  # no calls of staged functions: they would not know the mode
    z, w = kind.sym("z", model.nx + work), kind.sym("w", model.nw + sum(count_switches(model)))
    N, V, time = model.unpack(z[: model.nx])
    u, mode = split_mode(model, w)
    acceleration = forward_dynamics(model, N, V, u, time, mode)[0]
    parts = [model.pack(V, acceleration, 1)]
    if work:
        mech = model.weighted(u, inverse=False)
        if model.scene.supports is None:
            push = forces.total(model.scene, mech, N, V, u, time, mode)
        else:  # reactions of moved supports work too
            push = ca.mtimes(acceleration, sparse(mech.M))
        parts.append(ca.sum2(ca.sum1(push * V)))
    return ca.Function("held", [z, w], ca.cse([ca.densify(ca.vertcat(*parts))]), ["z", "w"], ["zdot"])


def split_mode(model: Model, w: Any) -> tuple[Any, forces.Mode]:
    """Return u (nw,), the control and the parameters, and the mode in w = (u, mode (k,))."""
    nu, (strings, contacts) = model.nw, count_switches(model)
    return w[:nu], forces.Mode(w[nu : nu + strings].T if strings else None, w[nu + strings :].T if contacts else None)


def build_potential(model: Model) -> ca.Function:
    """Return (x, u) -> elastic and gravity energy, J."""
    x, u = model.symbols(not model.mechanism.large)
    mech = model.weighted(u, inverse=False)
    total = ca.densify(sum(forces.potential_energy(model.scene, mech, model.unpack(x)[0], u)))
    return ca.Function("potential", [x, u], [total], ["x", "u"], ["potential"])


def count_switches(model: Model) -> tuple[int, int]:
    """Count the strings that can go slack and the contacts that nodes can have with grounds."""
    scene = model.scene
    contacts = forces.contacts(scene, model.mechanism)
    return len(scene.switching_strings), contacts[-1][2].stop if contacts else 0

"""What every motion of a model keeps, whatever its strings do: bar lengths, joints, momenta, the plane it lies in.

Rows of a goal that repeat these have linearly dependent gradients with the dynamics, so that no solver can impose them: they are
left out (`ocp.reduction`), after a check that they hold by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.momentum import AXES, bodies, momentum_rows
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


class UnreachableGoal(ValueError):
    """The goals contradict each other, the bars' lengths, what the motion keeps whatever the strings do, or the time there is."""


@dataclass(frozen=True, eq=False)
class Invariant:
    """A group of rows that stay zero along every motion: CasADi expressions of the state and the time since the start."""

    kind: str
    value: Any
    names: tuple[str, ...]
    units: tuple[str, ...]  # "m", "m/s", "m²/s" or "s"


def invariants(model: Model, start: Array, x: Any, time: Any) -> list[Invariant]:
    """The groups of rows that vanish at the symbolic state x (nx), `time` seconds after `start` (nx,); groups that a model lacks are left out."""
    N, V, clock = model.unpack(x)
    N0, V0 = (np.asarray(Z).T for Z in _numbers(model, start))
    scene = model.scene
    groups = [*_constraints(model, x)]
    if scene.has_clock:
        groups.append(Invariant("clock", clock - float(start[-1]) - time, ("the clock runs",), ("s",)))
    if scene.ground is None and scene.pressure is None and scene.forces is None and scene.supports is None:
        gravity = np.zeros(3) if scene.gravity is None else np.array(scene.gravity.acceleration)
        rows = [momentum_rows(body, model.mechanism, (N, V), x, start, gravity, time) for body in bodies(model.structure, gravity)]
        values, names, units = zip(*rows, strict=True)
        groups.append(Invariant("momentum", ca.vertcat(*values), sum(names, ()), sum(units, ())))
        groups += _plane(N, V, N0, V0, gravity)
    return [group for group in groups if group.names]


def _numbers(model: Model, start: Array) -> tuple[Array, Array]:
    """Columns of N and V as rows."""
    x = ca.SX.sym("x", model.nx)
    N, V, _ = model.unpack(x)
    values = ca.Function("columns", [x], [N, V])(start)
    return values[0].full().T, values[1].full().T


def _constraints(model: Model, x: Any) -> list[Invariant]:
    mech, rows = model.mechanism, model.constraints(x)
    groups = []
    if mech.bars:
        names = tuple(f"bar {k} keeps its length" for k in range(mech.bars))
        groups.append(Invariant("bar", ca.vertcat(rows.bars, rows.bar_rates), 2 * names, ("m",) * mech.bars + ("m/s",) * mech.bars))
    if mech.joints:
        held = np.flatnonzero(mech.active.T.ravel()).tolist()
        names = tuple(f"joint {k // 3} holds along {AXES[k % 3]}" for k in held)
        groups.append(Invariant("joint", ca.vertcat(rows.joints, rows.joint_rates), 2 * names, ("m",) * len(held) + ("m/s",) * len(held)))
    return groups


def _plane(N: Any, V: Any, N0: Array, V0: Array, gravity: Array) -> list[Invariant]:
    """A structure that starts flat stays in its plane (or on its line): all forces act along members or gravity."""
    size = np.ptp(N0, axis=1).max(initial=1e-300)
    speeds = np.column_stack([V0, gravity])
    reach = np.column_stack([(N0 - N0[:, :1]) / size, speeds / max(np.abs(speeds).max(), 1e-300)])
    left, values, _ = np.linalg.svd(reach)
    normals = left[:, int(np.sum(values > 1e-9)) :]
    if not normals.shape[1]:
        return []
    value = ca.vertcat(*(ca.vec(ca.mtimes(ca.DM(normals).T, Z)) for Z in (N - ca.DM(N0), V)))
    count = N.shape[1] * normals.shape[1]
    return [Invariant("plane", value, ("every node stays in the plane of the start",) * 2 * count, ("m",) * count + ("m/s",) * count)]

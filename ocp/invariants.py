"""What every motion of a model keeps, whatever its strings do: bar lengths, joints, momenta, the plane it lies in.

Rows of a goal that repeat these have linearly dependent gradients with the dynamics, so that no solver can impose them: they are
left out (`ocp.reduction`), after a check that they hold by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.algebra import sparse
from tenscasadi.model import Model
from tenscasadi.structure import Structure
from tenscasadi.validate import Array

AXES = "xyz"


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
    groups = [*_constraints(model, N, V, clock)]
    if scene.has_clock:
        groups.append(Invariant("clock", clock - float(start[-1]) - time, ("the clock runs",), ("s",)))
    if scene.ground is None and scene.pressure is None and scene.forces is None and scene.supports is None:
        gravity = np.zeros(3) if scene.gravity is None else np.array(scene.gravity.acceleration)
        groups += _momentum(model, N, V, N0, V0, gravity, time)
        groups += _plane(N, V, N0, V0, gravity)
    return [group for group in groups if group.names]


def _numbers(model: Model, start: Array) -> tuple[Array, Array]:
    """Columns of N and V as rows."""
    x = ca.SX.sym("x", model.nx)
    N, V, _ = model.unpack(x)
    values = ca.Function("columns", [x], [N, V])(start)
    return values[0].full().T, values[1].full().T


def _constraints(model: Model, N: Any, V: Any, clock: Any) -> list[Invariant]:
    mech = model.mechanism
    groups = []
    if mech.bars:
        B, Bd = (ca.mtimes(Z, sparse(mech.C_b.T)) for Z in (N, V))
        length = ca.DM(mech.lengths).T
        value = ca.vertcat(((ca.sum1(B * B) / length - length) / 2).T, (ca.sum1(B * Bd) / length).T)
        names = tuple(f"bar {k} keeps its length" for k in range(mech.bars))
        groups.append(Invariant("bar", value, 2 * names, ("m",) * mech.bars + ("m/s",) * mech.bars))
    if mech.joints:
        D, Dd, _ = model.targets(clock)
        held = np.flatnonzero(mech.active.T.ravel()).tolist()
        value = ca.vertcat(*(ca.vec(ca.mtimes(Z, sparse(mech.P)) - wanted)[held] for Z, wanted in ((N, D), (V, Dd))))
        names = tuple(f"joint {k // 3} holds along {AXES[k % 3]}" for k in held)
        groups.append(Invariant("joint", value, 2 * names, ("m",) * len(held) + ("m/s",) * len(held)))
    return groups


def free_motions(structure: Structure, gravity: Array) -> tuple[NDArray[np.bool_], list[tuple[Array, Array]]]:
    """The axes (3,) bool along which nothing holds the structure, and the rotations (t, ω) whose momentum is kept.

    A rotation moves node r by t + ω×(r − c), c the centre of mass along the free axes: its momentum is conserved when it moves no
    pinned coordinate, wherever the nodes are, and no weight (Noether's theorem). A single pin leaves three rotations, two pins one.
    """
    attached = np.zeros(len(structure.nodes), dtype=bool)
    attached[structure.bars] = True
    attached[structure.strings] = True
    fixed = structure.fixed & attached[:, None]
    along: NDArray[np.bool_] = np.logical_not(fixed.any(axis=0))
    size = np.ptp(structure.nodes, axis=0).max(initial=1e-300)
    origin = structure.nodes.mean(axis=0)
    conditions = [np.eye(6)[axis] for axis in range(3) if along[axis]]
    for node, axis in np.argwhere(fixed):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        row = np.eye(6)[axis]  # (t + ω×r)_a = t_a + ω_b r_c − ω_c r_b
        for other, turn, sign in ((c, b, 1.0), (b, c, -1.0)):
            if fixed[node, other]:
                row[3 + turn] += sign * (structure.nodes[node, other] - origin[other]) / size
            else:
                conditions.append(np.eye(6)[3 + turn])
        conditions.append(row)
    if gravity.any():
        g = gravity / np.linalg.norm(gravity)
        cross = np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])  # g×ω
        conditions += [np.concatenate([np.zeros(3), cross[axis]]) for axis in range(3) if not along[axis]]
        conditions.append(np.concatenate([g, np.zeros(3)]))
    _, values, right = np.linalg.svd(np.array(conditions) if conditions else np.zeros((1, 6)))
    rank = int(np.sum(values > 1e-9))
    rotations = []
    for vector in right[rank:]:
        t, omega = vector[:3] * size, vector[3:]
        if np.linalg.norm(omega) > 1e-9:
            rotations.append((t - np.cross(omega, np.where(along, 0.0, origin)), omega))
    return along, rotations


def _momentum(model: Model, N: Any, V: Any, N0: Array, V0: Array, gravity: Array, time: Any) -> list[Invariant]:
    along, rotations = free_motions(model.structure, gravity)
    M = model.mechanism.M
    weight = np.asarray(M.sum(axis=1)).ravel()
    mass = float(weight.sum())
    if mass == 0.0:
        return []

    def momenta(N: Any, V: Any) -> tuple[Any, Any, Any]:
        centre, drift = (ca.mtimes(Z, ca.DM(weight)) / mass for Z in (N, V))
        arms = N - ca.repmat(centre * ca.DM(along.astype(float)), 1, N.shape[1])
        P = ca.mtimes(V, sparse(M))  # 3×n momenta of the columns
        turning = [arms[b, :] * P[c, :] - arms[c, :] * P[b, :] for b, c in ((1, 2), (2, 0), (0, 1))]  # r×p
        spin = [ca.dot(ca.DM(t), ca.sum2(P)) + ca.sum2(sum(omega[a] * turning[a] for a in range(3))) for t, omega in rotations]
        return centre, drift, ca.vertcat(*spin) / mass if spin else ca.DM.zeros(0, 1)

    c, v, spin = momenta(N, V)
    c0, v0, spin0 = momenta(ca.DM(N0), ca.DM(V0))
    g = ca.DM(gravity)
    axes = np.flatnonzero(along).tolist()
    value = ca.vertcat((c - c0 - v0 * time - g * time**2 / 2)[axes], (v - v0 - g * time)[axes], spin - spin0)
    names = [f"the centre of mass {what} along {AXES[axis]}" for what in ("follows its path", "keeps its speed") for axis in axes]
    names += [f"the angular momentum about ({', '.join(f'{w:.2g}' for w in omega)}) is kept" for _, omega in rotations]
    units = ("m",) * len(axes) + ("m/s",) * len(axes) + ("m²/s",) * len(rotations)
    return [Invariant("momentum", value, tuple(names), units)]


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

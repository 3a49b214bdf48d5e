"""Quantities that no string force changes, as constraints.

They are bar lengths, joints, momenta, and the plane of a flat structure. Goal rows that repeat them
have gradients that depend linearly on those of the dynamics, so that no solver can impose them.
Such rows are dropped (`ocp.targets.row_reduction`) after a check that they are satisfied.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse

from ocp.problem.rows import Rows
from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.body_assembly import connected_pairs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Booleans, Indices

AXES = "xyz"


def invariants(
    model: Model, start: Array, x: Any, time: Any, half_square: Any = None
) -> list[Rows]:
    """Build residuals of the conserved quantities, by kind.

    They vanish at all states that a plan can reach. They are functions of the symbolic state x
    (nx), `time` seconds after `start` (nx,), and of `half_square`, time²/2. Kinds are "bar",
    "joint", "clock", "momentum" and "plane", if the model has them.
    """
    half_square = time**2 / 2 if half_square is None else half_square
    N, V, clock = model.unpack(x)
    N0, V0 = (np.asarray(Z).T for Z in _numbers(model, start))
    scene = model.scene
    groups = [*rigid_rows(model, x)]
    if scene.has_clock:
        groups.append(Rows(clock - float(start[-1]) - time, ("the clock runs",), ("s",), "clock"))
    if conserves_momentum(scene):
        gravity = np.zeros(3) if scene.gravity is None else np.array(scene.gravity.acceleration)
        rows = [
            _momentum_rows(body, model.mechanism, (N, V), x, start, gravity, (time, half_square))
            for body in bodies(model.structure, gravity)
        ]
        values, names, units = zip(*rows, strict=True)
        groups.append(Rows(ca.vertcat(*values), sum(names, ()), sum(units, ()), "momentum"))
        groups += _plane(N, V, N0, V0, gravity)
    return [group for group in groups if group.names]


def conserves_momentum(scene: Scene) -> bool:
    """Return whether no outer force but constant gravity changes momenta."""
    return (
        scene.ground is None
        and scene.pressure is None
        and scene.forces is None
        and not scene.over_time
        and not _exchange_momentum(scene)
    )


def _exchange_momentum(scene: Scene) -> bool:
    """Return whether contact between bars changes conserved momenta.

    It does so if bars of different parts touch, or fixed bars. Friction of bars has no couple about
    their axes, so it changes the angular momentum.
    """
    if scene.bar_contact is None:
        return False
    if scene.bar_contact.friction is not None:
        return True
    s = scene.structure
    touching = s.bars[scene.bar_contact.select_pairs(s)]
    fixed = np.asarray(s.fixed.all(axis=1))[touching].all(axis=2)
    return len(bodies(s, np.zeros(3))) > 1 or bool(fixed.any())


def _numbers(model: Model, start: Array) -> tuple[Array, Array]:
    """Evaluate nodes (n, 3) [m] and velocities (n, 3) [m/s] at a state.

    `start` (nx,) is the state.
    """
    x = ca.SX.sym("x", model.nx)
    N, V, _ = model.unpack(x)
    values = ca.Function("columns", [x], [N, V])(start)
    return values[0].full().T, values[1].full().T


def rigid_rows(model: Model, x: Any) -> list[Rows]:
    """Build the constraint residuals of bars and joints.

    They are functions of the symbolic state x (nx).
    """
    mech, rows = model.mechanism, model.constraints(x)
    groups = []
    if mech.bars:
        names = tuple(f"{name} keeps its length" for name in mech.bar_names)
        groups.append(
            Rows(
                ca.vertcat(rows.bars, rows.bar_rates),
                2 * names,
                ("m",) * mech.bars + ("m/s",) * mech.bars,
                "bar",
            )
        )
    if mech.joints:
        held = np.flatnonzero(mech.active.T.ravel()).tolist()
        names = tuple(
            f"joint {k // 3} holds along {AXES[k % 3] if mech.frames is None else f'direction {k % 3}'}"
            for k in held
        )
        groups.append(
            Rows(
                ca.vertcat(rows.joints, rows.joint_rates),
                2 * names,
                ("m",) * len(held) + ("m/s",) * len(held),
                "joint",
            )
        )
    return groups


def _plane(N: Any, V: Any, N0: Array, V0: Array, gravity: Array) -> list[Rows]:
    """Build constraints that keep a flat structure in its plane.

    Nodes and velocities N, V (3×n) stay in the plane of the initial ones N0, V0. The constraints
    apply if all forces act along members or gravity. A straight structure is kept on its line.
    """
    size = np.ptp(N0, axis=1).max(initial=1e-300)
    speeds = np.column_stack([V0, gravity])
    reach = np.column_stack([(N0 - N0[:, :1]) / size, speeds / max(np.abs(speeds).max(), 1e-300)])
    left, values, _ = np.linalg.svd(reach)
    normals = left[:, int(np.sum(values > 1e-9)) :]
    if not normals.shape[1]:
        return []
    value = ca.vertcat(*(ca.vec(ca.mtimes(ca.DM(normals).T, Z)) for Z in (N - ca.DM(N0), V)))
    count = N.shape[1] * normals.shape[1]
    return [
        Rows(
            value,
            ("every node stays in the plane of the start",) * 2 * count,
            ("m",) * count + ("m/s",) * count,
            "plane",
        )
    ]


@dataclass(frozen=True, eq=False)
class Body:
    """Part of the structure without forces from other parts.

    Attributes
    ----------
    nodes : ndarray of int
        Nodes that can move.
    along : ndarray of bool, shape (3,)
        Axes along which no node is pinned.
    rotations : list of (ndarray, ndarray)
        Rotations (t, ω) with conserved momentum, see `free_motions`.
    name : str
        End of the names of its residuals, such as " of body 0".
    """

    nodes: Indices
    along: Booleans
    rotations: list[tuple[Array, Array]]
    name: str


def bodies(structure: Structure, gravity: Array) -> list[Body]:
    """Find the parts of the structure that members connect.

    Members that meet in a pinned node are not connected there. `gravity` (3,) [m/s²] decides which
    rotations conserve momentum.
    """
    pinned: Booleans = np.asarray(structure.fixed.all(axis=1), dtype=bool).reshape(-1)
    pairs = connected_pairs(structure)
    at_pin: Booleans = pinned[pairs[:, 0]] | pinned[pairs[:, 1]]
    links, held = pairs[~at_pin], pairs[at_pin]
    n = len(structure.nodes)
    graph = scipy.sparse.coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(n, n))
    count, label = scipy.sparse.csgraph.connected_components(graph, directed=False)
    groups = [np.flatnonzero((label == k) & ~pinned) for k in range(count)]
    groups = [moving for moving in groups if moving.size]
    found = []
    for k, moving in enumerate(groups):
        touching = np.unique(held[np.isin(held, moving).any(axis=1)])
        nodes = np.union1d(moving, touching[pinned[touching]])
        along, rotations = free_motions(structure.nodes[nodes], structure.held[nodes], gravity)
        found.append(Body(moving, along, rotations, f" of body {k}" if len(groups) > 1 else ""))
    return found


def free_motions(
    nodes: Array, fixed: Booleans, gravity: Array
) -> tuple[Booleans, list[tuple[Array, Array]]]:
    """Find translations and rotations of a body with conserved momentum.

    Returns the free axes (3,) of its nodes (n, 3), and the rotations (t, ω) with conserved
    momentum. A rotation moves node r by t + ω×(r − c), with c the center of mass along the free
    axes. Its momentum is conserved if it moves no pinned coordinate (`fixed`, (n, 3)) and no
    weight, wherever the nodes are (Noether's theorem). A single pin leaves three rotations, and two
    pins leave one.
    """
    along: Booleans = np.logical_not(np.asarray(fixed.any(axis=0)))
    origin = nodes.mean(axis=0)
    size = float(np.abs(nodes - origin).max()) or 1.0
    conditions = [np.eye(6)[axis] for axis in range(3) if along[axis]]
    for node, axis in np.argwhere(fixed):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        row = np.eye(6)[axis]  # (t + ω×r)_a = t_a + ω_b r_c − ω_c r_b
        for other, turn, sign in ((c, b, 1.0), (b, c, -1.0)):
            if fixed[node, other]:
                row[3 + turn] += sign * (nodes[node, other] - origin[other]) / size
            else:
                conditions.append(np.eye(6)[3 + turn])
        conditions.append(row)
    if gravity.any():
        g = gravity / np.linalg.norm(gravity)
        cross = np.array([[0.0, -g[2], g[1]], [g[2], 0.0, -g[0]], [-g[1], g[0], 0.0]])  # g×ω
        conditions += [
            np.concatenate([np.zeros(3), cross[axis]]) for axis in range(3) if not along[axis]
        ]
        conditions.append(np.concatenate([g, np.zeros(3)]))
    _, values, right = np.linalg.svd(np.array(conditions) if conditions else np.zeros((1, 6)))
    rank = int(np.sum(values > 1e-9))
    rotations = []
    for vector in right[rank:]:
        t, omega = vector[:3] * size, vector[3:]
        if np.linalg.norm(omega) > 1e-9:
            rotations.append((t - np.cross(omega, np.where(along, 0.0, origin)), omega))
    return along, rotations


def _momentum_rows(
    body: Body,
    mech: Mechanism,
    now: tuple[Any, Any],
    x: Any,
    start: Array,
    gravity: Array,
    times: tuple[Any, Any],
) -> tuple[Any, tuple[str, ...], tuple[str, ...]]:
    """Build residuals of linear and angular momentum per mass.

    They include the trajectory of the center of mass of `body`. `now` is N and V (3×n) as
    expressions of the state x (nx), `start` (nx,) the initial state. `times` are the time T after
    the start and T²/2. `gravity` (3,) is in m/s². Returns the residuals with their names and units.
    """
    time, half_square = times
    c, v, spin = _momenta(body, mech, *now)
    c0, v0, spin0 = ca.Function("begun", [x], [c, v, spin])(start)
    g = ca.DM(gravity)
    axes = np.flatnonzero(body.along).tolist()
    value = ca.vertcat(
        (c - c0 - v0 * time - g * half_square)[axes], (v - v0 - g * time)[axes], spin - spin0
    )
    names = [
        f"the center of mass{body.name} {what} along {AXES[axis]}"
        for what in ("follows its path", "keeps its speed")
        for axis in axes
    ]
    names += [
        f"the angular momentum{body.name} about ({', '.join(f'{w:.2g}' for w in omega)}) is kept"
        for _, omega in body.rotations
    ]
    units = ["m"] * len(axes) + ["m/s"] * len(axes) + ["m²/s"] * len(body.rotations)
    return value, tuple(names), tuple(units)


def _momenta(body: Body, mech: Mechanism, N: Any, V: Any) -> tuple[Any, Any, Any]:
    """Compute center of mass, its velocity, and angular momenta.

    N and V (3×n) are positions and velocities of the nodes. Momenta are divided by the mass. Pinned
    nodes are excluded. There is one angular momentum for each free rotation of the body. Returns
    expressions of (3,), (3,) and one entry per rotation.
    """
    own = np.isin(mech.physical, body.nodes)
    weight = np.asarray(mech.M.sum(axis=1)).ravel() * own
    mass = float(weight.sum())
    center, drift = (ca.mtimes(Z, ca.DM(weight)) / mass for Z in (N, V))
    arms = N - ca.repmat(center * ca.DM(body.along.astype(float)), 1, N.shape[1])
    P = ca.mtimes(V, sparse(mech.M)) * ca.repmat(
        ca.DM(own.astype(float)).T, 3, 1
    )  # 3×n momenta of the columns
    turning = [
        arms[b, :] * P[c, :] - arms[c, :] * P[b, :] for b, c in ((1, 2), (2, 0), (0, 1))
    ]  # r×p
    spin = [
        ca.dot(ca.DM(t), ca.sum2(P)) + ca.sum2(sum(omega[a] * turning[a] for a in range(3)))
        for t, omega in body.rotations
    ]
    return center, drift, ca.vertcat(*spin) / mass if spin else ca.DM.zeros(0, 1)

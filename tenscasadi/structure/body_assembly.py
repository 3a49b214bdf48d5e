"""Rigid bodies as basic nodes, massless bars and a constant mass matrix.

A point of a body at x has constant weights w on its basic nodes X, which solve [X; 1] w = [x; 1].
With H = [X; 1], the mass matrix on the basic nodes is H⁻¹ J H⁻ᵀ, where J contains the second
moments, the first moments and the mass. Massless bars keep the distances of the basic nodes. The
other nodes are dependent: constant affine combinations of the basic ones. There are four basic
nodes, three in a body without thickness, and two in a thin rod.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.sparse import block_diag, csr_array

from tenscasadi.structure.class_one import member_lengths
from tenscasadi.util.linear_algebra import fit_rotation, fit_velocities
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, TOLERANCE, Array, Indices

# relative height of a basic node: M⁻ grows with its inverse square, and keeps six digits
_MIN_HEIGHT = TOLERANCE**0.5
_PREFERENCE = 0.3  # of the largest height, from which on shared and pinned nodes are preferred


class MassMap(NamedTuple):
    """Mass matrix of a body as a function of mass m and second moments S.

    The matrix is m w wᵀ + W S Wᵀ on the basic nodes.

    Attributes
    ----------
    nodes : list of int
        Basic nodes (b,).
    center : ndarray (b,)
        Weights w of the center of mass on them.
    directions : ndarray (b, 3)
        Matrix W [1/m].
    """

    nodes: list[int]
    center: Array
    directions: Array


@dataclass(frozen=True, eq=False)
class BodyAssembly:
    """Rigid bodies of a structure in terms of its nodes.

    Bodies whose nodes lie in a plane, but not their mass, have an auxiliary node. Auxiliary nodes
    follow the structure's n nodes.

    Attributes
    ----------
    nodes : ndarray (n + h, 3)
        Positions of all nodes [m].
    bars : ndarray of int (b, 2)
        Ends of the massless bars.
    body : ndarray of int (b,)
        Body of each bar.
    lengths : ndarray (b,)
        Lengths of the bars [m].
    mass : csr_array (n + h, n + h)
        Mass matrix of the bodies [kg].
    spread : csr_array (n + h, n + h)
        Weights of independent nodes (columns) on all nodes (rows).
    dependent : ndarray of int
        Dependent nodes.
    hosts : tuple of ndarray of int
        Nodes of the body of each auxiliary node.
    maps : tuple of MassMap
        Dependence of the mass matrix on mass and inertia of each body.
    """

    nodes: Array
    bars: Indices
    body: Indices
    lengths: Array
    mass: csr_array
    spread: csr_array
    dependent: Indices
    hosts: tuple[Indices, ...]
    maps: tuple[MassMap, ...]

    def add_mass(self, M: Any) -> csr_array:
        """Add the mass matrix of the bodies to M (n, n).

        The result has the auxiliary nodes in its last rows and columns.
        """
        rest = csr_array((len(self.nodes) - M.shape[0],) * 2)
        return csr_array(block_diag([M, rest]) + self.mass)

    def find_auxiliary(self, nodes: Array, velocities: Array | None = None) -> Array:
        """Compute the auxiliary nodes' positions or velocities.

        They follow the rigid-body motion that fits the nodes of each body best.

        Parameters
        ----------
        nodes : ndarray, shape (n, 3)
            Positions [m].
        velocities : ndarray, shape (n, 3), optional
            Velocities [m/s].

        Returns
        -------
        ndarray, shape (h, 3)
            Velocities of the auxiliary nodes if they are given, else positions.
        """
        found = np.zeros((len(self.hosts), 3))
        for k, own in enumerate(self.hosts):
            start, places = self.nodes[own], nodes[own]
            mean, center = start.mean(axis=0), places.mean(axis=0)
            rotation = fit_rotation(start - mean, places - center)
            arm = rotation @ (self.nodes[len(nodes) + k] - mean)
            found[k] = center + arm
            if velocities is not None:
                drift, spin = fit_velocities(places, velocities[own])
                found[k] = drift + np.cross(spin, arm)
        return found


@dataclass(frozen=True, eq=False)
class _BasicNodes:
    """Basic nodes of one body, with weights of its other nodes.

    `basic` are the b basic nodes, without an `auxiliary` one, whose position is given. `mass` is
    the mass matrix of both [kg]. `weights` express each of the `others` by the basic nodes. Numbers
    refer to the nodes of the structure.
    """

    basic: list[int]
    auxiliary: Array  # (0 or 1, 3)
    mass: Array  # (b, b) of the basic nodes, then the auxiliary one
    center: Array  # (b,), see `MassMap`
    directions: Array  # (b, 3)
    others: list[int]
    weights: Array  # (others, b)


@dataclass(eq=False)
class _Found:
    """Collected bars, mass matrix and affine relations of all bodies.

    `pairs` are the end nodes of the massless bars, and `body` is the body of each. For `relations`
    see `_solve_relations`, for the others `BodyAssembly`.
    """

    pairs: list[tuple[int, ...]]
    body: list[int]
    relations: list[tuple[int, dict[int, float]]]
    mass: csr_array
    hosts: list[Indices]
    maps: list[MassMap]


def connected_pairs(structure: Any) -> Indices:
    """List the pairs (m, 2) of connected nodes.

    Bars, strings and bodies connect them.
    """
    bodies = [
        np.column_stack([np.full(len(body.nodes) - 1, body.nodes[0]), body.nodes[1:]])
        for body in structure.bodies
    ]
    return np.concatenate([structure.bars, structure.strings, *bodies])


def is_separate(structure: Any) -> bool:
    """Return whether an unsupported part is connected to no other part."""
    pairs, count = connected_pairs(structure), len(structure.nodes)
    links = csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    parts, label = sp.csgraph.connected_components(links, directed=False)
    return bool(parts > 1 and len(np.unique(label[structure.held.any(axis=1)])) < parts)


def assemble_bodies(structure: Any) -> BodyAssembly | None:
    """Convert a structure's bodies to basic nodes, bars and masses.

    Returns None without bodies. Raises ValueError if the nodes of a body do not fit its mass, its
    bars or its supports.
    """
    s, count = structure, len(structure.nodes)
    if not s.bodies:
        return None
    owners = np.bincount(np.concatenate([body.nodes for body in s.bodies]), minlength=count)
    preferred = (owners > 1) | s.held.any(axis=1)
    for k, body in enumerate(s.bodies):
        inside = np.isin(s.bars, body.nodes).all(axis=1)
        for bar in np.flatnonzero(inside):
            raise ValueError(
                f"bodies[{k}] has both nodes of bar {bar}, {s.bars[bar].tolist()}: remove the bar, "
                "which the body holds rigidly"
            )
    frames = [_build_frame(k, body, s.nodes, preferred) for k, body in enumerate(s.bodies)]
    auxiliary = np.concatenate([frame.auxiliary for frame in frames])
    size, fixed = count + len(auxiliary), s.fixed.all(axis=1)
    numbers = iter(range(count, size))
    found = _Found([], [], [], csr_array((size, size)), [], [])
    for k, (frame, body) in enumerate(zip(frames, s.bodies, strict=True)):
        basic = [*frame.basic, *(next(numbers) for _ in frame.auxiliary)]
        found.hosts.extend(np.array(body.nodes, dtype=np.intp) for _ in frame.auxiliary)
        found.maps.append(MassMap(basic, frame.center, frame.directions))
        ends = np.repeat(basic, len(basic)), np.tile(basic, len(basic))
        found.mass = found.mass + csr_array((frame.mass.ravel(), ends), shape=(size, size))
        for pair in combinations(basic, 2):
            held = all(node < count and fixed[node] for node in pair)
            earlier = any(set(pair) <= set(other.nodes) for other in s.bodies[:k])
            if not held and not earlier:  # otherwise supports or another body keep their distance
                found.pairs.append(pair)
                found.body.append(k)
        for node, own in zip(frame.others, frame.weights, strict=True):
            found.relations.append((k, {node: 1.0} | dict(zip(basic, -own, strict=True))))
    nodes = np.concatenate([s.nodes, auxiliary])
    bars = np.array(found.pairs, dtype=np.intp).reshape(-1, 2)
    rows = _solve_relations(s, found.relations, {node for frame in frames for node in frame.basic})
    return BodyAssembly(
        nodes,
        bars,
        np.array(found.body, dtype=np.intp),
        member_lengths("bodies", nodes, bars, "bar"),
        found.mass,
        _build_spread(rows, size),
        np.array(sorted(rows), dtype=np.intp),
        tuple(found.hosts),
        tuple(found.maps),
    )


def _build_frame(k: int, body: Any, nodes: Array, preferred: Any) -> _BasicNodes:
    """Choose the basic nodes of body number k.

    `nodes` (n, 3) are those of the structure, and `preferred` (n,) flags nodes that are chosen if
    possible. The mass matrix of the basic nodes and the weights of the other nodes follow. Raises
    ValueError if the body's nodes do not fit its inertia.
    """
    own = np.array(body.nodes, dtype=np.intp)
    X = nodes[own]
    properties = body.mass_properties(X)
    basic, Q, size = _choose_basic(k, X, preferred[own])
    origin, auxiliary = X[basic[0]], np.zeros((0, 3))
    outside = _extent_outside(properties, origin, Q)
    if len(basic) < 4 and outside > NEGLIGIBLE * size:
        if len(basic) == 2:
            raise ValueError(
                f"bodies[{k}]: its nodes {list(body.nodes)} lie on a line, but its mass does not "
                f"(radius of gyration {outside:.3g} m): add a node off the line, or give the "
                "inertia of a thin rod"
            )
        normal = np.cross(Q[:, 0], Q[:, 1])
        auxiliary = (X[basic].mean(axis=0) + size / 2 * normal)[None]
        Q = np.column_stack([Q, normal])
    places = np.concatenate([X[basic], auxiliary])
    H = np.vstack([((places - origin) @ Q).T, np.ones(len(places))])
    inverse = np.linalg.inv(H)
    moments = Q.T @ properties.moments @ Q
    if np.linalg.eigvalsh(moments)[0] < NEGLIGIBLE * np.trace(properties.moments):
        where = ["on a line", "in a plane"][len(Q.T) - 2] if len(Q.T) > 1 else "at a point"
        raise ValueError(
            f"bodies[{k}]: its mass lies {where}, but not its nodes {list(body.nodes)}: give the "
            "inertia of its thickness, or remove the nodes off its mass"
        )
    first = properties.mass * (Q.T @ (properties.center - origin))
    total = moments + np.outer(first, first) / properties.mass
    J = np.block([[total, first[:, None]], [first[None], np.array([[properties.mass]])]])
    others = [j for j in range(len(own)) if j not in basic]
    weights = (inverse @ np.vstack([((X[others] - origin) @ Q).T, np.ones(len(others))])).T
    weights[np.abs(weights) < 1e-14 * np.abs(weights).max(initial=0.0)] = 0.0
    M = inverse @ J @ inverse.T
    center = inverse @ np.append(Q.T @ (properties.center - origin), 1.0)
    return _BasicNodes(
        own[basic].tolist(),
        auxiliary,
        (M + M.T) / 2,
        center,
        inverse[:, :-1] @ Q.T,
        own[others].tolist(),
        weights,
    )


def _choose_basic(k: int, X: Array, preferred: Any) -> tuple[list[int], Array, float]:
    """Choose affinely independent nodes whose span contains the others.

    X are the positions of the nodes of body number k, in rows, and `preferred` flags those that are
    chosen if possible. Returns the chosen rows, orthonormal directions (3, d) of the span, and the
    size of the body [m].
    """
    spread = np.linalg.norm(X - X.mean(axis=0), axis=1)
    size = 2 * float(spread.max())
    chosen = [int(np.argmax(np.where(preferred, spread, -1.0) if preferred.any() else spread))]
    directions = np.zeros((3, 0))
    while len(chosen) < 4:
        arms = X - X[chosen[0]]
        arms = arms - arms @ directions @ directions.T
        height = np.linalg.norm(arms, axis=1)
        best = int(height.argmax())
        if height[best] <= NEGLIGIBLE * size:
            break
        if height[best] < _MIN_HEIGHT * size:
            shape = {1: "a point", 2: "a line", 3: "a plane"}[len(chosen)]
            raise ValueError(
                f"bodies[{k}]: its nodes lie within {height[best]:.2g} m of {shape}: move them "
                f"onto it, or add a node at least {_MIN_HEIGHT * size:.2g} m off it"
            )
        liked = np.where(preferred & (height >= _PREFERENCE * height[best]), height, 0.0)
        pick = int(liked.argmax()) if liked.any() else best
        chosen.append(pick)
        directions = np.column_stack([directions, arms[pick] / height[pick]])
    if len(chosen) < 2:
        raise ValueError(f"bodies[{k}]: its nodes lie at one point: give nodes at several points")
    return chosen, directions, size


def _extent_outside(own: Any, origin: Array, Q: Array) -> float:
    """Compute how far a body's mass extends from a plane or line [m].

    `own` are the mass properties of the body. The plane or line contains `origin` and the
    orthonormal directions Q (3, d).
    """
    across = np.eye(3) - Q @ Q.T
    gyration = np.sqrt(max(float(np.trace(across @ own.moments @ across)), 0.0) / own.mass)
    thin = float(np.sqrt(NEGLIGIBLE * np.trace(own.moments) / own.mass))  # of rounded moments
    offset = float(np.linalg.norm(across @ (own.center - origin)))
    return max(gyration if gyration > thin else 0.0, offset)


def _solve_relations(
    structure: Any, relations: list[tuple[int, dict[int, float]]], basic: set[int]
) -> dict[int, dict[int, float]]:
    """Solve affine relations between nodes for dependent nodes.

    A relation is a body and coefficients by node whose weighted sum of positions vanishes.
    Dependent nodes have no supports. Returns the weights of independent nodes by dependent node.
    `basic` are the basic nodes of all bodies, which become dependent only if no other node can.
    """
    columns = sorted({node for _, relation in relations for node in relation})
    real = np.array([node < len(structure.nodes) for node in columns], dtype=bool)
    own = np.array(columns, dtype=np.intp)[real]
    held, fixed = np.zeros((2, len(columns)), dtype=bool)
    held[real], fixed[real] = structure.held[own].any(axis=1), structure.fixed[own].all(axis=1)
    attached = np.array([node not in basic for node in columns])
    solved: dict[int, Array] = {}  # by column
    for k, relation in relations:
        row = np.array([relation.get(node, 0.0) for node in columns])
        for column, other in solved.items():
            row -= row[column] * other
        row[np.abs(row) < ROUNDING] = 0.0
        if fixed[row != 0.0].all():  # it follows from other bodies or from pins
            continue
        free = np.where(held, 0.0, np.abs(row))
        liked = np.where(attached & (free >= 0.1 * free.max()), free, 0.0)
        pivot = int(liked.argmax() if liked.any() else free.argmax())
        if not free[pivot]:
            nodes = [columns[column] for column in np.flatnonzero(row)]
            raise ValueError(
                f"bodies[{k}]: nodes {nodes} depend on each other, and all have supports: remove "
                "the support of one, which the body holds, or pin them along all axes"
            )
        row /= row[pivot]
        solved = {column: other - other[pivot] * row for column, other in solved.items()}
        solved[pivot] = row
    return {
        columns[pivot]: {columns[c]: -row[c] for c in np.flatnonzero(row) if c != pivot}
        for pivot, row in solved.items()
    }


def _build_spread(rows: dict[int, dict[int, float]], size: int) -> csr_array:
    """Build the matrix (size, size) from independent nodes to all nodes.

    `rows` has the weights of independent nodes by dependent node. Other nodes have weight 1 on
    themselves.
    """
    entries = [(node, node, 1.0) for node in range(size) if node not in rows]
    entries += [
        (node, other, weight) for node, own in rows.items() for other, weight in own.items()
    ]
    row, column, value = zip(*entries, strict=True)
    return csr_array((value, (row, column)), shape=(size, size))

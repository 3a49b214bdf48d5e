"""NTRT rods that represent a rigid body."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tenscasadi.exchange.ntrt.rigid_groups import RigidPart
from tenscasadi.structure.class_one import measure_diagonal
from tenscasadi.structure.rigid_body import MassProperties
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.validate import NEGLIGIBLE, Array

optimize = lazy_module("scipy.optimize")


class Rod(NamedTuple):
    """Rod of NTRT: two nodes, mass [kg] and radius [m]."""

    nodes: tuple[int, int]
    mass: float
    radius: float


def find_body_rods(nodes: Array, wanted: MassProperties) -> tuple[Array, list[Rod]]:
    """Find rods with the mass, center and inertia of a body.

    These properties are `wanted`. The rods join the nodes (k, 3) of the body. If no rods between
    these have its inertia, the ends of three rods along its principal axes are added.

    Returns
    -------
    points : ndarray, shape (k or up to k + 6, 3)
        Nodes of the rods [m].
    rods : list of Rod
        Rods, of which some only join nodes and have no mass.
    """
    size = measure_diagonal(nodes)
    b = _moments(wanted, wanted, size)
    thin, stout = float(np.sqrt(NEGLIGIBLE)), 0.5  # radius by length: nearly a line; a stub
    for points in (nodes, np.concatenate([nodes, _find_cross(wanted)])):
        parts = [
            RigidPart(pair, points[list(pair)], 1.0, ratio * length)
            for pair in combinations(range(len(points)), 2)
            if (length := float(np.linalg.norm(points[pair[1]] - points[pair[0]])))
            > NEGLIGIBLE * size
            for ratio in (thin, stout)
        ]
        A = np.stack([_moments(part.mass_properties(), wanted, size) for part in parts], axis=1)
        shares, missed = optimize.nnls(A / A[0], b)
        if missed <= NEGLIGIBLE:
            break
    rods = []
    for part, lean, fat in zip(parts[::2], shares[::2], shares[1::2], strict=True):
        if lean + fat > 0:  # both on one line act as one rod between them
            radius = part.length * np.sqrt((lean * thin**2 + fat * stout**2) / (lean + fat))
            rods.append(Rod(part.nodes, float((lean + fat) * wanted.mass), float(radius)))
    return points, rods + _join_nodes(points, rods)


def _find_cross(wanted: MassProperties) -> Array:
    """Find the ends (up to 6, 3) of crossed rods with given moments.

    `wanted` are the mass properties of the rods together.
    """
    values, axes = np.linalg.eigh(wanted.moments)
    some = values > NEGLIGIBLE * values.max()
    arms = np.sqrt(3 * some.sum() * values[some] / wanted.mass)[:, None] * axes.T[some]
    return np.asarray(wanted.center + np.concatenate([arms, -arms]))


def _moments(own: MassProperties, wanted: MassProperties, size: float) -> Array:
    """Compute normalized mass, first and second moments (10,).

    They are those of `own`. The moments are about the center of `wanted`. They are divided by its
    mass and powers of the length `size`.
    """
    arm = own.center - wanted.center
    second = (own.moments + own.mass * np.outer(arm, arm))[np.triu_indices(3)]
    moments = np.concatenate([[own.mass], own.mass * arm / size, second / size**2])
    return np.asarray(moments / wanted.mass)


def _join_nodes(points: Array, rods: list[Rod]) -> list[Rod]:
    """Find massless rods that connect otherwise separate nodes.

    `points` (n, 3) are the nodes [m], and `rods` the known rods. Returns only the new ones.
    """
    ends = np.array([rod.nodes for rod in rods], dtype=np.intp).reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(len(points), len(points)))
    first = np.unique(connected_components(links, directed=False)[1], return_index=True)[1]
    spans = np.linalg.norm(points[first] - points[first[0]], axis=1)
    return [
        Rod((int(first[0]), int(node)), 0.0, float(span) / 100)
        for node, span in zip(first[1:], spans[1:], strict=True)
    ]

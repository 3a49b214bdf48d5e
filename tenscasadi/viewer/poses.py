"""Where instances of a mesh stand: members as stretched copies of one cylinder, nodes as copies of one ball."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.util.validate import Array, Indices

Floats = NDArray[np.float32]


class Mesh(NamedTuple):
    """Vertices (v, 3) and triangles (f, 3)."""

    vertices: Array
    faces: Indices


class Poses(NamedTuple):
    """Places (m, 3), quaternions (m, 4), w first, and scales (m, 3) of m copies."""

    places: Floats
    turns: Floats
    scales: Floats


def cylinder(sides: int) -> Mesh:
    """Return an open cylinder of radius 1 about z from −1/2 to 1/2: joints cover its ends."""
    angles = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angles), np.sin(angles)])
    vertices = np.vstack([np.column_stack([ring, np.full(sides, end)]) for end in (-0.5, 0.5)])
    a = np.arange(sides)
    b = (a + 1) % sides
    return Mesh(
        vertices,
        np.vstack([np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])]),
    )


def ball(rings: int = 6, sides: int = 10) -> Mesh:
    """Return a ball of radius 1 as `rings` bands of `sides` quadrangles."""
    theta = np.pi * np.arange(rings + 1) / rings
    phi = 2 * np.pi * np.arange(sides) / sides
    round_ = np.stack(
        [
            np.outer(np.sin(theta), np.cos(phi)),
            np.outer(np.sin(theta), np.sin(phi)),
            np.outer(np.cos(theta), np.ones(sides)),
        ],
        axis=2,
    )
    a = (np.arange(rings)[:, None] * sides + np.arange(sides)).ravel()
    b = (np.arange(rings)[:, None] * sides + (np.arange(sides) + 1) % sides).ravel()
    return Mesh(
        round_.reshape(-1, 3),
        np.vstack([np.column_stack([a, a + sides, b + sides]), np.column_stack([a, b + sides, b])]),
    )


def octahedron() -> Mesh:
    """Return the ball of radius 1 with the fewest faces."""
    corners = np.vstack([np.eye(3), -np.eye(3)])
    upper = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2)]
    return Mesh(corners, np.array(upper + [(b, a, 5) for a, b, _ in upper]))


def cone(sides: int = 12) -> Mesh:
    """Return a cone that stands below its tip at the origin, 2 high and 1 in radius."""
    angles = 2 * np.pi * np.arange(sides) / sides
    rim = np.column_stack([np.cos(angles), np.sin(angles), np.full(sides, -2.0)])
    a = np.arange(sides)
    b = (a + 1) % sides
    tip, foot = np.full(sides, sides), np.full(sides, sides + 1)
    vertices = np.vstack([rim, (0.0, 0.0, 0.0), (0.0, 0.0, -2.0)])
    return Mesh(vertices, np.vstack([np.column_stack([a, b, tip]), np.column_stack([b, a, foot])]))


def member_poses(nodes: Array, members: Indices, radius: float | Array) -> Poses:
    """Return the poses that make `cylinder` the members (m, 2) between nodes (n, 3); one with an end that is not finite has size 0."""
    first, second = nodes[members[:, 0]], nodes[members[:, 1]]
    known: NDArray[np.bool_] = np.asarray(
        np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    )
    first, second = (np.where(known[:, None], ends, 0.0) for ends in (first, second))
    along = second - first
    length = np.sqrt(np.einsum("ij,ij->i", along, along))
    direction = along / np.where(length > 0, length, 1.0)[:, None]
    # The shortest turn of z to a direction d is (1 + d_z, −d_y, d_x, 0), normalised; against z any
    # half turn.
    turns = np.stack(
        [1 + direction[:, 2], -direction[:, 1], direction[:, 0], np.zeros(len(members))], axis=1
    )
    size = np.sqrt(np.einsum("ij,ij->i", turns, turns))[:, None]
    turns = np.where(size > 1e-6, turns / np.maximum(size, 1e-6), (0.0, 1.0, 0.0, 0.0))
    scales = np.stack([radius * known, radius * known, length], axis=1)
    return Poses(
        ((first + second) / 2).astype(np.float32),
        turns.astype(np.float32),
        scales.astype(np.float32),
    )


def coarse(values: Floats, grain: float) -> Floats:
    """Round values to multiples of a power of two, at most `grain`; 0: leave them. Their last bits are then 0, and take no room when packed."""
    if grain == 0:
        return values
    step = np.float32(2.0 ** np.floor(np.log2(grain)))
    return np.asarray(np.round(values / step) * step, dtype=np.float32)


def node_places(nodes: Array) -> Floats:
    """Return places (n, 3) of nodes; those that are not finite lie at the origin."""
    known: NDArray[np.bool_] = np.asarray(np.isfinite(nodes).all(axis=1))
    return np.where(known[:, None], nodes, 0.0).astype(np.float32)

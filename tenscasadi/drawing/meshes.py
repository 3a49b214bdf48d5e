"""Triangle meshes, and poses of their copies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.util.validate import Array, Indices

Floats = NDArray[np.float32]


class Mesh(NamedTuple):
    """Triangle mesh.

    `vertices` (v, 3) are positions, and `faces` (f, 3) the vertices of triangles.
    """

    vertices: Array
    faces: Indices


class Poses(NamedTuple):
    """Poses of m copies of a mesh.

    Attributes
    ----------
    positions, scales : ndarray, shape (m, 3)
        Positions [m] and scales along the axes of the mesh.
    quaternions : ndarray, shape (m, 4)
        Rotations, w first.
    """

    positions: Floats
    quaternions: Floats
    scales: Floats

    def round(self, grain: float) -> Poses:
        """Round positions and scales to a resolution `grain` [m].

        Rotations are rounded likewise. A grain of 0 changes nothing.
        """
        if grain == 0:
            return self
        positions, scales = (
            round_floats(values, grain) for values in (self.positions, self.scales)
        )
        return Poses(positions, round_floats(self.quaternions, 2.0**-13), scales)


def build_cylinder(sides: int) -> Mesh:
    """Build an open cylinder of radius 1 and length 1.

    It has as many faces as `sides`.
    """
    ring = _build_ring(sides)
    vertices = np.vstack([np.column_stack([ring, np.full(sides, end)]) for end in (-0.5, 0.5)])
    a = np.arange(sides)
    b = (a + 1) % sides
    return Mesh(
        vertices,
        np.vstack([np.column_stack([a, b, b + sides]), np.column_stack([a, b + sides, a + sides])]),
    )


def build_cone(sides: int = 12) -> Mesh:
    """Build a cone with its tip at the origin.

    It has as many faces as `sides`. It has the radius 1 and the height 2.
    """
    rim = np.column_stack([_build_ring(sides), np.full(sides, -2.0)])
    a = np.arange(sides)
    b = (a + 1) % sides
    tip, base = np.full(sides, sides), np.full(sides, sides + 1)
    vertices = np.vstack([rim, (0.0, 0.0, 0.0), (0.0, 0.0, -2.0)])
    return Mesh(vertices, np.vstack([np.column_stack([a, b, tip]), np.column_stack([b, a, base])]))


def build_arrowhead() -> Mesh:
    """Build a cone of radius 1 and length 1."""
    cone = build_cone()
    return Mesh(0.5 * cone.vertices * (2.0, 2.0, 1.0) + (0.0, 0.0, 0.5), cone.faces)


def build_ball(rings: int = 6, sides: int = 10) -> Mesh:
    """Build a sphere of radius 1 from rings of quadrangles.

    Each ring has as many as `sides`.
    """
    theta, phi = np.pi * np.arange(rings + 1) / rings, _build_ring(sides)
    z = np.broadcast_to(np.cos(theta)[:, None, None], (rings + 1, sides, 1))
    vertices = np.concatenate([np.sin(theta)[:, None, None] * phi, z], axis=2).reshape(-1, 3)
    row = np.arange(rings)[:, None] * sides
    a = (row + np.arange(sides)).ravel()
    b = (row + (np.arange(sides) + 1) % sides).ravel()
    faces = [np.column_stack([a, a + sides, b + sides]), np.column_stack([a, b + sides, b])]
    return Mesh(vertices, np.vstack(faces))


def _build_ring(sides: int) -> Array:
    angles = 2 * np.pi * np.arange(sides) / sides
    return np.column_stack([np.cos(angles), np.sin(angles)])


def stretch_cylinders(ends: Array, radius: Array) -> Poses:
    """Compute the poses of cylinders between given ends.

    The ends are (m, 2, 3) [m]. `radius` (m,) is in m. Members with an end that is not finite have
    no size.
    """
    known = np.asarray(np.isfinite(ends).all(axis=(1, 2)))
    first, second = np.where(known[:, None, None], ends, 0.0).swapaxes(0, 1)
    along = second - first
    length = np.linalg.norm(along, axis=1)
    direction = along / np.where(length > 0, length, 1.0)[:, None]
    # The smallest rotation from z to a direction d is (1 + d_z, −d_y, d_x, 0), normalized. Against
    # z it is any half turn.
    turns = np.stack(
        [1 + direction[:, 2], -direction[:, 1], direction[:, 0], np.zeros(len(ends))], axis=1
    )
    norms = np.linalg.norm(turns, axis=1)[:, None]
    turns = np.where(norms > 1e-6, turns / np.maximum(norms, 1e-6), (0.0, 1.0, 0.0, 0.0))
    scales = np.stack([radius * known, radius * known, length], axis=1)
    middle = (first + second) / 2
    return Poses(*(part.astype(np.float32) for part in (middle, turns, scales)))


def place_balls(centers: Array, radius: Array) -> Poses:
    """Compute the poses of upright copies at given centers.

    The centers are (m, 3) [m]. `radius` (m,) scales the copies. Copies at a position that is not
    finite have no size.
    """
    known = np.asarray(np.isfinite(centers).all(axis=1))
    upright = np.tile(np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32), (len(centers), 1))
    scales = np.repeat((radius * known)[:, None], 3, axis=1)
    positions = np.where(known[:, None], centers, 0.0)
    return Poses(positions.astype(np.float32), upright, scales.astype(np.float32))


def round_floats(values: Floats, grain: float) -> Floats:
    """Round values to multiples of a power of two.

    It is at most `grain`. The last bits are then zero, so that the values compress well.
    """
    step = np.float32(2.0 ** np.floor(np.log2(grain)))
    return np.asarray(np.round(values / step) * step, dtype=np.float32)

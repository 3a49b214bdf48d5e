"""Faces of rigid bodies as triangles."""

from __future__ import annotations

import numpy as np

from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices


def find_hulls(structure: Structure | None) -> list[Indices]:
    """Find the faces (f, 3) of each rigid body.

    They are triangles of node indices: the given ones, or those of the convex hull. Bodies whose
    nodes lie on a line have no hull.
    """
    bodies = () if structure is None else structure.bodies
    nodes = np.zeros((0, 3)) if structure is None else structure.nodes
    found = []
    for body in bodies:
        own = np.array(body.nodes, dtype=np.intp)
        found.append(
            own[_find_triangles(nodes[own])]
            if body.faces is None
            else np.array(body.faces, dtype=np.intp).reshape(-1, 3)
        )
    return found


def _find_triangles(points: Array) -> Indices:
    """Find the convex hull (f, 3) of points (k, 3)."""
    from scipy.spatial import ConvexHull  # takes a while to load

    arms = points - points.mean(axis=0)
    _, sizes, right = np.linalg.svd(arms)
    dimension = int(np.sum(sizes > NEGLIGIBLE * sizes[0]))
    if dimension == 3:
        return np.asarray(ConvexHull(points).simplices, dtype=np.intp)
    if dimension < 2:
        return np.zeros((0, 3), dtype=np.intp)
    corners = np.arange(3) if len(points) == 3 else ConvexHull(arms @ right[:2].T).vertices
    fan = np.arange(1, len(corners) - 1)
    return np.asarray(corners[np.column_stack([np.zeros_like(fan), fan, fan + 1])], dtype=np.intp)

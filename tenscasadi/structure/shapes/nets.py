"""Nets and membranes of strings."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.field_types import ElsewhereInFile
from tenscasadi.structure.shapes.family import build_structure, place_ring, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_COUNT, Indices, number, positive_number, whole_number


@shape
def membrane(
    p: int = 8,
    q: int = 5,
    radius: float = 1.0,
    length: float = 2.0,
    node_mass: Annotated[ArrayLike, ElsewhereInFile()] = 0.1,
    **options: Any,
) -> Structure:
    """Build a cylindrical membrane of strings (class 0, Sect. 7.3).

    It is open at both ends. Rings of nodes around the z axis are connected by double helices.

    ::

        ring 1    p ────── p+1 ───── …      node j p + i is on ring j, at the angle (2 i + j) π/p;
                 ╱  ╲     ╱  ╲     ╱        rings run from z = −length/2 to +length/2
        ring 0  0 ────── 1 ────── 2 …

    Strings: the rings, ring by ring (q p); then for each node of ring j its two strings to ring
    j+1, to nodes (j+1) p + i and (j+1) p + i−1 (2 p (q−1)).

    Parameters
    ----------
    p : int
        Number of nodes on each ring, at least 3.
    q : int
        Number of rings, at least 2.
    radius : float
        Radius of the cylinder [m].
    length : float
        Distance from the first ring to the last [m].
    node_mass : array_like, shape (p q,)
        Mass of each node [kg], or one number for all.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The membrane, which has no bars.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> net = tc.shapes.membrane(p=4, q=3)
    >>> len(net.nodes), len(net.strings)
    (12, 28)
    """
    p, q = whole_number("p", p, 3, MAX_COUNT), whole_number("q", q, 2, MAX_COUNT)
    if p * q > MAX_COUNT:
        raise ValueError(f"p is {p} and q is {q}: they must give at most {MAX_COUNT} nodes")
    radius, length = positive_number("radius", radius), positive_number("length", length)
    nodes = np.concatenate(
        [place_ring(p, radius, j * np.pi / p, length * (j / (q - 1) - 0.5)) for j in range(q)]
    )
    ring, before, after = _membrane_neighbors(p, q)
    lower = ring[: p * (q - 1)]
    helices = np.stack(
        [np.c_[lower, lower + p], np.c_[lower, before[: len(lower)] + p]], axis=1
    ).reshape(-1, 2)
    strings = {
        "bottom": np.c_[ring, after][:p],
        "rings": np.c_[ring, after][p : p * (q - 1)],
        "top": np.c_[ring, after][p * (q - 1) :],
        "helices": helices,
    }
    ends = [("bottom", p), ("", p * (q - 2)), ("top", p)]
    given = {"node_mass": node_mass, **options}
    return build_structure(nodes, {}, strings, given, node_groups=ends)


def membrane_faces(p: int = 8, q: int = 5) -> Indices:
    """Find the triangles between the strings of `membrane`.

    They are counterclockwise as seen from outside.

    Parameters
    ----------
    p : int
        Number of nodes on each ring.
    q : int
        Number of rings.

    Returns
    -------
    ndarray of int, shape (2 p (q−1), 3)
        Nodes of each triangle, for `Pressure`.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.membrane_faces(p=3, q=2).tolist()
    [[0, 1, 3], [1, 2, 4], [2, 0, 5], [0, 3, 5], [1, 4, 3], [2, 5, 4]]
    """
    p, q = whole_number("p", p, 3, MAX_COUNT), whole_number("q", q, 2, MAX_COUNT)
    ring, before, after = _membrane_neighbors(p, q)
    lower, upper = slice(0, p * (q - 1)), slice(p, p * q)
    upright = np.c_[ring[lower], after[lower], ring[lower] + p]
    hanging = np.c_[ring[lower], ring[upper], before[upper]]
    return np.concatenate([upright, hanging])


def _membrane_neighbors(p: int, q: int) -> tuple[Indices, Indices, Indices]:
    """Find each node's previous and next node on its ring.

    There are q rings of p nodes. Returns all nodes, their previous and their next nodes, each (p
    q,).
    """
    ring = np.arange(p * q)
    first = ring - ring % p
    return ring, first + (ring - 1) % p, first + (ring + 1) % p


@shape
def hyperbolic_paraboloid(
    cells: int = 6,
    side: float = 2.0,
    rise: float = 1.0,
    node_mass: Annotated[ArrayLike, ElsewhereInFile()] = 0.1,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a net on a hyperbolic paraboloid (class 0).

    Its two families of strings are the straight lines of the surface z = rise · xy / (side/2)².

    ::

        2 ───── 5 ───── 8       node j (cells+1) + i at x = side (j/cells − ½), y = side (i/cells − ½);
        │       │       │       the corners lie at z = ±rise, the boundary is pinned
        1 ───── 4 ───── 7     y ↑
        │       │       │       └→ x
        0 ───── 3 ───── 6

    Strings connect inner nodes with their neighbors: along y, then along x, in lexical order of
    their first nodes. The boundary has no strings. Equal force densities are in equilibrium.

    Parameters
    ----------
    cells : int
        Number of cells along each side, at least 2.
    side : float
        Side of the square ground plan [m].
    rise : float
        Height of two corners above z = 0 [m]. The other corners are as far below.
    node_mass : array_like, shape ((cells+1)²,)
        Mass of each node [kg], or one number for all.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The net, which has no bars.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> net = tc.shapes.hyperbolic_paraboloid(cells=2)
    >>> net.nodes[4].tolist(), len(net.strings), len(net.pinned)
    ([0.0, 0.0, 0.0], 4, 8)
    """
    count = whole_number("cells", cells, 2, int(MAX_COUNT**0.5)) + 1
    half, rise = 0.5 * positive_number("side", side), number("rise", rise)
    x, y = np.meshgrid(*2 * [np.linspace(-1.0, 1.0, count)], indexing="ij")
    nodes = np.column_stack([half * x.ravel(), half * y.ravel(), rise * (x * y).ravel()])
    index = np.arange(count**2).reshape(count, count)
    along_y = np.stack([index[1:-1, :-1], index[1:-1, 1:]], axis=-1).reshape(-1, 2)
    along_x = np.stack([index[:-1, 1:-1], index[1:, 1:-1]], axis=-1).reshape(-1, 2)
    boundary = np.concatenate([index[0], index[-1], index[1:-1, 0], index[1:-1, -1]])
    strings = {"along_y": along_y, "along_x": along_x}
    given = {"pinned": np.sort(boundary).tolist(), "node_mass": node_mass, **options}
    stress = np.ones(len(along_x) + len(along_y))
    return build_structure(nodes, {}, strings, given, stress, prestress)

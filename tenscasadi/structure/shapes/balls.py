"""Balls of bars: expanded octahedra and truncated polyhedra."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from tenscasadi.structure.shapes.family import build_structure, polygon, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, number, positive_number


@shape
def six_bar_ball(
    bar_length: float = 1.0, prestress: float | None = None, **options: Any
) -> Structure:
    """Build a ball of six bars (class 1).

    It is the expanded octahedron, with three parallel pairs of bars and 24 equal strings, centered
    at the origin.

    ::

        bar   nodes     along   at                   seen along x, towards −x:
         0    0 →  1    x       z = −l/4
         1    2 →  3    x       z = +l/4                    9     11
         2    4 →  5    y       x = −l/4                    │ 2,3 │         z ↑
         3    6 →  7    y       x = +l/4             4,6 ───┼─────┼─── 5,7    └→ y
         4    8 →  9    z       y = −l/4                    │ 0,1 │
         5   10 → 11    z       y = +l/4                    8     10

    Each bar of length l runs from −l/2 to +l/2 along its axis; the two bars of a pair lie half a
    bar length apart. Strings join all pairs of nodes that lie √6/4 l = 0.612 l apart, in lexical
    order: each node has four. Equal force densities are in equilibrium.

    Parameters
    ----------
    bar_length : float
        Length l of each bar [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The ball.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> ball = tc.shapes.six_bar_ball()
    >>> len(ball.bars), len(ball.strings), round(float(ball.string_lengths[0]), 3)
    (6, 24, 0.612)
    """
    return expanded_octahedron(bar_length, 0.5, prestress, **options)


@shape
def expanded_octahedron(
    bar_length: float = 1.0, ratio: float = 0.5, prestress: float | None = None, **options: Any
) -> Structure:
    """Build an expanded octahedron of six bars (class 1).

    Nodes, bars and strings are those of `six_bar_ball`, which has the ratio ½. The 24 strings have
    equal lengths at any ratio r: √((1 − r + r²)/2) times the length of the bars.

    Parameters
    ----------
    bar_length : float
        Length of each bar [m].
    ratio : float
        Distance r of parallel bars relative to their length, between 0 and 1. The structure has a
        self-stress at ½. At 1/φ = 0.618 the nodes are those of a regular icosahedron.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The expanded octahedron, centered at the origin.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> icosahedron = tc.shapes.expanded_octahedron(ratio=2 / (1 + 5**0.5))
    >>> icosahedron.string_lengths.round(6).min().item()  # that of the shorter edges
    0.618034
    """
    length, ratio = positive_number("bar_length", bar_length), number("ratio", ratio)
    if not 0.0 < ratio < 1.0:
        raise ValueError(f"ratio is {ratio:g}: it must lie between 0 and 1, where strings meet")
    if prestress is not None and ratio != 0.5:
        raise ValueError(
            f"prestress needs the ratio 0.5, and ratio is {ratio:g}: leave one of them out"
        )
    along_x = np.array([(end, 0, side) for side in (-ratio, ratio) for end in (-1, 1)])
    halves = np.concatenate([np.roll(along_x, axis, axis=1) for axis in range(3)])
    strings = [
        (a, b)
        for a, b in combinations(range(12), 2)
        if a // 4 != b // 4 and halves[a] @ halves[b] > 0
    ]
    groups = {"": np.arange(12).reshape(6, 2)}, {"": np.array(strings)}
    return build_structure(0.5 * length * halves, *groups, options, np.ones(24), prestress)


@shape
def truncated_tetrahedron(
    bar_length: float = 1.0,
    force_ratio: float = 1.0,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a truncated tetrahedron of six bars (class 1).

    ::

             3k+2              four triangles of strings, k = 0 … 3, for the corners;
            ╱    ╲             each node has one string to another triangle
        3k  ────  3k+1         and one bar, to the node across one edge of the hexagon further

    Strings: the triangles 3k → 3k+1 → 3k+2 → 3k; then the six edges between triangles, in lexical
    order. Bars are in lexical order, too.

    Parameters
    ----------
    bar_length : float
        Length of each bar [m].
    force_ratio : float
        Force density of the edges between triangles relative to that of the triangles. It
        determines the form.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The ball, centered at the origin.

    Notes
    -----
    Rotations of the tetrahedron map each node to every other one. In the form of equilibrium, the
    3×3 equilibrium matrix of one node is singular.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.truncated_tetrahedron()
    Structure(12 nodes, 6 bars, 18 strings, 0 pinned)
    """
    corner, edge = (1.0, 1.0, 1.0), (0.0, 0.0, 1.0)
    return _truncate(corner, 3, edge, bar_length, force_ratio, prestress, options)


@shape
def truncated_icosahedron(
    bar_length: float = 1.0,
    force_ratio: float = 1.0,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a truncated icosahedron of 30 bars (class 1).

    ::

              5k+3             twelve pentagons of strings, k = 0 … 11, for the corners;
            ╱      ╲           each node has one string to another pentagon
        5k+4        5k+2       and one bar, to the node across one edge of the hexagon further
           ╲        ╱
            5k ── 5k+1

    Strings: the pentagons 5k → 5k+1 → … → 5k; then the 30 edges between pentagons, in lexical
    order. Bars are in lexical order, too.

    Parameters
    ----------
    bar_length : float
        Length of each bar [m].
    force_ratio : float
        Force density of the edges between pentagons relative to that of the pentagons. It
        determines the form.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The ball, centered at the origin.

    Notes
    -----
    Rotations of the icosahedron map each node to every other one. In the form of equilibrium, the
    3×3 equilibrium matrix of one node is singular.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.truncated_icosahedron()
    Structure(60 nodes, 30 bars, 90 strings, 0 pinned)
    """
    corner, edge = (0.0, 1.0, 0.5 + 0.5 * 5**0.5), (0.0, 0.0, 1.0)
    return _truncate(corner, 5, edge, bar_length, force_ratio, prestress, options)


def _truncate(
    corner: tuple[float, float, float],
    order: int,
    edge: tuple[float, float, float],
    bar_length: float,
    force_ratio: float,
    prestress: float | None,
    options: dict[str, Any],
) -> Structure:
    """Build a ball of bars on a truncated polyhedron.

    `corner` is a vertex of the polyhedron, shared by `order` faces, and `edge` the midpoint of an
    edge at this vertex. The other arguments are those of `truncated_tetrahedron`.
    """
    length, ratio = (
        positive_number("bar_length", bar_length),
        positive_number("force_ratio", force_ratio),
    )
    a, b = _rotate(np.array(corner), 2 * np.pi / order), _rotate(np.array(edge), np.pi)
    c = a @ b @ a.T  # along the faces of two corners, and the edge between
    rotations = [np.linalg.matrix_power(a, j) for j in range(order)]
    for rotation in rotations:
        if not np.any(np.isclose(rotations, rotation @ b).all(axis=(1, 2))):
            rotations += [rotation @ b @ turn for turn in rotations[:order]]
    node = _generator(a, b, c, ratio)
    node *= np.sign(node @ corner) * length / np.linalg.norm(c @ node - node)
    count = len(rotations)
    pairs = {
        name: np.array([(i, j) for i, j in enumerate(_images(rotations, turn)) if i < j])
        for name, turn in (("edges", b), ("bars", c))
    }
    faces = np.concatenate([polygon(first + np.arange(order)) for first in range(0, count, order)])
    stress = np.repeat([1.0, ratio], [count, count // 2])
    groups = {"": pairs["bars"]}, {"face": faces, "edge": pairs["edges"]}
    return build_structure(np.array(rotations) @ node, *groups, options, stress, prestress)


def _generator(a: Array, b: Array, c: Array, ratio: float) -> Array:
    """Find the node whose images by symmetry form an equilibrium.

    The nodes are its images under all rotations of the polyhedron. Strings connect it to its images
    under the rotations a, a⁻¹ (force density 1) and b (`ratio`), and a bar connects it to its image
    under c. Rotations are matrices (3, 3). Returns the direction (3,) of the node, of any length.
    """
    eye = np.eye(3)
    strings = a + a.T - 2 * eye + ratio * (b - eye)
    basis = np.linalg.eigh(c + c.T)[1][:, ::-1]  # the axis of c, and two directions across it
    W = basis.T @ strings @ basis
    # c − I is 0 along the axis and −2 across it: the axis is eliminated, 2 q are eigenvalues
    values, vectors = np.linalg.eig(W[1:, 1:] - np.outer(W[1:, 0], W[0, 1:]) / W[0, 0])
    across = vectors[:, np.argmin(np.abs(values))].real  # the only super-stable solution
    return np.asarray(basis @ np.append(-W[0, 1:] @ across / W[0, 0], across))


def _rotate(axis: Array, angle: float) -> Array:
    """Compute the rotation (3×3) about an axis by an angle [rad]."""
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def _images(rotations: list[Array], turn: Array) -> Indices:
    """Find the indices of the products rotation · turn in a group.

    `rotations` are all elements of the group, as matrices (3, 3), and `turn` is one of them.
    """
    flat = np.array(rotations).reshape(-1, 9)
    images = (np.array(rotations) @ turn).reshape(-1, 9)
    return np.asarray(np.argmax(images @ flat.T, axis=1))

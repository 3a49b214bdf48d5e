"""Standard structures, which accept all keywords of `Structure`."""

from __future__ import annotations

from itertools import combinations
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.field_types import PAIR, ElsewhereInFile
from tenscasadi.schema.value import Value
from tenscasadi.structure import names
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    Array,
    Indices,
    finite_array,
    number,
    positive_number,
    whole_number,
)

LARGEST_COUNT = 10**5  # bars, rings or units; larger structures would take hours


class Shape(Value):
    """Family of functions that build structures.

    The name of each function is its kind in files.
    """


shape = Shape.maker


@shape
def pendulum(length: float = 1.0, angle: float = np.pi / 4, **options: Any) -> Structure:
    """Build a pendulum of one bar in the x-z plane.

    Node 0 is pinned at the origin.

    ::

        0 ●────> x
           ╲
            ╲
             1

    Parameters
    ----------
    length : float
        Length of the bar, m.
    angle : float
        Angle from hanging down towards +x, rad.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The pendulum, which has no strings.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.pendulum(2.0, angle=0.0).nodes.round(6).tolist()
    [[0.0, 0.0, 0.0], [0.0, 0.0, -2.0]]
    """
    length = positive_number("length", length)
    angle = number("angle", angle)
    return Structure(
        np.array([np.zeros(3), _hanging(length, angle)]),
        bars=[(0, 1)],
        **{"pinned": (0,), **options},
    )


@shape
def double_pendulum(
    lengths: Annotated[ArrayLike, PAIR] = (1.0, 1.0),
    angles: Annotated[ArrayLike, PAIR] = (np.pi / 4, np.pi / 4),
    **options: Any,
) -> Structure:
    """Build a double pendulum in the x-z plane (class 2).

    Both bars share node 1. Node 0 is pinned at the origin.

    ::

        0 ●────> x
           ╲
            1
             ╲
              2

    Parameters
    ----------
    lengths : array_like, shape (2,)
        Lengths of bar 0, (0, 1), and of bar 1, (1, 2), m.
    angles : array_like, shape (2,)
        Angle of each bar from hanging down towards +x, rad.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The double pendulum, which has no strings.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.double_pendulum(angles=(0.0, 0.0)).nodes[:, 2].tolist()
    [0.0, -1.0, -2.0]
    """
    first, second = finite_array("lengths", lengths, (2,))
    upper, lower = finite_array("angles", angles, (2,))
    elbow = _hanging(positive_number("lengths", first), upper)
    tip = elbow + _hanging(positive_number("lengths", second), lower)
    return Structure(
        np.array([np.zeros(3), elbow, tip]), bars=[(0, 1), (1, 2)], **{"pinned": (0,), **options}
    )


@shape
def prism(
    bars: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    twist: float | None = None,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a prism with inclined bars (class 1).

    Strings form its two polygons.

    Each bar has a vertical string beside it.

    ::

        top      p ──── p+1 ── …      nodes p … 2p−1, at z = height, node p+i above node i, turned by twist − 2π/p
                 │ ╲  ╱ │
        bottom   0 ──── 1 ──── …      nodes 0 … p−1, at z = 0, node i at (radius, 2π i/p) in polar coordinates

    Bars: i → p+(i+1 mod p). Strings: bottom polygon i → i+1, top polygon, vertical i → p+i, p of
    each. They are named ``bottom[0]`` and so on, as are nodes.

    Parameters
    ----------
    bars : int
        Number p of bars, at least 3.
    radius : float
        Radius of both polygons, m.
    height : float
        Distance between the polygons, m.
    twist : float, optional
        Angle from a bar's bottom end to its top end about the z axis, rad; by default π/2 + π/p,
        the only one with a self-stress.
    prestress : float, optional
        Smallest force density, N/m, at which the strings hold the structure in equilibrium; it sets
        the rest lengths. By default strings are as long as their rest lengths.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The prism with its bottom in the plane z = 0.

    Notes
    -----
    In the self-stress the vertical strings have 2 sin(π/p) times the force density of the polygons,
    √3 times for three bars. The prism of the paper's Sect. 7.1 is ``prism(radius=1/√3, height=1,
    twist=2π/3)``.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(prestress=10.0)
    >>> gamma = prism.stiffness * (1 - prism.rest_length / prism.string_lengths)
    >>> gamma.round(3).tolist()
    [10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 17.321, 17.321, 17.321]
    """
    p = whole_number("bars", bars, 3, LARGEST_COUNT)
    radius, height = positive_number("radius", radius), positive_number("height", height)
    balanced = np.pi / 2 + np.pi / p
    turn = balanced if twist is None else number("twist", twist)
    if prestress is not None and not np.isclose(turn, balanced, rtol=0.0, atol=1e-12):
        raise ValueError(
            f"prestress needs the equilibrium twist, {balanced:g} rad, and twist is {turn:g}: leave one of them out"
        )
    i = np.arange(p)
    after = (i + 1) % p
    bottom = _ring(p, radius, 0.0, 0.0)
    top = _ring(p, radius, turn - 2 * np.pi / p, height)
    strings = np.concatenate([np.c_[i, after], np.c_[p + i, p + after], np.c_[i, p + i]])
    stress = np.repeat([1.0, 1.0, 2.0 * np.sin(np.pi / p)], p)
    options = {
        "node_names": names.name_members([("bottom", p), ("top", p)]),
        "string_names": names.name_members([("bottom", p), ("top", p), ("vertical", p)]),
        **options,
    }
    return _prestressed(
        Structure(np.concatenate([bottom, top]), np.c_[i, p + after], strings, **options),
        stress,
        prestress,
        options,
    )


@shape
def d_bar(
    bar_length: float = 1.0,
    angle: float = np.pi / 4,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a D-bar: four bars in a diamond (class 2).

    It lies in the plane z = 0 around the origin, with strings along both diagonals.

    ::

               3
             ╱ │ ╲
            0 ─┼─ 2      y ↑
             ╲ │ ╱         └→ x
               1

    Bars: (0, 1), (1, 2), (2, 3), (3, 0). Strings: (0, 2), (1, 3). Equal force densities are in
    equilibrium. No node is pinned by default; the paper pins node 0 (Sect. 7.2).

    Parameters
    ----------
    bar_length : float
        Length of each bar, m.
    angle : float
        Angle of the bars off the x axis, rad, between 0 and π/2.
    prestress : float, optional
        Smallest force density, N/m, at which the strings hold the structure in equilibrium; it sets
        the rest lengths. By default strings are as long as their rest lengths.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The D-bar.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.d_bar().string_lengths.round(6).tolist()
    [1.414214, 1.414214]
    """
    length, angle = positive_number("bar_length", bar_length), positive_number("angle", angle)
    if angle >= np.pi / 2:
        raise ValueError(f"angle is {angle:g}: it must be less than π/2, where the diamond folds")
    x, y = length * np.cos(angle), length * np.sin(angle)
    nodes = [(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0)]
    structure = Structure(nodes, [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3)], **options)
    return _prestressed(structure, np.ones(2), prestress, options)


@shape
def t_bar(
    length: float = 1.0, width: float = 0.5, prestress: float | None = None, **options: Any
) -> Structure:
    """Build a T-bar of four bars (class 4).

    All bars meet in node 4, the origin. They lie in the plane z = 0, inside a diamond of strings.

    ::

               3
             ╱ ┃ ╲
            0 ━4━ 2      y ↑
             ╲ ┃ ╱         └→ x
               1

    Bars: (4, 0), (4, 1), (4, 2), (4, 3). Strings: (0, 1), (1, 2), (2, 3), (3, 0). Equal force
    densities are in equilibrium.

    Parameters
    ----------
    length : float
        Distance from node 0 to node 2, m.
    width : float
        Distance from node 1 to node 3, m.
    prestress : float, optional
        Smallest force density, N/m, at which the strings hold the structure in equilibrium; it sets
        the rest lengths. By default strings are as long as their rest lengths.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The T-bar.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.t_bar().bar_lengths.tolist()
    [0.5, 0.25, 0.5, 0.25]
    """
    x, y = 0.5 * positive_number("length", length), 0.5 * positive_number("width", width)
    nodes = [(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0), (0, 0, 0)]
    structure = Structure(
        nodes, [(4, 0), (4, 1), (4, 2), (4, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)], **options
    )
    return _prestressed(structure, np.ones(4), prestress, options)


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
        Length l of each bar, m.
    prestress : float, optional
        Smallest force density, N/m, at which the strings hold the structure in equilibrium; it sets
        the rest lengths. By default strings are as long as their rest lengths.
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
    length = positive_number("bar_length", bar_length)
    shape = np.array(
        [(end * 2, 0, side) for side in (-1, 1) for end in (-1, 1)]
    )  # bars along x, in units of a quarter bar length
    quarters = np.concatenate([np.roll(shape, axis, axis=1) for axis in range(3)])
    strings = [
        (a, b)
        for a, b in combinations(range(12), 2)
        if np.sum((quarters[a] - quarters[b]) ** 2) == 6
    ]
    bars = np.arange(12).reshape(6, 2)
    return _prestressed(
        Structure(0.25 * length * quarters, bars, strings, **options),
        np.ones(24),
        prestress,
        options,
    )


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

    Strings: the rings, ring by ring (q p); then for each node of ring j its two to ring j+1, to
    nodes (j+1) p + i and (j+1) p + i−1 (2 p (q−1)).

    Parameters
    ----------
    p : int
        Number of nodes on each ring, at least 3.
    q : int
        Number of rings, at least 2.
    radius : float
        Radius of the cylinder, m.
    length : float
        Distance from the first ring to the last, m.
    node_mass : array_like, shape (p q,)
        Mass of each node, kg, or one number for all.
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
    p, q = whole_number("p", p, 3, LARGEST_COUNT), whole_number("q", q, 2, LARGEST_COUNT)
    if p * q > LARGEST_COUNT:
        raise ValueError(f"p is {p} and q is {q}: they must give at most {LARGEST_COUNT} nodes")
    radius, length = positive_number("radius", radius), positive_number("length", length)
    nodes = np.concatenate(
        [_ring(p, radius, j * np.pi / p, length * (j / (q - 1) - 0.5)) for j in range(q)]
    )
    ring, before, after = _membrane_neighbours(p, q)
    lower = ring[: p * (q - 1)]
    helices = np.stack(
        [np.c_[lower, lower + p], np.c_[lower, before[: len(lower)] + p]], axis=1
    ).reshape(-1, 2)
    rings = [("bottom", p), ("rings", p * (q - 2)), ("top", p)]
    options = {
        "node_names": names.name_members([("bottom", p), ("", p * (q - 2)), ("top", p)]),
        "string_names": names.name_members([*rings, ("helices", len(helices))]),
        **options,
    }
    return Structure(
        nodes, strings=np.concatenate([np.c_[ring, after], helices]), node_mass=node_mass, **options
    )


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
        Nodes of each triangle, as `Pressure` takes them.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.membrane_faces(p=3, q=2).tolist()
    [[0, 1, 3], [1, 2, 4], [2, 0, 5], [0, 3, 5], [1, 4, 3], [2, 5, 4]]
    """
    p, q = whole_number("p", p, 3, LARGEST_COUNT), whole_number("q", q, 2, LARGEST_COUNT)
    ring, before, after = _membrane_neighbours(p, q)
    lower, upper = slice(0, p * (q - 1)), slice(p, p * q)
    upright = np.c_[ring[lower], after[lower], ring[lower] + p]
    hanging = np.c_[ring[lower], ring[upper], before[upper]]
    return np.concatenate([upright, hanging])


def _membrane_neighbours(p: int, q: int) -> tuple[Indices, Indices, Indices]:
    """Find all nodes and their neighbors on the ring."""
    ring = np.arange(p * q)
    first = ring - ring % p
    return ring, first + (ring - 1) % p, first + (ring + 1) % p


def _ring(count: int, radius: float, start: float, z: float) -> Array:
    angles = start + 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)])


def _hanging(length: float, angle: float) -> Array:
    return np.array([length * np.sin(angle), 0.0, -length * np.cos(angle)])


def _prestressed(
    structure: Structure, stress: Array, prestress: float | None, options: dict[str, Any]
) -> Structure:
    """Set rest lengths for a self-stress.

    The smallest force density is `prestress`.
    """
    if prestress is None:
        return structure
    for name in ("rest_length", "bar_rest_length"):
        if options.get(name) is not None:
            raise ValueError(f"prestress and {name} are both given: leave one of them out")
    return structure.prestressed(stress * (positive_number("prestress", prestress) / stress.min()))

"""Ready-made structures. Every keyword of `Structure` but nodes, bars and strings may be added: bar_mass, stiffness, pinned …

Where a shape takes `prestress`, its rest lengths are such that the strings hold it in equilibrium and the smallest force
density is that many N/m (below the stiffness); without it the rest lengths are those of the keyword, or the strings' lengths.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices, finite_array, number, positive_number, whole_number


def pendulum(length: float = 1.0, angle: float = np.pi / 4, **options: Any) -> Structure:
    """One bar of `length` m in the x-z plane, `angle` rad from hanging down towards +x, pinned at node 0, the origin.

        0 ●────> x
           ╲
            ╲
             1

    No strings. Raises TypeError, ValueError for a length that is not positive.
    """
    length = positive_number("length", length)
    angle = number("angle", angle)
    return Structure(np.array([np.zeros(3), _hanging(length, angle)]), bars=[(0, 1)], **{"pinned": (0,), **options})


def double_pendulum(lengths: ArrayLike = (1.0, 1.0), angles: ArrayLike = (np.pi / 4, np.pi / 4), **options: Any) -> Structure:
    """Two bars in the x-z plane that share node 1, pinned at node 0, the origin: class 2. Bar 0 is (0, 1), bar 1 (1, 2).

        0 ●────> x
           ╲
            1
             ╲
              2

    `lengths` in m; `angles` in rad of each bar from hanging down towards +x. No strings. Raises TypeError, ValueError.
    """
    first, second = finite_array("lengths", lengths, (2,))
    upper, lower = finite_array("angles", angles, (2,))
    elbow = _hanging(positive_number("lengths", first), upper)
    tip = elbow + _hanging(positive_number("lengths", second), lower)
    return Structure(np.array([np.zeros(3), elbow, tip]), bars=[(0, 1), (1, 2)], **{"pinned": (0,), **options})


def prism(
    bars: int = 3, radius: float = 0.5, height: float = 1.0, twist: float | None = None, prestress: float | None = None, **options: Any
) -> Structure:
    """Two regular polygons of strings, `height` m apart, held by `bars` bars and as many vertical strings. Class 1.

        top      p ──── p+1 ── …      nodes p … 2p−1, at z = height, node p+i above node i, turned by twist − 2π/p
                 │ ╲  ╱ │
        bottom   0 ──── 1 ──── …      nodes 0 … p−1, at z = 0, node i at (radius, 2π i/p) in polar coordinates

    Bars: i → p+(i+1 mod p). Strings: bottom polygon i → i+1 (p), top polygon (p), vertical i → p+i (p).
    `twist` in rad: from a bar's bottom end to its top end about the z axis. The default, π/2 + π/p (150° for three bars), is
    the only one with a self-stress: γ_vertical = 2 sin(π/p) γ_polygon, √3 γ_polygon for three bars. The prism of the
    paper's Sect. 7.1 is prism(radius=1/√3, height=1, twist=2π/3). Raises TypeError, ValueError.
    """
    p = whole_number("bars", bars, 3)
    radius, height = positive_number("radius", radius), positive_number("height", height)
    balanced = np.pi / 2 + np.pi / p
    turn = balanced if twist is None else number("twist", twist)
    if prestress is not None and not np.isclose(turn, balanced, rtol=0.0, atol=1e-12):
        raise ValueError(f"prestress needs the equilibrium twist, {balanced:g} rad, and twist is {turn:g}: leave one of them out")
    i = np.arange(p)
    after = (i + 1) % p
    bottom = _ring(p, radius, 0.0, 0.0)
    top = _ring(p, radius, turn - 2 * np.pi / p, height)
    strings = np.concatenate([_pairs(i, after), _pairs(p + i, p + after), _pairs(i, p + i)])
    stress = np.repeat([1.0, 1.0, 2.0 * np.sin(np.pi / p)], p)
    return _prestressed(Structure(np.concatenate([bottom, top]), _pairs(i, p + after), strings, **options), stress, prestress, options)


def d_bar(bar_length: float = 1.0, angle: float = np.pi / 4, prestress: float | None = None, **options: Any) -> Structure:
    """Four bars in a diamond in the plane z = 0, about the origin, with strings along both diagonals: class 2 (Sect. 7.2).

               3
             ╱ │ ╲
            0 ─┼─ 2      y ↑
             ╲ │ ╱         └→ x
               1

    Bars: (0, 1), (1, 2), (2, 3), (3, 0), `angle` rad (between 0 and π/2) off the x axis. Strings: 0 is (0, 2), 1 is (1, 3).
    Equal force densities are in equilibrium. Nothing is pinned unless `pinned` says so: the paper pins node 0.
    Raises TypeError, ValueError.
    """
    length, angle = positive_number("bar_length", bar_length), positive_number("angle", angle)
    if angle >= np.pi / 2:
        raise ValueError(f"angle is {angle:g}: it must be less than π/2, where the diamond folds")
    x, y = length * np.cos(angle), length * np.sin(angle)
    nodes = [(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0)]
    structure = Structure(nodes, [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3)], **options)
    return _prestressed(structure, np.ones(2), prestress, options)


def t_bar(length: float = 1.0, width: float = 0.5, prestress: float | None = None, **options: Any) -> Structure:
    """Four bars that meet in node 4, the origin, in the plane z = 0, with a diamond of strings about them: class 4.

               3
             ╱ ┃ ╲
            0 ━4━ 2      y ↑
             ╲ ┃ ╱         └→ x
               1

    `length` from node 0 to node 2 and `width` from node 1 to node 3, in m. Bars: (4, 0), (4, 1), (4, 2), (4, 3). Strings:
    (0, 1), (1, 2), (2, 3), (3, 0). Equal force densities are in equilibrium. Raises TypeError, ValueError.
    """
    x, y = 0.5 * positive_number("length", length), 0.5 * positive_number("width", width)
    nodes = [(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0), (0, 0, 0)]
    structure = Structure(nodes, [(4, 0), (4, 1), (4, 2), (4, 3)], [(0, 1), (1, 2), (2, 3), (3, 0)], **options)
    return _prestressed(structure, np.ones(4), prestress, options)


def six_bar_ball(bar_length: float = 1.0, prestress: float | None = None, **options: Any) -> Structure:
    """Six bars in three parallel pairs and 24 equal strings about the origin: the expanded octahedron. Class 1.

        bar   nodes     along   at                   seen along x, towards −x:
         0    0 →  1    x       z = −l/4
         1    2 →  3    x       z = +l/4                    9     11
         2    4 →  5    y       x = −l/4                    │ 2,3 │         z ↑
         3    6 →  7    y       x = +l/4             4,6 ───┼─────┼─── 5,7    └→ y
         4    8 →  9    z       y = −l/4                    │ 0,1 │
         5   10 → 11    z       y = +l/4                    8     10

    Each bar runs from −l/2 to +l/2 along its axis; the two bars of a pair lie half a bar length apart.
    Strings join all pairs of nodes that lie √6/4 l = 0.612 l apart, in lexical order: each node has four. Equal force
    densities are in equilibrium. Raises TypeError, ValueError.
    """
    length = positive_number("bar_length", bar_length)
    shape = np.array([(end * 2, 0, side) for side in (-1, 1) for end in (-1, 1)])  # bars along x, in quarters of a bar
    quarters = np.concatenate([np.roll(shape, axis, axis=1) for axis in range(3)])
    strings = [(a, b) for a, b in combinations(range(12), 2) if np.sum((quarters[a] - quarters[b]) ** 2) == 6]
    bars = _pairs(np.arange(0, 12, 2), np.arange(1, 12, 2))
    return _prestressed(Structure(0.25 * length * quarters, bars, strings, **options), np.ones(24), prestress, options)


def membrane(p: int = 8, q: int = 5, radius: float = 1.0, length: float = 2.0, node_mass: ArrayLike = 0.1, **options: Any) -> Structure:
    """A cylinder of strings about the z axis, open at both ends: `q` rings of `p` nodes and double helices. Class 0 (Sect. 7.3).

        ring 1    p ────── p+1 ───── …      node j p + i is on ring j, at the angle (2 i + j) π/p;
                 ╱  ╲     ╱  ╲     ╱        rings run from z = −length/2 to +length/2
        ring 0  0 ────── 1 ────── 2 …

    Strings: the rings, ring by ring (q p); then for each node of ring j its two to ring j+1, to nodes (j+1) p + i and
    (j+1) p + i−1 (2 p (q−1)). `node_mass` in kg, on every node or one each. Raises TypeError, ValueError.
    """
    p, q = whole_number("p", p, 3), whole_number("q", q, 2)
    radius, length = positive_number("radius", radius), positive_number("length", length)
    nodes = np.concatenate([_ring(p, radius, j * np.pi / p, length * (j / (q - 1) - 0.5)) for j in range(q)])
    ring, before, after = _membrane_neighbours(p, q)
    lower = ring[: p * (q - 1)]
    helices = np.stack([_pairs(lower, lower + p), _pairs(lower, before[: len(lower)] + p)], axis=1).reshape(-1, 2)
    return Structure(nodes, strings=np.concatenate([_pairs(ring, after), helices]), node_mass=node_mass, **options)


def membrane_faces(p: int = 8, q: int = 5) -> Indices:
    """The triangles (2 p (q−1), 3) between the strings of `membrane(p, q)`, counterclockwise as seen from outside."""
    p, q = whole_number("p", p, 3), whole_number("q", q, 2)
    ring, before, after = _membrane_neighbours(p, q)
    lower, upper = slice(0, p * (q - 1)), slice(p, p * q)
    upright = np.column_stack([ring[lower], after[lower], ring[lower] + p])
    hanging = np.column_stack([ring[lower], ring[upper], before[upper]])
    return np.concatenate([upright, hanging])


def _membrane_neighbours(p: int, q: int) -> tuple[Indices, Indices, Indices]:
    """All nodes, and the nodes before and after each on its ring."""
    ring = np.arange(p * q)
    first = ring - ring % p
    return ring, first + (ring - 1) % p, first + (ring + 1) % p


def _ring(count: int, radius: float, start: float, z: float) -> Array:
    angles = start + 2 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)])


def _hanging(length: float, angle: float) -> Array:
    return np.array([length * np.sin(angle), 0.0, -length * np.cos(angle)])


def _pairs(first: Indices, second: Indices) -> Indices:
    return np.column_stack([first, second])


def _prestressed(structure: Structure, stress: Array, prestress: float | None, options: dict[str, Any]) -> Structure:
    """Rest lengths for the self-stress `stress`, scaled to have `prestress` as its smallest force density."""
    if prestress is None:
        return structure
    if options.get("rest_length") is not None:
        raise ValueError("prestress and rest_length are both given: leave one of them out")
    return structure.prestressed(stress * (positive_number("prestress", prestress) / stress.min()))

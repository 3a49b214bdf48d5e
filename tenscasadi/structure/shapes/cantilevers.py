"""Cantilevers: Michell's truss and arms of bars and strings."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.structure.shapes.family import build_structure, place_ring, polygon, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_COUNT, Array, Indices, positive_number, whole_number


@shape
def michell_cantilever(
    order: int = 4,
    radius: float = 1.0,
    inner_radius: float = 0.2,
    angle: float | None = None,
    **options: Any,
) -> Structure:
    """Build Michell's cantilever from two families of spirals.

    The spirals surround a circle. The cantilever carries a force in −y at node 0 with the least
    material: strings above, bars below. The nodes on the circle are pinned, all others in z alone.

    ::

              ╱ 5 ─── 2
             ╱     ╳    ╲        node m (m+1)/2 + i of level m = 0 … order lies at the radius
        circle  4          0      radius (inner_radius/radius)^(m/order) and the angle
             ╲     ╳    ╱        angle · (m − 2i) from the x axis
              ╲ 3 ─── 1

    From node i of level m a bar leads to node i+1 and a string to node i of level m+1.

    Parameters
    ----------
    order : int
        Number of levels, at least 1.
    radius : float
        Distance of node 0 from the center of the circle [m].
    inner_radius : float
        Radius of the circle [m].
    angle : float, optional
        Angle of the spirals from level to level [rad]. Default: the angle of least volume,
        π/2 − 2 atan a, where a is the ratio of consecutive radii.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The cantilever, in the plane z = 0.

    Notes
    -----
    Under a force F at node 0, Σ |force| · length = order · F r₀ (1/a − a) [1]_. With increasing
    order it converges to Michell's 2 F r₀ ln(r₀/r_q).

    References
    ----------
    .. [1] R. E. Skelton and M. C. de Oliveira, Tensegrity Systems, 2009, chapter 4.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.michell_cantilever(order=3)
    Structure(10 nodes, 6 bars, 6 strings, 10 pinned)
    """
    count = whole_number("order", order, 1, int((2 * MAX_COUNT) ** 0.5))
    outer, inner = (
        positive_number("radius", radius),
        positive_number("inner_radius", inner_radius),
    )
    if inner >= outer:
        raise ValueError(f"inner_radius is {inner:g}: it must be less than radius, {outer:g} m")
    ratio = (inner / outer) ** (1 / count)
    turn = np.pi / 2 - 2 * np.arctan(ratio) if angle is None else positive_number("angle", angle)
    level = np.repeat(np.arange(count + 1), np.arange(1, count + 2))
    place = np.arange(len(level)) - level * (level + 1) // 2
    spread, distance = turn * (level - 2 * place), outer * ratio**level
    nodes = np.column_stack(
        [distance * np.cos(spread), distance * np.sin(spread), np.zeros(len(level))]
    )
    free = np.arange(count * (count + 1) // 2)
    after = free + level[free] + 1  # node i of the next level
    pinned = {k: "z" if k < len(free) else "xyz" for k in range(len(level))}
    groups = {"": np.c_[free, after + 1]}, {"": np.c_[free, after]}
    return build_structure(nodes, *groups, {"pinned": pinned, **options})


@shape
def arm(
    cells: int = 3,
    sides: int = 3,
    length: float = 1.0,
    radius: float = 0.3,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a cantilever arm of D-bar cells (class 2p).

    The arm extends along x from a wall. Each cell is a spatial D-bar: p bars lead from one node of
    the axis to the nodes of a ring of strings, and p bars from these to the next node of the axis.
    Strings connect the rings of consecutive cells, and the first ring to the wall.

    ::

        wall ───── ring 0 ───── ring 1        node (p+1) c: axis between cells c−1 and c, at x = c · length
                  ╱      ╲    ╱      ╲        nodes (p+1) c + 1 … p: ring of cell c, in its middle
        wall ─ axis 0 ─── axis 1 ─── axis 2   the last p nodes: wall, half a cell behind axis 0

    Bars: for each cell the p bars to the ring and the p bars from it. Strings: for each cell its
    ring, its axis and p strings along x from the previous ring, or from the wall. Axis 0 and the
    wall are pinned.

    Parameters
    ----------
    cells : int
        Number of cells, at least 1.
    sides : int
        Number p of nodes of each ring, at least 3.
    length : float
        Length of a cell [m].
    radius : float
        Radius of the rings [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The arm, from the origin along x.

    Notes
    -----
    The self-stress has equal force densities in all strings along x.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.arm(cells=2, sides=4)
    Structure(15 nodes, 16 bars, 18 strings, 5 pinned)
    """
    p = whole_number("sides", sides, 3, MAX_COUNT)
    count = whole_number("cells", cells, 1, MAX_COUNT // p)
    length, radius = positive_number("length", length), positive_number("radius", radius)
    circle = place_ring(p, radius, 0.0, 0.0)[:, [2, 0, 1]]
    cell = np.concatenate([np.zeros((1, 3)), circle + [0.5 * length, 0, 0]])
    along = length * np.arange(count)[:, None, None] * [1.0, 0.0, 0.0]
    wall = circle - [0.5 * length, 0, 0]
    nodes = np.concatenate([(cell + along).reshape(-1, 3), [(count * length, 0, 0)], wall])
    axis = (p + 1) * np.arange(count + 1)
    rings = axis[:-1, None] + np.arange(1, p + 1)
    before = np.concatenate([[axis[-1] + np.arange(1, p + 1)], rings[:-1]])
    bars: dict[str, Indices] = {}
    strings: dict[str, Indices] = {}
    for c in range(count):
        ends = np.repeat(axis[c : c + 2, None], p, axis=1)
        bars |= {f"out{c}": np.c_[ends[0], rings[c]], f"back{c}": np.c_[rings[c], ends[1]]}
        strings[f"ring{c}"] = polygon(rings[c])
        strings[f"axis{c}"] = axis[None, c : c + 2]
        strings[f"along{c}"] = np.c_[before[c], rings[c]]
    given = {"pinned": [0, *range(axis[-1] + 1, len(nodes))], **options}
    return build_structure(nodes, bars, strings, given, _arm_stress(count, p), prestress)


def _arm_stress(cells: int, p: int) -> Array:
    """Compute the string force densities of the self-stress.

    They are ordered cell by cell, and 1 along x. The force density of bars is 2 + 2/p, positive in
    compression, or 2/p for bars that end at the tip. The arm has the given number of cells with p
    nodes in each ring.
    """
    pushes = np.full(cells, 2 * (2 + 2 / p))  # of both bars of a ring's node
    pushes[-1] = 2 + 4 / p
    along = np.ones(p + 1)
    rings = pushes / (2 - 2 * np.cos(2 * np.pi / p))
    return np.concatenate([np.r_[np.full(p, each), along] for each in rings])

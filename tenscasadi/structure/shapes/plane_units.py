"""Plane units for compression: D-bars and T-bars."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.structure.shapes.family import build_structure, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_COUNT, Array, Indices, positive_number, whole_number

_MOST_ITERATIONS = int(np.log(MAX_COUNT) / np.log(4))  # of which each replaces a bar by four


@shape
def d_bar(
    bar_length: float = 1.0,
    angle: float = np.pi / 4,
    prestress: float | None = None,
    iterations: int = 1,
    **options: Any,
) -> Structure:
    """Build a D-bar: four bars in a diamond (class 2).

    It lies in the plane z = 0 around the origin, with strings along both diagonals. Each further
    iteration replaces all bars by D-bars of the same angle, in the same plane.

    ::

               3
             ╱ │ ╲
            0 ─┼─ 2      y ↑
             ╲ │ ╱         └→ x
               1

    Bars: (0, 1), (1, 2), (2, 3), (3, 0). Strings: (0, 2), (1, 3). Equal force densities are in
    equilibrium. A bar (a, b) becomes the bars (a, c), (c, b), (b, d), (d, a) and the strings (a, b),
    (c, d), with new nodes c and d. Strings are in the order of the iterations. No node is pinned by
    default; the paper pins node 0 (Sect. 7.2).

    Parameters
    ----------
    bar_length : float
        Length of each bar after the first iteration [m].
    angle : float
        Angle of the bars off the x axis [rad], between 0 and π/2.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    iterations : int
        Number of iterations, including the first D-bar, at least 1.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The D-bar.

    Notes
    -----
    In the self-stress with equal force densities of all long diagonals, the force densities of the
    short diagonals of iteration k are k times as large.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.d_bar().string_lengths.round(6).tolist()
    [1.414214, 1.414214]
    """
    length, angle = positive_number("bar_length", bar_length), positive_number("angle", angle)
    if angle >= np.pi / 2:
        raise ValueError(f"angle is {angle:g}: it must be less than π/2, where the diamond folds")
    count = whole_number("iterations", iterations, 1, _MOST_ITERATIONS)
    x, y = length * np.cos(angle), length * np.sin(angle)
    nodes = np.array([(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0)])
    bars, strings = np.array([(0, 1), (1, 2), (2, 3), (3, 0)]), [np.array([(0, 2), (1, 3)])]
    stress = [np.ones(2)]
    for level in range(2, count + 1):
        a, b = bars.T
        c, d = len(nodes) + np.arange(2 * len(bars)).reshape(-1, 2).T
        nodes = np.concatenate([nodes, _beside(nodes, a, b, 0.5 * y / x)])
        strings.append(np.stack([a, b, c, d], axis=1).reshape(-1, 2))
        stress.append(np.tile([1.0, level], len(bars)))
        bars = np.stack([a, c, c, b, b, d, d, a], axis=1).reshape(-1, 2)
    groups = {"": bars}, {"": np.concatenate(strings)}
    return build_structure(nodes, *groups, options, np.concatenate(stress), prestress)


@shape
def t_bar(
    length: float = 1.0,
    width: float = 0.5,
    prestress: float | None = None,
    iterations: int = 1,
    **options: Any,
) -> Structure:
    """Build a T-bar of four bars (class 4).

    All bars share node 4, the origin. They lie in the plane z = 0, inside a diamond of strings.
    Each further iteration replaces the bars along the axis by T-bars of the same proportions.

    ::

               3
             ╱ ┃ ╲
            0 ━4━ 2      y ↑
             ╲ ┃ ╱         └→ x
               1

    Bars: (4, 0), (4, 1), (4, 2), (4, 3). Strings: (0, 1), (1, 2), (2, 3), (3, 0). Equal force
    densities are in equilibrium. A bar (a, b) becomes the bars (m, a), (m, c), (m, b), (m, d) and
    the strings (a, c), (c, b), (b, d), (d, a), with new nodes c, d and m. Bars across the axis come
    first. Strings are in the order of the iterations.

    Parameters
    ----------
    length : float
        Distance from node 0 to node 2 [m].
    width : float
        Distance from node 1 to node 3 [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    iterations : int
        Number of iterations, including the first T-bar, at least 1.
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
    count = whole_number("iterations", iterations, 1, _MOST_ITERATIONS)
    nodes = np.array([(-x, 0, 0), (0, -y, 0), (x, 0, 0), (0, y, 0), (0, 0, 0)])
    bars = np.array([(4, 0), (4, 1), (4, 2), (4, 3)])
    across, strings = [], [np.array([(0, 1), (1, 2), (2, 3), (3, 0)])]
    for _ in range(2, count + 1):
        across.append(bars[1::2])
        a, b = bars[::2].T
        c, d, m = len(nodes) + np.arange(3 * len(a)).reshape(-1, 3).T
        sides = _beside(nodes, a, b, 0.5 * y / x).reshape(-1, 2, 3)
        middle = 0.5 * (nodes[a] + nodes[b])[:, None]
        nodes = np.concatenate([nodes, np.concatenate([sides, middle], axis=1).reshape(-1, 3)])
        strings.append(np.stack([a, c, c, b, b, d, d, a], axis=1).reshape(-1, 2))
        bars = np.stack([m, a, m, c, m, b, m, d], axis=1).reshape(-1, 2)
    groups = {"": np.concatenate([*across, bars])}, {"": np.concatenate(strings)}
    return build_structure(nodes, *groups, options, np.ones(len(groups[1][""])), prestress)


def _beside(nodes: Array, a: Indices, b: Indices, offset: float) -> Array:
    """Compute two points beside the midpoint of each bar.

    They lie to the right and to the left of the bar (a, b) in the plane of x and y. `nodes` are (n,
    3). The distance from the midpoint is `offset` times the length of the bar.
    """
    right = offset * (nodes[b] - nodes[a])[:, [1, 0, 2]] * [1.0, -1.0, 1.0]
    middle = 0.5 * (nodes[a] + nodes[b])
    return np.stack([middle + right, middle - right], axis=1).reshape(-1, 3)

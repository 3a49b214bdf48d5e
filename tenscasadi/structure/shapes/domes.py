"""Cable domes and the bicycle wheel."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.structure.shapes.family import build_structure, place_ring, polygon, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    MAX_COUNT,
    MAX_REPETITIONS,
    Array,
    Indices,
    positive_number,
    whole_number,
)


@shape
def bicycle_wheel(
    spokes: int = 12,
    radius: float = 1.0,
    axle: float = 0.4,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a bicycle wheel (class 2).

    The rim and the axle are bars, the spokes are strings.

    ::

        0 … p−1  rim, in the plane z = 0        rim ╲     ╱ rim
        p        axle at z = −axle/2                 ╲ p+1╱
        p+1      axle at z = +axle/2                   │ ── z ↑
                                                       p

    Bars: the rim i → i+1, then the axle. Strings: the spokes i → p, then i → p+1. Equal force
    densities of all spokes are in equilibrium.

    Parameters
    ----------
    spokes : int
        Number p of spokes at each end of the axle, and of bars of the rim, at least 3.
    radius : float
        Radius of the rim [m].
    axle : float
        Length of the axle [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The wheel, its axle along z.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.bicycle_wheel(spokes=8)
    Structure(10 nodes, 9 bars, 16 strings, 0 pinned)
    """
    p = whole_number("spokes", spokes, 3, MAX_COUNT)
    radius, half = positive_number("radius", radius), 0.5 * positive_number("axle", axle)
    i = np.arange(p)
    nodes = np.concatenate([place_ring(p, radius, 0.0, 0.0), [(0, 0, -half), (0, 0, half)]])
    bars = {"rim": polygon(i), "axle": np.array([(p, p + 1)])}
    strings = {"lower": np.c_[i, np.full(p, p)], "upper": np.c_[i, np.full(p, p + 1)]}
    return build_structure(nodes, bars, strings, options, prestress=prestress)


@shape
def geiger_dome(
    segments: int = 12,
    hoops: int = 2,
    radius: float = 10.0,
    rise: float = 1.5,
    post: float = 1.5,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a Geiger cable dome (class 1).

    Posts are bars, and no two of them share a node. Ridges, diagonals and hoops are strings. Ridges
    and diagonals are radial. A hoop is a ring of strings between the bottoms of p posts. The outer
    ring of nodes is pinned.

    ::

               ╱ ─── ridge ─── top k ─── ridge ─── top 1 ──── top of the central post
        pinned                 │ post               │                │
               ╲ ── diagonal ─ bottom k  ╲ diagonal bottom 1  ╲ ──── bottom
                               ○ hoop               ○ hoop

    Nodes and members are listed from the inside to the outside. The first two nodes are the top and
    the bottom of the central post. The p tops and the p bottoms of the posts at the first hoop
    follow, then those at the next hoops. The last p nodes are pinned. The first bar is the central
    post, and those at each hoop follow. The first strings are the ridges, p in each ring. The
    diagonals follow in the same order. The last strings are the hoops, p in each.

    Parameters
    ----------
    segments : int
        Number p of radial planes, at least 3.
    hoops : int
        Number of hoops, at least 1.
    radius : float
        Radius of the pinned ring [m].
    rise : float
        Height of the central top above the pinned ring [m]; all tops lie on a paraboloid.
    post : float
        Length of the posts [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The dome, its pinned ring in the plane z = 0.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.geiger_dome(segments=8, hoops=1)
    Structure(26 nodes, 9 bars, 40 strings, 8 pinned)
    """
    return _dome(segments, hoops, radius, rise, post, (0,), prestress, options)


@shape
def levy_dome(
    segments: int = 12,
    hoops: int = 2,
    radius: float = 10.0,
    rise: float = 1.5,
    post: float = 1.5,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a Levy cable dome (class 1).

    Ridges and diagonals form triangles. It differs from `geiger_dome` outside the first hoop: each
    ring is rotated by half a segment, and two ridges and two diagonals lead from each post to the
    next ring. Nodes and members are listed as in `geiger_dome`. Outside the first hoop, the ridges of
    a ring lead from each post i to node i of the next ring, then from each post i to node i − 1. So
    do the diagonals.

    Parameters
    ----------
    segments : int
        Number p of posts of each hoop, at least 3.
    hoops : int
        Number of hoops, at least 1.
    radius : float
        Radius of the pinned ring [m].
    rise : float
        Height of the central top above the pinned ring [m]; all tops lie on a paraboloid.
    post : float
        Length of the posts [m].
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The dome, its pinned ring in the plane z = 0.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.levy_dome(segments=8, hoops=1)
    Structure(26 nodes, 9 bars, 56 strings, 8 pinned)
    """
    return _dome(segments, hoops, radius, rise, post, (0, -1), prestress, options)


def _dome(
    segments: int,
    hoops: int,
    radius: float,
    rise: float,
    post: float,
    shifts: tuple[int, ...],
    prestress: float | None,
    options: dict[str, Any],
) -> Structure:
    """Build a cable dome; for its dimensions and options see `geiger_dome`.

    Strings lead from node i to the nodes i + shift of the next ring, for all `shifts`.
    """
    count = whole_number("hoops", hoops, 1, MAX_REPETITIONS)
    p = whole_number("segments", segments, 3, MAX_COUNT // count)
    size, rise = positive_number("radius", radius), positive_number("rise", rise)
    nodes = _dome_nodes(p, count, size, rise, positive_number("post", post), len(shifts) > 1)
    i = np.arange(p)
    top = [np.zeros(p, dtype=int), *(2 + 2 * k * p + i for k in range(count + 1))]
    bottom = [np.ones(p, dtype=int), *(2 + (2 * k + 1) * p + i for k in range(count))]
    bars = {"center": np.array([(1, 0)])}
    bars |= {f"post{k}": np.c_[bottom[k], top[k]] for k in range(1, count + 1)}
    rays: dict[str, Indices] = {}
    for name, inner in (("ridge", top), ("diagonal", bottom)):
        for k in range(count + 1):
            steps = shifts if k else (0,)
            rays[f"{name}{k}"] = np.concatenate(
                [np.c_[inner[k], np.roll(top[k + 1], -step)] for step in steps]
            )
    rings = {f"hoop{k}": polygon(bottom[k]) for k in range(1, count + 1)}
    given = {"pinned": top[-1].tolist(), **options}
    return build_structure(nodes, bars, rays | rings, given, prestress=prestress)


def _dome_nodes(p: int, hoops: int, radius: float, rise: float, post: float, turned: bool) -> Array:
    """Compute the nodes (n, 3) of a cable dome [m].

    They are the central post, tops and bottoms of each of the `hoops` with p posts, and the pinned
    ring. `radius`, `rise` and `post` are those of `geiger_dome`. If `turned`, each ring outside the
    first hoop is rotated by half a segment.
    """
    nodes = [np.array([(0.0, 0.0, rise), (0.0, 0.0, rise - post)])]
    for k in range(1, hoops + 2):
        share = k / (hoops + 1)
        start = turned * (k - 1) * np.pi / p
        high = place_ring(p, share * radius, start, rise * (1 - share**2))
        nodes += [high, high - [0, 0, post]] if k <= hoops else [high]
    return np.concatenate(nodes)

"""Towers of stacked prisms, and spines of tetrahedra."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tenscasadi.structure.class_one import member_vectors
from tenscasadi.structure.shapes.family import build_structure, place_ring, polygon, shape
from tenscasadi.structure.shapes.prisms import check_twist, equilibrium_twist
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.validate import (
    MAX_COUNT,
    Array,
    Indices,
    number,
    positive_number,
    whole_number,
)

optimize = lazy_module("scipy.optimize")

_MOST_STAGES = 100  # the overlap of class-1 towers needs determinants of 6 times as many rows
_TRIALS = 100  # overlaps at which the sign of the determinant is evaluated


class _Tower(NamedTuple):
    """Nodes and groups of members of a tower.

    `nodes` are (n, 3) [m]; `bars` and `strings` have the node pairs of each group by name.
    """

    nodes: Array
    bars: dict[str, Indices]
    strings: dict[str, Indices]


@shape
def prism_tower(
    stages: int = 2,
    bars: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    joint_class: int = 2,
    twist: float | None = None,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a tower of stacked prisms.

    Consecutive stages have opposite handedness. In class 2, consecutive stages share a polygon of
    strings. In class 1, no bars share a node: each stage starts below the top of the previous one,
    and saddle strings zigzag between them.

    ::

        class 2                        class 1                        rings of p nodes, from below,
        ring 2  ── stage 1 ends        ring 3  ── stage 1 ends        node k p + i on ring k
        ring 1  ── it begins there     ring 1  ── stage 0 ends
        ring 0  ── stage 0 begins      ring 2  ── stage 1 begins, `overlap` below ring 1
                                       ring 0  ── stage 0 begins

    Bars of stage s: i → i±1 from its lower ring to its upper ring. Strings of class 2: the
    polygons, ring by ring; then the verticals i → i, stage by stage. Strings of class 1 begin with
    the lowest and the highest polygon and the verticals. Then each stage but the last has its
    saddle strings, to i and to i−1 of the next stage. They are followed by its diagonals, between
    the lower rings and between the upper rings of both stages.

    Parameters
    ----------
    stages : int
        Number of stages, at least 1.
    bars : int
        Number p of bars of each stage, at least 3.
    radius : float
        Radius of the rings [m].
    height : float
        Height of a stage [m].
    joint_class : {1, 2}
        Largest number of bars that share a node.
    twist : float, optional
        Angle from a bar's lower end to its upper end about the z axis [rad]. Default: π/2 + π/p in
        class 2, the only one with a self-stress, and π/2 + 7π/6p in class 1, where it fixes the
        overlap.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The tower, from the plane z = 0 upwards.

    Raises
    ------
    ValueError
        No overlap below the height of a stage has a self-stress with all strings of class 1 in
        tension at this twist.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.prism_tower(stages=3, bars=4)
    Structure(16 nodes, 12 bars, 28 strings, 0 pinned)
    >>> tower = tc.shapes.prism_tower(stages=2, joint_class=1)
    >>> round(float(tower.nodes[3, 2] - tower.nodes[6, 2]), 4)  # the overlap
    0.1633
    """
    count = whole_number("stages", stages, 1, _MOST_STAGES)
    p = whole_number("bars", bars, 3, MAX_COUNT // count)
    whole_number("joint_class", joint_class, 1, 2)
    radius, height = positive_number("radius", radius), positive_number("height", height)
    default = equilibrium_twist(p) + np.pi / (6 * p) * (joint_class == 1 and count > 1)
    turn = (default if twist is None else number("twist", twist)) - 2 * np.pi / p
    if joint_class == 1:
        tower = _overlap(count, p, radius, height, turn)
        return build_structure(*tower, options, prestress=prestress)
    check_twist(prestress, p, turn + 2 * np.pi / p)
    of_polygons = np.where(np.arange(count + 1) % count == 0, 1.0, 2.0)
    stress = np.repeat([*of_polygons, *np.full(count, 2.0 * np.sin(np.pi / p))], p)
    tower = _stack(count, p, radius, height, turn)
    return build_structure(*tower, options, stress, prestress)


def _stack(stages: int, p: int, radius: float, height: float, turn: float) -> _Tower:
    """Build a tower of class 2, whose stages share nodes.

    It has `stages` of p bars, with rings of this radius and stages of this height [m]. `turn` is
    the angle between the rings of a stage [rad].
    """
    i = np.arange(p)
    leaning = [(-1) ** s for s in range(stages)]
    angles = np.cumsum([0.0, *(side * turn for side in leaning)])
    nodes = np.concatenate(
        [place_ring(p, radius, angle, k * height) for k, angle in enumerate(angles)]
    )
    strings = {f"polygon{k}": polygon(k * p + i) for k in range(stages + 1)}
    strings |= {f"vertical{s}": np.c_[s * p + i, (s + 1) * p + i] for s in range(stages)}
    bars = {f"bar{s}": _join(p, s, s + 1, side) for s, side in enumerate(leaning)}
    return _Tower(nodes, bars, strings)


def _overlap(stages: int, p: int, radius: float, height: float, turn: float) -> _Tower:
    """Build a tower of class 1 whose overlap permits a self-stress.

    Stages overlap along z by a length that is found by bisection. At this overlap, the square
    equilibrium matrix of one node of each ring is singular. The arguments are those of `_stack`.
    """

    def build(overlap: float) -> _Tower:
        return _build_class_one(stages, p, radius, height, turn, overlap)

    def orientation(overlap: float) -> float:
        return float(np.linalg.slogdet(_ring_balance(build(overlap), p))[0])

    if stages == 1:
        return build(0.0)
    trials = np.linspace(0.0, height, _TRIALS + 1)[1:-1]
    signs = np.array([orientation(trial) for trial in trials])
    for k in np.flatnonzero(signs[:-1] * signs[1:] < 0.0):
        tower = build(optimize.bisect(orientation, trials[k], trials[k + 1]))
        stress = np.linalg.svd(_ring_balance(tower, p))[2][-1]
        if np.ptp(np.sign(stress * np.r_[-np.ones(stages), np.ones(len(tower.strings))])) == 0:
            return tower
    raise ValueError(
        f"twist is {turn + 2 * np.pi / p:g}: no overlap of the stages holds all strings in tension, "
        f"give one a little above {equilibrium_twist(p):g}"
    )


def _build_class_one(
    stages: int, p: int, radius: float, height: float, turn: float, overlap: float
) -> _Tower:
    """Build a tower of class 1 with given overlap [m].

    The overlap is that of the stages along z. The other arguments are those of `_stack`.
    """
    i, nodes, angle = np.arange(p), [], 0.0
    strings = {"polygon0": polygon(i), "polygon1": polygon((2 * stages - 1) * p + i)}
    bars: dict[str, Indices] = {}
    between: dict[str, Indices] = {}
    for s in range(stages):
        side = (-1) ** s
        lower, upper, base = 2 * s, 2 * s + 1, s * (height - overlap)
        nodes += [
            place_ring(p, radius, angle, base),
            place_ring(p, radius, angle + side * turn, base + height),
        ]
        angle += side * turn + np.pi / p
        bars[f"bar{s}"] = _join(p, lower, upper, side)
        strings[f"vertical{s}"] = _join(p, lower, upper, 0)
        if s + 1 < stages:
            between |= {
                f"saddle{s}": _join(p, upper, lower + 2, 0),
                f"other_saddle{s}": _join(p, upper, lower + 2, -1),
                f"diagonal{s}": _join(p, lower, lower + 2, min(-side, 0)),
                f"upper_diagonal{s}": _join(p, upper, upper + 2, min(side, 0)),
            }
    return _Tower(np.concatenate(nodes), bars, strings | between)


def _ring_balance(tower: _Tower, p: int) -> Array:
    """Compute the equilibrium matrix of one node of each ring.

    The tower is symmetric. Rows are radial, tangential and z forces on these nodes. Columns are
    groups of bars, then of strings. Two rows are omitted, which are dependent because of the
    rigid-body translation and rotation about z. Each ring has p nodes.
    """
    groups = [*tower.bars.values(), *tower.strings.values()]
    forces = np.zeros((len(tower.nodes), 3, len(groups)))
    for k, pairs in enumerate(groups):
        vectors = member_vectors(tower.nodes, pairs)
        np.subtract.at(forces[:, :, k], pairs[:, 0], vectors)
        np.add.at(forces[:, :, k], pairs[:, 1], vectors)
    first = tower.nodes[::p]
    across = first[:, :2] / np.linalg.norm(first[:, :2], axis=1, keepdims=True)
    x, y, z = forces[::p].transpose(1, 0, 2)
    radial = across[:, :1] * x + across[:, 1:] * y
    tangential = across[:, :1] * y - across[:, 1:] * x
    return np.asarray(np.concatenate([radial, tangential[1:], z[1:]]))


def _join(p: int, lower: int, upper: int, shift: int) -> Indices:
    """Build node pairs between two rings of p nodes.

    Node i of the lower ring is paired with node i + shift of the upper ring. Rings are given by
    their numbers `lower` and `upper`, from below.
    """
    i = np.arange(p)
    return np.asarray(np.c_[lower * p + i, upper * p + (i + shift) % p])


@shape
def spine(
    vertebrae: int = 3,
    width: float = 1.0,
    height: float = 1.0,
    pitch: float | None = None,
    prestress: float | None = None,
    **options: Any,
) -> Structure:
    """Build a spine of tetrahedra and strings (class 3).

    The vertebrae do not touch.

    ::

        4v+2 ──── 4v+3      top edge, along y, at height/2 above the center of the vertebra
           ╲ ╲╱ ╱
           ╱ ╱╲ ╲           centers lie `pitch` apart along z, so that a top edge
        4v   ──── 4v+1      stands above the bottom edge, along x, of the next vertebra

    Bars: the six edges of each vertebra, in lexical order. Strings between consecutive vertebrae:
    four verticals, which pull them together; then the four saddle strings from the top edge of the
    lower vertebra to the bottom edge of the upper vertebra, which pull them apart.

    Parameters
    ----------
    vertebrae : int
        Number of vertebrae, at least 1.
    width : float
        Length of the top and bottom edges [m].
    height : float
        Height of a vertebra [m].
    pitch : float, optional
        Distance of consecutive vertebrae [m], less than the height; by default two thirds of it.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The spine, its lowest edge in the plane z = 0.

    Notes
    -----
    In the self-stress, the force densities of saddle strings and verticals are in the ratio pitch :
    (height − pitch).

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.spine(vertebrae=4)
    Structure(16 nodes, 24 bars, 24 strings, 0 pinned)
    """
    count = whole_number("vertebrae", vertebrae, 1, MAX_COUNT)
    half, height = 0.5 * positive_number("width", width), positive_number("height", height)
    rise = 2 / 3 * height if pitch is None else positive_number("pitch", pitch)
    if rise >= height:
        raise ValueError(f"pitch is {rise:g}: it must be less than the height, {height:g} m")
    one = np.array([(-half, 0, 0), (half, 0, 0), (0, -half, height), (0, half, height)])
    start = 4 * np.arange(count)
    nodes = (one + rise * np.arange(count)[:, None, None] * [0, 0, 1]).reshape(-1, 3)
    edges = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
    vertical = np.array([(k, 4 + k) for k in range(4)])
    saddle = np.array([(2, 4), (2, 5), (3, 4), (3, 5)])
    strings: dict[str, Indices] = {}
    for v in range(count - 1):
        strings |= {f"vertical{v}": start[v] + vertical, f"saddle{v}": start[v] + saddle}
    stress = np.tile(np.repeat([height - rise, rise], 4), count - 1)
    vertebra = {f"vertebra{v}": first + edges for v, first in enumerate(start)}
    given = None if count == 1 else prestress
    return build_structure(nodes, vertebra, strings, options, stress, given)

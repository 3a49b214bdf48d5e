"""Structures of the problems in the suite."""

from __future__ import annotations

from typing import Any

import numpy as np

import tenscasadi as tc


def driven(structure: tc.Structure, **scene: Any) -> tc.Model:
    """Model of a structure with force densities as control."""
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **scene))


def turn(bars: int) -> float:
    """Angle [rad] about the vertical between the ends of a prism's bar in equilibrium."""
    return np.pi / 2 + np.pi / bars


def prism(bars: int, height: float, length: float = 1.4, **options: Any) -> tc.Structure:
    """Prism of a height [m] in equilibrium, with bars of a length [m]."""
    radius = np.sqrt(length**2 - height**2) / (2 * np.sin(turn(bars) / 2))
    return tc.shapes.prism(bars, radius, height, **options)


def tower(
    stages: int, height: float, bars: int = 3, length: float = 1.4, **options: Any
) -> tc.Structure:
    """Tower of prisms of a height [m] that share rings, with alternating handedness."""
    radius = np.sqrt(length**2 - height**2) / (2 * np.sin(turn(bars) / 2))
    one = range(bars)
    nodes, ends, strings, first = [], [], [], 0.0
    for level in range(stages + 1):
        angles = first + 2 * np.pi * np.arange(bars) / bars
        nodes.append(
            np.column_stack(
                [radius * np.cos(angles), radius * np.sin(angles), np.full(bars, level * height)]
            )
        )
        ring, above, way = level * bars, (level + 1) * bars, 1 if level % 2 == 0 else -1
        strings += [(ring + k, ring + (k + 1) % bars) for k in one]
        if level < stages:
            strings += [(ring + k, above + k) for k in one]
            ends += [(ring + k, above + (k + way) % bars) for k in one]
        first += way * (turn(bars) - 2 * np.pi / bars)
    return tc.Structure(np.concatenate(nodes), ends, strings, **options)


def six_bar_ball(size: float, **options: Any) -> tc.Structure:
    """Six-bar ball with bars at `size` times the distance from the center."""
    start = tc.shapes.six_bar_ball(**options)
    nodes = start.nodes.copy()
    middle = nodes[start.bars].mean(axis=1)
    for bar, (a, b) in enumerate(start.bars):
        nodes[[a, b]] += (size - 1) * middle[bar]
    return tc.Structure(nodes, start.bars, start.strings, **options)


def arm(bars: int = 1, **options: Any) -> tc.Structure:
    """Chain of hinged bars of 1 m that stands on the ground.

    Four strings connect the upper end of each bar to points around its lower end.
    """
    joints = [(0.0, 0.0, float(level)) for level in range(bars + 1)]
    around = [
        (x, y, float(level))
        for level in range(bars)
        for x, y in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))
    ]
    strings = [
        (level + 1, bars + 1 + 4 * level + side) for level in range(bars) for side in range(4)
    ]
    pinned = [0, *range(bars + 1, bars + 1 + 4 * bars)]
    return tc.Structure(
        [*joints, *around], [(k, k + 1) for k in range(bars)], strings, pinned=pinned, **options
    )


def hub(tips: np.ndarray, **options: Any) -> tc.Structure:
    """Bars from a common node to the nodes `tips` (n, 3), connected by strings."""
    count = len(tips)
    strings = [(a, b) for a in range(1, count + 1) for b in range(a + 1, count + 1)]
    return tc.Structure(
        [(0, 0, 0), *tips], [(0, k) for k in range(1, count + 1)], strings, **options
    )


def spread(count: int, lift: float) -> np.ndarray:
    """Unit vectors: one upward, `count` − 1 others `lift` rad below the horizontal."""
    angles = 2 * np.pi * np.arange(count - 1) / (count - 1)
    around = np.column_stack(
        [
            np.cos(lift) * np.cos(angles),
            np.cos(lift) * np.sin(angles),
            np.full(count - 1, -np.sin(lift)),
        ]
    )
    return np.vstack([around, (0, 0, 1)])


def net(size: int, **options: Any) -> tc.Structure:
    """Square net of `size` × `size` nodes of 0.2 kg, 0.5 m apart, with a fixed rim."""
    side = size + 2
    nodes = [(0.5 * row, 0.5 * column, 0.0) for row in range(side) for column in range(side)]
    inside = [row * side + column for row in range(1, side - 1) for column in range(1, side - 1)]
    across = [
        (k, k + step)
        for k in range(side * side)
        for step in (1, side)
        if (k + step in inside or k in inside) and k + step < side * side
    ]
    strings = [(a, b) for a, b in across if b - a == side or b // side == a // side]
    used = sorted({node for string in strings for node in string})
    place = {node: k for k, node in enumerate(used)}
    pinned = [place[node] for node in used if node not in inside]
    mass = [0.2 if node in inside else 0.0 for node in used]
    ends = [(place[a], place[b]) for a, b in strings]
    return tc.Structure(
        [nodes[node] for node in used], [], ends, node_mass=mass, pinned=pinned, **options
    )

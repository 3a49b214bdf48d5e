"""Shape changes of unsupported or hinged structures, from rest to rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

import ocp
import tenscasadi as tc
from ocp_problems.case import Case
from ocp_problems.structures import driven, hub, net, prism, six_bar_ball, spread, tower

EFFORT = (ocp.Effort(),)
Span = float | tuple[float, float]


def reshaped(
    start: tc.Structure, end: tc.Structure, lower: float, duration: Span = 1.0, **scene: Any
) -> ocp.Problem:
    """Change of a structure's string lengths to those of another one.

    It begins and ends at rest. Force densities are between `lower` and 200 N/m.
    """
    goals = [ocp.StringLengths(end.string_lengths), ocp.AtRest()]
    return ocp.Problem(
        driven(start, **scene),
        duration,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(lower, 200.0)],
        costs=EFFORT,
    )


def free_prism(
    bars: int, low: float, high: float, duration: Span = 1.0, **scene: Any
) -> ocp.Problem:
    """Height change of an unsupported prism from `low` to `high` [m]."""
    return reshaped(prism(bars, low), prism(bars, high), 2.0, duration, **scene)


def falling() -> ocp.Problem:
    """Shape change of a prism in free fall."""
    goals = [ocp.StringLengths(prism(3, 1.05).string_lengths)]
    model = driven(prism(3, 1.0), gravity=tc.Gravity())
    return ocp.Problem(
        model, 0.5, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)], costs=EFFORT
    )


def standing_prism(bars: int, angle: float) -> ocp.Problem:
    """Lifting of the upper nodes of a prism whose lower nodes are pinned.

    The upper nodes turn about the vertical by `angle` rad. Their height follows from the bar
    lengths.
    """
    structure = prism(bars, 1.0, pinned=range(bars))
    turned, ends = structure.nodes.copy(), structure.bars
    turned[bars:, :2] = turned[bars:, :2] @ [
        [np.cos(angle), np.sin(angle)],
        [-np.sin(angle), np.cos(angle)],
    ]
    flat = np.linalg.norm((turned[ends[:, 1]] - turned[ends[:, 0]])[:, :2], axis=1)
    turned[bars:, 2] = np.sqrt(structure.bar_lengths**2 - flat**2)
    goals = [
        ocp.NodePositions({node: tuple(turned[node]) for node in range(bars, len(turned))}),
        ocp.AtRest(),
    ]
    return ocp.Problem(
        driven(structure),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(2.0, 200.0)],
        costs=EFFORT,
    )


def free_tower(stages: int, low: float = 0.8, high: float = 0.88, bars: int = 3) -> ocp.Problem:
    """Height change of an unsupported tower."""
    return reshaped(tower(stages, low, bars), tower(stages, high, bars), 1.0)


def standing_tower(stages: int, low: float, high: float, **scene: Any) -> ocp.Problem:
    """Lifting of the mean of the highest ring of a tower with pinned lowest ring."""
    structure = tower(stages, low, pinned=range(3))
    top = range(3 * stages, 3 * stages + 3)
    goals = [ocp.NodePositions(dict.fromkeys(top, (None, None, stages * high))), ocp.AtRest()]
    return ocp.Problem(
        driven(structure, **scene),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 500.0)],
        costs=EFFORT,
    )


def d_bar(
    start: float, end: float, pinned: tuple[int, ...] = (0,), duration: Span = 1.0
) -> ocp.Problem:
    """Folding or unfolding of a D-bar."""
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=end).string_lengths), ocp.AtRest()]
    return ocp.Problem(
        driven(tc.shapes.d_bar(angle=start, pinned=pinned)), duration, goals=goals, costs=EFFORT
    )


def t_bar(turn: float, duration: Span = 1.0) -> ocp.Problem:
    """Rotation of the short bars of an unsupported T-bar against its long ones."""
    structure = tc.shapes.t_bar()
    nodes = structure.nodes.copy()
    nodes[[1, 3], 0], nodes[[1, 3], 1] = (
        nodes[[1, 3], 1] * np.sin(turn),
        nodes[[1, 3], 1] * np.cos(turn),
    )
    lengths = np.linalg.norm(np.diff(nodes[structure.strings], axis=1)[:, 0], axis=1)
    return ocp.Problem(
        driven(structure), duration, goals=[ocp.StringLengths(lengths), ocp.AtRest()], costs=EFFORT
    )


def ball(size: float, duration: Span = 1.0, **scene: Any) -> ocp.Problem:
    """Contraction or expansion of the six-bar ball; bars keep their directions."""
    goals = [ocp.Shape(six_bar_ball(size).nodes), ocp.AtRest()]
    start = tc.shapes.six_bar_ball()
    return ocp.Problem(
        driven(start, **scene),
        duration,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
        costs=EFFORT,
    )


def hub_folds(
    count: int, start: float, end: float, pinned: Sequence[int] = (), **scene: Any
) -> ocp.Problem:
    """Folding of bars around a hub, like those of an umbrella."""
    return reshaped(hub(spread(count, start), pinned=pinned), hub(spread(count, end)), 0.5, **scene)


def net_moves(size: int, depth: float) -> ocp.Problem:
    """Displacement of the middle of a net within its plane; the rim is fixed."""
    structure = net(size)
    middle = int(np.argmin(np.linalg.norm(structure.nodes - structure.nodes.mean(axis=0), axis=1)))
    place = structure.nodes[middle] + (depth, depth / 2, 0)
    goals = [ocp.NodePositions({middle: tuple(place)}), ocp.AtRest()]
    return ocp.Problem(
        driven(structure),
        1.0,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(0.5, 200.0)],
        costs=EFFORT,
    )


def small_cases() -> Iterator[Case]:
    """Yield problems of prisms, D-bars, T-bars and balls."""
    for bars in (3, 4, 5, 6):
        for low, high in ((1.0, 1.05), (1.0, 1.15), (1.1, 0.8)):
            name, quick = f"prism of {bars}, {low} to {high} m", bars == 3 and high == 1.15
            yield Case("prism", name, partial(free_prism, bars, low, high), 1e-4, quick)
    yield Case("prism", "prism of 3, flat to tall", partial(free_prism, 3, 0.3, 1.2), 1e-4)
    yield Case("prism", "prism on its feet, turns", partial(standing_prism, 3, 0.1), 1e-4, True)
    yield Case("prism", "prism on its feet, turns back", partial(standing_prism, 3, -0.2), 1e-4)
    yield Case("prism", "prism of 4 on its feet", partial(standing_prism, 4, 0.1), 1e-4)
    yield Case("prism", "prism in free fall", falling, 1e-4)
    yield Case("prism", "prism of 8", partial(free_prism, 8, 1.0, 1.1), 1e-3)
    yield Case("prism", "prism of 12", partial(free_prism, 12, 1.0, 1.1), 1e-3)
    yield Case(
        "free duration",
        "prism of 3, free duration",
        partial(free_prism, 3, 1.0, 1.1, (0.6, 1.6)),
        1e-4,
    )
    yield Case(
        "free duration",
        "prism of 4, free duration",
        partial(free_prism, 4, 1.0, 1.1, (0.6, 1.6)),
        1e-4,
    )
    yield Case("D-bar, T-bar", "D-bar, free, opens", partial(d_bar, np.pi / 4, 0.9, ()), 1e-4)
    yield Case("D-bar, T-bar", "D-bar, pinned, folds", partial(d_bar, np.pi / 4, 0.6), 1e-4, True)
    yield Case("D-bar, T-bar", "D-bar, pinned, folds far", partial(d_bar, np.pi / 4, 0.3), 1e-3)
    yield Case("D-bar, T-bar", "D-bar, pinned, unfolds", partial(d_bar, 0.4, 1.0), 1e-3)
    yield Case(
        "free duration",
        "D-bar, free duration",
        partial(d_bar, np.pi / 4, 0.6, (0,), (0.7, 1.5)),
        1e-4,
    )
    yield Case("D-bar, T-bar", "T-bar turns", partial(t_bar, 0.3), 1e-4, True)
    yield Case("D-bar, T-bar", "T-bar turns far", partial(t_bar, 0.7), 1e-4)
    yield Case("free duration", "T-bar, free duration", partial(t_bar, 0.4, (0.6, 1.4)), 1e-4)
    yield Case("ball", "ball shrinks a little", partial(ball, 0.95), 1e-3)
    yield Case("ball", "ball shrinks", partial(ball, 0.85), 1e-3)
    yield Case("ball", "ball grows", partial(ball, 1.1), 1e-3)


def large_cases() -> Iterator[Case]:
    """Yield problems of towers, hubs, nets and strings with mass."""
    for stages in (2, 3, 4, 8):
        yield Case("tower", f"tower of {3 * stages} bars", partial(free_tower, stages), 1e-3)
    yield Case("tower", "tower of 8 bars, rings of 4", partial(free_tower, 2, 0.8, 0.85, 4), 1e-3)
    yield Case("tower", "tower of 12 bars, rings of 6", partial(free_tower, 2, 0.8, 0.85, 6), 1e-3)
    yield Case("tower", "tower of 6 bars sinks", partial(free_tower, 2, 0.9, 0.75), 1e-3)
    yield Case("tower", "tower of 6 bars on its feet", partial(standing_tower, 2, 0.8, 0.9), 1e-3)
    yield Case(
        "tower",
        "tower of 6 bars under its weight",
        partial(standing_tower, 2, 0.8, 0.85, gravity=tc.Gravity()),
        1e-3,
    )
    yield Case(
        "tower",
        "tower of 12 bars under its weight",
        partial(standing_tower, 4, 0.8, 0.85, gravity=tc.Gravity()),
        1e-3,
    )
    yield Case("hub", "hub of 4 folds", partial(hub_folds, 4, 0.3, 0.6), 1e-3)
    yield Case("hub", "hub of 5 folds", partial(hub_folds, 5, 0.4, 0.1), 1e-3)
    yield Case("hub", "hub of 6 folds far", partial(hub_folds, 6, 0.1, 0.9), 1e-3)
    yield Case("hub", "hub of 5, held in the middle", partial(hub_folds, 5, 0.4, 0.1, (0,)), 1e-3)
    for size, depth in ((1, 0.2), (2, 0.15), (3, 0.15)):
        yield Case("net", f"net of {size * size} knots", partial(net_moves, size, depth), 1e-3)
    yield Case(
        "massive strings", "prism, strings of two pieces", partial(heavy_strings, 3, 2), 1e-3
    )
    yield Case(
        "massive strings", "prism, strings of three pieces", partial(heavy_strings, 3, 3), 1e-3
    )
    yield Case(
        "massive strings", "prism of 4, strings of two pieces", partial(heavy_strings, 4, 2), 1e-3
    )


def heavy_strings(bars: int, segments: int) -> ocp.Problem:
    """Lifting of a standing prism by strings with mass, in several segments each."""
    structure = prism(bars, 1.0, pinned=range(bars), string_mass=0.05)
    top = range(bars, 2 * bars)
    goals = [ocp.NodePositions(dict.fromkeys(top, (None, None, 1.05)))]
    model = driven(structure, segments=segments)
    return ocp.Problem(
        model, 0.5, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 500.0)], costs=EFFORT
    )

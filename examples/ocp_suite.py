"""A suite of planning problems, each solved from the default guess, with the error of its replay against a stated tolerance.

Run it: python examples/ocp_suite.py
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

import ocp
import tenscasadi as tc
from ocp.problem.bounds import Bound

EFFORT = (ocp.Effort(),)


class Case(NamedTuple):
    """A problem by name, how finely it is solved, and the error, m, that its replay may have."""

    name: str
    problem: Callable[[], ocp.Problem]
    intervals: int
    substeps: int
    tolerance: float
    quick: bool = False


class Row(NamedTuple):
    """What became of a case."""

    name: str
    success: bool
    iterations: int
    seconds: float
    error: float
    tolerance: float

    @property
    def met(self) -> bool:
        """Whether a plan was found and its replay is as exact as it should be."""
        return self.success and self.error <= self.tolerance


def prism(bars: int, height: float, length: float = 1.4, **options: object) -> tc.Structure:
    """The prism that stands `height` m tall in equilibrium on bars of `length` m."""
    chord = 2 * np.sin(np.pi / 4 + np.pi / (2 * bars))
    return tc.shapes.prism(bars, np.sqrt(length**2 - height**2) / chord, height, **options)  # type: ignore[arg-type]


def driven(structure: tc.Structure, gravity: tc.Gravity | None = None) -> tc.Model:
    """The structure under given force densities."""
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), gravity=gravity))


def free_prism(bars: int, low: float, high: float, duration: float | tuple[float, float] = 1.0) -> ocp.Problem:
    """A free prism changes its height, from rest to rest."""
    goals = [ocp.StringLengths(prism(bars, high).string_lengths), ocp.AtRest()]
    limits = [ocp.ForceDensityLimits(2.0, 200.0)]
    return ocp.Problem(driven(prism(bars, low)), duration, goals=goals, bounds=limits, costs=EFFORT)


def standing_prism(bars: int, angle: float) -> ocp.Problem:
    """A prism whose lower nodes are pinned lifts its upper ones, as far as the bars allow, by turning them by `angle` rad."""
    structure = prism(bars, 1.0, pinned=range(bars))
    turned, ends = structure.nodes.copy(), structure.bars
    turned[bars:, :2] = turned[bars:, :2] @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]
    flat = np.linalg.norm((turned[ends[:, 1]] - turned[ends[:, 0]])[:, :2], axis=1)
    turned[bars:, 2] = np.sqrt(structure.bar_lengths**2 - flat**2)
    goals = [ocp.NodePositions({node: tuple(turned[node]) for node in range(bars, len(turned))}), ocp.AtRest()]
    return ocp.Problem(driven(structure), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)], costs=EFFORT)


def d_bar(start: float, end: float, pinned: tuple[int, ...] = (0,), duration: float | tuple[float, float] = 1.0) -> ocp.Problem:
    """A D-bar folds or unfolds."""
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=end).string_lengths), ocp.AtRest()]
    structure = tc.shapes.d_bar(angle=start, pinned=pinned)
    return ocp.Problem(driven(structure), duration, goals=goals, costs=EFFORT)


def t_bar(turn: float, duration: float | tuple[float, float] = 1.0) -> ocp.Problem:
    """A free T-bar turns its short bars against its long ones, in the plane."""
    structure = tc.shapes.t_bar()
    nodes = structure.nodes.copy()
    nodes[[1, 3], 0], nodes[[1, 3], 1] = nodes[[1, 3], 1] * np.sin(turn), nodes[[1, 3], 1] * np.cos(turn)
    lengths = np.linalg.norm(np.diff(nodes[structure.strings], axis=1)[:, 0], axis=1)
    return ocp.Problem(driven(structure), duration, goals=[ocp.StringLengths(lengths), ocp.AtRest()], costs=EFFORT)


def ball(size: float) -> ocp.Problem:
    """The six-bar ball is pressed: every bar keeps its direction and moves towards the middle."""
    start = tc.shapes.six_bar_ball()
    nodes = start.nodes.copy()
    middle = nodes[start.bars].mean(axis=1)
    for bar, (a, b) in enumerate(start.bars):
        nodes[[a, b]] += (size - 1) * middle[bar]
    goals = [ocp.Shape(nodes), ocp.AtRest()]
    return ocp.Problem(driven(start), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=EFFORT)


def arm(place: float, weight: bool = False) -> ocp.Problem:
    """A bar on a hinge between four strings leans over."""
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    structure = tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5])
    goals = [ocp.NodePositions({1: (place, 0.2, None)}), ocp.AtRest()]
    model = driven(structure, tc.Gravity() if weight else None)
    return ocp.Problem(model, 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 300.0)], costs=EFFORT)


def there_and_back() -> ocp.Problem:
    """A prism grows and is back as it was, ready to start again."""
    goals = [ocp.Waypoint([ocp.Shape(prism(3, 1.1).nodes)], time=0.5), ocp.Periodic()]
    return ocp.Problem(driven(prism(3, 1.0)), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)], costs=EFFORT)


def falling() -> ocp.Problem:
    """A prism changes shape in free fall."""
    goals = [ocp.StringLengths(prism(3, 1.05).string_lengths)]
    return ocp.Problem(driven(prism(3, 1.0), tc.Gravity()), 0.5, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)], costs=EFFORT)


def limited(*bounds: Bound) -> ocp.Problem:
    """A prism grows within further limits."""
    asked = free_prism(3, 1.0, 1.1)
    return ocp.Problem(asked.model, 1.0, goals=asked.goals, bounds=[*asked.bounds, *bounds], costs=EFFORT)


def cases() -> Iterator[Case]:
    """All problems."""
    for bars in (3, 4, 5, 6):
        for low, high in ((1.0, 1.05), (1.0, 1.15), (1.1, 0.8)):
            name, quick = f"prism of {bars}, {low} to {high} m", bars == 3 and high == 1.15
            yield Case(name, lambda b=bars, a=low, z=high: free_prism(b, a, z), 20, 1, 1e-4, quick)  # type: ignore[misc]
    yield Case("prism of 3, flat to tall", lambda: free_prism(3, 0.3, 1.2), 30, 2, 1e-4)
    yield Case("prism of 3, free duration", lambda: free_prism(3, 1.0, 1.1, (0.6, 1.6)), 20, 1, 1e-4)
    yield Case("prism of 4, free duration", lambda: free_prism(4, 1.0, 1.1, (0.6, 1.6)), 20, 1, 1e-4)
    yield Case("prism on its feet, turns", lambda: standing_prism(3, 0.1), 20, 2, 1e-4, True)
    yield Case("prism on its feet, turns back", lambda: standing_prism(3, -0.2), 20, 2, 1e-4)
    yield Case("prism of 4 on its feet", lambda: standing_prism(4, 0.1), 20, 2, 1e-4)
    yield Case("prism there and back", there_and_back, 20, 1, 2e-4)
    yield Case("prism in free fall", falling, 20, 1, 1e-4)
    yield Case("prism, limited tension", lambda: limited(ocp.TensionLimits(upper=12.0)), 20, 1, 1e-4)
    yield Case("prism, limited winding", lambda: limited(ocp.RestLengthRateLimits(0.4, stiffness=1000.0)), 20, 1, 1e-4)
    yield Case("D-bar, free, opens", lambda: d_bar(np.pi / 4, 0.9, ()), 20, 2, 1e-4)
    yield Case("D-bar, pinned, folds", lambda: d_bar(np.pi / 4, 0.6), 20, 2, 1e-4, True)
    yield Case("D-bar, pinned, folds far", lambda: d_bar(np.pi / 4, 0.3), 30, 2, 1e-3)
    yield Case("D-bar, pinned, unfolds", lambda: d_bar(0.4, 1.0), 30, 2, 1e-3)
    yield Case("D-bar, free duration", lambda: d_bar(np.pi / 4, 0.6, (0,), (0.7, 1.5)), 20, 2, 1e-4)
    yield Case("T-bar turns", lambda: t_bar(0.3), 20, 2, 1e-4, True)
    yield Case("T-bar turns far", lambda: t_bar(0.7), 20, 2, 1e-4)
    yield Case("T-bar, free duration", lambda: t_bar(0.4, (0.6, 1.4)), 20, 2, 1e-4)
    yield Case("ball shrinks a little", lambda: ball(0.95), 12, 2, 1e-3)
    yield Case("ball shrinks", lambda: ball(0.85), 12, 2, 1e-3)
    yield Case("ball grows", lambda: ball(1.1), 12, 2, 1e-3)
    yield Case("arm leans", lambda: arm(0.4), 20, 1, 1e-4, True)
    yield Case("arm leans far", lambda: arm(-0.7), 20, 2, 1e-4)
    yield Case("arm leans under its weight", lambda: arm(0.4, True), 20, 2, 1e-4)


def main(quick: bool = False) -> list[Row]:
    """Solves the problems (quick: some of them), prints a row for each and how many met their tolerance; returns the rows."""
    print(f"{'problem':32}  found  iterations  seconds  replay error  tolerance")
    rows = []
    for case in cases():
        if quick and not case.quick:
            continue
        began = time.perf_counter()
        plan = ocp.solve(case.problem(), ocp.MultipleShooting(case.intervals, substeps=case.substeps), tolerance=case.tolerance)
        row = Row(case.name, plan.success, plan.iterations, time.perf_counter() - began, plan.replay_error, case.tolerance)
        note = "" if row.met else f"  ← {plan.message[:100]}"
        found = "yes" if row.success else "no"
        print(f"{row.name:32}  {found:5}  {row.iterations:10}  {row.seconds:7.2f}  {row.error:12.1e}  {row.tolerance:9.0e}{note}")
        rows.append(row)
    met = sum(row.met for row in rows)
    print(f"{met} of {len(rows)} problems ({met / len(rows):.0%}) solved from the default guess within their tolerance")
    return rows


if __name__ == "__main__":
    main()

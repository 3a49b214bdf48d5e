"""The policy of the default search: the first attempt, and those that follow a failure."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from planning import driven, folding, prism, raising, shaken

import ocp
import tenscasadi as tc
from ocp.results.result import PlanResult
from ocp.search.policy import attempts, choose_intervals
from ocp.search.task import prepare
from ocp.transcription.mesh import Guess


def in_full_coordinates(problem):
    model = tc.Model(problem.model.scene, coordinates="full")
    return ocp.Problem(
        model, problem.duration, goals=problem.goals, bounds=problem.bounds, costs=problem.costs
    )


def leaning():
    """A bar on a hinge between two strings leans over."""
    structure = tc.Structure(
        [(0, 0, 0), (0, 0, 1), (-1, 0, 0), (1, 0, 0)], [(0, 1)], [(1, 2), (1, 3)], pinned=[0, 2, 3]
    )
    return ocp.Problem(
        driven(structure),
        goals=[ocp.NodePositions({1: (0.3, None, None)}), ocp.AtRest()],
        costs=[ocp.Effort()],
    )


def expire(monitor):
    monitor.deadline = 0.0
    return monitor


def tall():
    """A prism of nine bars rises."""
    low, high = (tc.shapes.prism(9, 0.5, height) for height in (1.0, 1.02))
    goals = [ocp.StringLengths({0: high.string_lengths[0]})]
    bounds = [ocp.ForceDensityLimits(1.0, 200.0)]
    return ocp.Problem(driven(low), goals=goals, bounds=bounds, costs=[ocp.Effort()])


def widening(*bounds):
    """The ball grows: every bar keeps its direction and moves away from the middle."""
    ball = tc.shapes.six_bar_ball()
    nodes = ball.nodes.copy()
    middle = nodes[ball.bars].mean(axis=1)
    for bar, (a, b) in enumerate(ball.bars):
        nodes[[a, b]] += 0.05 * middle[bar]
    limits = [ocp.ForceDensityLimits(1.0, 200.0), *bounds]
    return ocp.Problem(
        driven(ball), goals=[ocp.Shape(nodes), ocp.AtRest()], bounds=limits, costs=[ocp.Effort()]
    )


CHOICES = {
    "three bars": (raising, "chosen: Variational of 30 intervals by Ipopt"),
    "six bars": (widening, "chosen: Variational of 30 intervals by CondensedNewton"),
    "one bar": (
        leaning,
        "chosen: Variational of 30 intervals by Ipopt; found in reduced coordinates",
    ),
    "nine bars": (tall, "chosen: Variational of 30 intervals by CondensedNewton"),
    "six bars, path constraints": (
        lambda: widening(ocp.TensionLimits(upper=60.0)),
        "chosen: Variational of 30 intervals by CondensedNewton",
    ),
    "moved supports, free duration": (
        lambda: shaken((0.4, 2.0)),
        "chosen: Variational of 30 intervals by Ipopt",
    ),
    "full coordinates, nodes without mass pinned": (
        lambda: in_full_coordinates(leaning()),
        "chosen: Variational of 30 intervals by Ipopt; found in reduced coordinates",
    ),
    "full coordinates": (
        lambda: in_full_coordinates(folding()),
        "chosen: Variational of 30 intervals by Ipopt; found in reduced coordinates",
    ),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * name.startswith(("six bars", "nine bars")))
        for name in CHOICES
    ],
)
def test_first_attempt_finds_the_optimum(name):
    make, said = CHOICES[name]
    problem = make()
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert plan.message.endswith(said)
    known = ocp.solve(problem, ocp.MultipleShooting(30), tolerance=1.0)
    assert plan.objective == pytest.approx(known.objective, rel=2e-3)


def test_a_ground_that_nothing_touches_changes_nothing():
    """A prism that is pinned, with a ground at its feet, or far below: the plan is that of least cost."""
    structure = prism(1.0).replace(pinned=[0, 1, 2])
    plans = {}
    for height in (None, 0.0, -5.0):
        ground = None if height is None else tc.Ground(height=height + structure.nodes[:, 2].min())
        model = tc.Model(
            tc.Scene(structure, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground)
        )
        goals = [ocp.StringLengths({6: 0.95 * structure.string_lengths[6]}), ocp.AtRest()]
        plans[height] = ocp.solve(
            ocp.Problem(
                model,
                goals=goals,
                bounds=[ocp.ForceDensityLimits(0.0, 200.0)],
                costs=[ocp.Effort()],
            )
        )
    for plan in plans.values():
        assert plan.success, plan.message
        assert "chosen: Variational of " in plan.message
        assert plan.objective == pytest.approx(plans[None].objective, rel=1e-3)


def test_what_misses_a_tolerance_is_followed_by_what_meets_it():
    plan = ocp.solve(raising(), tolerance=1e-8)
    assert plan.success, plan.message
    assert plan.worst_error <= 1e-8
    assert "chosen: Variational of " in plan.message
    exact = plan.replay(tc.DormandPrince853(), step=plan.time[1] / 4)
    assert exact.nodes[-1] == pytest.approx(plan.replay().nodes[-1], abs=1e-8)


def test_replay_within_the_tolerance_is_enough():
    """Whether corrections come as near to fine steps as asked is no part of the test."""
    plan = ocp.solve(raising(), ocp.Variational(30, accuracy=1e-18), ocp.Ipopt(), tolerance=1e-4)
    assert plan.success, plan.message
    assert plan.worst_error < 1e-4


def failing(problem, monkeypatch, *solvers, found=False):
    """Solve where the first attempts of some solvers fail; found: whether they find an optimum."""
    module = importlib.import_module("ocp.search.find_plan")
    run, asked, left = module.run_attempt, [], list(solvers)

    def run_attempt(task, attempt):
        outcome, target = run(task, attempt)
        name = type(attempt.transcription).__name__
        asked.append((name, attempt.transcription.count, attempt.guess))
        if type(attempt.solver) in left:
            left.remove(type(attempt.solver))
            duals = {} if found else {"duals": None}
            lost = np.full_like(outcome.force_density, 1.0)
            outcome = outcome._replace(
                success=False, coarse=False, why="it fails", force_density=lost, **duals
            )
        return outcome, target

    with monkeypatch.context() as patched:
        patched.setattr(module, "run_attempt", run_attempt)
        return ocp.solve(problem), asked


def test_finer_mesh_follows_an_inexact_plan(monkeypatch):
    plan, asked = failing(raising(), monkeypatch, ocp.Ipopt, found=True)
    assert plan.success, plan.message
    assert [one[:2] for one in asked] == [("Variational", 30), ("Variational", 60)]
    assert asked[1][2].trajectory.time.shape == (31,)  # it starts from the plan that was found
    assert plan.message.endswith(
        "chosen: Variational of 60 intervals by Ipopt, after Variational of 30 intervals by Ipopt"
    )


def test_shooting_follows_a_failure(monkeypatch):
    best = ocp.solve(raising()).objective
    plan, asked = failing(raising(), monkeypatch, ocp.Ipopt)
    assert [one[:2] for one in asked] == [("Variational", 30), ("MultipleShooting", 30)]
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(best, rel=2e-3)
    assert not any(isinstance(guess, PlanResult) for *_, guess in asked)  # both from the default


@pytest.mark.slow
def test_message_lists_attempts_where_no_plan_is_found():
    """A tenth of a second is too short for limits as low as these."""
    problem = ocp.Problem(
        driven(prism(1.0)),
        0.1,
        goals=[ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(1, 2)],
    )
    plan = ocp.solve(problem)
    assert not plan.success
    assert "; tried: Variational of 30 intervals by " in plan.message
    assert "MultipleShooting of 30 intervals by Ipopt" in plan.message
    assert plan.iterations > 0


@pytest.mark.parametrize(("bars", "solver"), [(5, ocp.Ipopt), (6, ocp.CondensedNewton)])
@pytest.mark.parametrize("bounds", [[], [ocp.TensionLimits(upper=60.0)]])
def test_condensed_newton_comes_first_from_six_bars(bars, solver, bounds):
    low, high = (tc.shapes.prism(bars, 0.5, height) for height in (1.0, 1.05))
    problem = ocp.Problem(
        driven(low),
        goals=[ocp.StringLengths({0: high.string_lengths[0]})],
        bounds=[ocp.ForceDensityLimits(1.0, 200.0), *bounds],
        costs=[ocp.Effort()],
    )
    task = prepare(problem, ocp.PiecewiseConstant(), 1e-3)
    assert isinstance(next(attempts(task, None)).solver, solver)


def test_time_limit_ends_the_search(monkeypatch):
    solve = ocp.CondensedNewton.solve
    late = lambda self, program, monitor: solve(self, program, expire(monitor))  # noqa: E731
    monkeypatch.setattr(ocp.CondensedNewton, "solve", late)
    plan = ocp.solve(tall(), time_limit=1000.0, tolerance=1e-9)
    assert not plan.success
    assert "stopped at the time limit" in plan.message
    assert plan.message.endswith("tried: Variational of 30 intervals by CondensedNewton")


def test_wide_limits_of_the_duration_do_not_matter():
    narrow, wide = (ocp.solve(raising(duration=limits)) for limits in ((0.3, 1.0), (0.01, 100.0)))
    assert wide.success, wide.message
    assert wide.objective == pytest.approx(narrow.objective, rel=1e-3)
    assert wide.time[-1] == pytest.approx(narrow.time[-1], rel=1e-2)


@pytest.mark.parametrize(("mass", "expected"), [(1.0, 30), (1e-4, 67)])
def test_intervals_follow_the_fastest_vibration(mass, expected):
    """A knot between two strings of γ = 0.025 N/m swings at √(2 γ/m)."""
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)],
        [],
        [(0, 1), (1, 2)],
        node_mass=[0, mass, 0],
        pinned=[0, 2],
    )
    problem = ocp.Problem(driven(structure), goals=[ocp.AtRest()], costs=[ocp.Effort()])
    guess = Guess(np.repeat(problem.initial_state[None], 5, axis=0), np.full((4, 2), 0.025), 1.0)
    assert choose_intervals(problem, guess) == pytest.approx(expected, abs=1)
    assert expected == max(30, round(3 * np.sqrt(2 * 0.025 / mass)))


def test_many_bars_take_more_intervals():
    """Forces add up along them, more than a guess knows."""
    problem = ocp.Problem(driven(tc.shapes.prism(36)), goals=[ocp.AtRest()], costs=[ocp.Effort()])
    guess = Guess(
        np.repeat(problem.initial_state[None], 5, axis=0), np.full((4, problem.model.nu), 1e-3), 1.0
    )
    assert choose_intervals(problem, guess) == 36


def test_a_node_a_million_times_heavier_moves_as_a_pinned_one():
    """The scale of forces is that of the light bars, which move."""
    low = tc.shapes.prism(bar_mass=1e-3)
    wide = (0.25 - (1.08**2 - 1.0) / (2 * np.sin(np.radians(75))) ** 2) ** 0.5
    high = tc.shapes.prism(radius=wide, height=1.08)
    pinned, loaded = (
        ocp.solve(
            ocp.Problem(
                driven(low.replace(**fixed)),
                goals=[ocp.StringLengths(high.string_lengths), ocp.AtRest()],
                bounds=[ocp.ForceDensityLimits(1e-3, 10.0)],
                costs=[ocp.Effort()],
            ),
            time_limit=60.0,
        )
        for fixed in ({"pinned": [3]}, {"node_mass": [0, 0, 0, 1e3, 0, 0]})
    )
    assert pinned.success, pinned.message
    assert loaded.success, loaded.message
    assert loaded.objective == pytest.approx(pinned.objective, rel=1e-3)


@pytest.mark.parametrize("build", [raising, tall])
def test_every_method_is_repeated_on_a_finer_mesh(build):
    """An optimum that its replay misses is refined by the method that found it."""
    rows = list(attempts(prepare(build(), ocp.PiecewiseConstant(), 1e-2), None))
    for row, finer in zip(rows[::2], rows[1::2], strict=True):
        assert row.after != "inexact" == finer.after
        assert finer[:2] == row[:2]

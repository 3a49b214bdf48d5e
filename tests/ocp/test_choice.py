"""What is chosen where neither transcription nor solver is given, and what follows where it fails."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from planning import driven, folding, prism, raising, shaken

import ocp
import tenscasadi as tc
from ocp.choice import Choice, choose, choose_intervals
from ocp.condensed.method import NOT_SETTLED, solve_condensed
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.initial_guess import Guess


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
    "one bar": (leaning, "chosen: Variational of 30 intervals by Ipopt"),
    "six bars, limits on the way": (
        lambda: widening(ocp.TensionLimits(upper=60.0)),  # a saddle
        "chosen: Variational of 30 intervals by CondensedNewton, after Variational of 30 intervals by Ipopt",
    ),
    "moved supports, free duration": (
        lambda: shaken((0.4, 2.0)),  # a saddle, too
        "chosen: Variational of 30 intervals by CondensedNewton, after Variational of 30 intervals by Ipopt",
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


@pytest.mark.parametrize("name", CHOICES)
def test_what_suits_the_problem_is_chosen_and_said(name):
    make, said = CHOICES[name]
    problem = make()
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert said in plan.message
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


def test_a_replay_within_the_tolerance_is_enough(monkeypatch):
    """How near corrections come to fine steps is the user's to ask for: what the package asks for itself is a means."""
    monkeypatch.setattr("ocp.choice.MISSED", 1e-18)
    for problem in (raising(), widening()):
        plan = ocp.solve(problem, seconds=60.0)
        assert plan.success, plan.message
        assert ", after " not in plan.message
        asked = ocp.solve(problem, plan.transcription, plan.solver, tolerance=1e-4)
        assert not asked.success
        assert "too coarse: corrections end" in asked.message
        assert asked.worst_error < 1e-4


@pytest.mark.parametrize("cost", [1e6, 0.0])
def test_ipopt_goes_on_where_costs_are_not_settled_and_the_better_plan_is_kept(monkeypatch, cost):
    of_package, known = sys.modules["ocp.solve"], solve_condensed
    monkeypatch.setattr(
        of_package,
        "solve_condensed",
        lambda *given: known(*given)._replace(status="unsettled", objective=cost),
    )
    plan = ocp.solve(widening())
    assert plan.success, plan.message
    order = (
        "Ipopt, after Variational of 30 intervals by CondensedNewton",
        "CondensedNewton, after Variational of 30 intervals by Ipopt",
    )
    assert plan.message.endswith(f"chosen: Variational of 30 intervals by {order[cost == 0]}")
    assert cost == 0 or plan.objective < 100


@pytest.mark.parametrize("status", [NOT_SETTLED, "settled"])
def test_only_plans_whose_costs_are_settled_are_guesses_for_the_next_method(monkeypatch, status):
    """A plan that still changes has multipliers that lead elsewhere: the next method begins with the guess that there was."""
    problem, given = raising(), object()
    missing = replace(ocp.solve(problem, ocp.Variational(4)), success=False, status=status)
    assert missing.duals is not None
    ways = [
        Choice(ocp.Variational(4), ocp.CondensedNewton()),
        Choice(ocp.Variational(6), ocp.Ipopt(), guess=given),
    ]
    of_package, begun = sys.modules["ocp.solve"], []
    monkeypatch.setattr(of_package, "choose", lambda *asked: iter(ways))
    monkeypatch.setattr(
        of_package,
        "_by_method",
        lambda asked, way, *rest: begun.append((asked.guess, way.guess)) or missing,
    )
    plan = ocp.solve(problem)
    assert plan.message.endswith(
        "tried: Variational of 4 intervals by CondensedNewton, Variational of 6 intervals by Ipopt"
    )
    assert begun == [(None, None), (None, given) if status == NOT_SETTLED else (missing, None)]


def test_what_was_tried_is_said_where_no_plan_is_found():
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


def test_few_bars_are_left_to_the_condensed_method_where_ipopt_fails(monkeypatch):
    of_package = sys.modules["ocp.solve"]
    solved = of_package.solve_program
    monkeypatch.setattr(
        of_package,
        "solve_program",
        lambda *given: solved(*given)._replace(success=False, duals=None, why="no plan"),
    )
    plan = ocp.solve(raising())
    assert plan.success, plan.message
    assert (
        "chosen: Variational of 30 intervals by CondensedNewton, after Variational of 30 intervals by Ipopt"
        in plan.message
    )
    monkeypatch.undo()
    assert plan.objective == pytest.approx(ocp.solve(raising()).objective, rel=2e-3)


@pytest.mark.parametrize(("bars", "solver"), [(8, ocp.Ipopt), (9, ocp.CondensedNewton)])
def test_limits_along_the_way_are_left_to_the_condensed_method_from_nine_bars_on(bars, solver):
    low, high = (tc.shapes.prism(bars, 0.5, height) for height in (1.0, 1.05))
    bounds = [ocp.ForceDensityLimits(1.0, 200.0), ocp.TensionLimits(upper=60.0)]
    problem = ocp.Problem(
        driven(low),
        goals=[ocp.StringLengths({0: high.string_lengths[0]})],
        bounds=bounds,
        costs=[ocp.Effort()],
    )
    target = find_target(problem, Scales.of(problem))
    assert isinstance(next(choose(problem, target, None, 1e-3)).solver, solver)


def test_guesses_with_noise_are_tried_where_others_lead_nowhere(monkeypatch):
    of_package, solved, calls = sys.modules["ocp.solve"], solve_condensed, []
    failing = {"success": False, "duals": None, "why": "no plan"}
    ipopt = of_package.solve_program
    monkeypatch.setattr(
        of_package, "solve_program", lambda *given: ipopt(*given)._replace(**failing)
    )
    monkeypatch.setattr(
        of_package,
        "solve_condensed",
        lambda *given: (
            calls.append(0) or solved(*given)._replace(**failing if len(calls) == 1 else {})
        ),
    )
    plan = ocp.solve(raising())
    assert plan.success, plan.message
    assert (
        "chosen: Variational of 30 intervals by CondensedNewton from a guess with noise 2, after "
        in plan.message
    )
    monkeypatch.undo()
    assert plan.objective == pytest.approx(ocp.solve(raising()).objective, rel=2e-3)


def test_what_the_time_ends_is_not_tried_otherwise(monkeypatch):
    """The condensed method leaves some of the time for corrections: too little for another method."""
    of_package = sys.modules["ocp.solve"]
    late = lambda *given: solve_condensed(*given[:-1], time.perf_counter())  # noqa: E731
    monkeypatch.setattr(of_package, "solve_condensed", late)
    plan = ocp.solve(widening(), seconds=1000.0)
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
    guess = Guess(np.repeat(problem.first_state[None], 5, axis=0), np.full((4, 2), 0.025), 1.0)
    assert choose_intervals(problem, guess) == pytest.approx(expected, abs=1)
    assert expected == max(30, round(3 * np.sqrt(2 * 0.025 / mass)))


def test_many_bars_take_more_intervals():
    """Forces add up along them, more than a guess knows."""
    problem = ocp.Problem(driven(tc.shapes.prism(36)), goals=[ocp.AtRest()], costs=[ocp.Effort()])
    guess = Guess(
        np.repeat(problem.first_state[None], 5, axis=0), np.full((4, problem.model.nu), 1e-3), 1.0
    )
    assert choose_intervals(problem, guess) == 36

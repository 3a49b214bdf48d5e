"""Solvers: the same plan from IPOPT and Fatrop, stages that see only themselves, and stops that keep the best iterate."""

from __future__ import annotations

import signal
import sys

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.boundary.find_target import find_target
from ocp.problem.scaling import Scales
from ocp.solvers.fatrop import cut_into_stages
from ocp.transcription.initial_guess import make_guess

BAR = 1.4


def prism(height):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height)


def raising(**changes):
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    model = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
    given = {"model": model, "goals": goals, "bounds": [ocp.ForceDensityLimits(5.0, 100.0)], "costs": [ocp.Effort()], **changes}
    return ocp.Problem(**given)


def program(problem, transcription):
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    return transcription.program(problem, target, scales, make_guess(problem, target, transcription.count))


CASES = {
    "shooting": (ocp.MultipleShooting(8), {}),
    "midpoint": (ocp.ImplicitMidpoint(8), {}),
    "tension": (ocp.MultipleShooting(8), {"bounds": [ocp.ForceDensityLimits(5.0, 100.0), ocp.TensionLimits(upper=12.0)]}),
    "smooth": (ocp.MultipleShooting(8), {"costs": [ocp.Effort(), ocp.Smoothness(1e-2)]}),
    "duration": (ocp.MultipleShooting(8), {"duration": (0.9, 1.1)}),
    "linear": (ocp.Variational(8, control=ocp.PiecewiseLinear()), {}),
}


@pytest.mark.parametrize("case", ["shooting", "midpoint", "tension", "smooth", "duration"])
def test_fatrop_finds_the_plan_of_ipopt(case):
    transcription, changes = CASES[case]
    problem = raising(**changes)
    one, other = (ocp.solve(problem, transcription, solver) for solver in (ocp.Ipopt(), ocp.Fatrop()))
    assert one.success
    assert other.success
    assert other.status == "Solve_Succeeded"
    assert other.iterations > 0
    assert other.objective == pytest.approx(one.objective, rel=1e-5)
    assert other.replay_error < 1e-3


@pytest.mark.parametrize("case", CASES)
def test_stages_see_themselves_and_what_is_handed_on(case):
    transcription, changes = CASES[case]
    built = program(raising(**changes), transcription)
    parts = cut_into_stages(built)
    assert sum(parts.states) + sum(parts.controls) == len(parts.first)
    assert sum(parts.states[1:]) + sum(parts.paths) == len(parts.lower) == len(parts.equality)
    assert parts.states[0] == 0
    stage = np.repeat(np.arange(len(parts.states)), np.add(parts.states, parts.controls))
    row, column = map(np.array, parts.nlp.jac_sparsity(1, 0).get_triplet())
    ends = np.cumsum(np.append(parts.states[1:], 0) + np.array(parts.paths))
    row_stage = np.searchsorted(ends, row, side="right")
    reach = stage[column] - row_stage
    assert reach.min() >= 0
    assert reach.max() <= 1
    # what reaches into the next stage is its state, once
    forward = reach == 1
    assert forward.sum() == sum(parts.states[1:])
    # the same values as the program's
    w = parts.first
    assert w[parts.original] == pytest.approx(built.first)


def test_progress_is_told_and_a_stop_keeps_the_best():
    seen = []

    def watch(now):
        seen.append(now)
        return now.iteration < 3

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(watch=watch))
    assert not plan.success
    assert plan.status == "User_Requested_Stop"
    assert [now.iteration for now in seen] == [0, 1, 2, 3]
    assert min(now.infeasibility for now in seen) < seen[0].infeasibility
    assert all(now.objective > 0 for now in seen)
    assert np.all(np.isfinite(plan.force_density))
    whole = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(watch=lambda now: None))
    assert whole.success


def test_an_interruption_keeps_the_best():
    def watch(now):
        if now.iteration == 2:
            raise KeyboardInterrupt

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(watch=watch))
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations <= 3
    assert np.all(np.isfinite(plan.trajectory.nodes))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different there")
def test_ctrl_c_keeps_the_best_and_leaves_the_keyboard_as_it_was(keyboard):

    def watch(now):
        if now.iteration == 2:  # within the solver, not within this function
            signal.raise_signal(signal.SIGINT)

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(watch=watch))
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations <= 3
    assert "from the keyboard" in plan.message
    assert signal.getsignal(signal.SIGINT) is keyboard


def test_what_a_watcher_raises_is_raised(capfd):
    def watch(now):
        raise ZeroDivisionError("a mistake of the watcher")

    with pytest.raises(ZeroDivisionError, match="a mistake of the watcher"):
        ocp.solve(raising(), ocp.Variational(6), ocp.Ipopt(watch=watch))
    assert not capfd.readouterr().err


def test_a_time_limit_stops():
    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(seconds=1e-6))
    assert "raise Ipopt(seconds=...)" in plan.message
    assert not plan.success
    assert plan.status == "Maximum_WallTime_Exceeded"


def test_a_plan_as_guess_takes_fewer_iterations():
    cold = ocp.solve(raising(), ocp.Variational(12))
    warm = ocp.solve(raising(), ocp.Variational(12), ocp.Ipopt(warm=True), guess=cold)
    assert warm.success
    assert warm.iterations < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-5)


def test_too_few_iterations_of_fatrop_are_a_status():
    plan = ocp.solve(raising(), ocp.MultipleShooting(8), ocp.Fatrop(max_iterations=2))
    assert not plan.success
    assert plan.status == "Maximum_Iterations_Exceeded"
    assert "no plan" in plan.message


@pytest.mark.parametrize("options", [{"nope": 1}, {"mu_init": "large"}])
def test_options_that_fatrop_does_not_have_are_refused(options):
    with pytest.raises(ValueError, match=r"Fatrop.options is .*: give options that Fatrop has"):
        ocp.solve(raising(), ocp.Variational(6), ocp.Fatrop(options=options))


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: ocp.Fatrop(max_iterations=0), ValueError, "Fatrop.max_iterations is 0"),
        (lambda: ocp.Fatrop(tolerance=-1.0), ValueError, "Fatrop.tolerance"),
        (lambda: ocp.Fatrop(verbose=1), TypeError, "Fatrop.verbose is 1: give True or False"),
        (lambda: ocp.Fatrop(options=[1]), TypeError, "Fatrop.options"),
        (lambda: ocp.Ipopt(seconds=-1.0), ValueError, "Ipopt.seconds"),
        (lambda: ocp.Ipopt(watch=3), TypeError, "Ipopt.watch is 3: give a function"),
        (lambda: ocp.Ipopt(warm="yes"), TypeError, "Ipopt.warm is 'yes': give True or False"),
    ],
)
def test_wrong_values_are_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()

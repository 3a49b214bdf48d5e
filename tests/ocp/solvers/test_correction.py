"""Coarse programs put right by fine steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning import leaning_arm, prism, program

import ocp
import tenscasadi as tc
from ocp.solvers.correction import solve_corrected
from ocp.solvers.monitor import Monitor
from tenscasadi.util.linear_algebra import AndersonMixing


def rising(duration: float | tuple[float, float] = 1.0, *more: object) -> ocp.Problem:
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    model = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
    return ocp.Problem(
        model,
        duration,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(5.0, 100.0), *more],
        costs=[ocp.Effort()],
    )


METHODS = {
    "leapfrog": ocp.Variational(20, accuracy=1e-9),
    "leapfrog, linear": ocp.Variational(20, accuracy=1e-9, control=ocp.PiecewiseLinear()),
    "unequal intervals": ocp.Variational((1,) * 10 + (2,) * 5, accuracy=1e-9),
    "midpoint": ocp.ImplicitMidpoint(20, accuracy=1e-9),
    "shooting": ocp.MultipleShooting(20, accuracy=1e-9),
    "collocation": ocp.DirectCollocation(15, degree=2, accuracy=1e-9),
}


@pytest.mark.parametrize("name", METHODS)
def test_the_replay_is_as_exact_as_was_asked(name):
    plan = ocp.solve(rising(), METHODS[name])
    assert plan.success, plan.message
    replay = plan.replay(step=plan.time[-1] / 2000)
    rounded = (
        1e-5 if plan.linear else 0.0
    )  # a replay holds linear force densities in each of its steps
    assert np.abs(replay.states[-1] - plan.trajectory.states[-1]).max() < 2e-9 + rounded
    assert plan.replay_error < 3e-9 + rounded
    assert plan.trajectory.bar_length_error.max() < 1e-7


def test_states_in_between_are_those_of_fine_steps():
    plan = ocp.solve(rising(), ocp.Variational(20, accuracy=1e-9))
    replay = plan.replay()
    assert (
        np.abs(replay.states[:: (len(replay.time) - 1) // 20] - plan.trajectory.states).max() < 1e-7
    )


def test_the_duration_may_be_free_and_limits_hold():
    asked = rising((0.6, 1.6), ocp.TensionLimits(upper=12.0))
    plan = ocp.solve(asked, ocp.Variational(30, accuracy=1e-8))
    assert plan.success, plan.message
    assert plan.replay_error < 1e-7
    assert max(plan.tension().max(), plan.tension(end=True).max()) < 12.0 * (1 + 1e-6)


@pytest.mark.parametrize(
    "asked",
    [
        rising(1.0, ocp.Constraint("speed", lambda now: now.velocities[2, 3:6].T, upper=0.13)),
        ocp.Problem(
            tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity())),
            goals=[
                ocp.StringLengths(prism(1.1).string_lengths),
                ocp.AtRest(),
                ocp.Waypoint([ocp.AtRest()], share=0.5),
            ],
            bounds=[ocp.ForceDensityLimits(5.0, 100.0)],
            costs=[ocp.Effort()],
        ),
    ],
    ids=["limit", "waypoint"],
)
def test_velocities_on_the_way_are_corrected_too(asked):
    plan = ocp.solve(asked, ocp.Variational(20, accuracy=1e-7))
    assert plan.success, plan.message
    assert plan.replay_error < 1e-6


def test_corrections_cost_the_order_of_the_scheme_and_no_more():
    coarse, exact = (
        ocp.solve(rising(), ocp.Variational(20, accuracy=accuracy)).objective
        for accuracy in (None, 1e-9)
    )
    fine = ocp.solve(
        rising(), ocp.MultipleShooting(20, substeps=8)
    ).objective  # the same force densities, the motion itself
    assert exact == pytest.approx(fine, rel=1e-5)
    assert abs(coarse - fine) > abs(exact - fine)


@pytest.mark.parametrize(
    ("bars", "lean", "weight"),
    [(3, 0.5, True), (5, 1.0, False)],
    ids=["under its weight", "five bars"],
)
def test_motions_along_which_errors_grow_are_corrected(bars, lean, weight):
    """Fine steps under the first force densities fall over, a metre from the plan: errors grow a millionfold."""
    plan = ocp.solve(
        leaning_arm(bars, lean, weight), ocp.Variational(50, accuracy=3e-4), tolerance=1e-3
    )
    assert plan.success, plan.message
    assert plan.error_growth > 1e3
    replay = plan.replay(step=plan.time[-1] / 4000)
    assert np.abs(replay.states[-1] - plan.trajectory.states[-1])[: plan.model.nq].max() < 3e-4


def test_more_than_corrections_can_do_is_said():
    plan = ocp.solve(rising(), ocp.Variational(20, accuracy=1e-16), tolerance=1e-16)
    assert not plan.success
    assert "too coarse: corrections end" in plan.message
    assert "give more intervals" in plan.message


class Restarted:
    """A solver of one's own, which only solves whole programs."""

    tolerance = 1e-8

    def solve(self, program, monitor=None):
        return ocp.Ipopt().solve(program, monitor)


def test_solvers_that_cannot_start_again_are_corrected_too():
    transcription, model = ocp.ImplicitMidpoint(20), rising().model
    built = program(rising(), transcription)
    measure = transcription.measure_residual(built, model)
    found = solve_corrected(built, Restarted(), measure, 1e-8)
    assert found.solution.success
    assert found.error < 1e-8


def test_extrapolated_corrections_need_fewer_rounds(monkeypatch):
    asked, transcription = rising(), ocp.Variational(6)
    built = program(asked, transcription)
    measure = transcription.measure_residual(built, asked.model)

    def count_rounds() -> int:
        rounds = []

        def counted(w, near):
            rounds.append(measure(w, near))
            return rounds[-1]

        found = solve_corrected(built, ocp.Ipopt(), counted, 1e-9)
        assert found.error < 1e-9
        return len(rounds)

    extrapolated = count_rounds()
    monkeypatch.setattr(AndersonMixing, "step", lambda self, change: change)
    assert extrapolated <= count_rounds() - 2


def test_last_round_computes_no_shift():
    asked, transcription, rounds = rising(), ocp.Variational(20), []
    built = program(asked, transcription)
    measure = transcription.measure_residual(built, asked.model)

    def counted(w, near):
        rounds.append(measure(w, near))
        return rounds[-1]

    assert solve_corrected(built, ocp.Ipopt(), counted, 1e-6).error < 1e-6
    assert ["shift" in vars(one) for one in rounds] == [True] * (len(rounds) - 1) + [False]


@pytest.mark.parametrize("ends", ["kept", "late"])
def test_states_of_fine_steps_count_only_within_the_limits(ends):
    """A round within them counts before one with a smaller error; without any, the planned states do."""
    asked, transcription, rounds = rising(), ocp.Variational(20), []
    built = program(asked, transcription)
    measure = transcription.measure_residual(built, asked.model)
    errors, kept = [2e-3, 1e-6, 2e-6], [False, False, ends == "kept"]
    monitor = Monitor()

    def judged(w, near):
        k = len(rounds)
        rounds.append(measure(w, near))
        if k == 2 and ends == "late":
            monitor.stop()
        return replace(rounds[-1], error=errors[k], check_limits=lambda: kept[k])

    found = solve_corrected(built, ocp.Ipopt(), judged, 1e-5, monitor)
    assert len(rounds) == 3
    assert found.error == errors[2 if ends == "kept" else 1]
    if ends == "kept":
        assert found.states is rounds[2].states
    else:
        assert found.states is None


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, "exact"])
def test_an_accuracy_is_a_positive_length(bad):
    with pytest.raises((TypeError, ValueError), match=r"Variational\.accuracy"):
        ocp.Variational(10, accuracy=bad)


@pytest.mark.parametrize("profile", [ocp.PiecewiseConstant(), ocp.PiecewiseLinear()])
def test_states_of_fine_steps_keep_active_limits(profile):
    limit = ocp.RestLengthRateLimits(0.12, stiffness=1000.0)
    plan = ocp.solve(rising(1.0, limit), ocp.Variational(30, accuracy=1e-4, control=profile))
    assert plan.success, plan.message
    assert "violates" not in plan.message
    assert plan.report().violated == ()
    rest = plan.rest_lengths(1000.0)
    rates = np.diff(rest, axis=0) / np.diff(plan.time)[: len(rest) - 1, None]
    assert np.abs(rates).max() == pytest.approx(0.12, rel=1e-4)

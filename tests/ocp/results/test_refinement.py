"""Mesh refinement: finer meshes until the replay meets a tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planning import driven, integrated, prism, raising, taller

import ocp
import tenscasadi as tc
from ocp.results.refinement import defects, refine_until_accurate
from ocp.solvers.monitor import Monitor


def test_a_refined_plan_meets_its_tolerance(coarse):
    assert coarse.replay_error > 1e-5
    fine = coarse.refine(1e-6)
    assert fine.success
    assert fine.replay_error <= 1e-6
    assert fine.replay_speed_error <= 1e-6
    assert np.diff(fine.time).max() > 1.5 * np.diff(fine.time).min()  # cut where it is needed
    gaps = [
        defects(plan.model, plan.time, plan.trajectory.states, plan.force_density).max()
        for plan in (fine, coarse)
    ]
    assert gaps[0] < 1e-2 * gaps[1]


def test_refining_goes_on_from_what_was_found():
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    asked = ocp.Problem(
        driven(prism(1.0, stiffness=1000.0)),
        0.5,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(2.0, 200.0)],
        costs=[ocp.Effort()],
    )
    fine = ocp.solve(asked, ocp.ImplicitMidpoint(12)).refine(3e-5)
    assert fine.success
    assert fine.worst_error <= 3e-5
    assert fine.iterations < 60  # from the guess's own barrier 280


def test_a_good_plan_is_left_alone(coarse):
    assert coarse.refine(1e-2) is coarse


def test_a_stopped_refinement_keeps_the_best_plan(coarse):
    seen = []
    found = coarse.refine(1e-9, progress=lambda now: seen.append(now) or len(seen) < 2)
    assert len(seen) == 2
    assert not found.success
    assert found.worst_error <= coarse.worst_error
    assert "the tolerance of 1e-09 m was not met before the search was stopped" in found.message
    late = coarse.refine(1e-9, time_limit=1e-3)
    assert "was not met within the time limit: increase time_limit" in late.message
    assert late.worst_error <= coarse.worst_error


def test_wrong_limits_of_a_refinement_are_told(coarse):
    with pytest.raises(ValueError, match="time_limit is 0"):
        coarse.refine(1e-9, time_limit=0.0)
    with pytest.raises(TypeError, match="progress is 'yes': give True or False"):
        coarse.refine(1e-9, progress="yes")


def test_a_plan_that_is_too_coarse_is_refined():
    rough = ocp.solve(taller(), ocp.MultipleShooting(3))
    assert not rough.success
    assert rough.refine(1e-4).success


def test_a_tolerance_that_is_not_met_is_said(coarse):
    plan = coarse.refine(1e-12, attempts=1)
    assert not plan.success
    assert "the tolerance of 1e-12 m was not met in 1 attempts" in plan.message


@pytest.mark.parametrize("lowered", [0.6, 1.5, np.nan])
def test_refining_stops_where_it_no_longer_helps(coarse, lowered):
    asked = []

    def find_plan(problem, transcription, solver, plan, tolerance, **options):
        asked.append(transcription.count)
        return replace(
            plan,
            replay_error=lowered * plan.replay_error,
            replay_speed_error=lowered * plan.replay_speed_error,
        )

    rough = replace(coarse, solver=object())  # of which no corrections are known
    plan = refine_until_accurate(rough, 1e-9, 5, find_plan, Monitor())
    assert len(asked) == 1
    assert not plan.success
    assert plan.worst_error == min(
        coarse.worst_error, np.nan_to_num(lowered * coarse.worst_error, nan=np.inf)
    )
    assert (
        "the tolerance of 1e-09 m was not met and 8 intervals in place of 8 do not halve the error"
        in plan.message
    )


def test_corrections_go_where_intervals_do_not(coarse):
    """Against SciPy: to 1e-9 m, on no finer mesh than a few parts of each interval."""
    found = ocp.solve(raising(), ocp.Variational(40)).refine(1e-9)
    assert found.success, found.message
    assert found.worst_error <= 1e-9
    assert len(found.time) == 41
    end = raising().model.nodes(integrated(found))
    assert tc.Structure(end, prism(1.1).bars, prism(1.1).strings).string_lengths == pytest.approx(
        prism(1.1).string_lengths, abs=2e-9
    )


@pytest.mark.slow
def test_refining_does_not_advise_itself(coarse):
    plan = coarse.refine(1e-15)
    assert not plan.success
    assert "the tolerance of 1e-15 m was not met because of rounding errors" in plan.message
    assert "refine" not in plan.message
    assert "give more intervals" not in plan.message


def test_a_plan_from_a_file_is_refined(coarse, tmp_path):
    coarse.save(tmp_path / "plan.npz")
    loaded = ocp.Plan.load(tmp_path / "plan.npz")
    fine = loaded.refine(1e-5)
    assert fine.success, fine.message
    assert fine.worst_error <= 1e-5 < loaded.worst_error


def test_what_was_not_found_is_not_refined():
    plan = ocp.solve(taller(), ocp.MultipleShooting(8), ocp.Ipopt(max_iterations=2))
    assert plan.refine(1e-4) is plan


@pytest.mark.parametrize("arguments", [(0.0,), ("fine",), (1e-3, 0)])
def test_bad_arguments_of_refine(coarse, arguments):
    with pytest.raises((TypeError, ValueError), match=r"tolerance|attempts"):
        coarse.refine(*arguments)


@pytest.mark.parametrize("solver", [ocp.Ipopt(), ocp.CondensedNewton()])
def test_a_plan_of_a_loose_accuracy_is_refined(solver):
    """Corrections that stop at the accuracy of the first plan would undo what a finer mesh gains."""
    plan = ocp.solve(raising(), ocp.Variational(20, accuracy=1e-3), solver, tolerance=1e-2)
    assert plan.success
    tolerance = plan.worst_error / 20
    fine = plan.refine(tolerance)
    assert fine.success, fine.message
    assert fine.worst_error <= tolerance
    assert len(fine.force_density) > 20
    assert fine.transcription.accuracy < tolerance

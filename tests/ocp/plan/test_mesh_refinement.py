"""What becomes of a plan: finer grids until the replay meets a tolerance, reports of limits, rest lengths."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.plan.mesh_refinement import defects

BAR = 1.4


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


MODEL = tc.Model(tc.Scene(prism(1.0, stiffness=1000.0), control=tc.ForceDensity()))


def problem(*bounds, to=1.15):
    goals = [ocp.Shape(prism(to).nodes), ocp.AtRest()]
    return ocp.Problem(MODEL, 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(5.0, 100.0), *bounds], costs=[ocp.Effort()])


@pytest.fixture(scope="module")
def coarse():
    return ocp.solve(problem(), ocp.MultipleShooting(8))


def test_a_refined_plan_meets_its_tolerance(coarse):
    assert coarse.replay_error > 1e-5
    fine = coarse.refine(1e-6)
    assert fine.success
    assert fine.replay_error <= 1e-6
    assert fine.replay_speed_error <= 1e-6
    assert np.diff(fine.time).max() > 1.5 * np.diff(fine.time).min()  # cut where it is needed
    gaps = [defects(plan.model, plan.time, plan.trajectory.states, plan.force_density).max() for plan in (fine, coarse)]
    assert gaps[0] < 1e-2 * gaps[1]


def test_refining_goes_on_from_what_was_found():
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    asked = ocp.Problem(MODEL, 0.5, goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)], costs=[ocp.Effort()])
    fine = ocp.solve(asked, ocp.ImplicitMidpoint(12)).refine(3e-5)
    assert fine.success
    assert fine.worst_error <= 3e-5
    assert fine.iterations < 60  # from the guess's own barrier 280


def test_a_good_plan_is_left_alone(coarse):
    assert coarse.refine(1e-2) is coarse


def test_a_plan_that_is_too_coarse_is_refined():
    rough = ocp.solve(problem(), ocp.MultipleShooting(3))
    assert not rough.success
    assert rough.refine(1e-4).success


def test_a_tolerance_that_is_not_met_is_said(coarse):
    plan = coarse.refine(1e-12, attempts=1)
    assert not plan.success
    assert "the tolerance of 1e-12 m was not met in 1 attempts" in plan.message


@pytest.mark.parametrize("lowered", [0.6, 1.5, np.nan])
def test_refining_stops_where_it_no_longer_helps(coarse, lowered, monkeypatch):
    asked = []

    def solve(problem, transcription, solver, plan, tolerance):
        asked.append(transcription.count)
        return replace(plan, replay_error=lowered * plan.replay_error, replay_speed_error=lowered * plan.replay_speed_error)

    monkeypatch.setattr(ocp.Plan, "_solve", staticmethod(solve))
    plan = coarse.refine(1e-9)
    assert len(asked) == 1
    assert not plan.success
    assert plan.worst_error == min(coarse.worst_error, np.nan_to_num(lowered * coarse.worst_error, nan=np.inf))
    assert "the tolerance of 1e-09 m was not met and 8 intervals in place of 8 do not halve the error" in plan.message


def test_what_was_not_found_is_not_refined():
    plan = ocp.solve(problem(), ocp.MultipleShooting(8), ocp.Ipopt(max_iterations=2))
    assert plan.refine(1e-4) is plan


@pytest.mark.parametrize("arguments", [(0.0,), ("fine",), (1e-3, 0)])
def test_bad_arguments_of_refine(coarse, arguments):
    with pytest.raises((TypeError, ValueError), match=r"tolerance|attempts"):
        coarse.refine(*arguments)


def test_a_loaded_plan_is_refined_and_reports_of_its_problem(coarse, tmp_path):
    loaded = ocp.Plan.load(coarse.save(tmp_path / "plan.npz"))
    assert str(loaded.report()) == str(coarse.report())
    fine, again = (plan.refine(1e-4) for plan in (coarse, loaded))
    assert again.success
    assert again.time == pytest.approx(fine.time, abs=1e-9)
    assert again.force_density == pytest.approx(fine.force_density, rel=1e-6)
    assert ocp.Plan.load(path=again.save(tmp_path / "again.npz")).refine(1e-4).success


def without(path, *names, **others):
    """The file with other fields."""
    with np.load(path) as archive:
        content = {name: archive[name] for name in archive.files if name not in names}
    np.savez_compressed(path, **content, **others)
    return path


def test_a_plan_of_an_older_version_says_how_it_is_refined(coarse, tmp_path):
    path = without(coarse.save(tmp_path / "plan.npz"), "solved")
    loaded = ocp.Plan.load(path)
    assert loaded.replay().success
    with pytest.raises(ValueError, match=r"older version.*Plan.load\(path, problem=...\)"):
        loaded.report()
    for plan in (loaded, ocp.Plan.load(path, problem())):
        with pytest.raises(ValueError, match=r"how the plan was solved \(its file is of an older version\).*guess=plan"):
            plan.refine(1e-6)
    assert str(ocp.Plan.load(path, problem()).report()) == str(coarse.report())


class OwnScheme(tc.RungeKutta4):
    """A scheme as users write them."""


@pytest.mark.parametrize("own", ["cost", "scheme"])
def test_what_no_file_holds_is_said_where_it_is_needed(own, tmp_path):
    costs = [ocp.Effort(), *([ocp.Integral("low", lambda now: now.nodes[2, 0] ** 2)] if own == "cost" else [])]
    asked = replace(problem(), costs=costs)
    transcription = ocp.MultipleShooting(8, scheme=OwnScheme() if own == "scheme" else tc.RungeKutta4())
    path = ocp.solve(asked, transcription, ocp.Ipopt(watch=lambda progress: True)).save(tmp_path / "plan.npz")
    said = "Problem.costs[1].expression is a function" if own == "cost" else "Transcription.scheme is of an own class, OwnScheme"
    with pytest.raises(ValueError, match=f"{re.escape(said)}.*guess=plan"):
        ocp.Plan.load(path).refine(1e-4)
    if own == "cost":
        assert ocp.Plan.load(path, asked).refine(1e-4).success


@pytest.mark.parametrize(
    "text",
    [
        "no json",
        "[" * 100_000,
        '{"problem": null}',
        '{"transcription": {"class": "os.system", "fields": {}}}',
        '{"solver": {"class": "Ipopt", "fields": {"options": {"mapping": [["hsllib", "/tmp/own.so"], ["linear_solver", "ma57"]]}}}}',
    ],
    ids=["no text", "deep", "nothing", "another class", "a library"],
)
def test_nothing_in_a_file_is_run(coarse, text, tmp_path):
    loaded = ocp.Plan.load(without(coarse.save(tmp_path / "plan.npz"), "solved", solved=np.asarray(text)))
    assert loaded.problem is None
    assert loaded.transcription is None
    assert loaded.solver is None
    with pytest.raises(ValueError, match="how the plan was solved"):
        loaded.refine(1e-4)


def test_a_report_names_what_holds_the_plan():
    most = 13.0
    asked = problem(ocp.TensionLimits(upper=most))
    plan = ocp.solve(asked, ocp.MultipleShooting(16))
    found = plan.report()
    assert plan.success
    assert ("force density of string 0", "lower") in {(one.name, one.side) for one in found.active}
    assert not found.violated
    text = str(found)
    assert "force density of string 0: lower limit 5 N/m" in text
    assert "violated: none" in text


def test_a_report_names_what_the_replay_breaks(coarse):
    peak = coarse.replay().tension.max()
    found = replace(coarse, problem=problem(ocp.TensionLimits(upper=0.9 * peak))).report()
    worst = max(found.violated, key=lambda one: one.worst)
    assert worst.name.startswith("tension of string")
    assert worst.side == "upper"
    assert worst.worst == pytest.approx(peak)
    assert 0 <= worst.time <= 1.0
    assert worst.name in str(found)


def test_wound_strings_do_what_force_densities_do(coarse):
    fine = ocp.solve(problem(), ocp.MultipleShooting(20))
    errors = []
    for updates in (5, 20):
        wound = ocp.replay_wound(fine, 500.0, damping=1.0, updates=updates)
        assert wound.success
        errors.append(np.abs(wound.nodes[-1] - fine.trajectory.nodes[-1]).max())
    assert errors[1] < 1e-3
    assert ocp.reachable(fine).all()
    soft = ocp.reachable(fine, 8.0)
    assert soft.any()
    assert not soft.all()
    assert not ocp.reachable(fine, 500.0, shortest=1.05).all()
    with pytest.raises(ValueError, match="stiffness of string"):
        ocp.replay_wound(fine, 8.0)
    with pytest.raises(ValueError, match="stiffness of string 0 is -5: it must be at least 0"):
        ocp.reachable(fine, -5.0)
    with pytest.raises(ValueError, match="shortest of string 0 is -1: it must be at least 0"):
        ocp.reachable(fine, 500.0, -1.0)

"""Plans of strings that can break, and closed loops in which they do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.bounds.string_bounds import StrengthLimits

FORCE = 11.5


@cache
def cross(force: float | None = None, margin: float = 0.05) -> tc.Model:
    strength = None if force is None else tc.Breaking(force, margin)
    scene = tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity(), strength=strength)
    return tc.Model(scene)


def problem(model: tc.Model, **changes: object) -> ocp.Problem:
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    fields = {"duration": 0.3, "goals": goals, "costs": [ocp.Effort()]}
    return ocp.Problem(model, **fields | changes)


def test_plans_stay_below_the_strength():
    free, bounded = (
        ocp.solve(problem(model), ocp.MultipleShooting(15)) for model in (cross(), cross(FORCE))
    )
    assert free.success
    assert free.tension().max() > FORCE
    assert bounded.success, bounded.message
    assert bounded.tension().max() <= 0.95 * FORCE * (1 + 1e-6)
    assert bounded.replay().tension.max() < FORCE
    assert bounded.problem.model.na == 0
    # under the same control, the strings of the other plan break
    again, broken = (
        tc.simulate(cross(FORCE), 0.3, 1e-3, control=plan.force_density, compiled=False)
        for plan in (bounded, free)
    )
    assert not again.breaks
    assert broken.breaks


def test_plans_whose_replay_reaches_the_strength_are_rejected():
    structure = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0)
    strength = tc.Breaking(17.46, margin=0.0)  # 17.45 N at mesh points, and 17.50 N between them
    tight = tc.Model(tc.Scene(structure, control=tc.RestLength(), strength=strength))
    plan = ocp.solve(problem(tight, duration=0.6), ocp.MultipleShooting(4, substeps=8))
    assert not plan.success
    assert plan.message.startswith("no plan: string ")
    assert "between mesh points: give more intervals, or a larger Breaking.margin" in plan.message


def test_plans_found_in_reduced_coordinates_are_rejected_too():
    lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    goals = [ocp.StringLengths(lengths), ocp.AtRest()]

    def solve_in_full(strength: tc.Breaking | None) -> ocp.Plan:
        structure = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0)
        scene = tc.Scene(structure, control=tc.RestLength(), strength=strength)
        model = tc.Model(scene, coordinates="full")
        assert model.mechanism.joints
        given = ocp.Problem(model, 0.6, goals=goals, costs=[ocp.Effort()])
        return ocp.solve(given, ocp.Variational(4), tolerance=0.3)

    free = solve_in_full(None)
    assert free.success
    assert "found in reduced coordinates" in free.message
    at_mesh, between = free.tension().max(), free.replay().tension.max()
    assert between > 1.1 * at_mesh
    plan = solve_in_full(tc.Breaking(float(at_mesh + between) / 2, margin=0.0))
    assert not plan.success
    assert plan.message.startswith("no plan: string ")


def test_limits_that_contradict_the_strength_are_rejected():
    with pytest.raises(
        ValueError, match=r"TensionLimits\.lower is 11 .*Problem\.strength leaves 10\.925 N"
    ):
        problem(cross(FORCE), bounds=[ocp.TensionLimits(lower=11.0)])


def test_starts_have_no_broken_string():
    model = cross(FORCE)
    start = model.initial_state.copy()
    assert np.array_equal(problem(model, start=start).start, cross().initial_state)
    start[-4:-2] = [1, 0]
    with pytest.raises(
        ValueError,
        match=r"Problem\.start has the broken string 1: give a structure without it",
    ):
        problem(model, start=start)


@pytest.mark.parametrize("force", [FORCE, {0: FORCE}], ids=["all", "one"])
def test_problem_files_hold_the_strength(force: object, tmp_path: Path):
    own = ocp.TensionLimits(upper=50.0)
    asked = problem(cross(), bounds=[own])
    scene = replace(cross().scene, strength=tc.Breaking(force, margin=0.1))
    given = problem(tc.Model(scene), bounds=[own], start=asked.start + 0.0)
    path = ocp.save_problem(given, tmp_path / "cross.toml")
    again = ocp.load_problem(path)
    assert again.scene.strength == scene.strength
    assert path.read_text(encoding="utf-8").count("TensionLimits") == 1
    assert [type(bound) for bound in again.bounds] == [ocp.TensionLimits, StrengthLimits]
    assert np.array_equal(again.limits(ocp.TensionLimits), given.limits(ocp.TensionLimits))
    assert np.array_equal(again.start, given.start)
    second = ocp.save_problem(again, tmp_path / "again.toml")
    assert second.read_text(encoding="utf-8") == path.read_text(encoding="utf-8")


def test_plan_files_hold_the_strength(tmp_path: Path):
    plan = ocp.solve(problem(cross(FORCE)), ocp.MultipleShooting(15))
    again = ocp.Plan.load(plan.save(tmp_path / "cross.npz"))
    assert again.not_restored == ""
    assert again.problem.scene.strength == cross(FORCE).scene.strength
    assert len(again.problem.bounds) == 1
    assert again.model.na == 0
    finer = again.refine(1e-5)
    assert finer.success, finer.message
    assert finer.problem.scene.strength == cross(FORCE).scene.strength
    assert finer.replay().tension.max() < FORCE


def test_plan_files_without_their_problem_hold_the_model(tmp_path: Path):
    free = ocp.Integral("nothing", lambda now: 0.0 * now.tension[0])
    plan = ocp.solve(problem(cross(FORCE), costs=[ocp.Effort(), free]), ocp.MultipleShooting(15))
    again = ocp.Plan.load(plan.save(tmp_path / "cross.npz"))
    assert again.problem is None
    assert "nothing" in again.not_restored
    assert again.model.na == 0
    assert np.array_equal(again.trajectory.states, plan.trajectory.states)


def test_closed_loops_go_on_after_a_break():
    controller = ocp.Mpc(problem(cross(), duration=1.0), period=0.1, intervals=5)
    loop = ocp.run(controller, 0.4)
    weak = 0.9 * loop.trajectory.tension.max()
    broken = ocp.run(controller, 0.4, model=cross(float(weak)))
    assert broken.trajectory.success
    assert broken.trajectory.breaks
    assert "breaks at t =" in broken.trajectory.message
    first = broken.trajectory.breaks[0]
    late = broken.trajectory.time > first.time + 1e-9
    assert (broken.trajectory.tension[late][:, list(first.strings)] == 0).all()


def test_copied_problems_keep_the_strength():
    first = problem(cross(FORCE))
    copied = replace(replace(first, duration=0.4), costs=[ocp.Effort(2.0)])
    assert copied.strength == copied.scene.strength == first.strength
    assert len(copied.bounds) == len(first.bounds) == 1
    bounded = replace(first, bounds=[ocp.ForceDensityLimits(0.1)])
    kinds = [type(bound) for bound in bounded.bounds]
    assert kinds == [ocp.ForceDensityLimits, StrengthLimits]
    given = problem(cross(), strength=tc.Breaking(FORCE, 0.05))
    np.testing.assert_array_equal(given.bounds[-1].upper, first.bounds[-1].upper)
    assert problem(cross()).strength is None
    with pytest.raises(TypeError, match=r"Problem\.strength is 3"):
        problem(cross(), strength=3)


def test_limits_are_those_of_the_present_strength(tmp_path: Path):
    first, other = problem(cross(FORCE)), tc.Breaking(20.0, 0.05)
    for strength, model in [(other, first.model), (other, cross(30.0)), (None, cross(20.0))]:
        copied = replace(first, strength=strength, model=model)
        assert copied.strength == other
        assert [np.unique(bound.upper).tolist() for bound in copied.bounds] == [[19.0]]
    assert replace(first, model=cross(20.0)).strength == first.strength
    free = replace(first, strength=None)
    assert free.strength is None
    assert free.bounds == ()
    assert "Limits" not in ocp.save_problem(free, tmp_path / "free.toml").read_text("utf-8")


def test_files_hold_limits_of_strings_that_would_yield(tmp_path: Path):
    given = problem(cross(), strength=tc.Yielding(FORCE, viscosity=2.0))
    assert given.scene.strength is None
    again = ocp.load_problem(ocp.save_problem(given, tmp_path / "cross.toml"))
    assert np.array_equal(again.limits(ocp.TensionLimits), given.limits(ocp.TensionLimits))


def test_limits_of_the_user_stay_if_equal_to_the_derived():
    own = ocp.TensionLimits(upper=0.95 * FORCE)
    given = problem(cross(FORCE), bounds=[own])
    assert replace(given, strength=None).bounds == (own,)


def test_strength_of_the_problem_replaces_that_of_the_scene():
    given = problem(cross(FORCE), strength=tc.Breaking(5.0, 0.0))
    assert given.strength == given.scene.strength == tc.Breaking(5.0, 0.0)
    assert given.limits(ocp.TensionLimits)[1].max() == 5.0


def test_overloads_of_copied_problems_are_found():
    structure = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0)
    strength = tc.Breaking(17.46, margin=0.0)  # as above
    tight = tc.Model(tc.Scene(structure, control=tc.RestLength(), strength=strength))
    copied = replace(problem(tight, duration=0.5), duration=0.6)
    plan = ocp.solve(copied, ocp.MultipleShooting(4, substeps=8))
    assert not plan.success
    assert "between mesh points: give more intervals, or a larger Breaking.margin" in plan.message

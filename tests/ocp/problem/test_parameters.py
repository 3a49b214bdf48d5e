"""Plans of a model with parameters are those of the model that is built with the values."""

import copy
from dataclasses import replace

import numpy as np
import pytest

import ocp
import tenscasadi as tc

CROSS = tc.shapes.d_bar(pinned=[0])
GOALS = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
VALUES = {"bar_mass": [1.2, 0.8, 1.0, 1.1]}


def model(structure=CROSS, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


GIVEN = model(parameters=tc.Parameters("bar_mass"))


@pytest.mark.parametrize(
    "transcription",
    [ocp.MultipleShooting(10), ocp.Variational(10), ocp.ImplicitMidpoint(10)],
    ids=lambda t: type(t).__name__,
)
def test_plans_are_those_of_the_values(transcription):
    own = ocp.solve(
        ocp.Problem(GIVEN, goals=GOALS, costs=[ocp.Effort()], parameters=VALUES), transcription
    )
    built = ocp.solve(
        ocp.Problem(model(CROSS.replace(**VALUES)), goals=GOALS, costs=[ocp.Effort()]),
        transcription,
    )
    assert own.success
    np.testing.assert_allclose(own.force_density, built.force_density, rtol=1e-6, atol=1e-6)
    assert np.array_equal(own.replay().states, built.replay().states)


def test_a_plan_replays_with_the_values_after_it_was_stored(tmp_path):
    problem = ocp.Problem(GIVEN, goals=GOALS, parameters=VALUES)
    plan = ocp.solve(problem, ocp.MultipleShooting(6))
    again = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert np.array_equal(again.model.structure.bar_mass, VALUES["bar_mass"])
    assert np.array_equal(again.replay().states, plan.replay().states)
    assert ocp.Plan.load(tmp_path / "plan.npz", problem=problem).success == plan.success


def test_the_planned_force_densities_drive_the_model_with_parameters():
    plan = ocp.solve(ocp.Problem(GIVEN, goals=GOALS, parameters=VALUES), ocp.MultipleShooting(6))
    step = plan.time[1] / 10
    run = tc.simulate(
        GIVEN, plan.time[-1], step, control=plan.force_density, parameters=VALUES, compiled=False
    )
    np.testing.assert_allclose(run.nodes[-1], plan.replay().nodes[-1], atol=1e-12)


def test_plants_with_parameters_are_run():
    controller = ocp.Mpc(
        ocp.Problem(GIVEN, goals=GOALS, parameters=VALUES), period=0.1, intervals=5
    )
    own = ocp.run(controller, 0.3, model=GIVEN, parameters=VALUES)
    same = ocp.run(controller, 0.3)
    heavier = ocp.run(controller, 0.3, model=GIVEN, parameters={"bar_mass": 1.5})
    np.testing.assert_allclose(own.trajectory.states, same.trajectory.states, atol=1e-10)
    assert abs(heavier.trajectory.states - same.trajectory.states).max() > 1e-3
    with pytest.raises(ValueError, match="the controller's model has none: give the plant"):
        ocp.run(controller, 0.3, parameters=VALUES)


def test_values_are_checked_by_name():
    with pytest.raises(ValueError, match="parameters: bar_mass of bar 0 is -1 kg"):
        ocp.Problem(GIVEN, goals=GOALS, parameters={"bar_mass": -1.0})
    with pytest.raises(ValueError, match="the parameters of this model are none"):
        ocp.Problem(model(), goals=GOALS, parameters={"bar_mass": 1.0})


def test_a_problem_is_solved_at_other_values():
    problem = ocp.Problem(
        GIVEN,
        goals=[*GOALS, ocp.CenterOfMass((None, None, 0.0)).soft(1.0)],
        parameters={"bar_mass": 0.7},
    )
    again = copy.deepcopy(problem)
    plan = ocp.solve(again, ocp.MultipleShooting(6), parameters=VALUES)
    asked = ocp.Problem(GIVEN, goals=problem.given["goals"], parameters=VALUES)
    own = ocp.solve(asked, ocp.MultipleShooting(6))
    assert plan.success
    assert np.array_equal(plan.model.structure.bar_mass, VALUES["bar_mass"])
    np.testing.assert_allclose(plan.force_density, own.force_density, rtol=1e-6, atol=1e-6)
    wish = problem.with_parameters(VALUES).costs[-1].goal  # of the masses that are given now
    np.testing.assert_array_equal(wish.masses, asked.costs[-1].goal.masses)
    assert not np.array_equal(wish.masses, problem.costs[-1].goal.masses)
    with pytest.raises(ValueError, match="parameters: bar_mass of bar 0 is -1 kg"):
        ocp.solve(problem, parameters={"bar_mass": -1.0})


def test_a_plan_is_replayed_at_other_values(tmp_path):
    plan = ocp.solve(ocp.Problem(GIVEN, goals=GOALS, parameters=VALUES), ocp.MultipleShooting(6))
    heavy = {"bar_mass": 1.5}
    run = tc.simulate(
        GIVEN,
        plan.time[-1],
        plan.time[1] / 10,
        control=plan.force_density,
        parameters=heavy,
        compiled=False,
    )
    np.testing.assert_allclose(plan.replay(parameters=heavy).nodes[-1], run.nodes[-1], atol=1e-12)
    assert np.array_equal(plan.replay(parameters=VALUES).states, plan.replay().states)
    with pytest.raises(ValueError, match="tracked is True: give ocp"):
        plan.replay(tracked=True, parameters=heavy)
    again = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    for misses in (
        lambda: again.replay(parameters=heavy),
        lambda: replace(again, problem=None).replay(parameters=heavy),
    ):
        with pytest.raises(ValueError, match="parameters"):
            misses()


def test_a_problem_without_parameters_takes_no_values():
    for problem in (
        ocp.Problem(model(), goals=GOALS),
        replace(ocp.Problem(GIVEN, goals=GOALS), duration=2.0),
    ):
        with pytest.raises(
            ValueError,
            match=r"Problem\.model has none: give a problem that was made with a model of Scene",
        ):
            ocp.solve(problem, parameters={"bar_mass": 1.0})

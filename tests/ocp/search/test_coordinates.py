"""Problems in full coordinates are planned in reduced ones, and judged in their own."""

from __future__ import annotations

import sys

import casadi as ca
import numpy as np
import pytest
from ocp_problems.tasks import in_full_coordinates, long_arm, reach
from planning import driven, integrated

import ocp
import tenscasadi as tc
from ocp.search.coordinates import reduce_coordinates

SAID = "; found in reduced coordinates"


@pytest.fixture(scope="module")
def arm():
    """An arm in full coordinates, and its plan."""
    problem = in_full_coordinates(reach(0.4))
    return problem, ocp.solve(problem)


@pytest.fixture(scope="module")
def known(arm):
    """Its plan by a method that knows full coordinates."""
    plan = ocp.solve(arm[0], ocp.MultipleShooting(30))
    assert SAID not in plan.message
    return plan


def bounded(problem, *bounds, costs=None):
    return ocp.Problem(
        problem.model,
        problem.duration,
        goals=problem.goals,
        bounds=[*problem.bounds, *bounds],
        costs=costs or problem.costs,
    )


def test_the_plan_is_of_the_given_model(arm):
    problem, plan = arm
    model = problem.model
    assert model.mechanism.joints
    assert plan.success, plan.message
    assert plan.message.endswith(SAID)
    assert plan.problem is problem
    assert plan.model is model
    assert plan.trajectory.states.shape == (len(plan.time), model.nx)
    assert plan.trajectory.nodes == pytest.approx(model.nodes(plan.trajectory.states), abs=1e-12)
    assert np.abs(np.concatenate(model.constraints(plan.trajectory.states[7]))).max() < 1e-9
    end = integrated(plan)
    assert model.nodes(end)[1, :2] == pytest.approx([0.4, 0.2], abs=1e-5)
    assert np.abs(model.velocities(end)).max() < 1e-5


@pytest.mark.parametrize(
    ("transcription", "solver"),
    [
        (None, None),
        (None, ocp.CondensedNewton()),
        (ocp.Variational(30, accuracy=1e-5), None),
        (ocp.DirectCollocation(20), None),
        pytest.param(ocp.ImplicitMidpoint(30), None, marks=pytest.mark.slow),
    ],
    ids=["default", "CondensedNewton", "Variational", "Collocation", "ImplicitMidpoint"],
)
def test_it_is_the_optimum_of_multiple_shooting_in_full_coordinates(
    arm, known, transcription, solver
):
    problem, _ = arm
    plan = ocp.solve(problem, transcription, solver)
    assert plan.success, plan.message
    assert plan.message.endswith(SAID)
    assert plan.objective == pytest.approx(known.objective, rel=2e-3)
    assert plan.replay().nodes[-1, 1, :2] == pytest.approx([0.4, 0.2], abs=1e-4)


def test_joined_bars_under_their_weight_on_a_moving_start():
    """Three bars in a row, which begin in motion at a clock that has run."""
    small = long_arm(3, 0.3, weight=True)
    wind = tc.NodalForce(
        lambda t: (
            0.1
            * np.ones((len(small.model.scene.structure.nodes), 3))
            * t
            * (~small.model.scene.structure.fixed)
        )
    )
    model = tc.Model(
        tc.Scene(
            small.model.scene.structure,
            control=tc.ForceDensity(),
            gravity=tc.Gravity(),
            forces=wind,
        ),
        coordinates="full",
    )
    turning = np.zeros((len(model.structure.nodes), 3))
    turning[1:4, 0] = 0.1 * np.arange(1, 4)
    start = model.state(model.structure.nodes, turning)
    start[-1] = 0.7
    problem = ocp.Problem(
        model, 1.0, start=start, goals=small.goals, bounds=small.bounds, costs=small.costs
    )
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert plan.message.endswith(SAID)
    assert plan.trajectory.states[0] == pytest.approx(start, abs=1e-12)
    exact = plan.replay(tc.DormandPrince853(), step=plan.time[1])
    assert exact.nodes[-1, 3, :2] == pytest.approx([0.3, 0.1], abs=1e-4)
    assert np.abs(exact.velocities[-1]).max() < 1e-3


def test_own_expressions_get_the_state_of_the_given_model(arm):
    problem, plan = arm
    entry = problem.model.nq + problem.model.mechanism.coordinate_names.index("node 1 x")
    limit = 0.97 * np.abs(plan.trajectory.states[:, entry]).max()
    found = [
        ocp.solve(bounded(problem, ocp.Constraint("speed", expression, upper=limit)), *method)
        for expression, method in (
            (lambda now: now.state[entry], ()),
            (lambda now: now.velocities[0, 1], ()),
            (lambda now: now.state[entry], (ocp.MultipleShooting(30),)),
        )
    ]
    assert all(one.success for one in found)
    assert found[0].message.endswith(SAID)
    assert found[0].trajectory.states[:, entry].max() == pytest.approx(limit, rel=1e-4)
    assert found[0].objective == pytest.approx(found[1].objective, rel=1e-6)
    assert found[0].objective == pytest.approx(found[2].objective, rel=1e-3)
    assert found[0].objective > plan.objective + 1e-3


@pytest.mark.slow
def test_own_expressions_of_forces_of_bars(arm):
    """They are the same in both coordinates."""
    problem, plan = arm
    asked = bounded(
        problem,
        costs=[*problem.costs, ocp.Integral("bars", lambda now: 1e-3 * ca.sumsqr(now.bar_force))],
    )
    found, known = ocp.solve(asked), ocp.solve(asked, ocp.MultipleShooting(20))
    assert found.success, found.message
    assert found.message.endswith(SAID)
    assert found.objective == pytest.approx(known.objective, rel=5e-3)
    assert found.objective > plan.objective + 0.01


@pytest.mark.slow
def test_forces_in_joints_are_those_of_the_given_model(arm):
    problem, plan = arm
    forces = lambda now: 1e-3 * ca.sumsqr(now.model.multiplier_function(now.state, now.control)[1])  # noqa: E731
    found = ocp.solve(bounded(problem, costs=[*problem.costs, ocp.Integral("joints", forces)]))
    assert found.success, found.message
    controls = np.vstack([plan.force_density, plan.force_density[-1:]])
    joints = [
        np.sum(problem.model.multipliers(x, u).joint_force ** 2)
        for x, u in zip(plan.trajectory.states, controls, strict=True)
    ]
    assert found.objective == pytest.approx(
        plan.objective + 1e-3 * np.trapezoid(joints, plan.time), rel=2e-3
    )


def test_what_a_plan_is_used_for(arm, tmp_path):
    problem, plan = arm
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    fine = loaded.refine(1e-8)
    assert fine.success, fine.message
    assert fine.worst_error <= 1e-8
    assert fine.trajectory.states.shape[1] == problem.model.nx
    assert plan.report().active[0].name.startswith("force density of string")
    run = ocp.run(ocp.track(plan), 1.5)
    assert run.trajectory.nodes[-1, 1, :2] == pytest.approx([0.4, 0.2], abs=1e-3)


def test_guesses_are_of_the_given_model(arm):
    problem, plan = arm
    states, forces = plan.trajectory.states, plan.force_density
    warm = ocp.solve(problem, plan.transcription, ocp.Ipopt(warm_start=True), guess=plan)
    for found in (
        warm,
        ocp.solve(problem, guess=ocp.TrajectoryGuess(states, forces)),
        ocp.solve(problem, guess=plan),
    ):
        assert found.success, found.message
        assert found.message.endswith(SAID)
        assert found.objective == pytest.approx(plan.objective, rel=1e-6)
    assert warm.iterations < ocp.solve(problem, plan.transcription).iterations
    with pytest.raises(
        ValueError,
        match=rf"TrajectoryGuess.states has shape \({len(states)}, 34\): give an array of shape \(any, {problem.model.nx}\)",
    ):
        ocp.solve(problem, guess=ocp.TrajectoryGuess(states[:, :34], forces))


def test_success_is_what_the_given_model_does(arm, monkeypatch):
    """Where its motion were another one, the plan would be no success, whatever the twin does."""
    problem, _ = arm
    replays = sys.modules["ocp.results.replay"]
    replay = replays.replay_open

    def pushed(plan, model, *given, **options):
        motion = replay(plan, model, *given, **options)
        if model.coordinates == "reduced":
            return motion
        states = motion.states.copy()
        states[-1, : model.nq] += 0.05
        return tc.Trajectory(**{**vars(motion), "states": states})

    monkeypatch.setattr(replays, "replay_open", pushed)
    plan = ocp.solve(problem, ocp.Variational(30))
    assert not plan.success
    assert plan.replay_error == pytest.approx(0.05, rel=0.1)
    assert "its replay misses by" in plan.message


def test_what_has_no_twin():
    """Reduced coordinates of spatial motions, and classes that are not this package's."""
    free = ocp.Problem(driven(tc.shapes.prism()), goals=[ocp.AtRest()], costs=[ocp.Effort()])
    assert reduce_coordinates(free, None) is None

    class Own(ocp.Effort):
        pass

    problem = in_full_coordinates(reach(0.4))
    assert reduce_coordinates(problem, None) is not None
    assert reduce_coordinates(bounded(problem, costs=[Own()]), None) is None
    assert ocp.solve(bounded(problem, costs=[Own()]), ocp.Variational(10), tolerance=0.1).success


FLAT = tc.shapes.t_bar(0.8, 0.6)
ACROSS = np.array((0, 0, 1.0))
OUT_OF_PLANE = {
    "gravity": {"gravity": tc.Gravity((0.0, -3.0, -1.0))},
    "velocity": {"start": (0.0, 0.0, 0.0, 0.0, 0.1)},
    "ground": {"ground": tc.Ground()},
    "wind": {"forces": tc.NodalForce({0: (0.0, 0.0, 0.1)})},
    "goal": {"goals": [ocp.NodePositions({0: (None, None, 0.1)})]},
    "another plane": {"shift": 1.0},
}


@pytest.mark.parametrize("name", OUT_OF_PLANE)
def test_structures_that_leave_their_plane_have_no_twin(name):
    options = dict(OUT_OF_PLANE[name])
    speeds = np.outer(options.pop("start", np.zeros(5)), ACROSS)
    nodes = FLAT.nodes + options.pop("shift", 0.0) * ACROSS
    goals = options.pop("goals", [ocp.StringLengths({0: 0.5})])
    model = driven(FLAT, **options)
    start = np.ravel(model.state(nodes, velocities=speeds))
    assert reduce_coordinates(ocp.Problem(model, 0.5, start, goals=goals), None) is None


def test_infeasible_goals_name_what_the_given_coordinates_have():
    """The plane of a flat structure, which reduced coordinates lack."""
    problem = ocp.Problem(driven(FLAT), 0.5, goals=[ocp.CenterOfMass((None, None, 0.2))])
    assert reduce_coordinates(problem, None) is not None
    with pytest.raises(ocp.InfeasibleGoalError, match="stays in the plane of the start") as raised:
        ocp.solve(problem)
    assert any("plane" in name for name in raised.value.certificate.multipliers)


def test_a_single_infeasible_goal_contradicts_no_other():
    model = driven(FLAT.replace(pinned=dict.fromkeys(range(len(FLAT.nodes)), "z")))
    problem = ocp.Problem(model, 0.5, goals=[ocp.CenterOfMass((None, None, 0.2))])
    with pytest.raises(ocp.InfeasibleGoalError, match="comes closer: change the goal"):
        ocp.solve(problem)


def test_flat_structures_are_planned_in_their_plane():
    """A T-bar that spins and deforms in its plane, in the coordinates of a spatial model."""
    model = driven(FLAT, gravity=tc.Gravity((0.0, -2.0, 0.0)))
    spin = np.cross((0, 0, 0.5), FLAT.nodes)
    start = np.ravel(model.state(FLAT.nodes, velocities=spin))
    control = np.linspace(8.0, 12.0, model.nu)
    run = tc.simulate(model, 0.5, 1e-3, state=start, control=control, compiled=False)
    goals = [ocp.NodePositions({k: tuple(run.nodes[-1][k]) for k in (0, 3)})]
    bounds = [ocp.ForceDensityLimits(2.0, 60.0)]
    problem = ocp.Problem(model, 0.5, start, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    reduced = reduce_coordinates(problem, None)
    assert reduced.problem.model.nq == 2 * len(FLAT.nodes)
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert plan.message.endswith(SAID)
    assert plan.model is model
    assert plan.trajectory.states.shape == (len(plan.time), model.nx)
    assert np.abs(plan.trajectory.nodes[:, :, 2] - FLAT.nodes[:, 2]).max() == 0.0
    end = integrated(plan)
    assert model.nodes(end)[[0, 3]] == pytest.approx(run.nodes[-1][[0, 3]], abs=1e-3)
    again = ocp.solve(problem, guess=plan)
    assert again.success
    assert again.iterations <= plan.iterations


def test_redundant_bars_are_planned_in_reduced_coordinates():
    with pytest.warns(tc.RedundantConstraints):
        model = tc.Model(
            tc.Scene(tc.shapes.d_bar(pinned=[0, 1]), control=tc.ForceDensity()), coordinates="full"
        )
    problem = ocp.Problem(model, goals=[ocp.AtRest()], costs=[ocp.Effort()])
    reduced = reduce_coordinates(problem, None)
    assert reduced is not None
    assert reduced.problem.model.coordinates == "reduced"

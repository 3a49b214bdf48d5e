"""Jumps, landings and steps, judged by their replay on the ground; the laws of mechanics in and between phases."""

from __future__ import annotations

import sys
from functools import cache

import casadi as ca
import numpy as np
import pytest
from jumping import FEET, HEIGHT, flight, jumping, low_prism, push, standing

import ocp
import tenscasadi as tc
from ocp.phases.method import link_problem

GRAVITY = 9.81
PLAN = ocp.Variational(10)


@cache
def jump():
    """The task, and what it says of a push and a flight to 0.2 m."""
    task = link_problem(jumping(push(), flight(0.2)), ocp.Variational(20), 0.01)
    solution = ocp.Ipopt().solve(task.program)
    assert solution.success
    return task, task.values(solution.w)


def heights(model, states):
    return model.nodes(states)[..., 2].mean(axis=-1)  # all bars weigh the same


def test_a_flight_is_a_parabola():
    task, (_, air) = jump()
    model = task.parts[0].model
    speed = model.velocities(air.states[0])[:, 2].mean()
    t = np.linspace(0.0, air.duration, len(air.states))
    assert np.allclose(
        heights(model, air.states),
        heights(model, air.states[0]) + speed * t - GRAVITY * t**2 / 2,
        atol=1e-7,
    )
    assert heights(model, air.states[-1]) == pytest.approx(HEIGHT / 2 + 0.2, abs=1e-6)


def test_the_push_makes_the_momentum_of_the_flight():
    """Impulse of the ground less that of the weight, by the trapezium rule of the leapfrog, is the momentum at take-off."""
    task, (stance, air) = jump()
    model = task.parts[0].model
    h = stance.duration / (len(stance.states) - 1)
    pushed = stance.reactions.sum(axis=1)
    impulse = h * (pushed.sum(axis=0) - (pushed[0] + pushed[-1]) / 2) - [
        0,
        0,
        0.9 * GRAVITY * stance.duration,
    ]
    assert np.allclose(impulse, 0.9 * model.velocities(air.states[0]).mean(axis=0), atol=1e-6)


def pinned_model():
    return tc.Model(
        tc.Scene(low_prism().replace(pinned=FEET), control=tc.ForceDensity(), gravity=tc.Gravity())
    )


def test_reactions_are_those_of_pins():
    """Ω of the pinned model at the same states: the discrete reactions approach it with the square of the step."""
    pinned, errors = pinned_model(), []
    for count in (20, 40):
        squat = jumping(
            push(duration=0.4, goals=[ocp.CenterOfMass((None, None, 0.25)), ocp.AtRest()]),
            costs=[ocp.Smoothness()],
        )
        task = link_problem(squat, ocp.Variational(count), 0.01)
        solution = ocp.Ipopt().solve(task.program)
        assert solution.success
        (stance,) = task.values(solution.w)
        k = count // 2
        model = task.parts[0].model
        x = pinned.state(model.nodes(stance.states[k]), model.velocities(stance.states[k]))
        omega = pinned.multipliers(x, stance.force_density[k - 1 : k + 1].mean(axis=0)).joint_force
        errors.append(
            np.abs(np.abs(omega[:, -3:].T) - np.abs(stance.reactions[k])).max()
            / np.abs(omega).max()
        )
    assert errors[1] < 0.01
    assert errors[1] < errors[0]


def test_the_stance_is_the_motion_of_a_pinned_structure():
    task, (stance, _) = jump()
    model, pinned = task.parts[0].model, pinned_model()
    start = pinned.state(model.nodes(stance.states[0]))
    motion = tc.simulate(
        pinned,
        stance.duration,
        stance.duration / 400,
        tc.DormandPrince54(),
        state=start,
        control=stance.force_density,
    )
    assert np.allclose(motion.nodes[-1], model.nodes(stance.states[-1]), atol=1e-3)


def test_feet_are_pushed_within_the_cone_of_friction():
    _, (stance, _) = jump()
    along = np.linalg.norm(stance.reactions[:, :, :2], axis=2)
    assert (stance.reactions[:, :, 2] > -1e-6).all()
    assert (along <= 0.6 * stance.reactions[:, :, 2] + 1e-5).all()


@cache
def landing():
    """A drop from 0.3 m onto the feet, with a spin that the impact has to stop."""
    model = standing()
    nodes = low_prism().nodes + [0, 0, 0.3]
    velocities = np.cross([0.3, 0.2, 0.5], nodes - nodes.mean(axis=0)) + [0.2, 0.1, -0.5]
    problem = jumping(
        ocp.Phase((0.05, 0.6)),
        push(goals=[ocp.AtRest()]),
        start=np.asarray(model.state(nodes, velocities)),
        costs=[ocp.Effort()],
    )
    task = link_problem(problem, PLAN, 0.01)
    solution = ocp.Ipopt().solve(task.program)
    assert solution.success, solution.status
    air, stance = task.values(solution.w)
    return task.parts[0].model, air.states[-1], stance.states[0], stance.impulses[0]


def kinetic(model, velocities):
    M = model.mechanism.M
    return 0.5 * np.sum(velocities * (M @ velocities))


def test_an_impact_keeps_momenta_but_for_the_impulses_on_the_feet():
    model, before, after, impulses = landing()
    nodes, M = model.nodes(after), model.mechanism.M
    change = M @ (model.velocities(after) - model.velocities(before))
    assert np.allclose(change.sum(axis=0), impulses.sum(axis=0), atol=1e-8)
    assert np.allclose(
        np.cross(nodes, change).sum(axis=0),
        np.cross(nodes[list(FEET)], impulses).sum(axis=0),
        atol=1e-8,
    )


def test_an_impact_is_the_projection_onto_what_feet_and_bars_allow():
    """Carnot's theorem: without rebound, the energy that is lost is that of the velocities that are lost; and the closed form of the projection."""
    model, before, after, _ = landing()
    v, w = model.velocities(before), model.velocities(after)
    assert np.allclose(w[list(FEET)], 0.0)
    assert kinetic(model, v) - kinetic(model, w) == pytest.approx(kinetic(model, v - w), rel=1e-7)
    nodes, bars, n = model.nodes(after), low_prism().bars, 6
    J = np.zeros((len(bars) + 9, 3 * n))
    for k, (a, b) in enumerate(bars):
        J[k, 3 * a : 3 * a + 3], J[k, 3 * b : 3 * b + 3] = nodes[a] - nodes[b], nodes[b] - nodes[a]
    J[len(bars) + np.arange(9), np.arange(9)] = 1.0
    M = np.kron(model.mechanism.M.toarray(), np.eye(3))
    Q = np.linalg.solve(M, J.T)
    projected = v.ravel() - Q @ np.linalg.solve(J @ Q, J @ v.ravel())
    assert np.allclose(projected, w.ravel(), atol=1e-8)


@pytest.mark.parametrize("rise", [0.1, 0.3])
def test_a_prism_jumps_as_high_as_asked(rise):
    plan = ocp.solve(jumping(push(), flight(rise)))
    assert plan.success, plan.message
    replay = plan.replay()
    assert heights(plan.model, replay.states).max() - HEIGHT / 2 == pytest.approx(rise, abs=0.02)
    assert plan.force_density.shape == (40, 9)
    assert "2 phases" in plan.message


def test_without_the_strength_there_is_no_plan():
    plan = ocp.solve(jumping(push(), flight(0.4), bounds=[ocp.ForceDensityLimits(0.0, 2.0)]), PLAN)
    assert not plan.success
    assert plan.message.startswith("no plan")


def test_a_goal_that_feet_keep_it_from_is_told():
    plan = ocp.solve(jumping(push(goals=[ocp.NodePositions({0: (0.5, None, None)})])), PLAN)
    assert not plan.success
    assert "farthest in NodePositions: node 0 x" in plan.message


def test_what_is_found_is_a_guess_and_is_kept_in_files(tmp_path):
    problem = jumping(push(), flight(0.1))
    plan = ocp.solve(problem, PLAN)
    again = ocp.solve(problem, ocp.Variational(14), guess=plan)
    assert again.success
    assert len(again.time) == 29
    loaded = ocp.Plan.load(plan.save(tmp_path / "jump.npz"))
    assert len(loaded.problem.phases) == 2
    assert loaded.problem.phases[0].contact_nodes == FEET
    assert np.allclose(loaded.replay().nodes[-1], plan.replay().nodes[-1])
    assert not plan.tracked
    assert 1.0 < plan.error_growth < 20.0
    assert loaded.error_growth == pytest.approx(plan.error_growth)


def test_a_plan_in_phases_refines():
    coarse = ocp.solve(jumping(push(), flight(0.1)), ocp.Variational(5), tolerance=1.0)
    fine = coarse.refine(coarse.replay_error / 5)
    assert fine.success, fine.message
    assert fine.replay_error <= coarse.replay_error / 5
    assert len(fine.problem.phases) == 2


def test_corrections_decide_once_on_the_kind_of_replay(monkeypatch):
    module = sys.modules["ocp.search.methods"]
    measured, replayed = [], []
    replay = module.replay_plan

    def describe(plan, tolerance):
        measured.append(plan)
        return "" if len(measured) == 1 else "errors grow"

    def follow(plan, tracked):
        replayed.append(tracked)
        return replay(plan, tracked)

    monkeypatch.setattr(module, "describe_growth", describe)
    monkeypatch.setattr(module, "replay_plan", follow)
    ocp.solve(jumping(push(), flight(0.1)), PLAN, tolerance=1e-4)
    assert len(measured) == 1
    assert len(replayed) > 1
    assert not any(replayed)


@pytest.mark.slow
def test_limits_of_the_end_are_of_the_end_alone():
    """A limit that the end of the first phase breaks, as asked."""
    low = ocp.Constraint(
        "height", lambda now: ca.sum2(now.nodes[2, :]) / 6, upper=0.25, at_end=True
    )
    rising = push(goals=[ocp.CenterOfMass((None, None, 0.35))])
    plan = ocp.solve(
        jumping(
            rising, push(goals=[ocp.AtRest()]), bounds=[ocp.ForceDensityLimits(5.0, 500.0), low]
        ),
        PLAN,
    )
    assert plan.status == "Solve_Succeeded"
    own = heights(plan.model, plan.trajectory.states)
    assert own[10] == pytest.approx(
        0.35, abs=0.01
    )  # goals move a little against what the replay misses
    assert own[-1] < 0.25 + 0.01


def test_other_ways_to_solve_are_refused_by_name():
    problem = jumping(push())
    for given, named in (
        ({"transcription": ocp.MultipleShooting(5)}, "phases take ocp.Variational"),
        ({"solver": ocp.CondensedNewton()}, "solver is CondensedNewton"),
        ({"guess": ocp.EquilibriumGuess()}, "guess is"),
    ):
        with pytest.raises((TypeError, ValueError), match=named):
            ocp.solve(problem, **given)
    plan = ocp.solve(problem, PLAN)
    with pytest.raises(ValueError, match="guess is Plan"):
        ocp.solve(jumping(push(), flight(0.1)), PLAN, guess=plan)


def test_a_shape_is_a_goal_of_nodes_that_land():
    """Lengths between nodes that land are not kept from where they come from: they decide where it is."""
    wanted = low_prism().string_lengths
    air, stance = (
        ocp.Phase((0.05, 0.6)),
        push(duration=(0.1, 0.6), goals=[ocp.StringLengths({0: 0.9 * wanted[0]})]),
    )
    nodes = low_prism().nodes + [0, 0, 0.1]
    task = link_problem(jumping(air, stance, start=nodes), PLAN, 0.01)
    solution = ocp.Ipopt().solve(task.program)
    assert solution.success
    end = task.parts[0].model.nodes(task.values(solution.w)[-1].states[-1])
    a, b = low_prism().strings[0]
    assert np.linalg.norm(end[a] - end[b]) == pytest.approx(0.9 * wanted[0], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e4, 1e5])
@pytest.mark.parametrize("rise", [0.1, 0.2, 0.3, 0.4])
def test_jumps_of_all_heights_on_hard_grounds(rise, stiffness):
    plan = ocp.solve(
        jumping(push(), flight(rise), model=standing(stiffness, 0.2 * np.sqrt(stiffness)))
    )
    assert plan.success, plan.message
    assert heights(plan.model, plan.replay().states).max() - HEIGHT / 2 == pytest.approx(
        rise, abs=0.02
    )


@pytest.mark.slow
def test_a_prism_jumps_and_lands_at_rest():
    plan = ocp.solve(
        jumping(push(), flight(0.3), ocp.Phase((0.02, 0.5)), push(goals=[ocp.AtRest()])),
        tolerance=0.05,
    )
    assert plan.success, plan.message
    replay = plan.replay()
    assert np.abs(replay.nodes[:, :, 2].mean(axis=1).max() - HEIGHT / 2 - 0.3) < 0.01
    assert np.abs(replay.velocities[-1]).max() < 0.1
    assert np.abs(replay.nodes[-1, list(FEET), 2]).max() < 0.01


@pytest.mark.slow
def test_tracked_replay_counts_where_a_flight_is_unstable():
    """Depths of the contact nodes grow more than a hundredfold until the landing."""
    stance = ocp.Phase((0.2, 0.8), FEET, goals=[ocp.AtRest()])
    phases = push(duration=(0.1, 0.6)), ocp.Phase((0.1, 0.5)), stance
    plan = ocp.solve(jumping(*phases, costs=[ocp.Prestress(50.0)]))
    assert plan.success, plan.message
    assert plan.tracked
    assert plan.error_growth > 100
    assert plan.replay_error < 0.0125 < plan.open_loop_error
    assert "fold in open loop" in plan.message
    kept = plan.replay(tracked=True)
    assert np.abs(kept.velocities[-1]).max() * plan.time[-1] < 0.0125


@pytest.mark.slow
def test_a_prism_crawls_three_cycles():
    """Foot after foot steps 5 cm ahead while the others stand, three times."""
    ahead, phases = 0.05, [push(duration=(0.05, 0.5))]
    for cycle in range(1, 4):
        for foot in (2, 0, 1):
            place = (low_prism().nodes[foot, 0] + cycle * ahead, None, None)
            phases.append(
                ocp.Phase(
                    (0.03, 0.4),
                    [other for other in FEET if other != foot],
                    [ocp.NodePositions({foot: place})],
                )
            )
            phases.append(push(duration=(0.05, 0.5)))
    plan = ocp.solve(jumping(*phases, goals=[ocp.AtRest()]), PLAN, tolerance=0.05)
    assert plan.success, plan.message
    moved = plan.replay().nodes[-1, list(FEET), 0] - low_prism().nodes[list(FEET), 0]
    assert np.allclose(moved, 3 * ahead, atol=0.01)


def test_time_that_is_over_is_told():
    plan = ocp.solve(jumping(push(), flight(0.3)), PLAN, time_limit=1e-3)
    assert not plan.success
    assert "increase time_limit" in plan.message

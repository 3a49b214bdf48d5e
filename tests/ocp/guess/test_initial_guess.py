"""Initial guesses: on bars and within limits, at rest in equilibrium."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven, prism, raising

import ocp
import tenscasadi as tc
from ocp.guess.path import follow, make_guess
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target

PRISM = tc.shapes.prism()
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), gravity=tc.Gravity()))
LENGTHS = ocp.StringLengths({0: 0.8, 6: 1.0})


def test_the_guess_keeps_bars_and_limits_and_follows_the_path():
    problem = ocp.Problem(
        MODEL, 0.4, goals=[LENGTHS], bounds=[ocp.ForceDensityLimits(1.0, [30.0] * 8 + [1.0])]
    )
    target = find_target(problem, Scales.of(problem))
    guess = make_guess(problem, target, 8)
    assert max(MODEL.bar_length_error(state) for state in guess.states) < 1e-12
    assert guess.states[0] == pytest.approx(target.start)
    assert guess.states[-1] == pytest.approx(target.state)
    assert guess.force_density.min() >= 1.0
    assert guess.force_density[:, :8].max() <= 30.0
    assert np.all(guess.force_density[:, 8] == 1.0)
    assert guess.duration == 0.4


def test_guess_without_a_path_keeps_the_clock_running():
    push = tc.NodalForce(lambda t: [[0, 0, t]] * 6)
    model = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity(), forces=push))
    problem = ocp.Problem(model, 0.4, goals=[LENGTHS])
    target = find_target(problem, Scales.of(problem))
    guess = follow(problem, target, np.full((5, model.nq), np.nan))
    assert np.all(guess.states[:, :-1] == target.start[:-1])
    assert guess.states[:, -1] == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])


def test_noise_parts_what_symmetry_makes_equal_in_the_same_way_for_any_number_of_intervals():
    problem = growing()
    target = find_target(problem, Scales.of(problem))
    even, coarse, fine = (
        ocp.InverseDynamics(noise=noise).guess(problem, target, count)
        for noise, count in ((0.0, 8), (0.3, 8), (0.3, 16))
    )
    lower, upper = problem.force_density_limits
    assert np.ptp(even.force_density[:, :3], axis=1) == pytest.approx(
        0.0, abs=1e-6
    )  # the strings of a ring
    assert np.ptp(coarse.force_density[:, :3], axis=1).min() > 0.02 * even.force_density.max()
    assert np.all((lower <= coarse.force_density) & (coarse.force_density <= upper))
    added = coarse.force_density - even.force_density
    assert added.max() <= 0.3 * even.force_density.max()
    assert fine.force_density[0] == pytest.approx(coarse.force_density[0], rel=0.02)
    waiting = ocp.InverseDynamics().guess(problem, target, 8)
    assert np.array_equal(waiting.force_density, even.force_density)
    assert np.array_equal(
        waiting.perturb(*problem.control_limits).force_density, coarse.force_density
    )
    other = ocp.InverseDynamics(seed=1).guess(problem, target, 8)
    assert (
        np.abs(other.force_density - coarse.force_density).max() > 0.02 * even.force_density.max()
    )


@pytest.mark.parametrize(("lower", "duration"), [(2.0, 5.0), (50.0, 1.0)])
def test_slow_plans_of_free_structures_are_found_as_their_guesses_are_hardly_disturbed(
    lower, duration
):
    plan = ocp.solve(
        raising(duration=duration, bounds=[ocp.ForceDensityLimits(lower, 200.0)]), time_limit=60
    )
    assert plan.success, plan.message


def growing():
    return raising(goals=[ocp.Shape(prism(1.15).nodes), ocp.AtRest()])


def guesses():
    plan = ocp.solve(growing(), ocp.MultipleShooting(10))
    middle = plan.trajectory.nodes[[0, 5, -1]]
    return [
        ocp.InverseDynamics(),
        ocp.InverseDynamics(middle),
        ocp.EquilibriumGuess(),
        ocp.TrajectoryGuess(plan.trajectory.states, plan.force_density),
        plan,
    ]


def test_all_guesses_lead_to_the_same_plan():
    plans = [ocp.solve(growing(), ocp.MultipleShooting(12), guess=guess) for guess in guesses()]
    assert all(plan.success for plan in plans)
    assert [plan.objective for plan in plans] == pytest.approx([plans[0].objective] * 5, rel=1e-4)


BAD = {
    "no guess": (lambda: 1.0, TypeError, "guess is 1.0"),
    "path of one instant": (
        lambda: ocp.InverseDynamics(np.zeros((1, 6, 3))),
        ValueError,
        "InverseDynamics.path has 1",
    ),
    "noise below 0": (lambda: ocp.InverseDynamics(noise=-0.1), ValueError, "InverseDynamics.noise"),
    "seed of half a number": (
        lambda: ocp.InverseDynamics(seed=0.5),
        TypeError,
        "InverseDynamics.seed",
    ),
    "path of other nodes": (
        lambda: ocp.InverseDynamics(np.zeros((3, 5, 3))),
        ValueError,
        "InverseDynamics.path",
    ),
    "states of other size": (
        lambda: ocp.TrajectoryGuess(np.zeros((3, 5)), np.zeros((2, 9))),
        ValueError,
        "TrajectoryGuess.states",
    ),
    "forces of other size": (
        lambda: ocp.TrajectoryGuess(np.zeros((3, 36)), np.zeros((2, 8))),
        ValueError,
        "TrajectoryGuess.force_density",
    ),
    "duration zero": (
        lambda: ocp.TrajectoryGuess(np.zeros((3, 36)), np.zeros((2, 9)), 0.0),
        ValueError,
        "TrajectoryGuess.duration",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_guesses_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        ocp.solve(growing(), ocp.MultipleShooting(5), guess=make())


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.6, 0.8, 0.0)])
@pytest.mark.parametrize("body", [False, True])
def test_a_plate_turns_over_half_a_circle_without_collapse(body, axis):
    """Straight lines would lead all nodes of a plate, or of a triangle of bars, to a line or a point.

    About an axis in the plane, no common axis follows from the turn of each bar.
    """
    angle = np.deg2rad([90, 210, 330])
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    frame = [-1.5 * ring + [0, 0, z] for z in (-1.0, 1.0)]
    rigid = {"bars": [(0, 1), (1, 2), (2, 0)]}
    if body:
        rigid = {"bodies": [tc.RigidBody((0, 1, 2), mass=3.0, inertia=(0.1, 0.1, 0.2))]}
    structure = tc.Structure(
        np.vstack([0.4 * ring, *frame]),
        strings=[(i, j) for i in range(3) for j in range(3, 9)],
        pinned=range(3, 9),
        **rigid,
    )
    turned = 0.4 * (2 * np.outer(ring @ axis, axis) - ring)
    problem = ocp.Problem(
        driven(structure),
        2.0,
        goals=[ocp.NodePositions({k: tuple(turned[k]) for k in range(3)}), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(0.0, 300.0)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert plan.iterations < 50
    sides = plan.trajectory.nodes[:, [1, 2, 0]] - plan.trajectory.nodes[:, :3]
    assert np.linalg.norm(sides, axis=2) == pytest.approx(0.4 * np.sqrt(3), rel=1e-3)


def test_guesses_of_rigid_groups_make_whole_turns():
    """A T-bar returns to its place after one turn, which its velocities at both ends show."""
    cross = tc.shapes.t_bar(0.8, 0.6)
    model = driven(cross)
    spin = np.cross((0.0, 0.0, 2 * np.pi), cross.nodes)
    start = np.ravel(model.state(cross.nodes, velocities=spin))
    goals = [
        ocp.NodePositions(dict(enumerate(cross.nodes.tolist()))),
        ocp.NodeVelocities(dict(enumerate(spin.tolist()))),
    ]
    problem = ocp.Problem(model, 1.0, start, goals=goals)
    guess = make_guess(problem, find_target(problem, Scales.of(problem)), 20)
    halfway = model.nodes(guess.states[10])
    assert halfway == pytest.approx(cross.nodes * [-1, -1, 1], abs=0.02)

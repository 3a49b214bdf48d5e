"""Which rows of a goal are imposed: what the motion keeps by itself, what a shape needs beyond its string lengths, what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.boundary.find_target import find_target
from ocp.boundary.invariants import bodies, free_motions, invariants
from ocp.boundary.row_reduction import RowFunction, null_space, soft_directions
from ocp.boundary.sensitivities import Reach, find_controlled
from ocp.problem.scaling import Scales

PRISM = tc.shapes.prism()
BALL = tc.shapes.six_bar_ball()
D_BAR = tc.shapes.d_bar()
TWO = tc.Structure(
    np.concatenate([PRISM.nodes, PRISM.nodes + (3, 0, 0)]),
    np.concatenate([PRISM.bars, PRISM.bars + 6]),
    np.concatenate([PRISM.strings, PRISM.strings + 6]),
)
GRAVITY = tc.Gravity((0.0, 0.0, -9.81))


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


def lower(height, twist=None):
    """The prism of another height with the bars of PRISM."""
    chord = 2 * np.sin((np.radians(150) if twist is None else twist) / 2)  # of a bar seen from above, for radius 1
    return tc.shapes.prism(height=height, radius=np.sqrt(PRISM.bar_lengths[0] ** 2 - height**2) / chord, twist=twist)


def target(model, goals, duration=1.0, **options):
    problem = ocp.Problem(model, duration, goals=goals, **options)
    return find_target(problem, Scales.of(problem))


def spun(model, axis=(0, 0, 1.0), drift=(0, 0, 0)):
    nodes = model.structure.nodes
    return model.state(nodes, np.cross(axis, nodes) + drift)


# --- what every motion keeps ---

KEPT = {
    "free prism": (driven(PRISM), 6 + 9),
    "free prism falls": (driven(PRISM, gravity=GRAVITY), 6 + 9),
    "prism on a pin": (driven(PRISM.replace(pinned=[0])), 6 + 3),
    "prism on a pin, heavy": (driven(PRISM.replace(pinned=[0]), gravity=GRAVITY), 6 + 1),
    "prism on a pin, weight aslant": (driven(PRISM.replace(pinned=[0]), gravity=tc.Gravity((1.0, 2.0, 3.0))), 6 + 1),
    "prism on two pins": (driven(PRISM.replace(pinned=[0, 1])), 6 + 1),
    "prism on two pins, heavy": (driven(PRISM.replace(pinned=[0, 1]), gravity=GRAVITY), 6),
    "prism on three pins": (driven(PRISM.replace(pinned=[0, 1, 2])), 6),
    "prism on a floor": (driven(PRISM.replace(pinned={0: "z", 1: "z", 2: "z"}), gravity=GRAVITY), 6 + 5),
    "prism on a slope": (driven(PRISM.replace(pinned={0: "z", 1: "z", 2: "z"}), gravity=tc.Gravity((5.0, 0, -5.0))), 6 + 5),
    "prism on a rail": (driven(PRISM.replace(pinned={0: "yz", 1: "z"}), gravity=GRAVITY), 6 + 2),
    "ball": (driven(BALL), 12 + 9),
    "pressed ball": (driven(BALL, pressure=tc.Pressure([(0, 4, 8)], 5.0)), 12),
    "d-bar in full coordinates": (tc.Model(tc.Scene(D_BAR.replace(pinned=[0]), control=tc.ForceDensity()), coordinates="full"), None),
    "two prisms": (driven(TWO), 2 * (6 + 9)),
    "two prisms, each on a pin": (driven(TWO.replace(pinned=[0, 6])), 2 * (6 + 3)),
    "flat d-bar": (driven(D_BAR), None),
    "flat d-bar falls in its plane": (driven(D_BAR, gravity=tc.Gravity((1.0, -2.0, 0.0))), None),
}


def moving_start(model):
    """A start with as much velocity as the case allows: flat structures stay flat."""
    rng = np.random.default_rng(1)
    flat = not np.ptp(model.structure.nodes[:, 2])
    speeds = rng.normal(size=model.structure.nodes.shape) * (1.0, 1.0, 0.0 if flat else 1.0)
    speeds[model.structure.fixed] = 0.0
    return tc.Projection(iterations=10).step(model)(model.state(model.structure.nodes, speeds)).full().ravel()


@pytest.mark.parametrize("name", KEPT)
def test_invariants_stay_zero_along_a_motion(name):
    model, _ = KEPT[name]
    start = moving_start(model)
    table = np.random.default_rng(2).uniform(0, 10, size=(8, model.nu))
    end = tc.simulate(model, 0.2, step=2e-4, state=start, control=table, compiled=False).states[-1]
    x, time = ca.SX.sym("x", model.nx), ca.SX.sym("t")
    for group in invariants(model, start, x, time):
        value = ca.Function("kept", [x, time], [group.value])(end, 0.2).full()
        assert value.shape == (len(group.names), 1)
        assert np.abs(value).max() < 1e-8, group.kind
    assert np.abs(end - start).max() > 0.05


@pytest.mark.parametrize("name", [name for name, (_, count) in KEPT.items() if count is not None])
def test_invariants_are_all_that_the_strings_cannot_change(name):
    """Gradients of the end of a motion with respect to all controls span exactly what the invariants leave."""
    model, count = KEPT[name]
    start = moving_start(model)
    x = ca.SX.sym("x", model.nx)
    gradients = [ca.jacobian(group.value, x) for group in invariants(model, start, x, ca.SX(1.0))]
    intervals = 16
    reach = Reach(model, intervals, free_duration=False, substeps=16)
    controls = np.random.default_rng(3).uniform(0, 10, size=(intervals, model.nu))
    states = reach.rollout(start, controls, 1.0)
    A = ca.Function("A", [x], [ca.vertcat(*gradients)])(states[-1]).full()
    free = null_space(A / np.linalg.norm(A, axis=1, keepdims=True))
    assert free.shape[1] == model.nx - count
    sensitivity = reach.of_rows(ca.Function("state", [x], [x]), np.eye(model.nx), start, controls, 1.0)
    assert len(find_controlled(sensitivity)) == model.nx - count
    assert np.abs(A @ sensitivity).max() < 1e-4 * np.abs(A).max() * np.abs(sensitivity).max()


def test_sensitivities_agree_with_differences():
    model = driven(PRISM)
    intervals = 5
    reach = Reach(model, intervals, free_duration=True)
    controls = np.random.default_rng(4).uniform(1, 5, size=(intervals, 9))
    x = ca.SX.sym("x", model.nx)
    rows = ca.Function("rows", [x], [x[:7] ** 2])

    def end(controls, duration):
        return rows(reach.rollout(model.initial_state, controls, duration)[-1]).full().ravel()

    exact = reach.of_rows(rows, np.eye(rows.size1_out(0)), model.initial_state, controls, 0.5)
    change = np.random.default_rng(5).normal(size=controls.shape)
    e = 1e-5
    along = (end(controls + e * change, 0.5 + e) - end(controls - e * change, 0.5 - e)) / (2 * e)
    assert exact @ np.append(change.ravel(), 1.0) == pytest.approx(along, rel=1e-6, abs=1e-9)


def test_free_motions():
    along, rotations = free_motions(PRISM.nodes, PRISM.fixed, np.zeros(3))
    assert along.all()
    assert len(rotations) == 3
    along, rotations = free_motions(PRISM.nodes, PRISM.replace(pinned=[1]).fixed, np.zeros(3))
    assert not along.any()
    assert len(rotations) == 3
    for t, omega in rotations:
        assert t + np.cross(omega, PRISM.nodes[1]) == pytest.approx(np.zeros(3), abs=1e-12)


def test_bodies_end_at_pins():
    nodes = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (5, 5, 5), (1, 1, 0)]
    structure = tc.Structure(nodes, bars=[(0, 1), (0, 2)], strings=[(1, 4)], node_mass=[0, 0, 0, 1, 1], pinned=[0])
    found = bodies(structure, np.zeros(3))
    assert [body.nodes.tolist() for body in found] == [[1, 4], [2], [3]]
    assert [body.along.all() for body in found] == [False, False, True]
    assert [len(body.rotations) for body in found] == [3, 3, 3]


# --- counts ---

COUNTS = {
    "whole state of a prism": (driven(PRISM), [ocp.NodePositions(PRISM.nodes), ocp.AtRest()], "36 → 21 rows: 6 bar, 9 momentum"),
    "equilibrium lengths": (
        driven(PRISM),
        [ocp.StringLengths(PRISM.string_lengths), ocp.AtRest()],
        "27 → 18 rows: 4 bar, 6 momentum, 1 added for the shape",
    ),
    "lengths twice": (driven(PRISM), [ocp.StringLengths({0: 0.8}), ocp.StringLengths({0: 0.8})], "2 → 1 rows: 1 another"),
    "some lengths": (driven(PRISM), [ocp.StringLengths({6: 0.8, 7: 0.8, 8: 0.8})], "3 → 3 rows"),
    "whole state of a ball": (driven(BALL), [ocp.NodePositions(BALL.nodes), ocp.AtRest()], "72 → 51 rows: 12 bar, 9 momentum"),
    "ball at equilibrium": (
        driven(BALL),
        [ocp.StringLengths(BALL.string_lengths), ocp.AtRest()],
        "60 → 48 rows: 7 bar, 6 momentum, 1 added for the shape",
    ),
    "d-bar on a pin": (
        driven(D_BAR.replace(pinned=[0])),
        [ocp.StringLengths(tc.shapes.d_bar(angle=0.5).string_lengths), ocp.AtRest()],
        "11 → 2 rows: 5 bar, 3 momentum, 1 plane",
    ),
    "prism on three pins": (
        driven(PRISM.replace(pinned=[0, 1, 2])),
        [ocp.StringLengths({6: 0.9, 7: 0.9, 8: 0.9}), ocp.AtRest()],
        "12 → 9 rows: 3 bar",
    ),
    "nothing asked": (driven(PRISM), [], "no goals"),
}


@pytest.mark.parametrize("name", COUNTS)
def test_rows_are_counted(name):
    model, goals, text = COUNTS[name]
    found = target(model, goals)
    assert found.describe() == text
    if goals:
        assert np.abs(found.rows(found.state).full()).max() < 1e-9
        assert all(np.abs(misfit.full()).max(initial=0.0) < 1e-9 for misfit in found.misfit(found.state))
        assert model.bar_length_error(found.state) < 1e-12


def test_imposed_rows_are_independent_of_the_invariants():
    model = driven(PRISM)
    found = target(model, [ocp.NodePositions(PRISM.nodes), ocp.AtRest()])
    x = ca.SX.sym("x", model.nx)
    rows = [found.rows(x), *(group.value for group in invariants(model, model.initial_state, x, ca.SX(1.0)))]
    J = ca.Function("J", [x], [ca.jacobian(ca.vertcat(*rows), x)])(found.state).full()
    values = np.linalg.svd(J / np.linalg.norm(J, axis=1, keepdims=True))[1]
    assert len(J) == 36
    assert values[-1] > 0.05


# --- the shape that lengths ask for ---


@pytest.mark.parametrize("twist", [None, np.radians(149.9), np.radians(140), np.radians(100)])
@pytest.mark.parametrize("digits", [16, 4])
def test_lengths_find_their_shape_from_an_equilibrium(twist, digits):
    """The start is singular (lengths say nothing about its flex to first order), and so is the first of these targets."""
    model, wanted = driven(PRISM), lower(0.6, twist)
    found = target(model, [ocp.StringLengths(wanted.string_lengths.round(digits)), ocp.AtRest()])
    nodes = model.nodes(found.state)
    assert np.linalg.norm(nodes[PRISM.strings[:, 1]] - nodes[PRISM.strings[:, 0]], axis=1) == pytest.approx(wanted.string_lengths, abs=2e-4)
    assert found.adjusted < (1e-4 if digits == 4 else 1e-9)
    assert found.count == 18
    assert nodes.mean(axis=0) == pytest.approx(PRISM.nodes.mean(axis=0), abs=1e-9)
    if twist is None:  # the way there keeps the symmetry, and turns nothing
        turned = np.cross(PRISM.nodes - PRISM.nodes.mean(axis=0), nodes - nodes.mean(axis=0)).sum(axis=0)
        assert turned == pytest.approx(np.zeros(3), abs=1e-6)


def test_shape_rows_feel_the_flex_that_lengths_do_not():
    model = driven(PRISM)
    x = ca.SX.sym("x", model.nx)
    nodes = model.nodes(x)
    goal = ocp.StringLengths(PRISM.string_lengths).rows(PRISM, nodes, model.velocities(x)).value
    bars = [group.value for group in invariants(model, model.initial_state, x, ca.SX(0.0)) if group.kind == "bar"]
    value = ca.vertcat(goal, *bars)
    rows = RowFunction(x, value, np.ones(value.shape[0]), np.ones(model.nx))
    directions, _, curvature = soft_directions(rows, model.initial_state)
    assert directions.shape == (36, 1)
    assert abs(curvature).max() > 0.1
    assert np.abs(rows.only(slice(goal.shape[0]))(model.initial_state)[1] @ directions).max() < 1e-9
    found = target(model, [ocp.StringLengths(PRISM.string_lengths)])
    moved = model.initial_state + 1e-3 * directions[:, 0]
    assert np.abs(goal_misfit(goal, x, moved)).max() < 1e-5
    assert np.abs(found.rows(moved).full()).max() > 1e-4
    assert np.abs(found.misfit(moved)[0].full()).max() > 1e-4
    turned = model.state((PRISM.nodes - PRISM.nodes.mean(axis=0)) @ rotation(0.3))
    assert np.abs(found.rows(turned).full()).max() < 1e-12


def goal_misfit(goal, x, value):
    return ca.Function("misfit", [x], [goal])(value).full()


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def test_nodes_inside_strings_stay_on_the_line():
    model = driven(PRISM.replace(string_mass=0.1), segments=3)
    found = target(model, [ocp.StringLengths(lower(0.6).string_lengths)])
    nodes, s = model.nodes(found.state), model.structure
    chords = nodes[PRISM.strings[:, 1]] - nodes[PRISM.strings[:, 0]]
    assert nodes[s.strings[:, 1]] - nodes[s.strings[:, 0]] == pytest.approx(np.repeat(chords, 3, axis=0) / 3, abs=1e-6)
    assert np.linalg.norm(chords, axis=1) == pytest.approx(lower(0.6).string_lengths, abs=1e-9)


def test_a_clock_runs_to_the_end():
    table = np.zeros((6, 3))
    model = driven(PRISM, forces=tc.NodalForce(lambda t: ca.DM(table) * t))
    found = target(model, [ocp.StringLengths(lower(0.6).string_lengths)], duration=1.5)
    assert found.state[-1] == pytest.approx(1.5)


# --- what is refused ---

REFUSED = {
    "centre of mass": (driven(PRISM), [ocp.NodePositions(PRISM.nodes + (0, 0, 1))], {}, "NodePositions.*centre of mass.*along z"),
    "fall": (driven(PRISM, gravity=GRAVITY), [ocp.NodePositions(PRISM.nodes)], {}, "NodePositions.*centre of mass follows its path along z"),
    "rest in a fall": (driven(PRISM, gravity=GRAVITY), [ocp.AtRest()], {}, "AtRest: .* z misses its goal by .* m/s.*keeps its speed along z"),
    "rest of a drift": (driven(PRISM), [ocp.AtRest()], {"start": spun(driven(PRISM), (0, 0, 0), (1, 0, 0))}, "AtRest.*keeps its speed along x"),
    "rest of a spin": (driven(PRISM), [ocp.AtRest()], {"start": spun(driven(PRISM))}, r"AtRest.*angular momentum about \(0, 0, 1\)"),
    "too short a fall": (
        driven(PRISM, gravity=GRAVITY),
        [ocp.NodePositions(PRISM.nodes - (0, 0, 9.81 / 8))],
        {"duration": (0.6, 0.8)},
        "NodePositions.*along z",
    ),
    "bars": (driven(PRISM), [ocp.NodePositions({0: (0, 0, 0), 4: (5, 5, 5)})], {}, "NodePositions: node . . misses.*bar 0 keeps its length"),
    "lengths": (driven(PRISM), [ocp.StringLengths(0.8 * PRISM.string_lengths)], {}, "StringLengths: string .*bar . keeps its length"),
    "contradiction": (driven(PRISM), [ocp.StringLengths({0: 0.8}), ocp.StringLengths({0: 0.9})], {}, "string 0 .*contradict"),
    "out of the plane": (driven(D_BAR), [ocp.NodePositions({2: (None, None, 0.1), 0: (None, None, 0.1)})], {}, "node . z .*plane of the start"),
    "lengths that leave the plane": (
        driven(tc.shapes.t_bar()),
        [ocp.StringLengths(tc.shapes.t_bar().string_lengths * (0.95, 1.03, 0.95, 1.03))],
        {},
        "StringLengths.*plane of the start",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_unreachable_goals_are_refused_by_name(name):
    model, goals, options, message = REFUSED[name]
    with pytest.raises(ocp.UnreachableGoal, match=message):
        target(model, goals, **options)


def test_a_free_fall_is_accounted_for():
    model = driven(PRISM, gravity=GRAVITY)
    fallen = PRISM.nodes - (0, 0, 9.81 / 8)
    assert target(model, [ocp.NodePositions(fallen)], duration=0.5).count
    with pytest.raises(ocp.UnreachableGoal):
        target(model, [ocp.NodePositions(fallen)], duration=0.4)
    assert target(model, [ocp.NodePositions(fallen)], duration=(0.3, 0.8)).count  # and so is its duration

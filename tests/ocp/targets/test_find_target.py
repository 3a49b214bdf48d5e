"""Which rows of a goal are imposed: what the motion keeps by itself, what a shape needs beyond its string lengths, what is refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from ocp_problems.wide import waypoints
from planning import driven
from scipy.spatial.transform import Rotation

import ocp
import tenscasadi as tc
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target

PRISM = tc.shapes.prism()
BALL = tc.shapes.six_bar_ball()
D_BAR = tc.shapes.d_bar()
GRAVITY = tc.Gravity((0.0, 0.0, -9.81))


def lower(height, twist=None):
    """The prism of another height with the bars of PRISM."""
    chord = 2 * np.sin(
        (np.radians(150) if twist is None else twist) / 2
    )  # of a bar seen from above, for radius 1
    return tc.shapes.prism(
        height=height, radius=np.sqrt(PRISM.bar_lengths[0] ** 2 - height**2) / chord, twist=twist
    )


def target(model, goals, duration=1.0, **options):
    problem = ocp.Problem(model, duration, goals=goals, **options)
    return find_target(problem, Scales.of(problem))


def spun(model, axis=(0, 0, 1.0), drift=(0, 0, 0)):
    nodes = model.structure.nodes
    return model.state(nodes, np.cross(axis, nodes) + drift)


COUNTS = {
    "whole state of a prism": (
        driven(PRISM),
        [ocp.NodePositions(PRISM.nodes), ocp.AtRest()],
        "36 → 21 rows: 6 bar, 9 momentum",
    ),
    "equilibrium lengths": (
        driven(PRISM),
        [ocp.StringLengths(PRISM.string_lengths), ocp.AtRest()],
        "27 → 18 rows: 4 bar, 6 momentum, 1 added for the shape",
    ),
    "lengths twice": (
        driven(PRISM),
        [ocp.StringLengths({0: 0.8}), ocp.StringLengths({0: 0.8})],
        "2 → 1 rows: 1 another",
    ),
    "some lengths": (driven(PRISM), [ocp.StringLengths({6: 0.8, 7: 0.8, 8: 0.8})], "3 → 3 rows"),
    "whole state of a ball": (
        driven(BALL),
        [ocp.NodePositions(BALL.nodes), ocp.AtRest()],
        "72 → 51 rows: 12 bar, 9 momentum",
    ),
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
        assert found.measure(lambda share: found.state).values.max() < 1e-9
        assert model.bar_length_error(found.state) < 1e-12


@pytest.mark.parametrize("twist", [None, np.radians(149.9), np.radians(140), np.radians(100)])
@pytest.mark.parametrize("digits", [16, 4])
def test_lengths_find_their_shape_from_an_equilibrium(twist, digits):
    """The start is singular (lengths say nothing about its flex to first order), and so is the first of these targets."""
    model, wanted = driven(PRISM), lower(0.6, twist)
    found = target(model, [ocp.StringLengths(wanted.string_lengths.round(digits)), ocp.AtRest()])
    nodes = model.nodes(found.state)
    assert np.linalg.norm(
        nodes[PRISM.strings[:, 1]] - nodes[PRISM.strings[:, 0]], axis=1
    ) == pytest.approx(wanted.string_lengths, abs=2e-4)
    assert found.adjusted < (1e-4 if digits == 4 else 1e-9)
    assert found.count == 18
    assert nodes.mean(axis=0) == pytest.approx(PRISM.nodes.mean(axis=0), abs=1e-9)
    if twist is None:  # the way there keeps the symmetry, and turns nothing
        turned = np.cross(PRISM.nodes - PRISM.nodes.mean(axis=0), nodes - nodes.mean(axis=0)).sum(
            axis=0
        )
        assert turned == pytest.approx(np.zeros(3), abs=1e-6)


def test_nodes_inside_strings_stay_on_the_line():
    model = driven(PRISM.replace(string_mass=0.1), segments=3)
    found = target(model, [ocp.StringLengths(lower(0.6).string_lengths)])
    nodes, s = model.nodes(found.state), model.structure
    chords = nodes[PRISM.strings[:, 1]] - nodes[PRISM.strings[:, 0]]
    assert nodes[s.strings[:, 1]] - nodes[s.strings[:, 0]] == pytest.approx(
        np.repeat(chords, 3, axis=0) / 3, abs=1e-6
    )
    assert np.linalg.norm(chords, axis=1) == pytest.approx(lower(0.6).string_lengths, abs=1e-9)


def test_a_clock_runs_to_the_end():
    table = np.zeros((6, 3))
    model = driven(PRISM, forces=tc.NodalForce(lambda t: ca.DM(table) * t))
    found = target(model, [ocp.StringLengths(lower(0.6).string_lengths)], duration=1.5)
    assert found.state[-1] == pytest.approx(1.5)


REFUSED = {
    "center of mass": (
        driven(PRISM),
        [ocp.NodePositions(PRISM.nodes + (0, 0, 1))],
        {},
        "NodePositions.*center of mass.*along z",
    ),
    "fall": (
        driven(PRISM, gravity=GRAVITY),
        [ocp.NodePositions(PRISM.nodes)],
        {},
        "NodePositions.*center of mass follows its path along z",
    ),
    "rest in a fall": (
        driven(PRISM, gravity=GRAVITY),
        [ocp.AtRest()],
        {},
        "AtRest: .* z misses its goal by .* m/s.*keeps its speed along z",
    ),
    "rest of a drift": (
        driven(PRISM),
        [ocp.AtRest()],
        {"start": spun(driven(PRISM), (0, 0, 0), (1, 0, 0))},
        "AtRest.*keeps its speed along x",
    ),
    "rest of a spin": (
        driven(PRISM),
        [ocp.AtRest()],
        {"start": spun(driven(PRISM))},
        r"AtRest.*angular momentum about \(0, 0, 1\)",
    ),
    "too short a fall": (
        driven(PRISM, gravity=GRAVITY),
        [ocp.NodePositions(PRISM.nodes - (0, 0, 9.81 / 8))],
        {"duration": (0.6, 0.8)},
        "NodePositions.*along z",
    ),
    "bars": (
        driven(PRISM),
        [ocp.NodePositions({0: (0, 0, 0), 4: (5, 5, 5)})],
        {},
        "NodePositions: node . . misses.*bar 0 keeps its length",
    ),
    "lengths": (
        driven(PRISM),
        [ocp.StringLengths(0.8 * PRISM.string_lengths)],
        {},
        "StringLengths: string .*bar . keeps its length",
    ),
    "contradiction": (
        driven(PRISM),
        [ocp.StringLengths({0: 0.8}), ocp.StringLengths({0: 0.9})],
        {},
        "string 0 .*contradict",
    ),
    "out of the plane": (
        driven(D_BAR),
        [ocp.NodePositions({2: (None, None, 0.1), 0: (None, None, 0.1)})],
        {},
        "node . z .*plane of the start",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_infeasible_goals_carry_a_certificate(name):
    model, goals, options, message = REFUSED[name]
    with pytest.raises(ocp.InfeasibleGoalError, match=message) as caught:
        target(model, goals, **options)
    certificate = caught.value.certificate
    assert certificate.bound > 0
    assert any(certificate.multipliers.values())


def test_a_free_fall_is_accounted_for():
    model = driven(PRISM, gravity=GRAVITY)
    fallen = PRISM.nodes - (0, 0, 9.81 / 8)
    assert target(model, [ocp.NodePositions(fallen)], duration=0.5).count
    with pytest.raises(ocp.InfeasibleGoalError):
        target(model, [ocp.NodePositions(fallen)], duration=0.4)
    assert target(
        model, [ocp.NodePositions(fallen)], duration=(0.3, 0.8)
    ).count  # and so is its duration


def test_a_target_near_a_motion_has_the_rows_of_its_end():
    """A bar on a hinge comes to rest at half its height, wherever. Rows that leave out what the bar keeps on one side let it move on another."""
    structure = tc.Structure(
        [(0, 0, 0), (0.6, 0, 0.8), (0, 0, -1), (0, 1, -1)],
        [(0, 1)],
        [(1, 2), (1, 3)],
        pinned=[0, 2, 3],
    )
    problem = ocp.Problem(
        driven(structure), 1.0, goals=[ocp.NodePositions({1: (None, None, 0.5)}), ocp.AtRest()]
    )
    around = np.arccos(-1 / 3)
    tip = np.array(
        [np.sqrt(0.75) * np.cos(around), np.sqrt(0.75) * np.sin(around), 0.5]
    )  # across the bar of the target
    first = find_target(problem, Scales.of(problem))
    assert problem.model.nodes(first.state)[1] == pytest.approx([np.sqrt(0.75), 0, 0.5], abs=1e-6)
    moving = problem.model.state(
        [(0, 0, 0), tip, *structure.nodes[2:]],
        [(0, 0, 0), (np.sqrt(0.75), 0, 0.5), (0, 0, 0), (0, 0, 0)],
    )
    assert first.rows(moving).full() == pytest.approx(0, abs=1e-6)
    near = find_target(problem, Scales.of(problem), lambda share: moving)
    assert near.count == first.count
    assert problem.model.nodes(near.state)[1] == pytest.approx(tip, abs=0.1)
    assert np.abs(near.rows(moving).full()).max() > 0.1


def test_supports_at_rest_at_the_end_add_no_rows():
    """Only second order tells the clock there, and it changes no distance."""
    nodes = [(0, 0, 0), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]
    hanging = tc.Structure(
        nodes, [(0, 1)], [(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5]
    )
    moves = {k: lambda t, p=nodes[k]: (p[0], p[1], 0.8 * t * t * (1 - t) * (1 - t)) for k in (2, 3)}
    scene = tc.Scene(hanging, control=tc.ForceDensity(), supports=tc.SupportMotion(moves))
    goals = [ocp.StringLengths(hanging.string_lengths), ocp.AtRest()]
    problem = ocp.Problem(tc.Model(scene), 1.0, goals=goals)
    target = find_target(problem, Scales.of(problem))
    assert (target.count, target.shape) == (4, 0)


def test_certificate_is_a_positive_combination_of_all_rows():
    """At any state the rows, each times its multiplier, sum up to the bound at least."""
    model = driven(PRISM)
    lengths = 0.8 * PRISM.string_lengths
    with pytest.raises(ocp.InfeasibleGoalError) as caught:
        target(model, [ocp.StringLengths(lengths)])
    weights = caught.value.certificate.multipliers
    size = float(np.linalg.norm(np.ptp(PRISM.nodes, axis=0)))
    rng = np.random.default_rng(0)
    for spread in (0.0, 0.1, 1.0, 10.0):
        nodes = PRISM.nodes + spread * rng.normal(size=(6, 3))
        total = 0.0
        for pairs, wanted, name in (
            (PRISM.strings, lengths, "StringLengths: string {}"),
            (PRISM.bars, PRISM.bar_lengths, "bar {} keeps its length"),
        ):
            squared = ((nodes[pairs[:, 1]] - nodes[pairs[:, 0]]) ** 2).sum(axis=1)
            scale = np.maximum(wanted, wanted.mean())
            rows = (squared - wanted**2) / (2 * scale * size)
            total += sum(weights[name.format(k)] * row for k, row in enumerate(rows))
        assert total >= caught.value.certificate.bound * (1 - 1e-6)


def test_goals_without_a_proof_are_tried_with_a_warning():
    """Lengths that no state was found to meet, and no combination of rows excludes."""
    lengths = tc.shapes.t_bar().string_lengths * (0.95, 1.03, 0.95, 1.2)
    with pytest.warns(ocp.TargetNotFoundWarning, match="StringLengths"):
        found = target(driven(tc.shapes.t_bar()), [ocp.StringLengths(lengths)])
    assert not found.met
    assert "no target state was found" in found.describe()


@pytest.mark.parametrize("angle", [1.0, 2.5, 3.1])
def test_large_turns_are_found(angle):
    model = driven(PRISM)
    c, s = np.cos(angle), np.sin(angle)
    center = PRISM.nodes.mean(axis=0)
    turned = (PRISM.nodes - center) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + center
    start = spun(model, (0, 0, angle))
    found = target(model, [ocp.NodePositions(turned)], start=start)
    assert found.met
    assert model.nodes(found.state) == pytest.approx(turned, abs=1e-6)


def test_free_durations_are_searched():
    """Feet go aside and come back after one second."""
    prism = tc.shapes.prism(pinned=[0, 1, 2])
    moves = {
        k: lambda t, p=prism.nodes[k]: (p[0] + 0.1 * ca.sin(np.pi * t) ** 2, p[1], p[2])
        for k in range(3)
    }
    model = driven(prism, supports=tc.SupportMotion(moves))
    goals = [ocp.NodePositions({k: tuple(prism.nodes[k]) for k in range(3, 6)}), ocp.AtRest()]
    found = target(model, goals, duration=(0.4, 1.7))
    assert found.met
    assert found.state[-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("masses", [(1e-3, 1.0, 1e3), (1e3, 1e-2, 1e-3), (1e-3, 1e3, 1e-3)])
def test_goals_of_bars_with_masses_far_apart_are_met(masses):
    structure = tc.shapes.prism(3, 0.5, 1.0).replace(bar_mass=masses)
    model = driven(structure)
    run = tc.simulate(
        model,
        0.5,
        5e-4,
        control=np.linspace(40.0, 200.0, 9),
        correction=tc.Projection(),
        compiled=False,
    )
    places = ocp.NodePositions({k: tuple(run.nodes[-1][k]) for k in (0, 3, 4)})
    problem = ocp.Problem(model, 0.5, goals=[places])
    target = find_target(problem, Scales.of(problem))
    assert target.met
    assert model.nodes(target.state)[[0, 3, 4]] == pytest.approx(run.nodes[-1][[0, 3, 4]], abs=3e-4)


def test_random_starts_reach_far_shapes():
    """From the start alone, the search ends 7 cm off lengths that a simulated motion reaches."""
    problem = waypoints(42)
    assert find_target(problem, Scales.of(problem)).met


def sized(structure, **options):
    """The structure with a bounding box of diagonal 1 m."""
    size = np.linalg.norm(np.ptp(structure.nodes, axis=0))
    return tc.Structure(structure.nodes / size, structure.bars, structure.strings, **options)


NET = tc.Structure(PRISM.nodes, [], PRISM.strings, node_mass=1.0)
ROUNDED = {
    "prism": driven(sized(PRISM)),
    "falling prism": driven(sized(PRISM), gravity=GRAVITY),
    "standing prism": driven(sized(PRISM, pinned=[0, 1, 2])),
    "D-bar": driven(sized(D_BAR, pinned=[0])),
    "T-bar": driven(sized(tc.shapes.t_bar(0.8, 0.6))),
    "ball": driven(sized(BALL)),
    "net": driven(sized(NET, pinned=[0, 1, 2], node_mass=1.0)),
}


def lengths_of(nodes, pairs):
    return np.linalg.norm(nodes[pairs[:, 1]] - nodes[pairs[:, 0]], axis=1).round(2)


def orientation(nodes, start):
    """The rotation vector of the first three nodes, to two decimals."""
    frames = []
    for at in (nodes, start):
        edge, other = at[1] - at[0], at[2] - at[0]
        first, normal = edge / np.linalg.norm(edge), np.cross(edge, other)
        normal = normal / np.linalg.norm(normal)
        frames.append(np.column_stack([first, np.cross(normal, first), normal]))
    return Rotation.from_matrix(frames[0] @ frames[1].T).as_rotvec().round(2)


ROUNDED_GOALS = {
    "all nodes": lambda s, nodes, v: [ocp.NodePositions(nodes.round(2))],
    "some nodes": lambda s, nodes, v: [ocp.NodePositions({k: nodes[k].round(2) for k in (3, 1)})],
    "state": lambda s, nodes, v: [
        ocp.NodePositions(nodes.round(2)),
        ocp.NodeVelocities(np.where(s.fixed, 0.0, v.round(2))),
    ],
    "lengths": lambda s, nodes, v: [ocp.StringLengths(lengths_of(nodes, s.strings))],
    "shape": lambda s, nodes, v: [ocp.Shape(np.where(s.fixed, nodes, nodes.round(2)))],
    "center": lambda s, nodes, v: [ocp.CenterOfMass(nodes.mean(axis=0).round(2), s.node_mass + 1)],
    "orientation": lambda s, nodes, v: [
        ocp.NodeTripleOrientation((0, 1, 2), orientation(nodes, s.nodes))
    ],
    "bars": lambda s, nodes, v: [
        ocp.BarOrientation(k, (nodes[b] - nodes[a]).round(2))
        for k, (a, b) in enumerate(s.bars.tolist())
    ],
}


@pytest.mark.parametrize("goal", ROUNDED_GOALS)
@pytest.mark.parametrize("name", ROUNDED)
def test_goals_rounded_to_two_decimals_are_met(name, goal):
    """Goals of states that simulated motions reach, rounded: bars and momenta contradict most of them by millimeters."""
    model = ROUNDED[name]
    structure = model.scene.structure
    correction = tc.Projection() if len(structure.bars) else None
    options = {"correction": correction, "compiled": False, "verify": False}
    for seed in range(2):
        rng = np.random.default_rng(seed)
        control = rng.uniform(2.0, 15.0, model.nu)
        run = tc.simulate(model, 0.3, 2e-3, control=control, **options)
        goals = ROUNDED_GOALS[goal](structure, run.nodes[-1], run.velocities[-1])
        if not goals:
            continue
        found = target(model, goals, duration=0.3)
        assert found.met
        assert found.measure(lambda share, found=found: found.state).distances(0.3).max() <= 0.01
        assert found.adjusted == pytest.approx(
            found.measure(lambda share, found=found: found.state).distances(0.3).max(), abs=1e-6
        )


@pytest.mark.parametrize("tolerance", [1e-3, 1e-2])
@pytest.mark.parametrize("share", [0.9, 1.2])
def test_goals_are_refused_beyond_the_tolerance(tolerance, share):
    """Ends of a bar of 1 m, farther apart than its length: the nearest state misses each goal by half of the difference."""
    bar = tc.Structure([(0, 0, 0), (1, 0, 0), (0.5, 1, 0)], [(0, 1)], [(0, 2), (1, 2)], node_mass=1)
    size = np.sqrt(2)
    off = share * tolerance * size
    goal = ocp.NodePositions({0: (-off, 0, 0), 1: (1 + off, 0, 0)})
    problem = ocp.Problem(driven(bar), goals=[goal])
    options = {"scales": Scales.of(problem), "tolerance": tolerance}
    if share < 1:
        found = find_target(problem, **options)
        assert found.met
        assert found.adjusted == pytest.approx(off, rel=1e-3)
        assert f"goals are met up to {off:.1e} m" in found.describe()
    else:
        with pytest.raises(ocp.InfeasibleGoalError, match="bar 0 keeps its length"):
            find_target(problem, **options)

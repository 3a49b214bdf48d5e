"""Equilibria against analytic results, damped simulations, and input without an equilibrium."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tenscasadi as tc

GRAVITY = tc.Gravity((0, 0, -10))


def unbalanced(eq: tc.Equilibrium) -> float:
    """Largest force on a node, of strings, bars, weights, nodal forces, supports and grounds."""
    s, scene = eq.structure, eq.scene
    total = np.array(eq.reactions)
    for pairs, density in (
        (s.strings, eq.force_density),
        (s.bars, eq.bar_force / np.linalg.norm(np.diff(eq.nodes[s.bars], axis=1)[:, 0], axis=1)),
    ):
        pull = density[:, None] * (eq.nodes[pairs[:, 1]] - eq.nodes[pairs[:, 0]])
        np.add.at(total, pairs[:, 0], pull)
        np.add.at(total, pairs[:, 1], -pull)
    if scene.gravity is not None:
        total += np.outer(scene.modelled.mass_matrix().sum(axis=1), scene.gravity.acceleration)
    if scene.forces is not None:
        total += scene.forces.values
    return float(np.abs(total).max())


def prism(**options: object) -> tc.Structure:
    """A prestressed prism on a triangle that is pinned."""
    return tc.shapes.prism(**{"prestress": 30.0, "stiffness": 1e3, "pinned": [0, 1, 2], **options})


def test_weight_on_one_string():
    rope = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=2.0)
    eq = tc.find_equilibrium(tc.Scene(rope, gravity=GRAVITY))
    assert eq.success
    assert eq.stable
    np.testing.assert_allclose(eq.nodes[1], [0, 0, -1.2], atol=1e-12)
    np.testing.assert_allclose(eq.tension, 20.0, rtol=1e-12)
    np.testing.assert_allclose(eq.force_density, 20.0 / 1.2, rtol=1e-12)
    # the pin carries the masses of both nodes
    np.testing.assert_allclose(eq.reactions, [(0, 0, 40.0), (0, 0, 0)], atol=1e-10)


def test_start_is_kept_where_it_is_in_equilibrium():
    s = tc.shapes.prism(prestress=10.0)
    eq = tc.find_equilibrium(s and tc.Scene(s))
    assert eq.success
    assert eq.stable
    assert eq.iterations == 0
    np.testing.assert_allclose(eq.nodes, s.nodes, atol=1e-14)
    np.testing.assert_allclose(eq.bar_force, -np.sqrt(3) * 10 * s.bar_lengths, rtol=1e-12)


@pytest.mark.parametrize(
    "structure",
    [
        prism(),
        prism(bar_stiffness=2e4),
        prism(bar_stiffness=[2e4, np.inf, 1e4]),
        prism(pinned={0: "xyz", 1: "z", 2: "z"}, rollers={4: (1, 0, 2)}),
    ],
    ids=["rigid", "elastic", "both", "rollers"],
)
def test_forces_balance_on_every_node(structure):
    load = tc.NodalForce(np.linspace(-3, 3, 18).reshape(6, 3))
    eq = tc.find_equilibrium(tc.Scene(structure, gravity=GRAVITY, forces=load))
    assert eq.success, eq.message
    assert eq.residual < 1e-9
    assert unbalanced(eq) < 1e-9
    s = eq.structure
    rigid = ~s.elastic
    lengths = np.linalg.norm(np.diff(eq.nodes[s.bars], axis=1)[:, 0], axis=1)
    np.testing.assert_allclose(lengths[rigid], structure.bar_lengths[rigid], rtol=1e-12)
    k = s.bar_stiffness[s.elastic]
    np.testing.assert_allclose(
        eq.bar_force[s.elastic], k * (lengths - s.bar_rest_length)[s.elastic], rtol=1e-8
    )
    np.testing.assert_array_equal(s.rest_length, structure.rest_length)
    free = np.delete(eq.reactions, [*structure.pinned, *structure.rollers], axis=0)
    assert not free.any()


def test_slack_strings_carry_nothing():
    net = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0), (0, 0, 1)],
        strings=[(0, 1), (1, 2), (1, 3)],
        pinned=[0, 2, 3],
        node_mass=1.0,
        rest_length=[0.9, 0.9, 2.0],
    )
    eq = tc.find_equilibrium(tc.Scene(net, gravity=GRAVITY))
    assert eq.success
    assert eq.tension[2] == 0.0
    sag, k, rho = -eq.nodes[1, 2], 100.0, 0.9
    length = np.hypot(1, sag)
    np.testing.assert_allclose(2 * k * (length - rho) * sag / length, 10.0, rtol=1e-10)


def test_slack_net_falls_until_it_is_taut():
    """A chain of strings 20 % longer than the distance of its ends hangs as a catenary polygon."""
    count = 12
    nodes = np.column_stack([np.linspace(0, 1, count + 1), np.zeros((count + 1, 2))])
    chain = tc.Structure(
        nodes,
        strings=[(i, i + 1) for i in range(count)],
        pinned=[0, count],
        node_mass=0.1,
        stiffness=1e6,
        rest_length=1.2 / count,
    )
    eq = tc.find_equilibrium(tc.Scene(chain, gravity=GRAVITY))
    assert eq.success, eq.message
    pull = eq.force_density[:, None] * np.diff(eq.nodes, axis=0)
    np.testing.assert_allclose(pull[:, 0], pull[0, 0], rtol=1e-8)  # constant horizontal force
    np.testing.assert_allclose(np.diff(pull[:, 2]), 1.0, rtol=1e-6)  # the weight of each node


@pytest.mark.parametrize("angle", [0.0, 3.0, np.pi])
def test_pendulum_hangs_down_from_every_start(angle):
    """Upright it is in equilibrium, too, but at a saddle of the energy."""
    scene = tc.Scene(tc.shapes.pendulum(angle=angle), gravity=GRAVITY)
    eq = tc.find_equilibrium(scene)
    assert eq.success
    assert eq.stable
    np.testing.assert_allclose(eq.nodes[1], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(eq.bar_force, 5.0, rtol=1e-12)  # tension


def test_column_under_compression_leaves_its_straight_saddle():
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0)],
        bars=[(0, 1), (1, 2)],
        strings=[(1, 3), (1, 4)],
        stiffness=50.0,
        rest_length=0.5,
        pinned={0: "xyz", 1: "z", 2: "yz", 3: "xyz", 4: "xyz"},
    )
    for force, straight in ((49.0, True), (49.9, True)):
        load = tc.NodalForce([(0, 0, 0), (0, 0, 0), (-force, 0, 0), (0, 0, 0), (0, 0, 0)])
        eq = tc.find_equilibrium(tc.Scene(s, forces=load))
        assert eq.success
        assert (abs(eq.nodes[1, 1]) < 1e-6) == straight
    load = tc.NodalForce([(0, 0, 0), (0, 0, 0), (-51.0, 0, 0), (0, 0, 0), (0, 0, 0)])
    eq = tc.find_equilibrium(tc.Scene(s, forces=load))
    assert eq.success
    assert eq.nodes[1, 0] < 0.5  # it snaps through


def test_flat_dbar_folds_until_its_strings_are_slack():
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
        bars=[(0, 1), (1, 2), (2, 3), (3, 0)],
        strings=[(0, 2), (1, 3)],
        pinned=[0],
        stiffness=100.0,
        rest_length=[0.5, 1.0],
    )
    eq = tc.find_equilibrium(tc.Scene(s))  # flat, it is in equilibrium at a saddle of the energy
    assert eq.success, eq.message
    assert eq.residual < 1e-9
    assert not eq.stable
    np.testing.assert_array_equal(eq.tension, 0.0)


@pytest.mark.parametrize("control", [tc.RestLength(), tc.ForceDensity()])
def test_control_and_parameters(control):
    s = prism()
    scene = tc.Scene(s, control=control, gravity=GRAVITY, parameters=tc.Parameters("bar_mass"))
    eq = tc.find_equilibrium(scene)
    base = eq.control
    changed = tc.find_equilibrium(scene, control=0.97 * base, parameters={"bar_mass": 2.0})
    assert changed.success
    np.testing.assert_array_equal(changed.control, 0.97 * base)
    np.testing.assert_array_equal(changed.parameters, 2.0)
    fixed = s.replace(bar_mass=2.0)
    if isinstance(control, tc.RestLength):
        fixed = fixed.replace(rest_length=0.97 * base)
        np.testing.assert_allclose(changed.structure.rest_length, 0.97 * base, rtol=1e-15)
        other = tc.find_equilibrium(tc.Scene(fixed, gravity=GRAVITY))
        np.testing.assert_allclose(changed.nodes, other.nodes, atol=1e-10)
    else:
        np.testing.assert_allclose(changed.force_density, 0.97 * base, rtol=1e-14)


def test_segments_sag():
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], pinned=[0, 1], string_mass=0.5, stiffness=1e3
    )
    eq = tc.find_equilibrium(tc.Scene(s, segments=4, gravity=GRAVITY))
    assert eq.success
    assert eq.nodes.shape == (5, 3)
    assert eq.nodes[:, 2].min() < -0.01
    assert len(eq.tension) == 4


def test_pressure_inflates_a_pinned_membrane():
    p, q = 8, 5
    s = tc.shapes.membrane(p, q, pinned=[*range(p), *range(p * (q - 1), p * q)])
    scene = tc.Scene(s, pressure=tc.Pressure(tc.shapes.membrane_faces(p, q), 20.0))
    eq = tc.find_equilibrium(scene)
    assert eq.success, eq.message
    assert eq.stable
    middle = eq.nodes[2 * p : 3 * p]
    radius = np.hypot(middle[:, 0], middle[:, 1])
    np.testing.assert_allclose(radius, radius[0], rtol=1e-9)
    assert radius[0] > 1.05


def test_pressure_without_an_energy_balances():
    """The free edges of an open membrane give its pressure no energy."""
    s = tc.shapes.membrane(8, 6)
    scene = tc.Scene(s, pressure=tc.Pressure(tc.shapes.membrane_faces(8, 6), 3.0))
    eq = tc.find_equilibrium(scene)
    assert eq.success, eq.message
    assert eq.residual < 1e-9
    assert eq.stable
    assert tc.stability(eq).stable


def test_saddle_beside_a_load_without_energy_is_no_success():
    """A column buckles at 50 N; the free edges of a face give its pressure no energy."""
    column = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0), (1, -1, 0)]
    corners = [(5, 0, 0), (6, 0, 0), (5.5, 1, 0)]
    outside = [(4, -1, 0), (7, -1, 0), (5.5, 2, 0)]
    sides = [(5, 6), (6, 7), (7, 5), (5, 8), (6, 9), (7, 10)]
    s = tc.Structure(
        [*column, *corners, *outside],
        bars=[(0, 1), (1, 2)],
        strings=[(1, 3), (1, 4), *sides],
        stiffness=50.0,
        rest_length=0.5,
        node_mass=1.0,
        pinned={0: "xyz", 1: "z", 2: "yz", **dict.fromkeys((3, 4, 8, 9, 10), "xyz")},
    )
    for force, stable in ((49.0, True), (51.0, False)):
        load = np.zeros((11, 3))
        load[2, 0] = -force
        pressure = tc.Pressure([[5, 6, 7]], 1.0)
        eq = tc.find_equilibrium(tc.Scene(s, forces=tc.NodalForce(load), pressure=pressure))
        assert eq.success == eq.stable == stable
        assert stable or "unstable" in eq.message


def test_structure_stands_on_the_ground():
    s = tc.shapes.prism(prestress=30.0)
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY, ground=tc.Ground(stiffness=1e4)))
    assert eq.success
    assert eq.stable
    np.testing.assert_allclose(eq.reactions.sum(axis=0), [0, 0, 30.0], atol=1e-8)
    np.testing.assert_allclose(eq.nodes[:3, 2], -10.0 / 1e4, rtol=1e-6)  # 10 N each
    assert eq.reactions[:, 2].min() >= 0.0


def test_structure_falls_to_the_ground():
    s = tc.shapes.six_bar_ball(prestress=30.0)
    ground = tc.Ground(height=-2.0)
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY, ground=ground))
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.reactions[:, 2].sum(), 60.0, rtol=1e-8)


@pytest.mark.parametrize(("degrees", "holds"), [(10.0, True), (26.0, True), (28.0, False)])
def test_friction_holds_on_slopes_below_its_angle(degrees, holds):
    """tan 26.57° = 0.5 is the coefficient of friction."""
    tilt = np.deg2rad(degrees)
    gravity = tc.Gravity((9.81 * np.sin(tilt), 0, -9.81 * np.cos(tilt)))
    s = tc.shapes.prism(prestress=100.0, stiffness=1e4)
    eq = tc.find_equilibrium(tc.Scene(s, gravity=gravity, ground=tc.Ground(friction=0.5)))
    assert eq.success == holds, eq.message
    if holds:
        along, normal = np.linalg.norm(eq.reactions[:3, :2], axis=1), eq.reactions[:3, 2]
        assert np.all(along <= 0.5 * normal * (1 + 1e-9))
        np.testing.assert_allclose(
            eq.reactions.sum(axis=0), -3.0 * np.array(gravity.acceleration), atol=1e-7
        )
        assert np.abs(eq.nodes[:3, :2] - s.nodes[:3, :2]).max() < 0.05
    else:
        assert "net load" in eq.message


@pytest.mark.parametrize(("degrees", "holds"), [(60.0, True), (46.0, True), (44.0, False)])
def test_ladder_stands_above_its_least_angle(degrees, holds):
    """On a floor of friction μ, against a smooth wall: tan θ ≥ 1/(2 μ) = 1."""
    tilt = np.deg2rad(degrees)
    foot, top = (2 * np.cos(tilt), 0, 0), (0, 0, 2 * np.sin(tilt))
    s = tc.Structure([foot, top], [(0, 1)], pinned={0: "y", 1: "y"})
    floor = tc.Ground(stiffness=1e6, friction=0.5, nodes=[0])
    wall = tc.Ground(stiffness=1e6, normal=(1, 0, 0), nodes=[1])
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY, ground=[floor, wall]))
    stands = bool(eq.success and eq.nodes[1, 2] > 1.0)
    assert stands == holds
    if holds:
        push = 10.0 / (2 * np.tan(tilt))
        np.testing.assert_allclose(eq.reactions[0], [-push, 0, 10.0], rtol=1e-3, atol=1e-9)


def test_moved_supports_are_where_the_clock_has_them():
    s = tc.Structure(
        [(-1, 0, 1), (0, 0, 0), (1, 0, 1)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0
    )
    supports = tc.SupportMotion({0: lambda t: (-1 - t, 0, 1)})
    scene = tc.Scene(s, gravity=GRAVITY, supports=supports)
    model = tc.Model(scene)
    state = np.array(model.initial_state)
    state[-1] = 0.5
    eq = tc.find_equilibrium(model, start=state)
    assert eq.success
    assert eq.time == 0.5
    np.testing.assert_allclose(eq.nodes[0], [-1.5, 0, 1])
    still = s.replace(nodes=[(-1.5, 0, 1), (0, 0, 0), (1, 0, 1)])
    np.testing.assert_allclose(
        eq.nodes, tc.find_equilibrium(tc.Scene(still, gravity=GRAVITY)).nodes, atol=1e-10
    )
    assert eq.state[-1] == 0.5


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_other_functions_take_an_equilibrium(coordinates):
    scene = tc.Scene(prism(), gravity=GRAVITY, control=tc.RestLength())
    model = tc.Model(scene, coordinates=coordinates)
    eq = tc.find_equilibrium(model, control=0.98 * scene.structure.rest_length)
    assert eq.model is model
    assert eq.state.shape == (model.nx,)
    run = tc.simulate(model, 0.05, 1e-3, state=eq, compiled=False)
    np.testing.assert_allclose(run.nodes[-1], eq.nodes, atol=1e-9)
    assert np.abs(tc.linearize(eq).residual).max() < 1e-8
    np.testing.assert_allclose(
        tc.modes(eq).frequency, tc.modes(model, eq.state, eq.control).frequency, rtol=1e-9
    )
    again = tc.find_equilibrium(model, start=eq)
    assert again.iterations == 0
    np.testing.assert_array_equal(again.control, eq.control)


def test_a_scene_and_its_model_agree():
    scene = tc.Scene(prism(), gravity=GRAVITY)
    one, other = tc.find_equilibrium(scene), tc.find_equilibrium(tc.Model(scene))
    np.testing.assert_array_equal(one.nodes, other.nodes)
    np.testing.assert_allclose(one.model.nodes(one.state), one.nodes, atol=1e-15)


def test_equilibria_are_frozen_and_copied():
    eq = tc.find_equilibrium(tc.Scene(prism(), gravity=GRAVITY))
    again = pickle.loads(pickle.dumps(eq))  # noqa: S301  own data
    np.testing.assert_array_equal(again.nodes, eq.nodes)
    with pytest.raises(ValueError, match="read-only"):
        eq.nodes[0] = 1.0
    assert "in equilibrium" in repr(eq)


@pytest.mark.parametrize("elastic", [False, True])
def test_a_damped_simulation_ends_there(elastic):
    """To 1e-8 m, also with slack strings."""
    one = tc.shapes.prism(stiffness=1e3)
    strings = [*one.strings.tolist(), (0, 5), (1, 3), (2, 4)]  # no mechanism is left
    s = tc.Structure(one.nodes, one.bars, strings, stiffness=1e3, damping=30.0,
                     bar_stiffness=2e3 if elastic else None, pinned=[0, 1, 2])  # fmt: skip
    s = s.replace(rest_length=0.97 * s.string_lengths)
    load = np.zeros((6, 3))
    load[3] = (10, 5, -20)
    scene = tc.Scene(s, gravity=GRAVITY, forces=tc.NodalForce(load))
    eq = tc.find_equilibrium(scene)
    assert eq.success
    run = tc.simulate(
        tc.Model(scene), 20.0, 2e-3, correction=tc.Projection(), verify=False, energy_balance=False
    )
    assert run.success, run.message
    np.testing.assert_allclose(run.nodes[-1], eq.nodes, atol=1e-8)
    np.testing.assert_allclose(run.tension[-1], eq.tension, atol=1e-4)


# --- nothing to be found ---


def test_free_structure_under_gravity_falls():
    eq = tc.find_equilibrium(tc.Scene(tc.shapes.prism(prestress=10.0), gravity=GRAVITY))
    assert not eq.success
    assert not eq.stable
    assert "moves away" in eq.message
    assert "-30" in eq.message
    assert np.isfinite(eq.nodes).all()


@pytest.mark.parametrize("joint_class", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_tall_tower_without_prestress_ends_hanging(joint_class):
    tower = tc.shapes.prism_tower(10, joint_class=joint_class, pinned=[0, 1, 2])
    eq = tc.find_equilibrium(tc.Scene(tower, gravity=GRAVITY))
    assert eq.success, eq.message
    assert eq.nodes[:, 2].mean() < 0.0
    weight = 10.0 * tower.bar_mass.sum()
    assert eq.reactions[:, 2].sum() == pytest.approx(weight, rel=1e-9)


def test_straight_rigid_bars_carry_no_load_across():
    """The bar forces would be infinite: elastic bars are the cure."""
    nodes = [(-1, 0, 0), (0, 0, 0), (1, 0, 0)]
    line = tc.Structure(nodes, bars=[(0, 1), (1, 2)], strings=[(0, 1)], pinned=[0, 2])
    eq = tc.find_equilibrium(tc.Scene(line, gravity=GRAVITY))
    assert not eq.success
    assert "bar_stiffness" in eq.message
    elastic = tc.find_equilibrium(tc.Scene(line.replace(bar_stiffness=1e5), gravity=GRAVITY))
    assert elastic.success, elastic.message
    assert elastic.nodes[1, 2] < -1e-3


def test_disconnected_part_falls():
    two = tc.shapes.prism(prestress=10.0)
    nodes = np.vstack([two.nodes, two.nodes + (3, 0, 0)])
    s = tc.Structure(
        nodes,
        np.vstack([two.bars, two.bars + 6]),
        np.vstack([two.strings, two.strings + 6]),
        rest_length=np.tile(two.rest_length, 2),
        pinned=[0, 1, 2],
    )
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY))
    assert not eq.success
    assert "no equilibrium" in eq.message


def test_supports_that_tear_a_bar_are_reported():
    s = tc.Structure([(0, 0, 0), (1, 0, 0)], [(0, 1)], pinned=[0, 1])
    scene = tc.Scene(s, supports=tc.SupportMotion({1: lambda t: (1 + t, 0, 0)}))
    model = tc.Model(scene, coordinates="reduced")
    state = np.array(model.initial_state)
    state[-1] = 1.0
    eq = tc.find_equilibrium(model, start=state)
    assert not eq.success
    assert "rigid bars do not fit" in eq.message


def test_everything_pinned_is_in_equilibrium():
    s = tc.shapes.prism(prestress=10.0, pinned=range(6))
    eq = tc.find_equilibrium(tc.Scene(s, gravity=GRAVITY))
    assert eq.success
    assert eq.stable
    np.testing.assert_array_equal(eq.nodes, s.nodes)


def test_redundant_bars_are_balanced():
    """A planar truss with one bar too many: forces by least squares."""
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
        bars=[(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)],
        pinned={0: "xyz", 1: "yz", 2: "z", 3: "z"},
    )
    load = tc.NodalForce([(0, 0, 0), (0, 0, 0), (5, 0, 0), (0, 0, 0)])
    eq = tc.find_equilibrium(tc.Scene(s, forces=load))
    assert eq.success
    assert unbalanced(eq) < 1e-9


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"scene": 3}, TypeError, "scene"),
        ({"start": np.zeros((5, 3))}, ValueError, "start"),
        ({"start": np.full((6, 3), np.nan)}, ValueError, "start"),
        ({"start": np.zeros(7)}, ValueError, "start"),
        ({"start": np.ones((6, 3))}, ValueError, r"start\[0, 0\] moves a pinned coordinate"),
        ({"control": [1.0]}, ValueError, "control"),
        ({"parameters": {"stiffness": 1.0}}, ValueError, "stiffness"),
    ],
)
def test_wrong_arguments_are_rejected_by_name(arguments, error, text):
    scene = tc.Scene(prism(), gravity=GRAVITY)
    with pytest.raises(error, match=text):
        tc.find_equilibrium(**{"scene": scene, **arguments})


def test_start_off_its_roller_is_rejected():
    s = prism(pinned=(), rollers={0: (1, 0, 1)})
    with pytest.raises(ValueError, match="off its roller"):
        tc.find_equilibrium(tc.Scene(s), start=s.nodes + (1, 0, 0))


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(
    seed=st.integers(0, 10**6),
    pins=st.integers(0, 4),
    stiffness=st.sampled_from([0.0, 1.0, 1e3, 1e7]),
    elastic=st.booleans(),
    weight=st.sampled_from([0.0, 1.0, 1e3]),
)
def test_random_structures_are_solved_or_refused(seed, pins, stiffness, elastic, weight):
    """Never NaN, and where success is reported, forces balance."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 9))
    pairs = [(i, j) for i in range(n) for j in range(i)]
    rng.shuffle(pairs)
    bars = pairs[: int(rng.integers(0, 4))]
    s = tc.Structure(
        rng.normal(size=(n, 3)),
        bars,
        pairs[len(bars) : len(bars) + int(rng.integers(2, 12))],
        node_mass=0.1,
        stiffness=stiffness,
        bar_stiffness=1e4 if elastic else None,
        pinned=range(pins),
    )
    scene = tc.Scene(s, gravity=tc.Gravity((0, 0, -weight)))
    eq = tc.find_equilibrium(scene)
    for values in (eq.nodes, eq.tension, eq.bar_force, eq.reactions, eq.residual):
        assert np.isfinite(values).all()
    assert eq.message
    if eq.success:
        largest = max(np.abs(eq.tension).max(initial=0), np.abs(eq.bar_force).max(initial=0))
        assert eq.residual <= 1e-9 * max(largest, weight) + 1e-9 * stiffness

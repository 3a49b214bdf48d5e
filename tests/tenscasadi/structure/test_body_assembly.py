"""Bodies as basic nodes, massless bars and a mass matrix."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import tenscasadi as tc

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0.0)])


def with_body(nodes, *given, **options) -> tc.Structure:
    """A structure whose nodes are all held by one body."""
    return tc.Structure(nodes, bodies=[tc.RigidBody(range(len(nodes)), *given)], **options)


def energy(structure: tc.Structure, drift, spin) -> float:
    """Kinetic energy of a rigid motion, by the model."""
    model = tc.Model(tc.Scene(structure))
    speeds = np.asarray(drift) + np.cross(spin, structure.nodes)
    return float(model.energy(model.state(structure.nodes, speeds)).kinetic)


@pytest.mark.parametrize("nodes", [CUBE, CUBE[:4], SQUARE, SQUARE[:3]], ids=len)
def test_kinetic_energy_is_that_of_the_body(nodes):
    m, c, inertia = 2.0, np.array([0.2, 0.3, 0.4]), np.diag([0.3, 0.4, 0.5])
    rng = np.random.default_rng(0)
    s = with_body(np.vstack([nodes, nodes[0] + [0.1, 0.2, 0.0]]), m, c, inertia)
    for _ in range(3):
        drift, spin = rng.normal(size=(2, 3))
        v = drift + np.cross(spin, c)
        exact = 0.5 * m * v @ v + 0.5 * spin @ inertia @ spin
        assert energy(s, drift, spin) == pytest.approx(exact, rel=1e-12)


def test_users_see_the_nodes_and_bars_that_they_gave():
    s = with_body(SQUARE, 1.0, None, (1.0, 1.0, 1.0))
    model = tc.Model(tc.Scene(s))
    assert s.nodes.shape == (4, 3)
    assert len(s.bars) == len(s.bar_mass) == 0
    np.testing.assert_allclose(model.nodes(model.initial_state), SQUARE)
    assert model.multipliers(model.initial_state).bar_force_density.shape == (0,)
    assert tc.simulate(model, 0.1, 0.01).nodes.shape == (11, 4, 3)
    assert repr(s) == "Structure(4 nodes, 0 bars, 0 strings, 0 pinned, 1 body)"


def test_cube_has_four_basic_nodes():
    mechanism = tc.Model(tc.Scene(with_body(CUBE, 1.0))).mechanism
    assert len(mechanism.free_index) == 12
    assert mechanism.bars == 6
    assert np.linalg.cond(mechanism.free_mass.toarray()) < 100


def test_dependent_nodes_stay_affine_combinations():
    model = tc.Model(tc.Scene(with_body(CUBE, 1.0)))
    state = model.state(CUBE, np.cross((1, 2, 3), CUBE))
    run = tc.simulate(model, 0.5, 1e-2, state=state)
    apart = np.linalg.norm(run.nodes[:, :, None] - run.nodes[:, None], axis=3)
    np.testing.assert_allclose(apart, np.broadcast_to(apart[0], apart.shape), atol=1e-6)


def test_a_fixed_joint_of_four_nodes_adds_no_bars():
    nodes = np.vstack([CUBE, CUBE[4:] + [1, 0, 0]])
    bodies = [tc.RigidBody(range(8), 1.0), tc.RigidBody(range(4, 12), 1.0)]
    model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=bodies)))
    assert model.nq - model.mechanism.bars == 6
    assert model.redundancy is None


def test_pins_on_any_nodes_of_a_body():
    for pinned in ((0,), (0, 7), (3, 5, 6), (0, 1, 2, 3, 7)):
        model = tc.Model(tc.Scene(with_body(CUBE, 1.0, pinned=pinned), gravity=tc.Gravity()))
        run = tc.simulate(model, 0.2, 1e-3)
        assert run.success, run.message
        np.testing.assert_array_equal(run.nodes[-1][list(pinned)], CUBE[list(pinned)])
        freedom = {1: 3, 2: 1, 3: 0, 5: 0}[len(pinned)]
        assert np.linalg.matrix_rank(_constraints(model)) == model.nq - freedom


def _constraints(model: tc.Model) -> np.ndarray:
    import casadi as ca

    x = ca.SX.sym("x", model.nx)
    rows = model.constraints(x).bars
    jacobian = ca.Function("J", [x], [ca.jacobian(rows, x)[:, : model.nq]])
    return jacobian(model.initial_state).full()


def test_rollers_on_three_nodes_hold_a_plate():
    s = with_body(SQUARE, 1.0, pinned={0: "z", 1: "z", 2: "z"})
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity()))
    run = tc.simulate(model, 0.5, 1e-2, state=model.state(SQUARE, np.cross((0, 0, 1), SQUARE)))
    assert run.success
    assert np.abs(run.nodes[:, :, 2]).max() < 1e-12


def test_inclined_roller_on_a_body():
    s = with_body(CUBE, 1.0, rollers={2: (0, 1, 1)})
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity()))
    run = tc.simulate(model, 0.5, 1e-3, scheme=tc.DormandPrince853())
    assert run.success
    assert np.ptp(run.energy) < 1e-10
    np.testing.assert_allclose((run.nodes[:, 2] - CUBE[2]) @ (0, 1, 1), 0, atol=1e-12)


@pytest.mark.parametrize(
    ("nodes", "given", "options", "message"),
    [
        (SQUARE[:2], (1.0, None, (1, 1, 1)), {}, "lie on a line, but its mass does not"),
        (CUBE[[0, 0]], (1.0,), {}, "at one point"),
        (CUBE, (1.0, (0.5, 0.5, 0.0), (1, 1, 2)), {}, "its mass lies in a plane"),
        (SQUARE, (1.0, (0.5, 0.5, 0.1), (1, 1, 2)), {}, "its mass lies in a plane"),
        (CUBE, (1.0, None, (0, 1, 1)), {}, "its mass lies on a line|in a plane"),
        (np.vstack([SQUARE, (0.5, 0.5, 1e-5)]), (1.0,), {}, "within 1e-05 m of a plane"),
        (CUBE, (1.0,), {"bars": [(0, 7)]}, "both nodes of bar 0"),
        (SQUARE, (1.0,), {"pinned": dict.fromkeys(range(4), "z")}, "all have supports: remove"),
    ],
)
def test_impossible_bodies_are_rejected(nodes, given, options, message):
    with pytest.raises(ValueError, match=message):
        with_body(nodes, *given, **options)


@pytest.mark.parametrize(
    ("bodies", "message"),
    [
        (3, "bodies is 3: give a list of tenscasadi.RigidBody"),
        ([(0, 1)], r"bodies\[0\] is \(0, 1\): give a tenscasadi.RigidBody"),
        ([tc.RigidBody((0, 9), 1.0)], r"bodies\[0\].nodes is 9: node indices run from 0 to 7"),
    ],
)
def test_wrong_bodies_are_rejected(bodies, message):
    with pytest.raises((TypeError, ValueError), match=message):
        tc.Structure(CUBE, bodies=bodies)


def test_unsupported_uses_say_so():
    s = with_body(CUBE, 1.0, strings=[(0, 7)])
    for use in (lambda: s.class_one(), lambda: tc.Model(tc.Scene(s), "full")):
        with pytest.raises(ValueError, match="bodies"):
            use()


def test_replaced_nodes_move_the_body():
    s = with_body(CUBE, 1.0, (0.1, 0.2, 0.3), (0.3, 0.4, 0.5))
    moved = s.replace(nodes=CUBE + [1, 2, 3])
    np.testing.assert_allclose(moved.bodies[0].center, (1.1, 2.2, 3.3))
    assert s.replace(node_mass=1.0).bodies == s.bodies


def test_copies_and_pickles_keep_bodies():
    s = with_body(SQUARE, 1.0, None, (1.0, 1.0, 1.0))
    again = pickle.loads(pickle.dumps(s))  # noqa: S301  own data
    assert again.bodies == s.bodies
    assert energy(again, (1, 2, 3), (1, 0, 0)) == energy(s, (1, 2, 3), (1, 0, 0))


def test_states_of_nodes_off_their_body_are_rejected():
    model = tc.Model(tc.Scene(with_body(CUBE, 1.0)))
    moved = np.zeros_like(CUBE)
    moved[3, 0] = 0.1
    with pytest.raises(ValueError, match=r"nodes\[.\] is .* m off its rigid body"):
        model.state(CUBE + moved)
    with pytest.raises(ValueError, match=r"velocities\[.\] is .* m/s off its rigid body"):
        model.state(CUBE, moved)
    model.state(1.1 * CUBE, 2.0 * CUBE)  # affine: projections restore the lengths


def test_bodies_take_cables_and_segments():
    nodes = np.vstack([SQUARE, SQUARE + (0, 0, 1)])
    s = tc.Structure(
        nodes,
        strings=[(0, 4), (4, 1), (2, 6), (3, 7)],
        pinned=(5, 6, 7),
        node_mass=np.where(np.arange(8) == 4, 0.5, 0.0),
        bodies=[tc.RigidBody(range(4), 1.0, None, (0.2, 0.2, 0.3))],
        cables=[[0, 1]],
        stiffness=200.0,
        rest_length=0.8,
        string_mass=0.01,
    )
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity()))
    run = tc.simulate(model, 0.3, 1e-3)
    assert run.success, run.message
    plain = s.replace(cables=())
    halves = tc.Model(tc.Scene(plain, gravity=tc.Gravity(), segments=2, ends="consistent"))
    assert halves.nodes(halves.initial_state).shape == (12, 3)
    assert tc.simulate(halves, 0.1, 1e-3).success


@pytest.mark.parametrize(
    ("scene", "count"),
    [
        (tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()), 357),
        (tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity()), 171),
        (tc.Scene(tc.shapes.six_bar_ball(), gravity=tc.Gravity(), ground=tc.Ground()), 1140),
    ],
)
def test_expressions_without_bodies_are_as_short_as_before(scene, count):
    assert tc.Model(scene, "reduced").ode.n_instructions() <= count

"""Masses that are parameters: M and M⁻ against those that NumPy makes of numbers, whatever hangs together."""

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.dynamics.coordinates import build_mechanism


def comb(bars):
    """Bars in a row that all hang together, one end pinned, one node on a roller."""
    nodes = [(k, 0.0, 0.1 * (k % 2)) for k in range(bars + 1)]
    return tc.Structure(
        nodes,
        [(k, k + 1) for k in range(bars)],
        bar_radius=0.05,
        pinned={0: "xyz", bars: "z"},
        node_mass=0.1,
    )


STRUCTURES = {
    "class one": tc.shapes.prism(),
    "dumbbells": tc.shapes.prism().replace(
        bar_radius=np.sqrt(2 / 3) * tc.shapes.prism().bar_lengths
    ),  # M is diagonal then
    "class k": tc.shapes.d_bar(pinned=(0,)),
    "a block of scalar code": comb(4),
    "a block that a routine solves": comb(9),
    "a pinned node without mass": tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1)], [(1, 2)], pinned=[2]
    ),
}


@pytest.mark.parametrize("kind", [ca.SX, ca.MX], ids=["scalars", "vectors"])
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("name", STRUCTURES)
def test_matrices_are_those_of_the_numbers(name, coordinates, kind):
    structure = STRUCTURES[name]
    model = tc.Model(
        tc.Scene(structure, parameters=tc.Parameters("bar_mass", "node_mass")), coordinates
    )
    random = np.random.default_rng(0)
    changes = {
        "bar_mass": random.uniform(0.5, 2.0, len(structure.bars)),
        "node_mass": random.uniform(0.1, 0.3, len(structure.nodes)),
    }
    if name == "a pinned node without mass":
        changes["node_mass"][2] = 0.0
    expected = build_mechanism(structure.replace(**changes), coordinates)
    w = kind.sym("w", model.nw)
    mech = model.with_masses(w)
    found = ca.Function("masses", [w], [mech.M, *mech.inverse, mech.free_mass, *mech.G]).call(
        [model.parameters.values(changes)]
    )
    wanted = [expected.M, *expected.inverse, expected.free_mass, *expected.G]
    assert len(found) == len(wanted)
    moving = ~expected.P.toarray().any(axis=1)  # of the rest any mass gives the same motion
    for value, right in zip(found, wanted, strict=True):
        value, right = value.full(), right.toarray()
        if name == "a pinned node without mass" and len(right) == len(moving):
            value, right = value[moving][:, moving], right[moving][:, moving]
        np.testing.assert_allclose(value, right, rtol=1e-12, atol=1e-12 * abs(right).max())
    assert model.mechanism.system_size == expected.system_size


def test_what_is_constant_is_not_weighed():
    model = tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("stiffness")))
    assert model.with_masses(ca.SX.sym("w", model.nw)) is model.mechanism


def test_masses_that_cancel_for_some_values_do_not_for_others():
    """Two bars that meet do not feel each other where their shared node is infinitely heavy: the system stays there for other masses."""
    model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), parameters=tc.Parameters("node_mass")))
    assert model.mechanism.system_size == len(model.structure.bars)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_masses_on_bodies_are_parameters(count):
    """Bodies with an auxiliary node, four basic nodes, and a dependent node."""
    nodes = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.7, 0.4, -0.3)])[:count]
    body = tc.RigidBody(range(count), 2.0, (0.1, 0.1, 0.2), (0.3, 0.4, 0.5))
    anchors = [(2, 2, 2), (1.0, 1, 3)]
    s = tc.Structure(
        np.vstack([nodes, anchors]),
        bars=[(0, count + 1)],
        strings=[(count - 1, count)],
        pinned={count: "xyz", 1: "z"},
        bodies=[body],
        rest_length=0.5,
    )
    scene = tc.Scene(s, gravity=tc.Gravity(), parameters=tc.Parameters("node_mass", "bar_mass"))
    model, rng = tc.Model(scene), np.random.default_rng(0)
    masses = rng.uniform(0.1, 1.0, count + 2)
    given = {"node_mass": masses, "bar_mass": 0.7}
    other = tc.Model(tc.Scene(s.replace(node_mass=masses, bar_mass=0.7), gravity=tc.Gravity()))
    x = model.initial_state + 1e-2 * rng.normal(size=model.nx)
    found = model.ode(x, [], model.parameters.values(given)).full()
    np.testing.assert_allclose(found, other.ode(x, []).full(), rtol=1e-9, atol=1e-9)
    energies = model.energy(x, parameters=given), other.energy(x)
    np.testing.assert_allclose(*energies, rtol=1e-12)
    fixed = model.with_parameters(given)
    np.testing.assert_allclose(fixed.ode(x, []).full(), found, rtol=1e-9, atol=1e-9)
    runs = [
        tc.simulate(model, 0.1, 1e-3, parameters=given, compiled=False),
        tc.simulate(other, 0.1, 1e-3, compiled=False),
    ]
    np.testing.assert_allclose(runs[0].nodes, runs[1].nodes, atol=1e-10)

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


def boxes(thick=True):
    """A plate and a box that share a node, on strings, with a bar."""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0.1), (0.2, 0.3, 0.8)]
    far = [(2, 0, 0), (2, 1, 0), (1.5, 0.5, 1)]
    plate = {"inertia": (0.2, 0.3, 0.4 if thick else 0.5)}
    return tc.Structure(
        [*corners, *far, (0, 0, 2)],
        [(3, 7)],
        [(0, 4), (2, 5), (7, 6)],
        pinned={4: "z"},
        stiffness=50.0,
        bodies=[
            tc.RigidBody((0, 1, 2, 3), 2.0, inertia=np.diag([0.3, 0.4, 0.5]) + 0.02),
            tc.RigidBody((1, 4, 5), 3.0, **plate),
            tc.RigidBody((5, 6), 0.5),
        ],
    )


@pytest.mark.parametrize("kind", [ca.SX, ca.MX], ids=["scalars", "vectors"])
@pytest.mark.parametrize("names", [("body_mass",), ("body_mass", "body_inertia"), ("bar_mass",)])
def test_masses_of_bodies_are_those_of_the_numbers(names, kind):
    structure = boxes()
    if "body_inertia" in names:  # without the rod
        bodies = structure.bodies[:2]
        masses = [0, 0, 0, 0, 0, 0, 1.0, 0]
        structure = structure.replace(bodies=bodies, node_mass=masses)
    model = tc.Model(tc.Scene(structure, parameters=tc.Parameters(*names)))
    changes = {}
    if "bar_mass" in names:
        changes["bar_mass"] = [1.3]
    if "body_mass" in names:
        changes["body_mass"] = 0.7 * np.array([body.mass for body in structure.bodies])
    if "body_inertia" in names:
        changes["body_inertia"] = [0.25, 0.4, 0.45, 0.01, 0.02, -0.03, 0.3, 0.3, 0.5, 0, 0.05, 0]
    p = model.parameters.values(changes)
    expected = build_mechanism(model.with_parameters(p).structure, "reduced")
    w = kind.sym("w", model.nw)
    mech = model.with_masses(w)
    found = ca.Function("masses", [w], [mech.M, *mech.inverse]).call([p])
    for value, right in zip(found, [expected.M, *expected.inverse], strict=True):
        right = right.toarray()
        np.testing.assert_allclose(value.full(), right, rtol=1e-11, atol=1e-12 * abs(right).max())


def test_derivatives_by_inertia_match_differences():
    structure = boxes().replace(
        bodies=boxes().bodies[:1], pinned={}, node_mass=[0, 0, 0, 0, 1, 1, 1, 0]
    )
    names = tc.Parameters("body_mass", "body_inertia")
    model = tc.Model(tc.Scene(structure, gravity=tc.Gravity(), parameters=names))
    nodes = model.structure.nodes
    state = model.state(nodes, np.cross([1.0, 2.0, -1.5], nodes - nodes[0]))
    options = {"t_end": 0.05, "step": 1e-3}
    found = tc.sensitivities(model, state, by="parameters", **options, compiled=False)
    size = 1e-4
    nominal = np.tile(model.parameters.nominal, (model.np, 1))
    low, high = (
        tc.rollouts(model, states=state, parameters=nominal + sign * np.eye(model.np), **options)
        for sign in (-size, size)
    )
    by_differences = (high.final - low.final).T / (2 * size)
    np.testing.assert_allclose(found.jacobian, by_differences, atol=1e-6)


def test_parameters_of_bodies_act_on_all_functions():
    scene = tc.Scene(
        boxes(),
        gravity=tc.Gravity(),
        parameters=tc.Parameters("body_mass", scale=["body_inertia"]),
    )
    model = tc.Model(scene)
    assert model.parameters.names == (*(f"body_mass[{k}]" for k in range(3)), "body_inertia scale")
    given = {"body_mass": [2.5, 2.0, 0.7], "body_inertia": 1.3}
    options = {"t_end": 0.1, "step": 1e-3, "compiled": False}
    run = tc.simulate(model, parameters=given, **options)
    other = tc.simulate(model.with_parameters(given), **options)
    np.testing.assert_allclose(run.nodes, other.nodes, rtol=0, atol=1e-12)
    np.testing.assert_allclose(run.energy, other.energy, rtol=1e-12, atol=1e-10)
    many = tc.rollouts(model, 0.1, 1e-3, parameters=np.tile(model.parameters.values(given), (2, 1)))
    np.testing.assert_allclose(many.final[1], run.states[-1], rtol=0, atol=1e-11)


def test_equilibrium_carries_the_mass_of_bodies():
    hung = tc.Structure(
        [(0, 0, 0), (0.5, 0, -1), (0.5, 0.3, -1), (0.7, 0, -1.4)],
        strings=[(0, 1)],
        pinned=(0,),
        stiffness=1e3,
        bodies=[tc.RigidBody((1, 2, 3), 1.0, inertia=(0.1, 0.1, 0.1))],
    )
    scene = tc.Scene(hung, gravity=tc.Gravity(), parameters=tc.Parameters("body_mass"))
    rest = tc.find_equilibrium(scene, parameters={"body_mass": 4.0})
    assert rest.success, rest.message
    assert rest.reactions[0, 2] == pytest.approx(4 * 9.81, rel=1e-6)


@pytest.mark.parametrize(
    ("names", "given", "message"),
    [
        (("body_mass",), {"body_mass": -1.0}, "body_mass of body 0 is -1 kg: it must be greater"),
        (
            ("body_inertia",),
            {"body_inertia": [1, 1, 2.5, 0, 0, 0]},
            "body_inertia of body 0 has the principal moments .* less than the sum of the others",
        ),
    ],
)
def test_impossible_bodies_are_rejected(names, given, message):
    structure = boxes().replace(bodies=boxes().bodies[:1], node_mass=1.0)
    model = tc.Model(tc.Scene(structure, parameters=tc.Parameters(*names)))
    with pytest.raises(ValueError, match=message):
        model.parameters.values(given)


def test_scenes_without_such_bodies_are_rejected():
    with pytest.raises(ValueError, match="'body_mass', but the structure has no bodies"):
        tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("body_mass")))
    with pytest.raises(ValueError, match=r"bodies\[1\] has no thickness: name it under scale="):
        tc.Model(tc.Scene(boxes(thick=False), parameters=tc.Parameters("body_inertia")))
    pair = tc.Parameters("body_mass", groups={"body_mass": [[0, 3]]})
    with pytest.raises(ValueError, match="is 3: body indices run from 0 to 2"):
        tc.Model(tc.Scene(boxes(), parameters=pair))

"""A scene with the values of its parameters as constants is the one that a user would have written."""

import casadi as ca
import numpy as np

import tenscasadi as tc
from tenscasadi.scene.binding import fix

FACES = [(0, 1, 2), (3, 5, 4)]


def test_every_quantity_gets_its_value():
    structure = tc.shapes.prism(string_mass=0.1, damping=1.0)
    loads = {
        "gravity": tc.Gravity(),
        "pressure": tc.Pressure(FACES, 5.0),
        "forces": tc.NodalForce(np.ones((6, 3))),
    }
    names = (
        "stiffness",
        "damping",
        "rest_length",
        "string_mass",
        "bar_mass",
        "node_mass",
        "ground_stiffness",
        "ground_damping",
        "ground_friction",
        *loads,
    )
    grounds = [tc.Ground(1e3, 5.0, 0.2), tc.Ground(2e3, 6.0, 0.3, normal=(1, 0, 1))]
    scene = tc.Scene(structure, ground=grounds, parameters=tc.Parameters(*names), **loads)
    p = np.arange(1.0, len(scene.layout) + 1)
    own = fix(scene, p)
    assert own.parameters is None
    found = [getattr(own.structure, name) for name in names[:6]]
    found += [
        [getattr(ground, name) for ground in own.grounds]
        for name in ("stiffness", "damping", "friction")
    ]
    found += [own.gravity.acceleration, [own.pressure.difference], own.forces.values.ravel()]
    assert np.array_equal(np.concatenate(found), p)


def test_scales_multiply_constants_tables_and_functions_of_time():
    structure = tc.shapes.prism()
    scaled = tc.Parameters(scale=["gravity", "pressure", "forces"])
    loads = {
        "gravity": tc.Gravity([(0, 0, -1), (0, 0, -2)], times=[0.0, 1.0]),
        "pressure": tc.Pressure(FACES, lambda t: 3 + t),
        "forces": tc.NodalForce(lambda t: [[ca.sin(t), 0, 1]] * 6),
    }
    own = fix(tc.Scene(structure, parameters=scaled, **loads), np.array([2.0, 3.0, 4.0]))
    for name, factor in (("gravity", 2.0), ("pressure", 3.0), ("forces", 4.0)):
        expected = np.array(ca.DM(loads[name].at(ca.DM(0.5)))) * factor
        np.testing.assert_allclose(
            np.array(ca.DM(getattr(own, name).at(ca.DM(0.5)))), expected, rtol=1e-14
        )


def test_no_friction_at_all_is_none():
    scene = tc.Scene(
        tc.shapes.prism(),
        ground=tc.Ground(friction=0.5),
        parameters=tc.Parameters("ground_friction"),
    )
    assert fix(scene, np.zeros(1)).ground.friction is None

"""Values survive pickle and copy.deepcopy: the same content, still read-only, and models that compute the same."""

from __future__ import annotations

import copy
import pickle
import warnings

import numpy as np
import pytest

import ocp
import tenscasadi as tc

COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}  # noqa: S301


@pytest.fixture(params=COPIES)
def copied(request):
    return COPIES[request.param]


def arrays(value):
    return {name: item for name, item in vars(value).items() if isinstance(item, np.ndarray)}


@pytest.mark.parametrize("structure", [tc.shapes.double_pendulum(), tc.shapes.prism(string_mass=0.1).subdivide(2)], ids=["pinned", "subdivided"])
def test_structure(structure, copied):
    again = copied(structure)
    assert again.pinned == structure.pinned
    for name, array in arrays(structure).items():
        np.testing.assert_array_equal(getattr(again, name), array)
        assert not getattr(again, name).flags.writeable, name
    np.testing.assert_array_equal(again.class_one().P, structure.class_one().P)
    with pytest.raises(TypeError):
        again.pinned[0] = "x"
    with pytest.raises(AttributeError):
        again.stiffness = 1.0


def test_structure_that_keeps_the_columns_it_was_made_from(copied):
    split = tc.shapes.double_pendulum().class_one()
    structure = tc.Structure.from_matrices(split.N, C_b=split.C_b @ split.C_nb, P=split.P, D=split.D)
    np.testing.assert_array_equal(copied(structure).class_one().P, split.P)


@pytest.mark.parametrize("options", [{}, {"coordinates": "full"}, {"coordinates": "full", "bar_length": "constant"}], ids=str)
def test_model(options, copied):
    push = tc.NodalForce(np.full((2, 6, 3), (0.0, 1.0, 2.0)), times=(0.0, 1.0))
    ground = tc.Ground(stiffness=1e3, damping=1.0, friction=0.5)
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0), control=tc.ForceDensity(), ground=ground, forces=push), **options)
    again = copied(model)
    x, u = model.initial_state, model.initial_control
    np.testing.assert_array_equal(again.ode(x, u).full(), model.ode(x, u).full())
    assert (again.coordinates, again.mechanism.constant_length) == (model.coordinates, model.mechanism.constant_length)
    assert not again.scene.forces.values.flags.writeable


def test_model_warns_once(copied):
    triangle = tc.Structure([(0, 0, 0), (1, 0, 0), (0, 1, 0)], bars=[(0, 1), (1, 2), (2, 0)], pinned=(0, 1))
    with pytest.warns(tc.RedundantConstraints):
        model = tc.Model(tc.Scene(triangle))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert copied(model).redundancy == model.redundancy


def test_trajectory(copied):
    run = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), 0.02, 0.01, compiled=False)
    again = copied(run)
    for name, array in arrays(run).items():
        np.testing.assert_array_equal(getattr(again, name), array)
        assert not getattr(again, name).flags.writeable, name


def test_problem_and_plan(copied):
    prism = tc.shapes.prism(stiffness=1000.0, prestress=50.0)
    model = tc.Model(tc.Scene(prism, control=tc.ForceDensity()))
    problem = ocp.Problem(model, goals=[ocp.StringLengths({0: 0.9 * prism.string_lengths[0]})], bounds=[ocp.ForceDensityLimits(1.0, 200.0)])
    given = problem, ocp.Variational(intervals=6), ocp.Ipopt()
    plan, other = ocp.solve(*given), ocp.solve(*map(copied, given))
    np.testing.assert_array_equal(other.force_density, plan.force_density)
    again = copied(plan)
    np.testing.assert_array_equal(again.force_density, plan.force_density)
    assert not again.force_density.flags.writeable
    assert again.replay().nodes[-1] == pytest.approx(plan.replay().nodes[-1], abs=1e-12)

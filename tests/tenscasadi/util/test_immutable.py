"""Values survive pickle and copy.deepcopy: the same content, still read-only, and models that compute the same."""

from __future__ import annotations

import copy
import gc
import pickle
import warnings
import weakref

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from tenscasadi.analysis.modes import Modes
from tenscasadi.util.immutable import keep

COPIES = {"pickle": lambda value: pickle.loads(pickle.dumps(value)), "deepcopy": copy.deepcopy}  # noqa: S301


@pytest.fixture(params=COPIES)
def copied(request):
    return COPIES[request.param]


def arrays(value):
    return {name: item for name, item in vars(value).items() if isinstance(item, np.ndarray)}


@pytest.mark.parametrize(
    "structure",
    [tc.shapes.double_pendulum(), tc.shapes.prism(string_mass=0.1).subdivide(2)],
    ids=["pinned", "subdivided"],
)
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
    structure = tc.Structure.from_matrices(
        split.N, C_b=split.C_b @ split.C_nb, P=split.P, D=split.D
    )
    np.testing.assert_array_equal(copied(structure).class_one().P, split.P)


@pytest.mark.parametrize(
    "options",
    [{}, {"coordinates": "full"}, {"coordinates": "full", "bar_length": "constant"}],
    ids=str,
)
def test_model(options, copied):
    push = tc.NodalForce(np.full((2, 6, 3), (0.0, 1.0, 2.0)), times=(0.0, 1.0))
    ground = tc.Ground(stiffness=1e3, damping=1.0, friction=0.5)
    model = tc.Model(
        tc.Scene(
            tc.shapes.prism(prestress=50.0), control=tc.ForceDensity(), ground=ground, forces=push
        ),
        **options,
    )
    again = copied(model)
    x, u = model.initial_state, model.initial_control
    np.testing.assert_array_equal(again.ode(x, u).full(), model.ode(x, u).full())
    assert (again.coordinates, again.mechanism.constant_length) == (
        model.coordinates,
        model.mechanism.constant_length,
    )
    assert not again.scene.forces.values.flags.writeable


def test_model_warns_once(copied):
    triangle = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)], bars=[(0, 1), (1, 2), (2, 0)], pinned=(0, 1)
    )
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
    problem = ocp.Problem(
        model,
        goals=[ocp.StringLengths({0: 0.9 * prism.string_lengths[0]})],
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
    )
    given = problem, ocp.Variational(intervals=6), ocp.Ipopt()
    plan, other = ocp.solve(*given), ocp.solve(*map(copied, given))
    np.testing.assert_array_equal(other.force_density, plan.force_density)
    again = copied(plan)
    np.testing.assert_array_equal(again.force_density, plan.force_density)
    assert not again.force_density.flags.writeable
    assert again.replay().nodes[-1] == pytest.approx(plan.replay().nodes[-1], abs=1e-12)


def writeable(value, path, seen):
    """Yield the names of the arrays that can be written, of a value and of all values that it holds as attributes."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        yield path
    elif isinstance(value, (tuple, list)):
        for k, part in enumerate(value):
            yield from writeable(part, f"{path}[{k}]", seen)
    elif (
        type(value).__module__.partition(".")[0] in ("tenscasadi", "ocp") and id(value) not in seen
    ):
        seen.add(id(value))
        for name, part in vars(value).items():
            if name[0] != "_":
                yield from writeable(part, f"{path}.{name}", seen)


def test_no_array_of_a_frozen_value_can_be_written():
    cross = tc.shapes.d_bar(pinned=[0], stiffness=100.0)
    model = tc.Model(
        tc.Scene(
            cross,
            control=tc.ForceDensity(),
            gravity=tc.Gravity((0, 0, 0)),
            parameters=tc.Parameters("bar_mass"),
        )
    )
    full = tc.Model(model.scene, coordinates="full")
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    plan = ocp.solve(ocp.Problem(model, start=cross.nodes, goals=goals), ocp.MultipleShooting(10))
    values = {
        "Structure": cross,
        "ClassOne": cross.class_one(),
        "Model": model,
        "Model, full": full,
        "Trajectory": tc.simulate(full, 0.02, 0.01, compiled=False),
        "Modes": tc.modes(model),
        "Linearization": tc.linearize(model),
        "Sensitivities": tc.sensitivities(
            model, model.initial_state, 0.02, 0.01, by="state", compiled=False
        ),
        "Plan": plan,
        "Tracker": ocp.track(plan, decisions=40),
    }
    for own in (model, full):
        _ = own.initial_state, own.initial_control, own.mechanism.free_index
    found = [path for name, value in values.items() for path in writeable(value, name, set())]
    assert not found
    with pytest.raises(ValueError, match="read-only"):
        model.initial_state[0] = 1.0


def test_arrays_that_a_value_was_made_of_may_still_be_written():
    shape = np.zeros((3, 4, 3))
    modes = Modes(np.zeros(3), shape, 0, 1e-6)
    shape[0] = 1.0
    assert modes.shape[0].min() == 1.0
    assert not modes.shape.flags.writeable


def test_kept_values_are_freed_with_their_owner():
    """They refer to the owner: a model to its scene."""
    scene = tc.Scene(tc.shapes.prism(prestress=50.0))
    assert tc.stability(tc.find_equilibrium(scene)).stable
    seen = weakref.ref(scene)
    del scene
    gc.collect()
    assert seen() is None


def test_copies_do_not_take_over_kept_values(copied):
    structure = tc.shapes.prism()
    kept = keep(structure, "list", list)
    assert keep(structure, "list", list) is kept
    for again in (copied(structure), copy.copy(structure)):
        assert keep(again, "list", list) is not kept
    assert keep(structure, "list", list) is kept

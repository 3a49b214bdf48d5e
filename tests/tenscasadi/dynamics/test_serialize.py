"""Models as arrays: each thing that a scene can hold comes back, and where one differs it is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from inspect import signature

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.dynamics.serialize import (
    find_differences,
    model_from_arrays,
    model_to_arrays,
    structure_from_arrays,
)
from tenscasadi.structure.structure import PARAMETERS, Structure

CLOCK = np.array([0.0, 0.3, 0.7])
NODES = [(0, 0, 0), (1, 0, 0.1), (0.2, 1, 0), (0, 0.3, 1), (0.5, 0.5, 0.5)]


def structure(**changes):
    given = {
        "nodes": NODES,
        "bars": [(0, 1), (1, 2)],
        "strings": [(0, 3), (2, 3), (3, 4)],
        "node_mass": [0, 0, 0, 1, 1],
        "string_mass": 0.1,
    }
    return Structure(**{**given, "pinned": {0: "xyz", 2: "z"}, **changes})


def model(coordinates="full", bar_length="current", made=None, **scene):
    return tc.Model(
        tc.Scene(structure() if made is None else made, **{"control": tc.ForceDensity(), **scene}),
        coordinates,
        bar_length,
    )


def twisted():
    """The same structure with other columns for the ends of bars, as the paper's matrices may have them."""
    plain = structure()
    split = plain.class_one()
    order = np.array([2, 0, 1, 3, 4, 5])
    matrices = (
        split.N[:, order],
        (split.C_b @ split.C_nb)[:, order],
        split.C_s[:, order],
        split.P[order],
        split.D,
    )
    mass = np.array([0.0, 0, 0, 0, 1, 1])
    return Structure.from_matrices(*matrices, node_mass=mass)


def wind(rate):
    return tc.NodalForce(lambda t: [[np.sin(rate * t), 0, 0]] + [[0, 0, 0]] * 4)


OTHER: dict[str, Callable[[], tc.Model]] = {
    "Structure.nodes": lambda: model(made=structure(nodes=[*NODES[:-1], (0.5, 0.5, 0.6)])),
    "Structure.bars": lambda: model(made=structure(bars=[(0, 1), (2, 1)])),
    "Structure.strings": lambda: model(made=structure(strings=[(0, 3), (2, 3), (4, 3)])),
    "Structure.bar_mass": lambda: model(made=structure(bar_mass=2.0)),
    "Structure.bar_radius": lambda: model(made=structure(bar_radius=0.01)),
    "Structure.node_mass": lambda: model(made=structure(node_mass=[0, 0, 0, 1, 2])),
    "Structure.fixed": lambda: model(made=structure(pinned={0: "xyz", 2: "x"})),
    "Structure.rollers": lambda: model(
        made=structure(rollers={1: (1, 0, 1), 4: [(1, 1, 0), (0, 0, 1)]})
    ),
    "Structure.stiffness": lambda: model(made=structure(stiffness=101.0)),
    "Structure.damping": lambda: model(made=structure(damping=1.0)),
    "Structure.rest_length": lambda: model(made=structure(rest_length=0.5)),
    "Structure.string_mass": lambda: model(made=structure(string_mass=0.2)),
    "Structure.string_parent": lambda: model(made=structure(string_mass=0.1).subdivide(2)),
    "Structure.layout.physical": lambda: model(made=twisted()),
    "Scene.segments": lambda: model(segments=2),
    "Scene.ends": lambda: model(ends="lumped"),
    "Scene.fractions": lambda: model(segments=2, fractions=(0.2, 0.8)),
    "Scene.gravity": lambda: model(gravity=tc.Gravity()),
    "Scene.gravity.times": lambda: model(
        gravity=tc.Gravity([(0, 0, 1), (0, 2, 0)], times=[0, 0.5])
    ),
    "Scene.pressure.times": lambda: model(
        pressure=tc.Pressure([(0, 1, 2)], [3.0, 4.0], times=[0, 0.5])
    ),
    "Scene.ground.friction": lambda: model(ground=tc.Ground(normal=(0.1, 0.2, 1.0), friction=0.3)),
    "Scene.ground.nodes": lambda: model(ground=tc.Ground(nodes=[1, 3])),
    "Scene.ground.heights": lambda: model(
        ground=tc.Terrain([[0, 1, 0], [0, 0.5, 0.2]], (-1, -1), (1, 1.5), friction=0.3)
    ),
    "Scene.grounds": lambda: model(
        ground=[
            tc.Ground(),
            tc.Ground(friction=0.2),
            tc.Terrain([[0, 1], [0, 0.5]], (-1, -1), (1, 1), nodes=[2]),
        ]
    ),
    "Scene.pressure": lambda: model(pressure=tc.Pressure([(0, 1, 2)], 3.0)),
    "Scene.forces": lambda: model(forces=tc.NodalForce(np.ones((5, 3)))),
    "Scene.forces.bars": lambda: model(forces=tc.NodalForce(np.ones((5, 3)), bars={1: 1})),
    "Scene.forces.times": lambda: model(
        forces=tc.NodalForce(np.arange(30.0).reshape(2, 5, 3), times=[0, 0.5])
    ),
    "Scene.parameters": lambda: model(
        control=None,
        parameters=tc.Parameters("bar_mass", scale=["stiffness"], groups={"bar_mass": "all"}),
    ),
    "Scene.slack": lambda: model(slack=tc.Smooth(0.01)),
    "Scene.slack.laws": lambda: model(
        slack={0: tc.Linear(), 1: tc.Smooth(0.1), 2: tc.Clip("unclamped")}
    ),
    "Model.coordinates": lambda: model("reduced"),
    "Model.bar_length": lambda: model(bar_length="constant"),
}
FUNCTIONS: dict[str, Callable[[], tc.Model]] = {
    "Scene.forces": lambda: model(forces=wind(2.0)),
    "Scene.gravity": lambda: model(gravity=tc.Gravity(lambda t: [0, 0, np.sin(t)])),
    "Scene.pressure": lambda: model(pressure=tc.Pressure([(0, 1, 2)], lambda t: 3.0 * t)),
    "Scene.supports": lambda: model(supports=tc.SupportMotion({0: lambda t: (t**2, 0, 0)})),
}


def test_everything_that_a_model_has_is_covered():
    named = {name.split(".")[1] for name in [*OTHER, *FUNCTIONS]} | {"pinned"}  # pinned: fixed
    named |= {"node_names", "string_names", "bar_names"}
    assert set(PARAMETERS) <= named
    assert {field.name for field in fields(tc.Scene)} - {"structure", "control"} <= named
    assert set(signature(tc.Model).parameters) - {"scene"} <= named


@pytest.mark.parametrize("name", OTHER)
def test_a_model_comes_back_and_is_told_from_others(name):
    own = OTHER[name]()
    content = model_to_arrays(own, CLOCK)
    again = model_from_arrays(content)
    assert not find_differences(content, again)
    assert not find_differences(content, own)
    assert name in find_differences(content, model())
    state = own.initial_state + 1e-3 * np.random.default_rng(0).normal(size=own.nx)
    control = np.arange(own.nu) + 10.0
    given = [state, control, 1.1 * own.parameters.nominal] if own.np else [state, control]
    for function in ("ode", "observe"):
        for value, expected in zip(
            *(getattr(one, function).call(given) for one in (again, own)), strict=True
        ):
            assert np.array_equal(value.full(), expected.full())
    assert again.structure.pinned == own.structure.pinned


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_time_are_told_by_what_they_give(name):
    own = FUNCTIONS[name]()
    content = model_to_arrays(own, CLOCK)
    assert model_from_arrays(content) is None
    assert not find_differences(content, own)
    assert name in find_differences(content, model())
    assert find_differences(
        model_to_arrays(model(forces=wind(2.0)), CLOCK), model(forces=wind(2.1))
    ) == ["Scene.forces"]


def test_rounding_is_no_difference():
    own = model(made=structure(nodes=np.array(NODES) + 1e-14))
    assert not find_differences(model_to_arrays(model(), CLOCK), own)


def test_what_was_stored_before_there_were_layouts_is_compared_as_far_as_it_goes():
    content = {
        name: value
        for name, value in model_to_arrays(model(), CLOCK).items()
        if not name.startswith(("scene", "model", "structure.layout"))
    }
    assert model_from_arrays(content) is None
    assert np.array_equal(structure_from_arrays(content).nodes, structure().nodes)
    assert not find_differences(content, model("reduced"))


@pytest.mark.parametrize(
    "name", ["layout.physical", "layout.bar_columns", "layout.string_columns", "string_parent"]
)
def test_indices_that_point_nowhere_are_refused(name):
    content = model_to_arrays(model(), CLOCK)
    content[f"structure.{name}"] = content[f"structure.{name}"] + 100
    with pytest.raises(ValueError, match=f"field '{name}' does not hold indices below"):
        model_from_arrays(content)

"""Models in files of plans: they come back to the last bit, and differences are named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from inspect import signature
from typing import Any

import numpy as np
import pytest
from planning import save_and_load

import tenscasadi as tc
from ocp.plan.plan_files import find_differences
from tenscasadi.scene.samples import sample_functions
from tenscasadi.schema.time_formula import TimeFormula
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
    "Structure.bar_stiffness": lambda: model(made=structure(bar_stiffness=[1e3, np.inf])),
    "Structure.bar_rest_length": lambda: model(
        made=structure(bar_stiffness=1e3, bar_rest_length=1.2)
    ),
    "Structure.node_mass": lambda: model(made=structure(node_mass=[0, 0, 0, 1, 2])),
    "Structure.pinned": lambda: model(made=structure(pinned={0: "xyz", 2: "x"})),
    "Structure.rollers": lambda: model(
        made=structure(rollers={1: (1, 0, 1), 4: [(1, 1, 0), (0, 0, 1)]})
    ),
    "Structure.stiffness": lambda: model(made=structure(stiffness=101.0)),
    "Structure.damping": lambda: model(made=structure(damping=1.0)),
    "Structure.rest_length": lambda: model(made=structure(rest_length=0.5)),
    "Structure.string_mass": lambda: model(made=structure(string_mass=0.2)),
    "Structure.cables": lambda: model(made=structure(cables=[(0, 2)]), control=tc.Tension()),
    "Structure.cable_friction": lambda: model(
        made=structure(cables=[(0, 2)], cable_friction=0.1), control=tc.Tension()
    ),
    "Structure.bodies": lambda: model(
        "reduced",
        made=structure(
            nodes=[*NODES, (2, 0, 0), (2, 1, 0), (3, 0, 0)],
            node_mass=[0, 0, 0, 1, 1, 0, 0, 0],
            bodies=[tc.RigidBody((5, 6, 7), 2.0)],
        ),
    ),
    "Structure.derived ": lambda: model(made=structure(string_mass=0.1).subdivide(2)),
    "Structure.derived": lambda: model(made=twisted()),
    "Scene.segments": lambda: model(segments=2),
    "Scene.ends": lambda: model(ends="lumped"),
    "Scene.fractions": lambda: model(segments=2, fractions=(0.2, 0.8)),
    "Scene.gravity": lambda: model(gravity=tc.Gravity()),
    "Scene.gravity ": lambda: model(gravity=tc.Gravity([(0, 0, 1), (0, 2, 0)], times=[0, 0.5])),
    "Scene.pressure ": lambda: model(pressure=tc.Pressure([(0, 1, 2)], [3.0, 4.0], times=[0, 0.5])),
    "Scene.ground": lambda: model(ground=tc.Ground(normal=(0.1, 0.2, 1.0), friction=0.3)),
    "Scene.ground ": lambda: model(ground=tc.Ground(nodes=[1, 3])),
    "Scene.ground  ": lambda: model(
        ground=tc.Terrain([[0, 1, 0], [0, 0.5, 0.2]], (-1, -1), (1, 1.5), friction=0.3)
    ),
    "Scene.ground   ": lambda: model(
        ground=[
            tc.Ground(),
            tc.Ground(friction=0.2),
            tc.Terrain([[0, 1], [0, 0.5]], (-1, -1), (1, 1), nodes=[2]),
        ]
    ),
    "Scene.bar_contact": lambda: model(
        made=structure(bars=[(0, 1), (2, 3)], bar_radius=0.01),
        bar_contact=tc.BarContact([(0, 1)], damping=2.0),
    ),
    "Scene.strength": lambda: model(strength=tc.Breaking(40.0, margin=0.1)),
    "Scene.strength  ": lambda: model(
        control=tc.RestLength(), strength=tc.Yielding([40.0, 50.0, np.inf], 2.0)
    ),
    "Scene.strength ": lambda: model(strength=tc.Breaking({1: 40.0})),
    "Scene.pressure": lambda: model(pressure=tc.Pressure([(0, 1, 2)], 3.0)),
    "Scene.forces": lambda: model(forces=tc.NodalForce(np.ones((5, 3)))),
    "Scene.forces ": lambda: model(forces=tc.NodalForce(np.ones((5, 3)), bars={1: 1})),
    "Scene.forces  ": lambda: model(
        forces=tc.NodalForce(np.arange(30.0).reshape(2, 5, 3), times=[0, 0.5])
    ),
    "Scene.parameters": lambda: model(
        control=None,
        parameters=tc.Parameters("bar_mass", scale=["stiffness"], groups={"bar_mass": "all"}),
    ),
    "Scene.slack": lambda: model(slack=tc.Smooth(0.01)),
    "Scene.slack ": lambda: model(
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


def again(model: tc.Model) -> tc.Model:
    """The model from the text of a file."""
    found: tc.Model = save_and_load(model=model)["model"]
    return found


def differences(one: Any, other: Any) -> set[str]:
    return set(find_differences(one, other, "Model"))


def test_everything_that_a_model_has_is_covered():
    named = {name.split(".")[1].strip() for name in [*OTHER, *FUNCTIONS]}
    named |= {"node_names", "string_names", "bar_names"}
    assert set(PARAMETERS) <= named
    assert {field.name for field in fields(tc.Scene)} - {"structure", "control"} <= named
    assert set(signature(tc.Model).parameters) - {"scene"} <= named


@pytest.mark.parametrize("name", OTHER)
def test_a_model_comes_back_and_differs_from_others(name):
    own = OTHER[name]()
    back = again(own)
    assert not differences(back, own)
    assert name.strip() in differences(back, model())
    state = own.initial_state + 1e-3 * np.random.default_rng(0).normal(size=own.nx)
    control = np.arange(own.nu) + 10.0
    given = [state, control, 1.1 * own.parameters.nominal] if own.np else [state, control]
    for function in ("ode", "observe"):
        for value, expected in zip(
            *(getattr(one, function).call(given) for one in (back, own)), strict=True
        ):
            assert np.array_equal(value.full(), expected.full())
    assert back.structure.pinned == own.structure.pinned


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_of_time_are_stored_as_samples(name):
    own, part = FUNCTIONS[name](), name.split(".")[1]
    found = save_and_load(model=own)
    assert found["model"] is None
    assert found["not_restored"].startswith(f"Scene.{part}")
    sampled, fields = sample_functions(own.scene, CLOCK)
    assert fields == (part,)
    assert not differences(again(tc.Model(sampled, "full")).scene, sampled)
    assert name in differences(sampled, model().scene)
    other, _ = sample_functions(model(forces=wind(2.1)).scene, CLOCK)
    if part == "forces":
        assert differences(sampled, other) == {"NodalForce.values"}


def test_formulas_of_time_are_stored():
    own = tc.Gravity(TimeFormula((0.0, 0.0, "-a * t"), (("a", 2.5),)))
    back = again(model(gravity=own)).scene.gravity
    assert back.acceleration(2.0) == own.acceleration(2.0) == [0.0, 0.0, -5.0]
    assert sample_functions(model(gravity=own).scene, CLOCK)[1] == ()


def test_rounding_is_no_difference():
    assert not differences(model(), model(made=structure(nodes=np.array(NODES) + 1e-14)))


@pytest.mark.parametrize("name", ["physical", "bar_columns", "string_columns", "string_parent"])
def test_indices_that_point_nowhere_are_rejected(name):
    fields = structure(string_mass=0.1).subdivide(2).to_fields()
    fields["derived"][name] = fields["derived"][name] + 100
    with pytest.raises(ValueError, match=f"derived.{name} is wrong: give indices below"):
        Structure.from_fields(**fields)


class OwnLaw(tc.Clip):
    """A law of strings of a user."""


def test_reason_takes_the_place_of_a_model_that_no_file_holds():
    found = save_and_load(model=model(slack=OwnLaw()))
    assert found["model"] is None
    assert "OwnLaw" in found["not_restored"]

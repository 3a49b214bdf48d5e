"""The vector p: names, units, nominal values, values by name, and the physical domain of each."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import tenscasadi as tc


def layout(*names, structure=None, **options):
    loads = {
        name: options.pop(name)
        for name in ("gravity", "ground", "forces", "segments")
        if name in options
    }
    return tc.Scene(
        structure or tc.shapes.prism(damping=2.0),
        parameters=tc.Parameters(*names, **options),
        **loads,
    ).layout


def test_entries_in_the_order_of_the_names():
    own = layout(
        "bar_mass",
        "gravity",
        scale=["damping"],
        groups={"bar_mass": [[0, 2], [1]]},
        gravity=tc.Gravity(),
    )
    assert own.names == (
        "bar_mass[0]",
        "bar_mass[1]",
        "gravity[x]",
        "gravity[y]",
        "gravity[z]",
        "damping scale",
    )
    assert own.units == ("kg", "kg", "m/s²", "m/s²", "m/s²", "1")
    assert own.nominal.tolist() == [1.0, 1.0, 0.0, 0.0, -9.81, 1.0]
    assert own.places == {"bar_mass": slice(0, 2), "gravity": slice(2, 5), "damping": slice(5, 6)}
    assert str(own).splitlines()[0] == "bar_mass[0]    1 kg"


def test_quantities_follow_from_p():
    own = layout(
        "bar_mass",
        scale=["stiffness", "damping"],
        groups={"bar_mass": [[0, 2]], "stiffness": [[1, 2], [0]]},
    )
    p = np.array([5.0, 2.0, 3.0, 10.0])
    assert own.quantities["bar_mass"].numbers(p).tolist() == [5.0, 1.0, 5.0]
    assert own.quantities["stiffness"].numbers(p).tolist() == [300.0, 200.0, 200.0, *[100.0] * 6]
    assert own.quantities["damping"].numbers(p).tolist() == [20.0] * 9
    both = own.quantities["bar_mass"].numbers(np.array([p, p + 1]))
    assert both.tolist() == [[5.0, 1.0, 5.0], [6.0, 1.0, 6.0]]


def test_values_by_name():
    own = layout("stiffness", "bar_mass", groups={"bar_mass": "all"})
    assert np.array_equal(own.values(), own.nominal)
    assert own.values({"stiffness": 120.0}, bar_mass=2.0).tolist() == [120.0] * 9 + [2.0]
    assert own.values(stiffness=np.arange(9.0)).tolist() == [*range(9), 1.0]
    assert own.values(np.arange(10.0) + 1, bar_mass=[3.0])[-1] == 3.0
    assert not own.values().flags.writeable


@pytest.mark.parametrize(
    ("given_", "message"),
    [
        (np.ones(9), r"parameters has shape (9,): give an array of shape (10,)"),
        ({"stiffness": np.ones(3)}, "parameters['stiffness'] has shape (3,)"),
        (
            {"damping": 1.0},
            "parameters has 'damping': the parameters of this model are stiffness, bar_mass",
        ),
        ({"stiffness": np.nan}, "parameters['stiffness'] is nan"),
        (np.full(10, np.inf), "parameters[0] is inf"),
        (
            {"stiffness": [*[100.0] * 8, -1.0]},
            "parameters: stiffness of string 8 is -1 N/m: it must be at least 0",
        ),
        ({"bar_mass": 0.0}, "parameters: bar_mass of bar 0 is 0 kg: it must be greater than 0"),
    ],
)
def test_bad_values_are_refused_by_name(given_, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        layout("stiffness", "bar_mass", groups={"bar_mass": "all"}).values(given_)


@pytest.mark.parametrize(
    ("own", "given_", "message"),
    [
        (
            layout("ground_stiffness", ground=tc.Ground()),
            {"ground_stiffness": 0.0},
            "ground_stiffness of ground 0 is 0 N/m: it must be greater than 0",
        ),
        (
            layout("ground_damping", ground=tc.Ground()),
            {"ground_damping": -1.0},
            "ground_damping of ground 0 is -1 N·s/m: it must be at least 0",
        ),
        (
            layout("ground_friction", ground=tc.Ground(friction=1)),
            {"ground_friction": -0.1},
            "ground_friction of ground 0 is -0.1: it must be at least 0",
        ),
        (
            layout("rest_length"),
            {"rest_length": 0.0},
            "rest_length of string 0 is 0 m: it must be greater than 0",
        ),
        (layout(scale=["bar_mass"]), {"bar_mass": -2.0}, "bar_mass of bar 0 is -2 kg"),
        (
            layout("string_mass", structure=tc.shapes.prism(string_mass=0.1), segments=2),
            {"string_mass": 0.0},
            "string_mass of string 0 is 0 kg",
        ),
    ],
)
def test_each_quantity_has_its_domain(own, given_, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        own.values(given_)


def test_nodes_of_no_bar_need_a_mass():
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)], bars=[(0, 1)], strings=[(1, 2)], node_mass=[0, 0, 1.0]
    )
    own = layout("node_mass", structure=structure)
    assert own.values([0.0, 0.0, 0.5]).tolist() == [0.0, 0.0, 0.5]
    with pytest.raises(ValueError, match="node_mass of node 2 is 0 kg: it must be greater than 0"):
        own.values(np.zeros(3))


def test_many_rows_are_checked_at_once():
    own = layout("bar_mass")
    own.check(np.ones((4, 3)))
    with pytest.raises(ValueError, match=r"parameters\[2\]: bar_mass of bar 1 is -1 kg"):
        own.check(np.where(np.arange(12).reshape(4, 3) == 7, -1.0, 1.0))


def test_a_scene_without_parameters_has_an_empty_vector():
    model = tc.Model(tc.Scene(tc.shapes.prism()))
    assert model.np == 0
    assert model.parameters.values().shape == (0,)
    with pytest.raises(
        ValueError, match="the parameters of this model are none, as its scene has no Parameters"
    ):
        tc.simulate(model, 0.1, parameters={"stiffness": 1.0})


@given(
    st.one_of(
        st.none(),
        st.text(),
        st.integers(),
        st.floats(),
        hnp.arrays(float, hnp.array_shapes(max_dims=2, max_side=11)),
        st.lists(st.none()),
    )
)
def test_odd_values_are_refused_or_are_right(value):
    own = layout("stiffness", "bar_mass", groups={"bar_mass": "all"})
    for what in (value, {"stiffness": value}):
        try:
            p, fault = own.values(what), ""
        except (TypeError, ValueError) as error:
            p, fault = own.nominal, str(error)
        assert not fault or "parameters" in fault
        assert p.shape == (10,)
        assert (p >= 0).all()
        assert p[-1] > 0

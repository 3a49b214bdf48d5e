"""Which quantities are parameters: names, scales and groups, and what is refused by name."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tenscasadi as tc
from tenscasadi.scene.quantities import QUANTITIES


@pytest.mark.parametrize(
    ("names", "options", "message"),
    [
        ((), {}, "Parameters is empty: name quantities"),
        (("stifness",), {}, "Parameters got 'stifness': give some of stiffness, damping"),
        (("stiffness", "stiffness"), {}, "'stiffness' twice"),
        (("stiffness",), {"scale": ["stiffness"]}, "'stiffness' twice"),
        (
            ("stiffness",),
            {"groups": {"damping": "all"}},
            "Parameters.groups has 'damping', which is no parameter",
        ),
        (
            ("gravity",),
            {"groups": {"gravity": "all"}},
            "give groups of strings, bars, nodes, bodies or grounds",
        ),
        (("stiffness",), {"groups": {"stiffness": "some"}}, "is 'some': give \"all\""),
        (("stiffness",), {"groups": {"stiffness": []}}, "give one or more groups"),
        (("stiffness",), {"groups": {"stiffness": [[0, 1], []]}}, "give one or more groups"),
        (
            ("stiffness",),
            {"groups": {"stiffness": [[0, 1], [1]]}},
            "has index 1 again",
        ),
        (("stiffness",), {"groups": {"stiffness": [[-1]]}}, "must be at least 0"),
    ],
)
def test_what_makes_no_parameters_is_refused(names, options, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        tc.Parameters(*names, **options)


@pytest.mark.parametrize(
    ("names", "options"),
    [((3,), {}), (("stiffness",), {"scale": "damping"}), (("stiffness",), {"groups": [[0]]})],
)
def test_what_is_of_another_type_is_refused(names, options):
    with pytest.raises(TypeError, match="Parameters"):
        tc.Parameters(*names, **options)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (tc.Parameters("gravity"), "Scene.gravity is None"),
        (tc.Parameters("ground_friction"), "Scene.ground is None"),
        (tc.Parameters("forces"), "Scene.forces is None"),
        (
            tc.Parameters("stiffness", groups={"stiffness": [[9]]}),
            "is 9: string indices run from 0 to 8",
        ),
        (
            tc.Parameters("rest_length", groups={"rest_length": "all"}),
            "the scene's rest_length differs",
        ),
        (tc.Parameters(scale=["damping"]), "whose value is 0"),
    ],
)
def test_what_a_scene_does_not_have_is_refused(parameters, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        tc.Scene(tc.shapes.prism(), parameters=parameters)


def test_loads_that_change_over_time_are_scaled_only():
    over_time = {"gravity": tc.Gravity(lambda t: (0, 0, -t))}
    with pytest.raises(ValueError, match="varies over time: name 'gravity' under scale="):
        tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("gravity"), **over_time)
    assert tc.Scene(
        tc.shapes.prism(), parameters=tc.Parameters(scale=["gravity"]), **over_time
    ).layout.names == ("gravity scale",)


def test_friction_has_to_be_there():
    with pytest.raises(ValueError, match=r"Ground.friction is None: give a coefficient"):
        tc.Scene(tc.shapes.prism(), ground=tc.Ground(), parameters=tc.Parameters("ground_friction"))


def test_other_things_are_no_parameters():
    with pytest.raises(TypeError, match=r"Scene.parameters is \['stiffness'\]"):
        tc.Scene(tc.shapes.prism(), parameters=["stiffness"])


@given(
    st.lists(
        st.one_of(
            st.sampled_from(sorted(QUANTITIES)), st.text(max_size=3), st.none(), st.integers()
        ),
        max_size=3,
    ),
    st.data(),
)
def test_odd_input_is_refused_or_understood(names, data):
    kept = [name for name in names if isinstance(name, str)]
    groups = data.draw(
        st.none()
        | st.dictionaries(
            st.sampled_from([*kept, "stiffness"]),
            st.sampled_from(["all", [[0]], [[0, 2], [1]], 3, [[]]]),
        )
    )
    fault = ""
    try:
        layout = tc.Scene(
            tc.shapes.prism(), gravity=tc.Gravity(), parameters=tc.Parameters(*names, groups=groups)
        ).layout
    except (TypeError, ValueError) as error:
        layout, fault = tc.Scene(tc.shapes.prism()).layout, str(error)
    assert not fault or "Parameters" in fault
    assert len(layout.names) == len(layout.units) == len(layout.nominal) == len(set(layout.names))
    assert np.isfinite(layout.nominal).all()

"""Rollers: how they are given, kept, and refused."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning import save_and_load

import tenscasadi as tc
from ocp.plan.plan_files import find_differences

NODES = [(0, 0, 0), (1, 0, 0.1), (0.2, 1, 0)]
NONE = np.zeros(0)


def built(rollers: Any, **changes: Any) -> tc.Structure:
    return tc.Structure(NODES, bars=[(0, 1)], node_mass=1.0, rollers=rollers, **changes)


def test_normals_are_kept_orthonormal_and_stay_as_they_are() -> None:
    structure = built({2: (3, 0, 4), 0: [(1, 1, 0), (1, 0, 0.5)]})
    assert structure.rollers[2] == ((0.6, 0.0, 0.8),)
    normals = np.array(structure.rollers[0])
    assert np.allclose(normals @ normals.T, np.eye(2))
    assert np.allclose(
        np.cross(*normals),
        np.cross((1, 1, 0), (1, 0, 0.5)) / np.linalg.norm(np.cross((1, 1, 0), (1, 0, 0.5))),
    )
    assert list(structure.rollers) == [0, 2]
    assert structure.replace(bar_mass=2.0).rollers == structure.rollers
    assert structure.subdivide(1).rollers == structure.rollers
    assert not structure.fixed.any()
    assert structure.held.tolist() == [[True] * 3, [False] * 3, [True, False, True]]
    for again in (pickle.loads(pickle.dumps(structure)), copy.deepcopy(structure)):  # noqa: S301
        assert again.rollers == structure.rollers
    with pytest.raises(TypeError):
        structure.rollers[1] = ((1.0, 0.0, 0.0),)  # type: ignore[index]


def test_rollers_along_axes_are_pins_in_both_coordinates() -> None:
    structure = built({0: (0, 0, -2), 1: [(0, 3, 0), (0, 0, 1)]}, pinned={2: "xyz"})
    assert structure.rollers == {}
    assert structure.pinned == {0: "z", 1: "yz", 2: "xyz"}
    assert tc.Model(tc.Scene(structure)).nq == 3


def test_models_with_rollers_come_back_from_arrays() -> None:
    model = tc.Model(
        tc.Scene(
            built({0: (1, 0, 1), 2: [(1, 1, 0), (0, 0, 1)]}),
            gravity=tc.Gravity(),
            control=tc.ForceDensity(),
        ),
        "full",
    )
    again = save_and_load(model=model)["model"]
    assert again.structure.rollers == model.structure.rollers
    assert not list(find_differences(again, model, "Model"))
    other = tc.Model(
        tc.Scene(
            built({0: (1, 0, 1.1), 2: [(1, 1, 0), (0, 0, 1)]}),
            gravity=tc.Gravity(),
            control=tc.ForceDensity(),
        ),
        "full",
    )
    assert list(set(find_differences(again, other, "Model"))) == ["Structure.rollers"]


@pytest.mark.parametrize(
    ("rollers", "message"),
    [
        ([0], r"rollers is \[0\]: give a mapping"),
        ({5: (0, 0, 1)}, r"rollers is 5: node indices run from 0 to 2"),
        ({0: (0, 0, 0)}, r"rollers of node 0 is \(0, 0, 0\): give directions other than 0"),
        ({0: (0, 1)}, r"rollers of node 0 has shape \(2,\)"),
        ({0: "z"}, r"rollers of node 0 is not an array"),
        ({0: (0, np.nan, 1)}, r"rollers of node 0\[1\] is nan"),
        ({0: np.eye(3)}, r"rollers of node 0 has 3 directions: give one or two, or pin the node"),
        ({0: np.zeros((0, 3))}, r"rollers of node 0 has 0 directions"),
        (
            {0: [(1, 0, 1), (-2, 0, -2)]},
            r"rollers of node 0 .* parallel directions: give one of them",
        ),
        ({1: (1, 0, 1)}, r"node 1 is pinned along z, too: give all its directions in rollers"),
    ],
)
def test_what_is_no_roller_is_refused_by_name(rollers: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        built(rollers, pinned={1: "z"})


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_states_off_a_roller_are_refused(coordinates: Any) -> None:
    structure = built({2: (1, 0, 1)})
    model = tc.Model(tc.Scene(structure), coordinates)
    along, off = np.zeros((3, 3)), np.zeros((3, 3))
    along[2], off[2] = (1, 2, -1), (1, 0, 0)
    assert model.nodes(model.state(structure.nodes + along, along))[2] == pytest.approx(
        structure.nodes[2] + along[2]
    )
    with pytest.raises(ValueError, match=r"nodes\[2\] moves node 2 off its roller"):
        model.state(structure.nodes + off)
    with pytest.raises(ValueError, match=r"velocities\[2\] moves node 2 off its roller"):
        model.state(structure.nodes, off)


def test_what_reduced_coordinates_with_rollers_cannot_do_says_the_cure() -> None:
    structure = built({2: (1, 0, 1)})
    with pytest.raises(
        ValueError,
        match=r'Scene\.parameters contains masses, .* give Model\(coordinates="full"\)',
    ):
        tc.Model(tc.Scene(structure, parameters=tc.Parameters("node_mass")), "reduced")
    opened = tc.Model(
        tc.Scene(structure, gravity=tc.Gravity(), parameters=tc.Parameters("node_mass")), "full"
    )
    fixed = tc.Model(tc.Scene(structure.replace(node_mass=1.5), gravity=tc.Gravity()), "full")
    assert opened.ode(opened.initial_state, [], [1.5]).full() == pytest.approx(
        fixed.ode(fixed.initial_state, []).full(), abs=1e-12
    )
    run = tc.rollouts(fixed, 0.1, 0.01)
    assert run.success.all()


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.lists(
            st.floats(-1e6, 1e6) | st.sampled_from([0.0, 1.0, np.inf]), min_size=1, max_size=4
        ),
        min_size=0,
        max_size=3,
    )
)
def test_any_directions_become_orthonormal_or_are_refused(directions: list[list[float]]) -> None:
    try:
        structure = built({0: directions})
    except (TypeError, ValueError):
        with pytest.raises((TypeError, ValueError), match=r"^rollers of node 0"):
            built({0: directions})
        return
    normals = np.array(
        structure.rollers.get(
            0, np.eye(3)[["xyz".index(axis) for axis in structure.pinned.get(0, "")]]
        )
    )
    assert len(normals) == len(directions)
    assert np.abs(normals @ normals.T - np.eye(len(normals))).max() < 1e-9
    spanned = np.array(directions) / np.abs(directions).max()
    assert np.abs(spanned - spanned @ normals.T @ normals).max() < 1e-6

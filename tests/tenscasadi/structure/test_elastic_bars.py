"""Input of elastic bars, and rest lengths for given force densities."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tenscasadi as tc


def stressed(**options: object) -> tuple[tc.Structure, np.ndarray]:
    """A prism with elastic bars, and its self-stress with strings at 10 N/m."""
    s = tc.shapes.prism(bar_stiffness=1e4, **options)
    stress = tc.self_stress(s)[0]
    return s, 10.0 * stress / stress[0]


def test_bars_are_rigid_by_default():
    s = tc.shapes.prism()
    assert not s.elastic.any()
    assert np.isinf(s.bar_stiffness).all()
    assert (s.bar_rest_length == s.bar_lengths).all()


@pytest.mark.parametrize("rigid", [None, np.inf, [None, np.inf, np.inf]])
def test_none_and_inf_are_rigid(rigid):
    assert not tc.shapes.prism(bar_stiffness=rigid).elastic.any()


def test_stiffness_of_each_bar():
    s = tc.shapes.prism(bar_stiffness=[1e3, None, 2e3], bar_rest_length=[1.0, None, np.nan])
    assert s.elastic.tolist() == [True, False, True]
    np.testing.assert_array_equal(s.bar_stiffness, [1e3, np.inf, 2e3])
    np.testing.assert_array_equal(s.bar_rest_length, [1.0, *s.bar_lengths[1:]])


def test_replace_keeps_rest_lengths_of_elastic_bars_only():
    s = tc.shapes.prism(bar_stiffness=[1e3, np.inf, 2e3])
    larger = s.replace(nodes=1.1 * s.nodes)
    np.testing.assert_allclose(larger.bar_rest_length[[0, 2]], s.bar_lengths[[0, 2]], rtol=1e-15)
    np.testing.assert_allclose(larger.bar_rest_length[1], 1.1 * s.bar_lengths[1], rtol=1e-15)
    rigid = larger.replace(bar_stiffness=None)
    assert (rigid.bar_rest_length == rigid.bar_lengths).all()


def test_copies_and_pickles():
    s = tc.shapes.prism(bar_stiffness=[1e3, np.inf, 2e3], bar_rest_length=1.3)
    again = pickle.loads(pickle.dumps(s))  # noqa: S301  own data
    np.testing.assert_array_equal(again.bar_stiffness, s.bar_stiffness)
    np.testing.assert_array_equal(again.bar_rest_length, s.bar_rest_length)
    with pytest.raises(ValueError, match="read-only"):
        again.bar_stiffness[0] = 1.0


@given(
    value=st.one_of(
        st.floats(max_value=0.0),
        st.just(np.nan),
        st.just(-np.inf),
        st.floats(min_value=1e101, max_value=1e300),
        st.lists(st.floats(min_value=1.0, max_value=1e6), max_size=2),
        st.text(max_size=3),
        st.just([1.0, np.nan, 1.0]),
        st.just({0: 1.0}),
        st.just(1j),
    )
)
def test_bad_stiffness_is_rejected_by_name(value):
    with pytest.raises((TypeError, ValueError), match="bar_stiffness"):
        tc.shapes.prism(bar_stiffness=value)


@pytest.mark.parametrize("value", [0.0, -1.0, [1.0, 2.0], "a", [1.0, 1.0, -1.0], np.inf])
def test_bad_rest_length_is_rejected_by_name(value):
    with pytest.raises((TypeError, ValueError), match="bar_rest_length"):
        tc.shapes.prism(bar_stiffness=1e3, bar_rest_length=value)


def test_prestress_compresses_elastic_bars():
    s, stress = stressed()
    held = s.prestressed(stress)
    tension = held.bar_stiffness * (held.bar_lengths - held.bar_rest_length)
    np.testing.assert_allclose(tension, -stress[9:] * s.bar_lengths, rtol=1e-10)
    strings = held.stiffness * (held.string_lengths - held.rest_length)
    np.testing.assert_allclose(strings, stress[:9] * s.string_lengths, rtol=1e-12)


def test_bars_balance_strings_whose_force_densities_are_given():
    s, stress = stressed()
    np.testing.assert_allclose(
        s.prestressed(stress[:9]).bar_rest_length, s.prestressed(stress).bar_rest_length, rtol=1e-13
    )
    unbalanced = s.prestressed(np.linspace(1.0, 9.0, 9))  # least squares
    matrix = np.einsum(
        "mx,mn->nxm", np.vstack([s.C_s, s.C_b]) @ s.nodes, np.vstack([s.C_s, s.C_b])
    ).reshape(18, 12)
    lam = np.linalg.lstsq(-matrix[:, 9:], -matrix[:, :9] @ np.linspace(1.0, 9.0, 9), rcond=None)[0]
    np.testing.assert_allclose(
        unbalanced.bar_rest_length, s.bar_lengths * (1 + lam / 1e4), rtol=1e-12
    )


def test_force_densities_of_rigid_bars_are_ignored():
    s = tc.shapes.prism()
    stress = 10.0 * tc.self_stress(s)[0] / tc.self_stress(s)[0, 0]
    both, strings = s.prestressed(stress), s.prestressed(stress[:9])
    np.testing.assert_array_equal(both.rest_length, strings.rest_length)
    np.testing.assert_array_equal(both.bar_rest_length, s.bar_lengths)


def test_unattainable_force_densities_of_bars_are_rejected():
    s, stress = stressed()
    stress[9:] = -2e4  # tension that no stretch from a positive rest length reaches
    with pytest.raises(ValueError, match=r"force_density of bar 0 is -20000 N/m"):
        s.prestressed(stress)
    with pytest.raises(ValueError, match=r"give \(9,\) for strings or \(12,\)"):
        s.prestressed(np.ones(10))


def test_unreadable_force_densities_are_refused_by_name():
    class Unreadable:
        def __array__(self, *_: object, **__: object) -> np.ndarray:
            raise RuntimeError("broken")

    with pytest.raises(TypeError, match="force_density is not"):
        tc.stability(tc.shapes.prism(), force_density=Unreadable())


def test_shapes_prestress_their_elastic_bars():
    s = tc.shapes.prism(prestress=10.0, bar_stiffness=1e4)
    np.testing.assert_allclose(s.bar_rest_length / s.bar_lengths, 1 + 10 * 3**0.5 / 1e4, rtol=1e-12)
    with pytest.raises(ValueError, match="prestress and bar_rest_length are both given"):
        tc.shapes.prism(prestress=10.0, bar_stiffness=1e4, bar_rest_length=1.0)


@pytest.mark.parametrize("ending", ["toml", "json"])
def test_scene_files_hold_elastic_bars(ending, tmp_path):
    s = tc.shapes.prism(prestress=10.0, bar_stiffness=[1e4, np.inf, 2e4])
    path = tmp_path / f"prism.{ending}"
    tc.save_scene(tc.Scene(s), path)
    again = tc.load_scene(path).structure
    np.testing.assert_array_equal(again.bar_stiffness, s.bar_stiffness)
    np.testing.assert_array_equal(again.bar_rest_length, s.bar_rest_length)


def test_scene_files_name_elastic_groups(tmp_path):
    path = tmp_path / "frame.toml"
    path.write_text(
        """
format = 1
units = "SI"

[structure]
nodes = {a = [0, 0, 0], b = [1, 0, 0], c = [0, 1, 0]}

[structure.bars]
soft = {members = [["a", "b"]], bar_stiffness = 1e3, bar_rest_length = 1.1}
hard = {members = [["b", "c"]]}
"""
    )
    s = tc.load_scene(path).structure
    assert s.bar_stiffness.tolist() == [1e3, np.inf]
    assert s.bar_rest_length[0] == 1.1


def test_matlab_files_hold_elastic_bars(tmp_path):
    s = tc.shapes.prism(bar_stiffness=[1e4, np.inf, 2e4], bar_rest_length=1.3)
    again = tc.load_mat(tc.save_mat(s, tmp_path / "prism.mat"))
    np.testing.assert_array_equal(again.bar_stiffness, s.bar_stiffness)
    np.testing.assert_array_equal(again.bar_rest_length, s.bar_rest_length)
    with pytest.raises(ValueError, match="bar_stiffness of bar 0"):
        tc.save_mat(s, tmp_path / "motes.mat", class_one=True)


def test_mujoco_has_rigid_bars_only(tmp_path):
    with pytest.raises(ValueError, match=r"bar_stiffness of bar 0.*bar_stiffness=None"):
        tc.export_mjcf(tc.Scene(tc.shapes.prism(bar_stiffness=1e4)), tmp_path / "x.xml")

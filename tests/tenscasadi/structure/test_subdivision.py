"""Strings in segments: where their nodes, mass, stiffness and rest lengths go."""

from __future__ import annotations

import numpy as np
import pytest
from structures import DATA, chain, from_peer, peer

from tenscasadi.structure.structure import Structure


def test_string_nodes_of_the_subdivided_prism_are_those_of_the_peer() -> None:
    parent = from_peer(peer(DATA / "motes" / "px_prism_seg01.npz"))
    for segments, mass in ((2, 0.04), (5, 0.04)):
        child = parent.replace(string_mass=mass).subdivide(segments)
        d = peer(DATA / "motes" / f"px_prism_seg0{segments}.npz")
        split = child.class_one()
        np.testing.assert_allclose(split.N, d["N0"], atol=1e-15)
        np.testing.assert_array_equal(split.C_s, d["C_s"])
        np.testing.assert_allclose(split.M_s, d["M"], atol=1e-16)
        np.testing.assert_allclose(child.stiffness, d["k"])
        np.testing.assert_allclose(child.rest_length, d["s0"], rtol=1e-14)
        np.testing.assert_array_equal(child.string_parent, d["string_parents_1based"].ravel() - 1)


@pytest.mark.parametrize("ends", ["interior", "lumped"])
@pytest.mark.parametrize("fractions", [None, (0.2, 0.5, 0.3)])
def test_subdivision(ends: str, fractions: tuple[float, ...] | None) -> None:
    s = chain(string_mass=[0.3, 0.6, 0.9], rest_length=[1.0, 1.1, 1.2])
    cut = s.subdivide(3, ends, fractions)
    assert len(cut.nodes) == 5 + 6
    assert len(cut.strings) == 9
    np.testing.assert_array_equal(cut.nodes[:5], s.nodes)
    np.testing.assert_allclose(cut.node_mass.sum(), s.node_mass.sum() + 1.8, rtol=1e-14)
    assert not cut.string_mass.any()
    np.testing.assert_array_equal(cut.string_parent, [0, 0, 0, 1, 1, 1, 2, 2, 2])
    np.testing.assert_allclose(cut.string_fraction, np.tile(fractions or [1 / 3] * 3, 3))
    for i in range(3):
        part = cut.string_parent == i
        assert 1 / np.sum(1 / cut.stiffness[part]) == pytest.approx(
            s.stiffness[i], rel=1e-14
        )  # springs and dashpots in series
        assert 1 / np.sum(1 / cut.damping[part]) == pytest.approx(s.damping[i], rel=1e-14)
        assert cut.rest_length[part].sum() == pytest.approx(s.rest_length[i], rel=1e-14)
        path = cut.strings[part]
        assert path[0, 0] == s.strings[i, 0]
        assert path[-1, 1] == s.strings[i, 1]
        np.testing.assert_array_equal(path[1:, 0], path[:-1, 1])
        np.testing.assert_allclose(
            cut.string_lengths[part], s.string_lengths[i] * cut.string_fraction[part], rtol=1e-14
        )
        inner = path[1:, 0]
        f = cut.string_fraction[part]
        if ends == "interior":
            np.testing.assert_allclose(cut.node_mass[inner], s.string_mass[i] / 2)
        else:
            np.testing.assert_allclose(
                cut.node_mass[inner], s.string_mass[i] * 0.5 * (f[1:] + f[:-1])
            )
    if ends == "interior":
        np.testing.assert_array_equal(cut.node_mass[:5], s.node_mass)


def test_lumped_mass_of_equal_segments() -> None:
    s = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], string_mass=0.6, pinned=[0])
    np.testing.assert_allclose(
        s.subdivide(3, ends="lumped").node_mass, [0.1, 0.1, 0.2, 0.2]
    )  # m/2n at the ends, m/n inside
    np.testing.assert_allclose(s.subdivide(1, ends="lumped").node_mass, [0.3, 0.3])


def test_segments_per_string_and_once_more() -> None:
    s = chain(string_mass=0.3)
    cut = s.subdivide([1, 2, 3])
    np.testing.assert_array_equal(cut.string_parent, [0, 1, 1, 2, 2, 2])
    twice = s.subdivide(2, ends="lumped").replace(string_mass=0.1).subdivide(2)
    np.testing.assert_array_equal(
        twice.string_parent, np.repeat([0, 1, 2], 4)
    )  # always the first parent
    np.testing.assert_allclose(twice.string_fraction, 0.25)
    np.testing.assert_allclose(twice.stiffness, np.repeat(s.stiffness, 4) * 4)
    massless = chain()
    assert massless.subdivide(1) is massless
    assert not chain(string_mass=1.0).subdivide(1).string_mass.any()


def test_results_of_segments_are_read_per_parent_string() -> None:
    s = chain(string_mass=0.3)
    cut = s.subdivide(3, fractions=[0.5, 0.25, 0.25])
    tension = np.arange(18.0).reshape(2, 9)
    mean = cut.parent_mean(tension)
    assert mean.shape == (2, 3)
    assert mean[1, 2] == pytest.approx(0.5 * 15 + 0.25 * 16 + 0.25 * 17)
    np.testing.assert_allclose(s.parent_mean([1.0, 2.0, 3.0]), [1, 2, 3])
    with pytest.raises(ValueError, match="values has shape"):
        cut.parent_mean(np.zeros(3))

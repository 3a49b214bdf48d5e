"""Structure: inertia, pins, prestress, immutability, and no other outcome than built or refused."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from structures import PEERS, chain, from_peer, peer

from tenscasadi.structure import shapes
from tenscasadi.structure.structure import PARAMETERS, Structure


def test_inertia_of_a_thick_bar() -> None:
    s = Structure([(0, 0, 0), (0, 0, 2)], [(0, 1)], bar_mass=3.0, bar_radius=0.5)
    assert s.bar_inertia == pytest.approx([3 / 12 + 3 * 0.25 / 16])  # Eq. 19
    rod = (
        3.0 * 2.0**2 / 12 + 3.0 * 0.25 / 4
    )  # moment of a solid cylinder about a diameter through its centre
    assert s.bar_inertia[0] * 2.0**2 == pytest.approx(rod)


def test_prestress_gives_the_force_density() -> None:
    s = chain()
    gamma = np.array([0.0, 5.0, 29.0])
    tight = s.prestressed(gamma)
    np.testing.assert_allclose(
        tight.stiffness * (1 - tight.rest_length / tight.string_lengths), gamma, atol=1e-13
    )
    np.testing.assert_array_equal(
        chain(stiffness=0.0).prestressed(0.0).rest_length, s.string_lengths
    )


def test_replace_keeps_the_rest() -> None:
    s = chain(string_mass=0.3).subdivide(2)
    new = s.replace(stiffness=7.0)
    assert np.all(new.stiffness == 7.0)
    np.testing.assert_array_equal(new.string_parent, s.string_parent)
    np.testing.assert_array_equal(new.rest_length, s.rest_length)
    assert dict(new.pinned) == {0: "xyz", 2: "z"}
    moved = s.replace(nodes=s.nodes * 2)
    np.testing.assert_array_equal(moved.rest_length, s.rest_length)
    np.testing.assert_array_equal(moved.class_one().N, 2 * s.class_one().N)


def test_pins_and_fixed_coordinates() -> None:
    s = chain()
    assert s.fixed.sum() == 4
    assert s.fixed[0].all()
    assert s.fixed[2].tolist() == [False, False, True]
    assert s.class_one().P.shape[1] == 3  # two ties and the full pin: N P = D cannot hold one axis


def test_a_structure_does_not_change() -> None:
    s = chain(string_mass=0.3)
    for value in (s, s.subdivide(2), s.replace(damping=0.0), from_peer(peer(PEERS[0]))):
        with pytest.raises(AttributeError, match=r"replace\(stiffness="):
            value.stiffness = np.zeros(3)
        for name, array in vars(value).items():
            if isinstance(array, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 0
                assert not array.flags.writeable, name
        with pytest.raises(TypeError):
            value.pinned[1] = "x"  # type: ignore[index]
    assert repr(chain()) == "Structure(5 nodes, 3 bars, 3 strings, 2 pinned)"


def test_input_arrays_are_copied() -> None:
    nodes = np.array([(0.0, 0, 0), (1, 0, 0)])
    s = Structure(nodes, [(0, 1)])
    nodes[1, 0] = 5.0
    assert s.nodes[1, 0] == 1.0
    assert nodes.flags.writeable


def test_a_pinned_or_massive_node_of_no_bar_is_accepted() -> None:
    nodes = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    s = Structure(
        nodes, strings=[(0, 1), (1, 2)], pinned=[0], node_mass=[0, 0, 1.0], string_mass=[0.0, 0.2]
    )
    assert s.subdivide(1, ends="lumped").node_mass.tolist() == [0.0, 0.1, 1.1]
    with pytest.raises(ValueError, match="node_mass of node 1"):
        s.subdivide(1)  # the paper's way leaves node 1 without mass


def test_many_members_are_built_quickly_and_sparsely() -> None:
    s = shapes.membrane(60, 60)
    split = s.class_one(sparse=True)
    assert split.C_s.nnz == 2 * len(s.strings)
    assert split.M_s.nnz == 3600


JUNK = st.one_of(
    st.floats(),
    st.integers(-3, 5),
    st.sampled_from(
        [
            0.0,
            1e-300,
            1e300,
            5e-324,
            -1.0,
            1e99,
            1e-160,
            True,
            None,
            "x",
            b"1",
            1j,
            (0, 1),
            {0: "y"},
            {1: "xx"},
            {0: 3},
            object(),
        ]
    ),
    st.text(max_size=2),
)


ANYTHING = st.one_of(
    JUNK, st.lists(JUNK, max_size=4), st.lists(st.lists(JUNK, max_size=4), max_size=3)
)


POSITIVE = st.one_of(
    st.floats(0.1, 10.0), st.floats(1e-100, 1e100), st.floats(0.0, exclude_min=True)
)


@st.composite
def keywords(draw: st.DrawFn) -> dict[str, Any]:
    """Keywords of a structure that may well be sound, with up to two of them replaced by anything at all."""
    n = draw(st.integers(1, 5))
    pair = st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True)
    pairs = st.lists(pair, max_size=4, unique_by=frozenset) if n > 1 else st.just([])
    size = draw(st.sampled_from([1.0, 1.0, 1e-3, 1e90, 1e-60]))
    point = st.tuples(
        *[
            st.integers(-3, 3).map(lambda i: i * size),
            st.floats(-size, size),
            st.floats(-size, size),
        ]
    )
    found: dict[str, Any] = {
        "nodes": draw(st.lists(point, min_size=n, max_size=n)),
        "bars": draw(pairs),
        "strings": draw(pairs),
        "bar_mass": draw(POSITIVE),
        "bar_radius": size * draw(st.floats(0.0, 2.0)),
        "node_mass": draw(st.lists(POSITIVE, min_size=n, max_size=n)),
        "pinned": draw(
            st.dictionaries(st.integers(0, n - 1), st.sampled_from(["x", "yx", "zyx"]), max_size=2)
        ),
    }
    for name in draw(st.lists(st.sampled_from(PARAMETERS), max_size=2)):
        found[name] = draw(ANYTHING)
    return found


@settings(max_examples=150, deadline=None)
@given(keywords())
def test_anything_is_refused_or_gives_a_sound_structure(found: dict[str, Any]) -> None:
    try:
        s = Structure(**found)
    except (TypeError, ValueError) as error:
        named = str(error)
        refused = True
    else:
        refused = False
    if refused:
        assert re.match(r"\w+", named)[0] in PARAMETERS, named  # type: ignore[index]
        return
    for array in (s.bar_lengths, s.string_lengths, s.rest_length):
        assert np.all(np.isfinite(array) & (array > 0))
    M = s.mass_matrix().toarray()
    for axis in range(3):
        free = ~s.fixed[:, axis] & ~np.isin(
            np.arange(len(M)), s.strings[s.string_mass > 0]
        )  # a string's mass is on no node yet
        kept = M[np.ix_(free, free)]
        if kept.size:
            scale = 1 / np.sqrt(np.diag(kept))
            assert np.all(np.isfinite(scale))
            assert np.linalg.eigvalsh(scale[:, None] * kept * scale).min() > 1e-8
    split = s.class_one()
    assert np.all(split.N @ split.P == split.D)

"""Input of cables, and their inputs."""

from __future__ import annotations

import copy
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import tenscasadi as tc
from tenscasadi.structure.cables import find_directions, wrap_angles


def chain(count: int = 5, **options: object) -> tc.Structure:
    """Nodes along x, with a string between neighbors and a lone one from the first to the last."""
    nodes = [(k, 0.1 * k * k, 0) for k in range(count)]
    strings = [(k, k + 1) for k in range(count - 1)] + [(0, count - 1)]
    return tc.Structure(nodes, strings=strings, node_mass=1.0, pinned=[0], **options)


def test_strings_are_their_own_inputs_without_cables():
    s = chain()
    assert s.cables == ()
    assert s.cable_friction.shape == (0,)
    assert s.cable_of.tolist() == [0, 1, 2, 3, 4]
    assert "cable" not in repr(s)


def test_inputs_are_ordered_by_first_strings():
    s = chain(cables=[[3, 2], [0, 1]])
    assert s.cable_of.tolist() == [0, 0, 1, 1, 2]
    assert chain(cables=[[2, 1, 0]]).cable_of.tolist() == [0, 0, 0, 1, 2]
    assert chain(cables=[[0, 1]], cable_friction=0.2).cable_friction.tolist() == [0.2]
    assert "1 cable," in repr(chain(cables=[[0, 1]]))
    assert "2 cables," in repr(s)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cables": [[0, 2]]}, "give strings that meet end to end"),
        ({"cables": [[0, 1, 3]]}, "string 3 joins nodes 3 and 4"),
        ({"cables": [[0, 1], [1, 2]]}, "string 1, which is in cables\\[0\\] already"),
        ({"cables": [[0, 1, 0]]}, "string 0, which is in cables\\[0\\] already"),
        ({"cables": [[]]}, "cables\\[0\\] is empty"),
        ({"cables": [[0, 5]]}, "string indices run from 0 to 4"),
        ({"cables": [[0, 1]], "cable_friction": -0.1}, "cable_friction of cable 0 is -0.1"),
        ({"cables": [[0, 1]], "cable_friction": [0.1, 0.2]}, "cable_friction has shape"),
        ({"cables": [[0, 1]], "damping": [1, 0, 1, 1, 1]}, "damping of string 1 is 0"),
    ],
)
def test_wrong_cables_are_rejected(options, message):
    with pytest.raises(ValueError, match=message):
        chain(**options)


@pytest.mark.parametrize("cables", [[0, 1], "01", 3, [[0.0, 1.0]], [[True, 1]]])
def test_cables_of_other_types_are_rejected(cables):
    with pytest.raises(TypeError, match="cables"):
        chain(cables=cables)


@given(st.data())
def test_any_path_is_followed(data):
    """Strings of a random walk meet end to end, whatever their directions are."""
    count = data.draw(st.integers(2, 6))
    walk = data.draw(
        st.lists(st.integers(0, count - 1), min_size=2, max_size=8).filter(
            lambda nodes: all(a != b for a, b in itertools.pairwise(nodes))
        )
    )
    turned = data.draw(st.lists(st.booleans(), min_size=len(walk), max_size=len(walk)))
    pairs = list(itertools.pairwise(walk))
    strings = np.array(
        [pair[::-1] if turn else pair for pair, turn in zip(pairs, turned, strict=False)]
    )
    path = find_directions(strings, range(len(strings)))
    assert all(a[1] == b[0] for a, b in itertools.pairwise(path))
    assert [sorted(step) for step in path] == [sorted(pair) for pair in pairs]


def test_cables_pass_a_node_twice_and_close_in_a_loop():
    triangle = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    for strings in ([(0, 1), (1, 2), (2, 0)], [(0, 1), (1, 2), (2, 1)]):
        s = tc.Structure(
            triangle,
            strings=strings,
            node_mass=1.0,
            rest_length=0.9,
            cables=[[0, 1, 2]],
            cable_friction=0.2,
        )
        angles = wrap_angles(s, s.cables[0])
        assert angles[0] == pytest.approx(0.75 * np.pi)
        assert angles[1] == pytest.approx(0.75 * np.pi if strings[2] == (2, 0) else np.pi)
        tension = tc.simulate(tc.Model(tc.Scene(s)), 0.01, 1e-3, compiled=False).tension
        assert np.ptp(tension[0]) < 1e-9  # at rest
        assert tension.min() > 0


def test_copies_keep_cables():
    s = chain(cables=[[0, 1], [2, 3]], cable_friction=[0.1, 0.0])
    for same in (s.replace(node_mass=2.0), copy.deepcopy(s)):
        assert same.cables == s.cables
        assert same.cable_friction.tolist() == [0.1, 0.0]
        assert same.cable_of.tolist() == s.cable_of.tolist()


def test_subdivision_keeps_cables_whole():
    s = chain(string_mass=0.1, cables=[[1, 2]])
    parts = s.subdivide([2, 1, 1, 3, 1])
    assert parts.cables == ((2, 3),)
    assert parts.cable_of.tolist() == [0, 1, 2, 2, 3, 4, 5, 6]
    with pytest.raises(ValueError, match="segments of string 1 is 2: give 1"):
        s.subdivide(2)


def test_scene_rejects_force_densities_and_two_laws_of_a_cable():
    s = chain(cables=[[0, 1]])
    with pytest.raises(ValueError, match="give Tension\\(\\) or RestLength\\(\\)"):
        tc.Scene(s, control=tc.ForceDensity())
    with pytest.raises(ValueError, match="give one law to strings \\[0, 1\\]"):
        tc.Scene(s, slack={0: tc.Linear()})
    assert tc.Scene(s, slack={0: tc.Linear(), 1: tc.Linear()}).nu == 0

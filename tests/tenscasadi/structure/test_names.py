"""Names of nodes, bars and strings: checked, kept by copies, and understood as groups."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.structure.names import add_names

NODES = [(0, 0, 0), (0, 0, 1), (1, 0, 1)]


def mast(**names):
    return tc.Structure(
        NODES, bars=[(0, 1)], strings=[(1, 2), (2, 0)], node_mass=1.0, pinned=[0], **names
    )


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"node_names": ["foot", "top"]}, "node_names has 2 entries: give 3"),
        ({"node_names": ["foot", "top", "7"]}, "an index, too"),
        ({"node_names": ["foot", "top", "foot"]}, "again: give unique names"),
        ({"bar_names": [3]}, "bar_names is 3: give text"),
        ({"string_names": "guys"}, "give a list"),
    ],
)
def test_wrong_names_are_rejected(names, words):
    with pytest.raises((TypeError, ValueError), match=words):
        mast(**names)


def test_copies_keep_names():
    named = mast(node_names=["foot", "top", ""], string_names=["guy", "tie"], bar_names=["mast"])
    assert named.replace(bar_mass=3.0).node_names == ("foot", "top", "")
    new = {"stiffness": 9.0, "damping": 0.0, "rest_length": 1.0, "string_mass": 0.0}
    assert named.prestressed(1.0).string_names == ("guy", "tie")
    assert named.replace(strings=[(1, 2), (2, 0), (0, 1)], **new).string_names == ()
    parts = named.replace(string_mass=0.1).subdivide([2, 1], "lumped")
    assert parts.node_names == ("foot", "top", "", "")
    assert parts.string_names == ("guy[0]", "guy[1]", "tie")
    assert parts.names.find("string", "guy") == [0, 1]


def test_groups_are_found_by_the_names_of_their_members():
    names = tc.shapes.prism(4).names
    assert names.find("string", "vertical") == [8, 9, 10, 11]
    assert names.find("string", "top[2]") == [6]
    assert names.find("node", "top") == [4, 5, 6, 7]
    assert names.find("node", 3) == [3]
    with pytest.raises(ValueError, match="did you mean 'bottom'"):
        names.find("node", "bottm")


@pytest.mark.parametrize("field", ["pinned", "bars", "strings", "cables"])
@pytest.mark.parametrize("endless", [range(10**9), itertools.count()])
def test_endless_lists_are_rejected_by_field(field, endless):
    with pytest.raises(ValueError, match=f"^{field} has more than 100000 entries"):
        tc.Structure([(0, 0, 0), (1, 0, 0)], **{field: endless})


def test_messages_show_names_beside_indices():
    structure = tc.Structure(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [(0, 1)],
        [(1, 2)],
        node_mass=1.0,
        node_names=["foot", "", "top"],
        string_names=["guy"],
    )
    assert add_names("nodes 0, 1 and 2 meet, strings 0 and 7 too, 2 m of bar 0.5", structure) == (
        "nodes 0, 1 and 2 meet, strings 0 and 7 too, 2 m of bar 0.5 "
        "(node 0: foot, node 2: top, string 0: guy)"
    )
    text = "bar 0, node 0 z, node 1, node 2 and string 0 of 9, string 7, string 0 (guy)"
    assert add_names(text, structure) == (
        "bar 0, node 0 z, node 1, node 2 and string 0 of 9, string 7, string 0 (guy) "
        "(node 0: foot, node 2: top, string 0: guy)"
    )


NAMED = mast(node_names=["foot", "top", "far"], string_names=["guy", "tie"], bar_names=["mast"])


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: NAMED.replace(stiffness=[1.0, -1.0]), "(string 1: tie)"),
        (lambda: NAMED.replace(node_mass=0.0), "(node 2: far)"),
        (lambda: NAMED.replace(bar_stiffness=[-1.0]), "(bar 0: mast)"),
        (lambda: NAMED.prestressed([1e6, 1.0]), "(string 0: guy)"),
        (lambda: NAMED.subdivide(2), "(string 0: guy)"),
        (lambda: tc.Scene(NAMED, supports=tc.SupportMotion({1: (0, 0, 1)})), "(node 1: top)"),
        (lambda: tc.Model(tc.Scene(NAMED)).state(NAMED.nodes + 1.0), "(node 0: foot)"),
        (lambda: tc.find_equilibrium(NAMED_SCENE, start=NAMED.nodes + 1.0), "(node 0: foot)"),
        (lambda: tc.find_prestress(NAMED, minimum=2.0, maximum=1.0), "(string 0: guy)"),
        (lambda: tc.equilibrium_force_density(NAMED, minimum=[1.0, -1.0]), "(string 1: tie)"),
        (lambda: tc.form_find(NAMED, positions={"foot": (1, 0, 0)}), "(node 0: foot)"),
    ],
)
def test_errors_show_names_beside_indices(call, names):
    with pytest.raises(ValueError, match=re.escape(names)) as raised:
        call()
    assert str(raised.value).endswith(names)
    assert str(raised.value).count(names[1:-1]) == 1


NAMED_SCENE = tc.Scene(NAMED)


def test_warnings_show_names_beside_indices():
    nodes = [(0, 0, 0), (1, 0, 0), (0.5, 0, 0)]
    line = tc.Structure(nodes, bars=[(0, 2), (2, 1)], pinned=[0, 1], bar_names=["left", "right"])
    with pytest.warns(match=r"\(bar 0: left, bar 1: right\)"):
        tc.Model(tc.Scene(line))


def test_loads_are_given_by_name_or_index():
    top = np.array([(0.0, 0, 0), (0, 0, -5), (0, 0, 0)])
    by_name = tc.NodalForce({"top": (0, 0, -5)})
    assert np.array_equal(tc.Scene(NAMED, forces=by_name).forces.values, top)
    over_time = tc.NodalForce({1: np.outer([0, 1], [0, 0, -5])}, times=[0.0, 1.0])
    assert np.array_equal(tc.Scene(NAMED, forces=over_time).forces.values, [0 * top, top])
    held = NAMED.replace(pinned=[0, 2]).prestressed(1.0)
    state = tc.stability(held)
    for load in ({"top": (0, 0, -5)}, {1: (0, 0, -5)}, by_name):
        assert np.array_equal(state.displacement(load), state.displacement(top))
    with pytest.raises(ValueError, match="did you mean 'top'"):
        tc.Scene(NAMED, forces=tc.NodalForce({"tpo": (0, 0, -5)}))
    with pytest.raises(ValueError, match="has shape"):
        tc.NodalForce({"top": (0, -5)})

"""Structure: the paper's matrices both ways, mass, subdivision, prestress, immutability, and no other outcome than built or refused."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array

from tenscasadi.structure import shapes
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.structure import PARAMETERS, Structure

DATA = Path(__file__).parents[3] / "tests" / "data"
PEERS = [p for p in sorted((DATA / "motes").glob("*.npz")) if "analytical" not in p.stem]


def peer(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def from_peer(d: dict[str, np.ndarray]) -> Structure:
    columns = d["N0"].shape[1]
    mass = np.zeros(columns)
    mass[columns - len(d["m_string_node"]) :] = d["m_string_node"]
    return Structure.from_matrices(
        d["N0"], d["C_b"], d["C_s"], d["P"], d["D"], node_mass=mass, bar_mass=d["m_bar"], stiffness=d["k"], damping=d["c"], rest_length=d["s0"]
    )


def chain(**options: Any) -> Structure:
    """Three bars meeting in node 1, a string node 4, pins at 0 and (one axis) 2; every number different."""
    nodes = [(0, 0, 0), (1, 0.2, 0.1), (2, 0, 0.3), (1, 1, 0), (0.5, 0.5, 1.0)]
    found: dict[str, Any] = {
        "bars": [(1, 0), (2, 1), (1, 3)],
        "strings": [(0, 3), (3, 4), (4, 1)],
        "bar_mass": [1.0, 2.0, 3.0],
        "bar_radius": [0.0, 0.1, 0.2],
        "node_mass": [0.0, 0.5, 0.0, 0.0, 0.25],
        "pinned": {0: "zyx", 2: "z"},
        "stiffness": [10.0, 20.0, 30.0],
        "damping": [0.1, 0.2, 0.3],
    }
    return Structure(nodes, **{**found, **options})


STRUCTURES = {
    "chain": chain(),
    "prism": shapes.prism(5),
    "d_bar": shapes.d_bar(pinned=[0]),
    "t_bar": shapes.t_bar(),
    "membrane": shapes.membrane(4, 3),
    "ball": shapes.six_bar_ball(bar_radius=0.05),
}


def test_there_are_peers() -> None:
    assert len(PEERS) == 11


@pytest.mark.parametrize("path", PEERS, ids=lambda p: p.stem)
def test_matrices_of_the_peer_come_back(path: Path) -> None:
    d = peer(path)
    s = from_peer(d)
    split = s.class_one()
    np.testing.assert_allclose(split.N, d["N0"], atol=1e-15)
    np.testing.assert_array_equal(split.P, d["P"])
    np.testing.assert_array_equal(split.D, d["D"])
    np.testing.assert_array_equal(split.C_s, d["C_s"])
    np.testing.assert_array_equal(split.C_b @ split.C_nb, d["C_b"])
    np.testing.assert_allclose(split.M_s, d["M"], rtol=1e-15, atol=1e-16)


@pytest.mark.parametrize(
    ("case", "pinned"),
    [("ex00_double_pendulum", [0]), ("ex02_dbar", [0]), ("ex03_dbar_unit", [0]), ("ex04_pendulum", [0]), ("ex05_xframe_dt1e-4", [0, 1])],
)
def test_ties_merge_and_pins_pin(case: str, pinned: list[int]) -> None:
    d = peer(DATA / "motes" / f"{case}.npz")
    s = from_peer(d)
    assert dict(s.pinned) == dict.fromkeys(pinned, "xyz")
    np.testing.assert_array_equal(s.nodes, d["pre_N"].T)  # the peer's own nodes before it split them, order of first appearance
    np.testing.assert_array_equal(s.C_b, d["pre_C_b"])
    np.testing.assert_array_equal(s.C_s, d["pre_C_s"])


def test_mass_of_physical_nodes_is_the_merged_class_one_mass() -> None:
    for name, s in STRUCTURES.items():
        split = s.class_one()
        E = np.eye(len(s.nodes))[split.physical]  # n'×n
        np.testing.assert_allclose(s.mass_matrix().toarray(), E.T @ split.M_s @ E, rtol=1e-14, atol=1e-15, err_msg=name)
        np.testing.assert_allclose(s.mass_matrix().sum(), s.bar_mass.sum() + s.node_mass.sum(), rtol=1e-14)


@pytest.mark.parametrize("name", STRUCTURES)
def test_identities_of_the_split(name: str) -> None:
    s = STRUCTURES[name]
    c = s.class_one()
    beta, columns = len(s.bars), c.N.shape[1]
    Nb, Ns = c.N @ c.C_nb.T, c.N @ c.C_ns.T
    B = (s.nodes[s.bars[:, 1]] - s.nodes[s.bars[:, 0]]).T
    R = 0.5 * (s.nodes[s.bars[:, 1]] + s.nodes[s.bars[:, 0]]).T
    string_nodes = np.setdiff1d(np.arange(len(s.nodes)), s.bars)
    np.testing.assert_array_equal(c.N, s.nodes[c.physical].T)
    np.testing.assert_array_equal(np.vstack([c.C_nb, c.C_ns]), np.eye(columns))  # Eqs. 61, 62
    np.testing.assert_allclose(Nb @ c.C_r.T, R, atol=1e-15)  # Eq. 63
    np.testing.assert_array_equal(Ns, s.nodes[string_nodes].T)  # Eq. 64
    np.testing.assert_allclose(Nb @ c.C_b.T, B, atol=1e-15)  # Eq. 65
    np.testing.assert_allclose(c.N @ c.C_s.T, (s.nodes[s.strings[:, 1]] - s.nodes[s.strings[:, 0]]).T, atol=1e-15)  # Eq. 66
    np.testing.assert_allclose(c.N @ c.P, c.D, atol=1e-15)  # Eq. 84
    np.testing.assert_allclose(c.N[:, :beta], s.nodes[s.bars[:, 0]].T)  # first ends, then second ends, then string nodes
    np.testing.assert_allclose(c.N[:, beta : 2 * beta], s.nodes[s.bars[:, 1]].T)
    ends = np.bincount(s.bars.ravel(), minlength=len(s.nodes))
    full_pins = [node for node, axes in s.pinned.items() if axes == "xyz"]
    assert c.P.shape[1] == np.maximum(ends - 1, 0).sum() + len(full_pins)
    assert c.P.size == 0 or np.linalg.matrix_rank(c.P) == c.P.shape[1]
    ties = c.P.shape[1] - len(full_pins)
    assert np.all(np.diff(c.physical[np.argmax(c.P, axis=0)[:ties]]) >= 0)  # in node order, and the pins too
    np.testing.assert_array_equal(c.physical[np.argmax(c.P, axis=0)[ties:]], full_pins)
    assert np.all(np.sum(c.P[:, :ties] == -1, axis=0) == 1)
    assert not np.any(c.P[:, ties:] < 0)
    J, m = np.diag(s.bar_inertia), np.diag(s.bar_mass)
    M_b = c.C_b.T @ J @ c.C_b + c.C_r.T @ m @ c.C_r
    point = np.zeros(columns)
    for node in range(len(s.nodes)):
        point[np.flatnonzero(c.physical == node)[0]] = s.node_mass[node]
    np.testing.assert_allclose(c.M_s, c.C_nb.T @ M_b @ c.C_nb + np.diag(point), atol=1e-15)  # Eq. 81, with masses on bar ends


@pytest.mark.parametrize("name", ["prism", "d_bar", "ball"])
def test_inverse_mass_of_a_bar_in_closed_form(name: str) -> None:
    s = STRUCTURES[name]
    inverse = np.linalg.inv(s.class_one().M_s)
    beta = len(s.bars)
    expected = np.zeros((2 * beta, 2 * beta))
    for k, (m, J) in enumerate(zip(s.bar_mass, s.bar_inertia, strict=True)):
        expected[k, k] = expected[beta + k, beta + k] = 1 / m + 1 / (4 * J)
        expected[k, beta + k] = expected[beta + k, k] = 1 / m - 1 / (4 * J)
    np.testing.assert_allclose(inverse, expected, rtol=1e-12, atol=1e-14)


def test_inertia_of_a_thick_bar() -> None:
    s = Structure([(0, 0, 0), (0, 0, 2)], [(0, 1)], bar_mass=3.0, bar_radius=0.5)
    assert s.bar_inertia == pytest.approx([3 / 12 + 3 * 0.25 / 16])  # Eq. 19
    rod = 3.0 * 2.0**2 / 12 + 3.0 * 0.25 / 4  # moment of a solid cylinder about a diameter through its centre
    assert s.bar_inertia[0] * 2.0**2 == pytest.approx(rod)


@pytest.mark.parametrize("name", STRUCTURES)
def test_round_trip_through_the_paper_matrices(name: str) -> None:
    s = STRUCTURES[name]
    c = s.class_one()
    mass = np.diag(c.M_s - c.C_nb.T @ (c.C_b.T @ np.diag(s.bar_inertia) @ c.C_b + c.C_r.T @ np.diag(s.bar_mass) @ c.C_r) @ c.C_nb)
    back = Structure.from_matrices(
        c.N, c.C_b @ c.C_nb, c.C_s, c.P, c.D, node_mass=np.maximum(mass, 0.0), bar_mass=s.bar_mass, bar_radius=s.bar_radius, stiffness=s.stiffness
    )
    order = np.array([np.flatnonzero(c.physical == node)[0] for node in range(len(s.nodes))]).argsort()  # order of first appearance
    np.testing.assert_array_equal(back.nodes, s.nodes[order])
    np.testing.assert_array_equal(order[back.bars], s.bars)
    np.testing.assert_array_equal(order[back.strings], s.strings)
    assert {int(order[node]) for node in back.pinned} == {node for node, axes in s.pinned.items() if axes == "xyz"}
    again = back.class_one()
    for field in ("N", "C_b", "C_s", "C_r", "C_nb", "C_ns", "P", "D"):
        np.testing.assert_array_equal(getattr(again, field), getattr(c, field), err_msg=field)
    np.testing.assert_allclose(again.M_s, c.M_s, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", STRUCTURES)
def test_sparse_split_is_the_dense_one(name: str) -> None:
    dense, sparse = STRUCTURES[name].class_one(), STRUCTURES[name].class_one(sparse=True)
    for field in ("C_b", "C_s", "C_r", "C_nb", "C_ns", "P", "M_s"):
        np.testing.assert_array_equal(getattr(sparse, field).toarray(), getattr(dense, field), err_msg=field)
    np.testing.assert_array_equal(sparse.N, dense.N)


@pytest.mark.parametrize(
    ("case", "nodes", "pinned"), [("double_pendulum", 3, [0]), ("dbar_regular", 4, [1]), ("redundant_triangle", 4, [0, 1])], ids=lambda v: str(v)
)
def test_joints_of_the_certified_cases(case: str, nodes: int, pinned: list[int]) -> None:
    spec = json.loads((DATA / "certified" / f"{case}.json").read_text())["spec"]
    N = np.array(spec["nodes"]).T
    C_b, C_s = (connectivity(np.array(spec[key], dtype=np.intp).reshape(-1, 2), N.shape[1]) for key in ("bars", "strings"))
    P = csr_array(np.array(spec["P"]))
    s = Structure.from_matrices(N, C_b, C_s, P, spec["D"], node_mass=spec.get("point_mass", 0.0))  # sparse, as they grow
    assert len(s.nodes) == nodes
    assert dict(s.pinned) == dict.fromkeys(pinned, "xyz")
    split = s.class_one()
    np.testing.assert_array_equal(split.P, spec["P"])
    np.testing.assert_allclose(split.N, N, atol=1e-15)
    np.testing.assert_array_equal(split.C_b @ split.C_nb, C_b.toarray())


def test_matrices_with_shared_columns_are_split() -> None:
    d = peer(DATA / "motes" / "ex02_dbar.npz")
    s = Structure.from_matrices(d["pre_N"], d["pre_C_b"], d["pre_C_s"], P=[[1.0], [0], [0], [0]], D=d["pre_N"][:, :1])
    split = s.class_one()
    assert split.C_b.shape == (4, 8)
    assert split.P.shape == (8, 5)
    assert dict(s.pinned) == {0: "xyz"}
    np.testing.assert_allclose(s.mass_matrix().toarray(), from_peer(d).mass_matrix().toarray())


def test_columns_of_the_user_survive_changes() -> None:
    d = peer(DATA / "motes" / "ex02_dbar.npz")
    s = from_peer(d).replace(string_mass=0.6, node_mass=[0.0, 0.5, 0.0, 0.0]).subdivide(3)
    c = s.class_one()
    np.testing.assert_array_equal(c.N[:, :8], d["N0"])
    np.testing.assert_array_equal(c.P[:8], d["P"])
    assert not c.P[8:].any()
    np.testing.assert_allclose(c.N @ c.C_s.T, (s.nodes[s.strings[:, 1]] - s.nodes[s.strings[:, 0]]).T, atol=1e-15)
    np.testing.assert_allclose(np.diag(c.M_s)[8:], 0.3)
    assert c.C_s[0, np.argmin(d["C_s"][0])] == -1.0
    assert c.C_s[2, np.argmax(d["C_s"][0])] == 1.0
    assert c.M_s[:8, :8].sum() == pytest.approx(4.0 + 0.5)  # the bars, and the point mass in one column of its node
    other = s.replace(pinned=()).class_one()  # another P: the default columns
    np.testing.assert_array_equal(other.N[:, :4], s.nodes[s.bars[:, 0]].T)


@pytest.mark.parametrize("name", STRUCTURES)
def test_split_of_a_subdivided_structure(name: str) -> None:
    s = STRUCTURES[name].replace(string_mass=0.2)
    cut, whole = s.subdivide(2), s.class_one()
    c = cut.class_one()
    columns = whole.N.shape[1]
    np.testing.assert_array_equal(c.N[:, :columns], whole.N)
    np.testing.assert_array_equal(c.N, cut.nodes[c.physical].T)
    np.testing.assert_allclose(c.N @ c.C_s.T, (cut.nodes[cut.strings[:, 1]] - cut.nodes[cut.strings[:, 0]]).T, atol=1e-15)
    np.testing.assert_array_equal((c.C_s[::2] + c.C_s[1::2])[:, :columns], whole.C_s)  # a string's ends stay in their columns
    np.testing.assert_array_equal(c.P[:columns], whole.P)


def test_node_mass_of_tied_columns_adds_up() -> None:
    N = np.array([[0, 1, 1, 2.0], [0, 0, 0, 0], [0, 0, 0, 0]])
    C_b = [[-1, 1, 0, 0], [0, 0, -1, 1]]
    s = Structure.from_matrices(N, C_b, None, P=[[0], [-1], [1], [0]], node_mass=[0.0, 0.25, 0.75, 2.0])
    np.testing.assert_array_equal(s.node_mass, [0, 1.0, 2.0])
    free = s.class_one().M_s - Structure.from_matrices(N, C_b, None, P=[[0], [-1], [1], [0]]).class_one().M_s
    np.testing.assert_allclose(np.diag(free), [0.0, 0.25, 0.75, 2.0], atol=1e-15)


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
        assert 1 / np.sum(1 / cut.stiffness[part]) == pytest.approx(s.stiffness[i], rel=1e-14)  # springs and dashpots in series
        assert 1 / np.sum(1 / cut.damping[part]) == pytest.approx(s.damping[i], rel=1e-14)
        assert cut.rest_length[part].sum() == pytest.approx(s.rest_length[i], rel=1e-14)
        path = cut.strings[part]
        assert path[0, 0] == s.strings[i, 0]
        assert path[-1, 1] == s.strings[i, 1]
        np.testing.assert_array_equal(path[1:, 0], path[:-1, 1])
        np.testing.assert_allclose(cut.string_lengths[part], s.string_lengths[i] * cut.string_fraction[part], rtol=1e-14)
        inner = path[1:, 0]
        f = cut.string_fraction[part]
        if ends == "interior":
            np.testing.assert_allclose(cut.node_mass[inner], s.string_mass[i] / 2)
        else:
            np.testing.assert_allclose(cut.node_mass[inner], s.string_mass[i] * 0.5 * (f[1:] + f[:-1]))
    if ends == "interior":
        np.testing.assert_array_equal(cut.node_mass[:5], s.node_mass)


def test_lumped_mass_of_equal_segments() -> None:
    s = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], string_mass=0.6, pinned=[0])
    np.testing.assert_allclose(s.subdivide(3, ends="lumped").node_mass, [0.1, 0.1, 0.2, 0.2])  # m/2n at the ends, m/n inside
    np.testing.assert_allclose(s.subdivide(1, ends="lumped").node_mass, [0.3, 0.3])


def test_segments_per_string_and_once_more() -> None:
    s = chain(string_mass=0.3)
    cut = s.subdivide([1, 2, 3])
    np.testing.assert_array_equal(cut.string_parent, [0, 1, 1, 2, 2, 2])
    twice = s.subdivide(2, ends="lumped").replace(string_mass=0.1).subdivide(2)
    np.testing.assert_array_equal(twice.string_parent, np.repeat([0, 1, 2], 4))  # always the first parent
    np.testing.assert_allclose(twice.string_fraction, 0.25)
    np.testing.assert_allclose(twice.stiffness, np.repeat(s.stiffness, 4) * 4)
    massless = chain()
    assert massless.subdivide(1) is massless
    assert not chain(string_mass=1.0).subdivide(1).string_mass.any()


def test_prestress_gives_the_force_density() -> None:
    s = chain()
    gamma = np.array([0.0, 5.0, 29.0])
    tight = s.prestressed(gamma)
    np.testing.assert_allclose(tight.stiffness * (1 - tight.rest_length / tight.string_lengths), gamma, atol=1e-13)
    np.testing.assert_array_equal(chain(stiffness=0.0).prestressed(0.0).rest_length, s.string_lengths)


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
    s = Structure(nodes, strings=[(0, 1), (1, 2)], pinned=[0], node_mass=[0, 0, 1.0], string_mass=[0.0, 0.2])
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
    st.sampled_from([0.0, 1e-300, 1e300, 5e-324, -1.0, 1e99, 1e-160, True, None, "x", b"1", 1j, (0, 1), {0: "y"}, {1: "xx"}, {0: 3}, object()]),
    st.text(max_size=2),
)
ANYTHING = st.one_of(JUNK, st.lists(JUNK, max_size=4), st.lists(st.lists(JUNK, max_size=4), max_size=3))
POSITIVE = st.one_of(st.floats(0.1, 10.0), st.floats(1e-100, 1e100), st.floats(0.0, exclude_min=True))


@st.composite
def keywords(draw: st.DrawFn) -> dict[str, Any]:
    """Keywords of a structure that may well be sound, with up to two of them replaced by anything at all."""
    n = draw(st.integers(1, 5))
    pair = st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True)
    pairs = st.lists(pair, max_size=4, unique_by=frozenset) if n > 1 else st.just([])
    size = draw(st.sampled_from([1.0, 1.0, 1e-3, 1e90, 1e-60]))
    point = st.tuples(*[st.integers(-3, 3).map(lambda i: i * size), st.floats(-size, size), st.floats(-size, size)])
    found: dict[str, Any] = {
        "nodes": draw(st.lists(point, min_size=n, max_size=n)),
        "bars": draw(pairs),
        "strings": draw(pairs),
        "bar_mass": draw(POSITIVE),
        "bar_radius": size * draw(st.floats(0.0, 2.0)),
        "node_mass": draw(st.lists(POSITIVE, min_size=n, max_size=n)),
        "pinned": draw(st.dictionaries(st.integers(0, n - 1), st.sampled_from(["x", "yx", "zyx"]), max_size=2)),
    }
    for name in draw(st.lists(st.sampled_from(PARAMETERS), max_size=2)):
        found[name] = draw(ANYTHING)
    return found


@settings(max_examples=500, deadline=None)
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
        free = ~s.fixed[:, axis] & ~np.isin(np.arange(len(M)), s.strings[s.string_mass > 0])  # a string's mass is on no node yet
        kept = M[np.ix_(free, free)]
        if kept.size:
            scale = 1 / np.sqrt(np.diag(kept))
            assert np.all(np.isfinite(scale))
            assert np.linalg.eigvalsh(scale[:, None] * kept * scale).min() > 1e-8
    split = s.class_one()
    assert np.all(split.N @ split.P == split.D)


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

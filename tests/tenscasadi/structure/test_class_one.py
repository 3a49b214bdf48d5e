"""The paper's matrices, both ways: the split, its identities, and what comes back from matrices of peers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from structures import DATA, PEERS, STRUCTURES, from_peer, peer

from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.structure import Structure


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
    [
        ("ex00_double_pendulum", [0]),
        ("ex02_dbar", [0]),
        ("ex03_dbar_unit", [0]),
        ("ex04_pendulum", [0]),
        ("ex05_xframe_dt1e-4", [0, 1]),
    ],
)
def test_ties_merge_and_pins_pin(case: str, pinned: list[int]) -> None:
    d = peer(DATA / "motes" / f"{case}.npz")
    s = from_peer(d)
    assert dict(s.pinned) == dict.fromkeys(pinned, "xyz")
    np.testing.assert_array_equal(
        s.nodes, d["pre_N"].T
    )  # the peer's own nodes before it split them, order of first appearance
    np.testing.assert_array_equal(s.C_b, d["pre_C_b"])
    np.testing.assert_array_equal(s.C_s, d["pre_C_s"])


def test_mass_of_physical_nodes_is_the_merged_class_one_mass() -> None:
    for name, s in STRUCTURES.items():
        split = s.class_one()
        E = np.eye(len(s.nodes))[split.physical]  # n'×n
        np.testing.assert_allclose(
            s.mass_matrix().toarray(), E.T @ split.M_s @ E, rtol=1e-14, atol=1e-15, err_msg=name
        )
        np.testing.assert_allclose(
            s.mass_matrix().sum(), s.bar_mass.sum() + s.node_mass.sum(), rtol=1e-14
        )


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
    np.testing.assert_allclose(
        c.N @ c.C_s.T, (s.nodes[s.strings[:, 1]] - s.nodes[s.strings[:, 0]]).T, atol=1e-15
    )  # Eq. 66
    np.testing.assert_allclose(c.N @ c.P, c.D, atol=1e-15)  # Eq. 84
    np.testing.assert_allclose(
        c.N[:, :beta], s.nodes[s.bars[:, 0]].T
    )  # first ends, then second ends, then string nodes
    np.testing.assert_allclose(c.N[:, beta : 2 * beta], s.nodes[s.bars[:, 1]].T)
    ends = np.bincount(s.bars.ravel(), minlength=len(s.nodes))
    full_pins = [node for node, axes in s.pinned.items() if axes == "xyz"]
    assert c.P.shape[1] == np.maximum(ends - 1, 0).sum() + len(full_pins)
    assert c.P.size == 0 or np.linalg.matrix_rank(c.P) == c.P.shape[1]
    ties = c.P.shape[1] - len(full_pins)
    assert np.all(
        np.diff(c.physical[np.argmax(c.P, axis=0)[:ties]]) >= 0
    )  # in node order, and the pins too
    np.testing.assert_array_equal(c.physical[np.argmax(c.P, axis=0)[ties:]], full_pins)
    assert np.all(np.sum(c.P[:, :ties] == -1, axis=0) == 1)
    assert not np.any(c.P[:, ties:] < 0)
    J, m = np.diag(s.bar_inertia), np.diag(s.bar_mass)
    M_b = c.C_b.T @ J @ c.C_b + c.C_r.T @ m @ c.C_r
    point = np.zeros(columns)
    for node in range(len(s.nodes)):
        point[np.flatnonzero(c.physical == node)[0]] = s.node_mass[node]
    np.testing.assert_allclose(
        c.M_s, c.C_nb.T @ M_b @ c.C_nb + np.diag(point), atol=1e-15
    )  # Eq. 81, with masses on bar ends


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


@pytest.mark.parametrize("name", STRUCTURES)
def test_round_trip_through_the_paper_matrices(name: str) -> None:
    s = STRUCTURES[name]
    c = s.class_one()
    mass = np.diag(
        c.M_s
        - c.C_nb.T
        @ (c.C_b.T @ np.diag(s.bar_inertia) @ c.C_b + c.C_r.T @ np.diag(s.bar_mass) @ c.C_r)
        @ c.C_nb
    )
    back = Structure.from_matrices(
        c.N,
        c.C_b @ c.C_nb,
        c.C_s,
        c.P,
        c.D,
        node_mass=np.maximum(mass, 0.0),
        bar_mass=s.bar_mass,
        bar_radius=s.bar_radius,
        stiffness=s.stiffness,
    )
    order = np.array(
        [np.flatnonzero(c.physical == node)[0] for node in range(len(s.nodes))]
    ).argsort()  # order of first appearance
    np.testing.assert_array_equal(back.nodes, s.nodes[order])
    np.testing.assert_array_equal(order[back.bars], s.bars)
    np.testing.assert_array_equal(order[back.strings], s.strings)
    assert {int(order[node]) for node in back.pinned} == {
        node for node, axes in s.pinned.items() if axes == "xyz"
    }
    again = back.class_one()
    for field in ("N", "C_b", "C_s", "C_r", "C_nb", "C_ns", "P", "D"):
        np.testing.assert_array_equal(getattr(again, field), getattr(c, field), err_msg=field)
    np.testing.assert_allclose(again.M_s, c.M_s, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("name", STRUCTURES)
def test_sparse_split_is_the_dense_one(name: str) -> None:
    dense, sparse = STRUCTURES[name].class_one(), STRUCTURES[name].class_one(sparse=True)
    for field in ("C_b", "C_s", "C_r", "C_nb", "C_ns", "P", "M_s"):
        np.testing.assert_array_equal(
            getattr(sparse, field).toarray(), getattr(dense, field), err_msg=field
        )
    np.testing.assert_array_equal(sparse.N, dense.N)


@pytest.mark.parametrize(
    ("case", "nodes", "pinned"),
    [("double_pendulum", 3, [0]), ("dbar_regular", 4, [1]), ("redundant_triangle", 4, [0, 1])],
    ids=lambda v: str(v),
)
def test_joints_of_the_certified_cases(case: str, nodes: int, pinned: list[int]) -> None:
    spec = json.loads((DATA / "certified" / f"{case}.json").read_text())["spec"]
    N = np.array(spec["nodes"]).T
    C_b, C_s = (
        connectivity(np.array(spec[key], dtype=np.intp).reshape(-1, 2), N.shape[1])
        for key in ("bars", "strings")
    )
    P = csr_array(np.array(spec["P"]))
    s = Structure.from_matrices(
        N, C_b, C_s, P, spec["D"], node_mass=spec.get("point_mass", 0.0)
    )  # sparse, as they grow
    assert len(s.nodes) == nodes
    assert dict(s.pinned) == dict.fromkeys(pinned, "xyz")
    split = s.class_one()
    np.testing.assert_array_equal(split.P, spec["P"])
    np.testing.assert_allclose(split.N, N, atol=1e-15)
    np.testing.assert_array_equal(split.C_b @ split.C_nb, C_b.toarray())


def test_matrices_with_shared_columns_are_split() -> None:
    d = peer(DATA / "motes" / "ex02_dbar.npz")
    s = Structure.from_matrices(
        d["pre_N"], d["pre_C_b"], d["pre_C_s"], P=[[1.0], [0], [0], [0]], D=d["pre_N"][:, :1]
    )
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
    np.testing.assert_allclose(
        c.N @ c.C_s.T, (s.nodes[s.strings[:, 1]] - s.nodes[s.strings[:, 0]]).T, atol=1e-15
    )
    np.testing.assert_allclose(np.diag(c.M_s)[8:], 0.3)
    assert c.C_s[0, np.argmin(d["C_s"][0])] == -1.0
    assert c.C_s[2, np.argmax(d["C_s"][0])] == 1.0
    assert c.M_s[:8, :8].sum() == pytest.approx(
        4.0 + 0.5
    )  # the bars, and the point mass in one column of its node
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
    np.testing.assert_allclose(
        c.N @ c.C_s.T, (cut.nodes[cut.strings[:, 1]] - cut.nodes[cut.strings[:, 0]]).T, atol=1e-15
    )
    np.testing.assert_array_equal(
        (c.C_s[::2] + c.C_s[1::2])[:, :columns], whole.C_s
    )  # a string's ends stay in their columns
    np.testing.assert_array_equal(c.P[:columns], whole.P)


def test_node_mass_of_tied_columns_adds_up() -> None:
    N = np.array([[0, 1, 1, 2.0], [0, 0, 0, 0], [0, 0, 0, 0]])
    C_b = [[-1, 1, 0, 0], [0, 0, -1, 1]]
    s = Structure.from_matrices(
        N, C_b, None, P=[[0], [-1], [1], [0]], node_mass=[0.0, 0.25, 0.75, 2.0]
    )
    np.testing.assert_array_equal(s.node_mass, [0, 1.0, 2.0])
    free = (
        s.class_one().M_s
        - Structure.from_matrices(N, C_b, None, P=[[0], [-1], [1], [0]]).class_one().M_s
    )
    np.testing.assert_allclose(np.diag(free), [0.0, 0.25, 0.75, 2.0], atol=1e-15)


def test_connectivity_on_bar_ends_alone_is_told_how_to_cover_all_columns() -> None:
    s = Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)], bars=[(0, 1)], strings=[(1, 2)], node_mass=[0, 0, 1.0]
    )
    c = s.class_one()
    with pytest.raises(
        ValueError,
        match=r"C_b has shape \(1, 2\), a column for each end of a bar: give C_b @ C_nb, of shape \(1, 3\)",
    ):
        Structure.from_matrices(c.N, c.C_b, c.C_s, c.P, c.D, node_mass=s.node_mass)
    back = Structure.from_matrices(c.N, c.C_b @ c.C_nb, c.C_s, c.P, c.D, node_mass=s.node_mass)
    np.testing.assert_array_equal(back.bars, s.bars)

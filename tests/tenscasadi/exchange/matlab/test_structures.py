"""Structures in .mat files of MOTES and TsgFEM, written by SciPy."""

from __future__ import annotations

import json

import numpy as np
import pytest
from comparison import assert_same_structure
from references import DATA, MOTES, motes
from scipy.io import savemat
from scipy.sparse import coo_array, csc_array

import tenscasadi as tc

N = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]).T
C_b = np.array([[-1.0, 0, 1, 0], [0, -1, 0, 1]])
C_s = np.array([[-1.0, 1, 0, 0], [0, -1, 1, 0], [0, 0, -1, 1], [1, 0, 0, -1]])
CROSS = {"N": N, "C_b": C_b, "C_s": C_s, "s_0": np.full((4, 1), 0.9)}


def task_of(name: str) -> dict:
    """The struct that MOTES simulates, from its recorded inputs."""
    data = np.load(DATA / "motes" / f"{name}.npz")
    task = {
        "N": data["N0"],
        "Nd0": data["Nd0"],
        "C_b": data["C_b"],
        "C_s": data["C_s"],
        "s_0": data["s0"][:, None],
        "W": data["W"],
    }
    task |= {
        "k": data["k"][None],
        "c": data["c"][None],
        "m": data["m_bar"][None],
        "tf": 5.0,
        "dt": 1e-3,
        "video": 0.0,
    }
    if data["m_string_node"].size:
        task["ms"] = data["m_string_node"][None]
    return task | ({"P": data["P"], "D": data["D"]} if data["P"].size else {})


@pytest.mark.parametrize("name", MOTES)
def test_a_workspace_of_motes(name, tmp_path):
    info = json.loads((DATA / "motes" / f"{name}.json").read_text())
    more = {
        "i": 3.0,
        "Cb_in": np.array(info["bars_1based"], dtype=float).reshape(-1, 2),
        "k": 7.0,
        "prism_name": "x",
        "found": {"a": 1.0},
    }
    savemat(tmp_path / "motes.mat", {"task": task_of(name), **more})
    assert_same_structure(tc.load_mat(tmp_path / "motes.mat"), motes(name).scene.structure)


def test_defaults_are_those_of_motes(tmp_path):
    savemat(tmp_path / "x.mat", CROSS)
    read = tc.load_mat(tmp_path / "x.mat")
    assert_same_structure(
        read,
        tc.Structure(
            N.T,
            [(0, 2), (1, 3)],
            [(0, 1), (1, 2), (2, 3), (3, 0)],
            1.0,
            stiffness=100.0,
            damping=0.0,
            rest_length=0.9,
        ),
    )
    loose = {
        "N": np.column_stack([N, [0.0, 0.0, 1.0]]),
        "C_b": np.pad(C_b, ((0, 0), (0, 1))),
        "C_s": np.pad(C_s, ((0, 0), (0, 1))),
        "s_0": 0.9,
    }
    loose["C_s"][0] = [-1, 0, 0, 0, 1]
    savemat(tmp_path / "y.mat", loose)
    assert tc.load_mat(tmp_path / "y.mat").node_mass.tolist() == [0.0, 0.0, 0.0, 0.0, 0.1]


@pytest.mark.parametrize(
    "members",
    [
        {"C_b": csc_array(C_b), "C_s": coo_array(C_s)},
        {"C_b": C_b.astype(np.int8), "C_s": C_s.astype(np.int32)},
        {
            "C_b_in": np.array([[1.0, 3], [2, 4]]),
            "C_s_in": np.array([[1.0, 2], [2, 3], [3, 4], [4, 1]]),
        },
        {
            "Cb_in": np.array([[1, 3], [2, 4]], dtype=np.uint8),
            "Cs_in": np.array([[1, 2], [2, 3], [3, 4], [4, 1]]),
        },
        {"C_b": np.array([[1.0, 3], [2, 4]]), "C_s": C_s},
    ],
    ids=["sparse", "integers", "pairs", "pairs of integers", "pairs under the name of matrices"],
)
def test_members_are_matrices_or_pairs_that_count_from_one(members, tmp_path):
    savemat(tmp_path / "x.mat", {"N": N, "s_0": np.full(4, 0.9), **members})
    savemat(tmp_path / "y.mat", CROSS)
    assert_same_structure(tc.load_mat(tmp_path / "x.mat"), tc.load_mat(tmp_path / "y.mat"))


def test_two_nodes_are_not_taken_for_pairs(tmp_path):
    savemat(
        tmp_path / "x.mat", {"N": N[:, :2], "C_b": np.array([[1.0, -1.0]]), "C_s": np.zeros((0, 0))}
    )
    assert tc.load_mat(tmp_path / "x.mat").bars.tolist() == [[1, 0]]
    savemat(tmp_path / "x.mat", {"N": N[:, :2], "C_b": np.array([[1.0, 2.0]])})
    assert tc.load_mat(tmp_path / "x.mat").bars.tolist() == [[0, 1]]


def tsgfem() -> dict:
    """A workspace of TsgFEM: a pinned cross whose members are numbered bars first."""
    length = np.linalg.norm(N @ np.vstack([C_b, C_s]).T, axis=0)
    E, A = (
        np.array([2e11, 2e11, *[76e9] * 4])[:, None],
        np.array([1e-4, 1e-4, *[1e-6] * 4])[:, None],
    )
    l0 = np.concatenate([length[:2], 0.99 * length[2:]])[:, None]
    workspace = {
        "N": N,
        "C_b": C_b,
        "C_s": C_s,
        "C": np.vstack([C_b, C_s]),
        "mass": 7870 * A * l0,
        "pinned_X": [[1.0], [2.0]],
    }
    data = {
        "N": N,
        "C": np.vstack([C_b, C_s]),
        "E": E,
        "A": A,
        "l0": l0,
        "index_b": [[1.0], [2.0]],
        "index_s": [[3.0, 4, 5, 6]],
        "D": np.zeros((12, 12)),
    }
    return {
        **workspace,
        "pinned_Y": np.array([[1.0]]),
        "pinned_Z": np.array([[1.0], [3.0]]),
        "data": data,
    }


def test_a_workspace_of_tsgfem(tmp_path):
    workspace = tsgfem()
    savemat(
        tmp_path / "x.mat",
        {**workspace, "data_out": {**workspace["data"], "n_t": np.zeros((12, 5))}},
    )
    read, data = tc.load_mat(tmp_path / "x.mat"), workspace["data"]
    assert read.stiffness == pytest.approx(
        (data["E"] * data["A"] / data["l0"]).ravel()[2:], rel=1e-15
    )
    assert read.rest_length == pytest.approx(0.99 * np.sqrt(2), rel=1e-12)
    assert read.bar_mass.tolist() == workspace["mass"].ravel()[:2].tolist()
    assert read.string_mass.tolist() == workspace["mass"].ravel()[2:].tolist()
    assert dict(read.pinned) == {0: "xyz", 1: "x", 2: "z"}
    # the consistent mass matrix of TsgFEM, a sixth of [2 1; 1 2] for each bar, is that of rigid
    # bars
    both = np.abs(C_b).T @ np.diag(read.bar_mass) @ np.abs(C_b)
    assert read.mass_matrix().toarray() == pytest.approx((both + np.diag(np.diag(both))) / 6)


@pytest.mark.parametrize("name", ["t", "q"])
def test_rest_lengths_of_tsgfem_follow_from_forces(tmp_path, name):
    workspace = tsgfem()
    data = workspace["data"]
    length = np.linalg.norm(N @ data["C"].T, axis=0)[:, None]
    rest = data.pop("l0")
    force = data["E"] * data["A"] * (length / rest - 1.0)
    data[name] = force if name == "t" else force / length
    savemat(tmp_path / "x.mat", workspace)
    read = tc.load_mat(tmp_path / "x.mat")
    assert read.rest_length == pytest.approx(rest[2:, 0], rel=1e-12)
    assert read.stiffness == pytest.approx((data["E"] * data["A"] / rest)[2:, 0], rel=1e-12)
    data[name] = force[:3]
    savemat(tmp_path / "x.mat", workspace)
    with pytest.raises(ValueError, match="l0 is missing"):
        tc.load_mat(tmp_path / "x.mat")


def test_pins_of_tsgfem_as_columns_of_the_identity(tmp_path):
    workspace = {key: value for key, value in tsgfem().items() if "pinned" not in key}
    savemat(tmp_path / "x.mat", {**workspace, "Ib": csc_array(np.eye(12)[:, [0, 1, 2, 5]])})
    assert dict(tc.load_mat(tmp_path / "x.mat").pinned) == {0: "xyz", 1: "z"}


def test_members_of_tsgfem_may_be_in_any_order(tmp_path):
    workspace = tsgfem()
    order = [2, 0, 3, 4, 1, 5]
    data = {
        key: value[order] if np.shape(value)[:1] == (6,) else value
        for key, value in workspace["data"].items()
    }
    data |= {"index_b": [[2.0], [5.0]], "index_s": [[1.0, 3, 4, 6]]}
    mass = workspace["mass"][order]
    savemat(tmp_path / "x.mat", {**workspace, "C": data["C"], "mass": mass, "data": data})
    savemat(tmp_path / "y.mat", workspace)
    assert_same_structure(tc.load_mat(tmp_path / "x.mat"), tc.load_mat(tmp_path / "y.mat"))
    data["index_b"] = [[2.0]]
    savemat(tmp_path / "x.mat", {**workspace, "data": data})
    with pytest.raises(ValueError, match="C holds 6 members, index_b and index_s 5 of them"):
        tc.load_mat(tmp_path / "x.mat")


def clustered() -> dict:
    """Build a workspace of CTSFEM: strings 0 and 1 of the cross are one cable."""
    workspace = tsgfem()
    S = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 1, 0, 0]] + [[0] * 6] * 2)
    S[3, 4] = S[4, 5] = 1
    data = {key: workspace["data"][key] for key in ("N", "C")}
    data |= {key: workspace["data"][key][[0, 1, 2, 4, 5]] for key in ("E", "A")}
    rest = S @ workspace["data"]["l0"]
    data |= {"S": S, "l0_t": np.hstack([rest, 0.9 * rest])}
    data |= {"index_b": [[1.0], [2.0]], "index_s": [[3.0, 4, 5]]}
    return {**workspace, "data": data, "index_s": data["index_s"], "rho": 7870.0}


def test_groups_of_strings_become_cables(tmp_path):
    savemat(tmp_path / "x.mat", clustered())
    read = tc.load_mat(tmp_path / "x.mat")
    assert read.cables == ((0, 1),)
    savemat(tmp_path / "y.mat", tsgfem())
    apart = tc.load_mat(tmp_path / "y.mat")
    assert read.strings.tolist() == apart.strings.tolist()
    assert read.rest_length == pytest.approx(apart.rest_length, rel=1e-12)
    assert read.stiffness == pytest.approx(apart.stiffness, rel=1e-12)
    assert tc.load_mat(tmp_path / "x.mat", cables=()).cables == ()


def test_cables_are_ordered_from_end_to_end(tmp_path):
    workspace = clustered()
    workspace["data"]["S"] = np.array([[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 1, 1, 1]])
    for key in ("E", "A"):
        workspace["data"][key] = workspace["data"][key][:3]
    workspace["data"] |= {"l0_t": [[1.0], [1.0], [5.0]], "index_s": [[3.0]]}
    savemat(tmp_path / "x.mat", {**workspace, "index_s": [[3.0]]})
    read = tc.load_mat(tmp_path / "x.mat")
    assert [sorted(cable) for cable in read.cables] == [[0, 1, 2, 3]]
    assert read.rest_length.sum() == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ([0, 0, 1, 0, 1, 0], "S groups the members 3, 5, which do not meet end to end"),
        ([1, 1, 0, 0, 0, 0], "S groups bars, which cannot slide over nodes"),
    ],
)
def test_groups_that_are_no_cables_need_a_lenient_import(tmp_path, group, message):
    workspace = tsgfem()
    alone = [row for row in np.eye(6) if not (row * group).any()]
    S = np.array([group, *alone])
    bars = [[1.0]] if group[0] else [[2.0], [3.0]]
    strings = [[k + 1.0] for k in range(5) if [k + 1.0] not in bars]
    data = {key: workspace["data"][key][:5] for key in ("E", "A", "l0")}
    data |= {"N": workspace["data"]["N"], "C": workspace["data"]["C"], "S": S}
    data |= {"index_b": bars, "index_s": strings}
    savemat(tmp_path / "x.mat", {"data": data, "index_s": strings, "mass": np.ones((5, 1))})
    with pytest.raises(ValueError, match=message):
        tc.load_mat(tmp_path / "x.mat")
    with pytest.warns(tc.InexactImportWarning, match=message):
        assert tc.load_mat(tmp_path / "x.mat", strict=False).cables == ()


def test_data_is_read_of_several_structures(tmp_path):
    savemat(tmp_path / "x.mat", {"a_out": {**CROSS, "N": 2 * N}, "data": CROSS})
    with pytest.warns(tc.InexactImportWarning, match="structures a_out, data, of which 'data' is"):
        assert tc.load_mat(tmp_path / "x.mat").nodes[0, 0] == 1.0
    assert tc.load_mat(tmp_path / "x.mat", "a_out").nodes[0, 0] == 2.0


def test_lenient_import_reads_the_first_of_several_structures(tmp_path):
    savemat(tmp_path / "x.mat", {"first": {**CROSS, "mgyro": 1.0}, "out": {**CROSS, "N": 2 * N}})
    with pytest.warns(tc.InexactImportWarning) as caught:
        read = tc.load_mat(tmp_path / "x.mat", strict=False)
    assert read.nodes[0, 0] == 1.0
    assert [change.partition(":")[0] for change in caught[0].message.changes] == [
        "it holds the structures first, out",
        "the variables mgyro, out are not read",
        "mgyro is not 0",
    ]


def test_lenient_import_leaves_out_damping_of_nodes_and_controls(tmp_path):
    workspace = tsgfem()
    workspace["data"]["D"] = np.eye(12)
    savemat(tmp_path / "x.mat", workspace)
    with pytest.warns(tc.InexactImportWarning, match="D is not 0: damping of nodes"):
        assert not tc.load_mat(tmp_path / "x.mat", strict=False).damping.any()
    savemat(tmp_path / "y.mat", {**CROSS, "s_0": np.outer(CROSS["s_0"], [1.0, 0.5])})
    with pytest.warns(tc.InexactImportWarning, match="s_0 has shape"):
        assert set(tc.load_mat(tmp_path / "y.mat", strict=False).rest_length) == {0.9}


def test_pins_of_statics_in_motes_have_a_flag_for_each_axis(tmp_path):
    savemat(tmp_path / "x.mat", {**CROSS, "Pinned_nodes": [[2.0, 1, 1, 1], [4, 0, 0, 1]]})
    assert dict(tc.load_mat(tmp_path / "x.mat").pinned) == {1: "xyz", 3: "z"}


def without(fields: dict, *names: str) -> dict:
    return {key: value for key, value in fields.items() if key not in names}


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ({"x": 1.0}, "holds no structure, .* it holds x"),
        (
            {"a": CROSS, "b": {**CROSS, "N": 2 * N}},
            "holds the structures a, b: say which by name='a'",
        ),
        ({**CROSS, "N": N.T}, r"N has shape \(4, 3\): give an array of shape \(3, any\)"),
        ({**CROSS, "N": N * np.nan}, "N.* is nan"),
        ({**CROSS, "N": "run me"}, "N is not"),
        (
            {**CROSS, "C_b": C_b[:, :3]},
            r"C_b has shape \(2, 3\): give a column for each of the 4 nodes",
        ),
        ({**CROSS, "C_s": np.abs(C_s)}, "C_s has a row other than zeros with one −1 and one [+]1"),
        (
            {**CROSS, "C_s": csc_array(np.abs(C_s))},
            "C_s has a row other than zeros with one −1 and one [+]1",
        ),
        ({**CROSS, "C_b": np.array([[1.0, 5.0]])}, "C_b holds 5: give whole numbers from 1 to 4"),
        ({**CROSS, "C_b": np.array([[1.0, 2.5]])}, "C_b holds 2.5"),
        (
            {**CROSS, "s_0": np.ones((4, 7))},
            r"s_0 has shape \(4, 7\): values over time are a control",
        ),
        ({**CROSS, "s_0": "rest_script"}, "s_0 is a text, 'rest_script', which is not run"),
        ({**CROSS, "k": np.ones(3)}, "k has shape .*: give 4 numbers or one"),
        ({**CROSS, "m": -1.0}, "bar_mass of bar 0 is -1"),
        ({**CROSS, "mgyro": 1.0}, "mgyro is not 0"),
        ({**CROSS, "P": np.ones((4, 1)), "D": np.zeros((3, 1))}, "P: column 0"),
        ({"N": N, "C": C_s}, "C holds all members: say which are bars"),
        ({**CROSS, "pinned_nodes": 0.0}, "pinned_nodes holds 0: give whole numbers from 1 to 4"),
        (
            without(tsgfem(), "mass"),
            "mass is missing, from which bar_mass follows: give bar_mass=...",
        ),
        (
            {**tsgfem(), "data": {**tsgfem()["data"], "D": np.eye(12)}},
            "D is not 0: damping of nodes",
        ),
        (
            {**tsgfem(), "data": {**tsgfem()["data"], "l0": 0.0}},
            "l0 of member 1 is 0: it must be greater than 0",
        ),
    ],
)
def test_what_is_wrong_is_named_with_the_file(content, named, tmp_path):
    path = tmp_path / "wrong.mat"
    savemat(path, content)
    with pytest.raises((TypeError, ValueError), match=rf"(?s)wrong\.mat: .*{named}") as caught:
        tc.load_mat(path)
    assert len(str(caught.value).splitlines()) == 1


def test_options_replace_what_the_file_says(tmp_path):
    savemat(tmp_path / "x.mat", {**CROSS, "s_0": np.ones((4, 7)), "k": 5.0})
    read = tc.load_mat(tmp_path / "x.mat", rest_length=[0.5, 0.6, 0.7, 0.8], pinned=[2])
    assert read.rest_length.tolist() == [0.5, 0.6, 0.7, 0.8]
    assert dict(read.pinned) == {2: "xyz"}
    assert set(read.stiffness) == {5.0}
    savemat(tmp_path / "y.mat", {**tsgfem(), "data": {**tsgfem()["data"], "D": np.eye(12)}})
    assert set(tc.load_mat(tmp_path / "y.mat", damping=3.0).damping) == {3.0}
    with pytest.raises(TypeError, match="load_mat got 'strings': give keywords of Structure"):
        tc.load_mat(tmp_path / "x.mat", strings=[(0, 1)])


def test_a_struct_is_chosen_by_name(tmp_path):
    savemat(tmp_path / "x.mat", {"small": CROSS, "large": {**CROSS, "N": 2 * N}})
    assert tc.load_mat(tmp_path / "x.mat", "large").nodes[0, 0] == 2.0
    with pytest.raises(
        ValueError,
        match="name is 'huge': the file's structs with N and C_b or C_s are small, large",
    ):
        tc.load_mat(tmp_path / "x.mat", "huge")


def test_mass_of_strings_is_lumped_at_nodes_without_mass(tmp_path):
    net = {
        "N": np.array([[0.0, 1, 2], [0, 0, 0], [0, 0, 0]]),
        "C": np.array([[-1.0, 1, 0], [0, -1, 1]]),
        "index_s": [[1.0, 2]],
        "E": 1e9 * np.ones((2, 1)),
        "A": 1e-6 * np.ones((2, 1)),
        "l0": 0.9 * np.ones((2, 1)),
        "mass": np.array([[0.2], [0.4]]),
        "pinned_X": [[1.0], [3.0]],
        "pinned_Y": [[1.0], [3.0]],
        "pinned_Z": [[1.0], [3.0]],
    }
    savemat(tmp_path / "net.mat", net)
    assert tc.load_mat(tmp_path / "net.mat").string_mass.tolist() == [0.2, 0.4]
    with pytest.warns(tc.InexactImportWarning, match="node 1 has no mass: half the mass"):
        read = tc.load_mat(tmp_path / "net.mat", strict=False)
    assert read.node_mass == pytest.approx([0.1, 0.3, 0.2])
    assert not read.string_mass.any()
    assert tc.simulate(tc.Model(tc.Scene(read)), 0.01, compiled=False).success

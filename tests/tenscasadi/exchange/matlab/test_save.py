"""Structures written for MATLAB: exact when read back, and tasks that MOTES can run."""

from __future__ import annotations

import json

import numpy as np
import pytest
from comparison import assert_same_structure
from references import DATA, motes
from scipy.io import loadmat, savemat

import tenscasadi as tc

ROLLING = tc.Structure(
    [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
    [(0, 1)],
    [(1, 2)],
    node_mass=[0.1, 0.2, 0.3],
    rollers={0: (1, 0, 1)},
)
STRUCTURES = {
    "prism": tc.shapes.prism(stiffness=500.0, prestress=20.0, damping=1.0, bar_radius=0.01),
    "D-bar": tc.shapes.d_bar(pinned={0: "xyz", 2: "z"}),
    "pendulum": tc.shapes.double_pendulum(),
    "ball": tc.shapes.six_bar_ball(string_mass=0.1),
    "segments": tc.shapes.prism(stiffness=500.0, string_mass=0.1).subdivide(3),
    "no strings": tc.Structure([(0, 0, 0), (1, 1 / 3, 0)], [(0, 1)]),
    "rollers": ROLLING,
    "cables": tc.shapes.prism(stiffness=500.0).replace(
        cables=[[8, 2], [5, 4, 3]], cable_friction=[0.0, 0.25]
    ),
    "bodies": tc.Structure(
        [*np.eye(3).tolist(), (0, 0, 0), (2, 0, 0), (3, 0, 1)],
        bars=[(4, 5)],
        strings=[(2, 4), (3, 5)],
        bodies=[
            tc.RigidBody([0, 1, 2, 3], 2.0, (0.1, 0.2, 1 / 3), (0.3, 0.4, 0.5)),
            tc.RigidBody([4, 0], 1 / 3),
            tc.RigidBody(
                [1, 2, 5], 1.0, inertia=[[3, 0.1, 0], [0.1, 4, 0], [0, 0, 5]], faces=[(1, 2, 5)]
            ),
        ],
    ),
}


@pytest.mark.parametrize("name", STRUCTURES)
def test_a_structure_comes_back_to_the_last_bit(name, tmp_path):
    assert_same_structure(
        tc.load_mat(tc.save_mat(STRUCTURES[name], tmp_path / "x.mat")), STRUCTURES[name]
    )


def test_cables_have_the_matrix_of_ctsfem(tmp_path):
    structure = STRUCTURES["cables"]
    S = loadmat(tc.save_mat(structure, tmp_path / "x.mat"))["S"]
    assert S.shape == (9, 12)  # 3 bars, 2 cables and 4 strings; 3 bars and 9 strings
    assert np.array_equal(S[:3], np.eye(3, 12))
    assert (S.sum(axis=0) == 1).all()
    groups = [tuple(np.flatnonzero(row[3:])) for row in S[3:]]
    assert {(2, 8), (3, 4, 5)} <= set(groups)


@pytest.mark.parametrize("cables", [(), [(2, 8)], [(8, 2), (5, 4, 3)]])
def test_given_cables_replace_those_of_a_file_and_their_friction(cables, tmp_path):
    path = tc.save_mat(STRUCTURES["cables"], tmp_path / "x.mat")
    expected = STRUCTURES["cables"].replace(cables=(), cable_friction=0.0).replace(cables=cables)
    assert_same_structure(tc.load_mat(path, cables=cables), expected)
    if cables:
        assert tc.load_mat(path, cables=cables, cable_friction=0.1).cable_friction[0] == 0.1


@pytest.mark.parametrize(
    "changes",
    [
        {"cable_strings": np.array([[1.0, 40.0]])},
        {"cable_strings": "ab"},
        {"rigid_bodies": np.eye(2)},
        {"rigid_bodies": {"body_1": 3.0}},
        {"rigid_bodies": {"body_1": {"nodes": [1.0, 99.0], "mass": 1.0}}},
        {"rigid_bodies": {"body_1": {"nodes": [1.0, 2.0], "mass": [1.0, 2.0]}}},
        {"rigid_bodies": {"body_1": {"nodes": [1.0, 2.0], "mass": 1.0, "inertia": "x"}}},
    ],
)
def test_wrong_cables_and_bodies_are_named(changes, tmp_path):
    task = loadmat(tc.save_mat(STRUCTURES["prism"], tmp_path / "x.mat"))
    task = {key: value for key, value in task.items() if not key.startswith("_")}
    savemat(tmp_path / "y.mat", {**task, **changes})
    with pytest.raises(tc.SceneFileError, match="|".join(changes) + "|RigidBody"):
        tc.load_mat(tmp_path / "y.mat")


@pytest.mark.parametrize(
    "name", ["ex02_dbar", "px_prism_seg02", "ex00_double_pendulum", "ex01_string_only_dt1e-4"]
)
def test_the_split_is_the_one_that_motes_was_run_with(name, tmp_path):
    data, structure = np.load(DATA / "motes" / f"{name}.npz"), motes(name).scene.structure
    task = loadmat(tc.save_mat(structure, tmp_path / "x.mat", class_one=True))
    for key, recorded in {"N": "N0", "C_b": "C_b", "C_s": "C_s", "P": "P", "D": "D"}.items():
        assert np.array_equal(task[key].reshape(data[recorded].shape), data[recorded]), key
    assert task["s_0"].shape == (len(data["s0"]), 1)
    assert np.array_equal(task["s_0"].ravel(), data["s0"])
    assert np.array_equal(task["k"], data["k"][None])
    assert np.array_equal(task["ms"].ravel(), data["m_string_node"])
    assert_same_structure(tc.load_mat(tmp_path / "x.mat"), structure)
    assert (
        json.loads((DATA / "motes" / f"{name}.json").read_text())["n_bars"] == task["C_b"].shape[0]
    )


def test_ends_of_bars_come_first_as_motes_takes_the_first_columns_for_them(tmp_path):
    structure = tc.Structure(
        np.eye(4, 3), [(1, 3)], [(0, 1), (0, 3), (2, 3)], node_mass=[0.5, 0.0, 0.7, 0.0]
    )
    task = loadmat(tc.save_mat(structure, tmp_path / "x.mat", class_one=True))
    assert np.array_equal(task["N"].T, structure.nodes[[1, 3, 0, 2]])
    assert task["ms"].tolist() == [[0.5, 0.7]]
    assert task["C_s"].tolist() == [[1, 0, -1, 0], [0, 1, -1, 0], [0, 1, 0, -1]]


@pytest.mark.parametrize(
    ("structure", "named"),
    [
        (
            STRUCTURES["prism"],
            "bar_radius of bar 0 is 0.01, which MOTES does not model: give 0.0",
        ),
        (STRUCTURES["ball"], "string_mass of string 0 is 0.1"),
        (STRUCTURES["D-bar"], "node 2 has a roller"),
        (ROLLING.replace(node_mass=[0.0, 0.0, 0.3]), "node 0 has a roller"),
        (ROLLING.replace(rollers={}), "node_mass of node 0 is 0.1"),
        (
            tc.Structure(np.eye(3), [(0, 1)], [(1, 2)], pinned=[2]),
            "node_mass of node 2 is 0, which MOTES does not model: give a mass",
        ),
    ],
)
def test_what_motes_would_leave_out_is_refused_by_name(structure, named, tmp_path):
    with pytest.raises(ValueError, match=f"class_one: {named}"):
        tc.save_mat(structure, tmp_path / "x.mat", class_one=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["cables", "bodies"])
def test_motes_takes_no_cables_and_bodies(name, tmp_path):
    with pytest.raises(
        ValueError, match=rf"{name}, which save_mat\(class_one=True\) does not take"
    ):
        tc.save_mat(STRUCTURES[name], tmp_path / "x.mat", class_one=True)


def test_wrong_arguments_are_named(tmp_path):
    with pytest.raises(TypeError, match="data is 3: give a Structure or a Trajectory"):
        tc.save_mat(3, tmp_path / "x.mat")
    with pytest.raises(TypeError, match="class_one is 1"):
        tc.save_mat(ROLLING, tmp_path / "x.mat", class_one=1)
    with pytest.raises(FileNotFoundError):
        tc.save_mat(ROLLING, tmp_path / "missing" / "x.mat")

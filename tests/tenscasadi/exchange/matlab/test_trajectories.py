"""Trajectories in .mat files of `save_mat`, MOTES and TsgFEM."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from references import DATA, MOTES, motes
from scipy.io import loadmat, savemat

import tenscasadi as tc

WAVES = ["px_prism_seg01", "ex02_dbar", "ex01_string_only_dt1e-4", "px_prism_spin"]


@pytest.fixture(scope="module")
def run():
    model = tc.Model(
        tc.Scene(
            tc.shapes.d_bar(pinned=[0], stiffness=50.0),
            control=tc.ForceDensity(),
            gravity=tc.Gravity(),
        )
    )
    return tc.simulate(
        model, 0.1, 0.01, control=np.linspace([1.0, 2.0], [3.0, 4.0], 10), compiled=False
    )


def assert_same(one: tc.Trajectory, other: tc.Trajectory) -> None:
    for field in fields(one):
        if field.name == "scene":  # which MATLAB's files do not hold
            continue
        a, b = getattr(one, field.name), getattr(other, field.name)
        assert type(a) is type(b), field.name
        assert (
            np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
            if isinstance(a, np.ndarray)
            else a == b
        ), field.name


def workspace(name: str) -> dict:
    """Variables that a script of MOTES has when its simulation is over."""
    data = np.load(DATA / "motes" / f"{name}.npz")
    task = {
        "N": data["N0"],
        "C_b": data["C_b"],
        "C_s": data["C_s"],
        "s_0": data["s0"][:, None],
        "k": data["k"][None],
        "c": data["c"][None],
    }
    task |= {"m": data["m_bar"][None], "ms": data["m_string_node"][None]} | (
        {"P": data["P"], "D": data["D"]} if data["P"].size else {}
    )
    history = {
        "Nhist": data["N"].transpose(1, 2, 0),
        "Ndhist": data["Nd"].transpose(1, 2, 0),
        "gamma": data["gamma_log"].T,
        "t": data["t"][None],
    }
    return {"task": task, "History": history, "debug": {"sys_def": {"N": data["N0"]}}}


def test_ours_comes_back_to_the_last_bit(run, tmp_path):
    assert_same(tc.load_mat_trajectory(tc.save_mat(run, tmp_path / "x.mat")), run)
    odd = replace(run, energy_error=np.full(11, np.nan), success=False, message="γ < 0", attempts=7)
    assert_same(tc.load_mat_trajectory(tc.save_mat(odd, tmp_path / "y.mat")), odd)


@pytest.mark.parametrize(
    "structure", [tc.Structure([(0, 0, 0), (1, 0, 0)], [(0, 1)]), tc.shapes.prism(stiffness=100.0)]
)
def test_a_single_row_and_no_strings_come_back(structure, tmp_path):
    run = tc.simulate(tc.Model(tc.Scene(structure)), 0.1, 0.1, compiled=False)
    one = tc.Trajectory.from_arrays({f.name: np.asarray(getattr(run, f.name))[:1] if np.ndim(getattr(run, f.name)) and f.name not in ("bars", "strings", "pinned", "parameters") else np.asarray(getattr(run, f.name)) for f in fields(run) if f.name not in ("scene", "sampled")})  # fmt: skip  # noqa: E501
    for whole in (run, one):
        assert_same(tc.load_mat_trajectory(tc.save_mat(whole, tmp_path / "x.mat")), whole)


def test_matlab_finds_the_history_of_motes(run, tmp_path):
    read = loadmat(tc.save_mat(run, tmp_path / "x.mat"), simplify_cells=True)
    history = read["History"]
    assert np.array_equal(history["Nhist"], run.nodes.transpose(2, 1, 0))  # 3×n×T
    assert np.array_equal(history["Ndhist"][:, 2, 5], run.velocities[5, 2])
    assert np.array_equal(history["gamma"], run.force_density.T)
    assert np.array_equal(history["t"], run.time)
    assert history["bar_len"][:, -1] == pytest.approx(
        np.linalg.norm(read["N"] @ read["C_b"].T, axis=0), rel=1e-3
    )
    assert read["pinned_nodes"] == 1
    assert np.array_equal(tc.load_mat(tmp_path / "x.mat").strings, run.strings)


@pytest.mark.parametrize("name", WAVES)
def test_a_motion_of_motes(name, tmp_path):
    savemat(tmp_path / "x.mat", workspace(name))
    case = motes(name)
    assert name in MOTES
    read = tc.load_mat_trajectory(tmp_path / "x.mat")
    assert np.array_equal(read.time, case.data["t"])
    assert np.array_equal(read.nodes, case.nodes)
    assert np.array_equal(read.velocities, case.data["Nd"].transpose(0, 2, 1)[:, case.columns])
    info = json.loads((DATA / "motes" / f"{name}.json").read_text())
    assert read.bar_length_error.max() <= max(2 * (info["max_bar_length_error"] or 0), 1e-12)
    if not case.data["c"].any():  # nothing takes energy away: what is left is MOTES' own error
        assert np.ptp(read.energy) < 1e-3 * np.abs(read.energy).max()
    assert read.force_density[0] == pytest.approx(
        case.data["gamma_log"][0], rel=1e-6, abs=1e-9
    )  # of the start, which no stage has moved
    assert "another program's motion, read from" in read.message
    given = tc.load_mat_trajectory(
        tmp_path / "x.mat", tc.Model(tc.Scene(case.scene.structure, gravity=tc.Gravity()))
    )
    assert np.array_equal(given.nodes, read.nodes)
    assert np.ptp(given.energy_parts[:, 2]) >= 0
    assert given.energy_parts[:, 2].any() or not read.nodes[..., 2].any()


def test_a_motion_of_motes_in_a_model_with_parameters(tmp_path):
    savemat(tmp_path / "x.mat", workspace("px_prism_seg01"))
    structure = motes("px_prism_seg01").scene.structure
    model, stiffer = (
        tc.Model(tc.Scene(structure, parameters=tc.Parameters("stiffness"))),
        {"stiffness": 2 * structure.stiffness},
    )
    read = tc.load_mat_trajectory(tmp_path / "x.mat", model, stiffer)
    built = tc.load_mat_trajectory(
        tmp_path / "x.mat", tc.Model(tc.Scene(structure.replace(**stiffer)))
    )
    assert np.array_equal(read.parameters, stiffer["stiffness"])
    assert read.tension == pytest.approx(built.tension, rel=1e-12)


def test_force_densities_of_motes_may_be_the_control(tmp_path):
    savemat(tmp_path / "x.mat", workspace("px_prism_seg01"))
    case = motes("px_prism_seg01")
    model = tc.Model(tc.Scene(case.scene.structure, control=tc.ForceDensity()))
    read = tc.load_mat_trajectory(tmp_path / "x.mat", model)
    assert np.array_equal(read.control, case.data["gamma_log"])
    assert np.array_equal(read.force_density, case.data["gamma_log"])


def tsgfem(run: tc.Trajectory) -> dict:
    """What TsgFEM's dynamic_solver returns of this motion: velocities end one time before positions."""
    rows = len(run.time)
    positions, velocities = (
        np.asarray(value).reshape(rows, -1).T for value in (run.nodes, run.velocities)
    )
    C = np.array([[-1.0, 1, 0, 0], [0, 0, -1, 1]])
    data = {
        "N": run.nodes[0].T,
        "C": C,
        "n_t": positions,
        "nd_t": velocities[:, :-1],
        "out_tspan": run.time[None],
    }
    return {"data_out": data, "t_t": np.zeros((2, rows)), "N": run.nodes[0].T, "C_b": C}


def test_a_motion_of_tsgfem(tmp_path):
    nodes = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0.5)]
    model = tc.Model(tc.Scene(tc.Structure(nodes, [(0, 1), (2, 3)]), gravity=tc.Gravity()))
    run = tc.simulate(
        model, 0.2, 0.02, state=model.state(model.structure.nodes, np.ones((4, 3))), compiled=False
    )
    savemat(tmp_path / "x.mat", tsgfem(run))
    read = tc.load_mat_trajectory(tmp_path / "x.mat", model)
    assert np.array_equal(read.time, run.time[:-1])
    assert np.array_equal(read.nodes, run.nodes[:-1])
    assert np.array_equal(read.states, run.states[:-1])
    assert read.energy == pytest.approx(run.energy[:-1], rel=1e-12)


def test_clocks_of_models_show_the_times_of_the_motion(tmp_path):
    scene = tc.Scene(
        tc.Structure([(0, 0, 0), (1, 0, 0)], [(0, 1)]),
        forces=tc.NodalForce(lambda t: [[0, 0, t], [0, 0, 0]]),
    )
    model = tc.Model(scene)
    run = tc.simulate(model, 0.2, 0.02, compiled=False)
    history = {
        "Nhist": run.nodes.transpose(2, 1, 0),
        "Ndhist": run.velocities.transpose(2, 1, 0),
        "t": run.time,
    }
    savemat(tmp_path / "x.mat", history)
    assert tc.load_mat_trajectory(tmp_path / "x.mat", model).states == pytest.approx(
        run.states, abs=1e-15
    )
    assert run.states[-1, -1] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            lambda w: w.pop("History"),
            "it holds no motion, which is Nhist, Ndhist, t or n_t, nd_t, out_tspan",
        ),
        (lambda w: w.update(other=w["History"]), "it holds the motions History, other: keep one"),
        (lambda w: w.pop("task"), "holds no structure"),
        (
            lambda w: w["History"].update(t=np.zeros((1, 3))),
            "Nhist has shape .*give an array of shape",
        ),
        (
            lambda w: w["History"].update(t=w["History"]["t"][:, ::-1]),
            "its times are none, or do not increase",
        ),
        (
            lambda w: w["History"]["Nhist"].__setitem__((0, 0, 3), np.nan),
            r"Nhist\[0, 0, 3\] is nan",
        ),
        (
            lambda w: w["History"].update(Ndhist=w["History"]["Ndhist"][:, :2]),
            r"Ndhist has shape \(3, 2, 101\)",
        ),
        (lambda w: w["History"].update(Ndhist="x"), "Ndhist is 'x': give an array"),
    ],
)
def test_what_is_wrong_is_named_with_the_file(change, named, tmp_path):
    content = workspace("px_prism_seg01")
    change(content)
    savemat(tmp_path / "wrong.mat", content)
    with pytest.raises(ValueError, match=rf"(?s)wrong\.mat: .*{named}") as caught:
        tc.load_mat_trajectory(tmp_path / "wrong.mat")
    assert len(str(caught.value).splitlines()) == 1


def test_models_that_do_not_fit_are_refused(tmp_path):
    savemat(tmp_path / "x.mat", workspace("px_prism_seg01"))
    wound = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.RestLength()))
    with pytest.raises(
        ValueError, match=r"model\.scene\.control is RestLength\(\): give a model with control=None"
    ):
        tc.load_mat_trajectory(tmp_path / "x.mat", wound)
    with pytest.raises(ValueError, match="nodes has shape"):
        tc.load_mat_trajectory(tmp_path / "x.mat", tc.Model(tc.Scene(tc.shapes.six_bar_ball())))
    pinned = tc.Model(tc.Scene(tc.shapes.prism(pinned=[0])))
    with pytest.raises(ValueError, match=r"at time .* s nodes\[0, 0\] moves a pinned coordinate"):
        tc.load_mat_trajectory(tmp_path / "x.mat", pinned)
    with pytest.raises(TypeError, match="model is 3"):
        tc.load_mat_trajectory(tmp_path / "x.mat", 3)
    savemat(
        tmp_path / "y.mat", {"x": 1.0, "format": "tenscasadi trajectory 1", "History": {"t": 1.0}}
    )
    with pytest.raises(ValueError, match=r"y\.mat: it lacks 'N'"):
        tc.load_mat_trajectory(tmp_path / "y.mat")

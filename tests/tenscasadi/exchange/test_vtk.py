"""Frames for ParaView, read back by meshio: they hold the motion, and the forces in them balance."""

from __future__ import annotations

import sys
from xml.etree import ElementTree

import numpy as np
import pytest

import tenscasadi as tc


@pytest.fixture(scope="module")
def model():
    return tc.Model(tc.Scene(tc.shapes.prism(stiffness=1000.0, prestress=50.0)))


@pytest.fixture(scope="module")
def run(model):
    spin = np.cross((0.0, 0.0, 2.0), model.structure.nodes)
    return tc.simulate(
        model, 0.1, 0.01, state=model.state(model.structure.nodes, spin), compiled=False
    )


def frames(path):
    """Times and meshes that a .pvd names."""
    meshio = pytest.importorskip("meshio", reason="tenscasadi[exchange] is not installed")
    sets = ElementTree.parse(path).getroot().findall("Collection/DataSet")
    return [float(part.get("timestep")) for part in sets], [
        meshio.read(path.parent / part.get("file")) for part in sets
    ]


def test_frames_hold_the_motion(run, tmp_path):
    pytest.importorskip("meshio", reason="tenscasadi[exchange] is not installed")
    times, meshes = frames(tc.export_vtk(run, tmp_path / "run.pvd"))
    assert times == run.time.tolist()
    for row, mesh in enumerate(meshes):
        assert np.array_equal(mesh.points, run.nodes[row])
        assert np.array_equal(mesh.point_data["velocity"], run.velocities[row])
        (block,) = mesh.cells
        kind, number = mesh.cell_data["kind"][0], mesh.cell_data["number"][0].astype(int)
        assert np.array_equal(block.data[kind == 0], run.bars)
        assert np.array_equal(block.data[kind == 1], run.strings)
        assert number.tolist() == [*range(3), *range(9)]
        assert np.array_equal(mesh.cell_data["tension"][0][kind == 1], run.tension[row])
        assert np.isnan(
            mesh.cell_data["tension"][0][kind == 0]
        ).all()  # not known without the model


def test_forces_balance_at_rest_and_accelerate_otherwise(model, run, tmp_path):
    pytest.importorskip("meshio", reason="tenscasadi[exchange] is not installed")
    still = tc.simulate(model, 0.02, 0.01, compiled=False)
    for motion in (still, run):
        mesh = frames(tc.export_vtk(motion, tmp_path / "run.pvd", model=model))[1][0]
        (block,), gamma = mesh.cells, mesh.cell_data["force_density"][0]
        pulls = np.zeros((6, 3))
        for (a, b), density in zip(block.data, gamma, strict=True):
            pulls[a] += density * (mesh.points[b] - mesh.points[a])
            pulls[b] -= density * (mesh.points[b] - mesh.points[a])
        acceleration = model.ode(motion.states[0], model.initial_control).full().ravel()[model.nq :]
        moved = model.nodes(np.concatenate([acceleration, np.zeros(model.nq)])) - model.nodes(
            np.zeros(model.nx)
        )
        assert pulls == pytest.approx(
            model.structure.mass_matrix() @ moved, abs=1e-9
        )  # M N̈ = forces of members
        assert np.allclose(pulls, 0, atol=1e-9) == (motion is still)
        lengths = np.linalg.norm(
            mesh.points[block.data[:, 1]] - mesh.points[block.data[:, 0]], axis=1
        )
        assert mesh.cell_data["length"][0] == pytest.approx(lengths)
        assert mesh.cell_data["tension"][0] == pytest.approx(gamma * lengths)
        assert (mesh.cell_data["tension"][0][:3] < 0).all()


def test_each_so_many_rows_and_structures_of_one_kind_of_member(run, tmp_path):
    pytest.importorskip("meshio", reason="tenscasadi[exchange] is not installed")
    times, _ = frames(tc.export_vtk(run, tmp_path / "a & 'b'.pvd", every=4))
    assert times == run.time[::4].tolist()
    pendulum = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    swing = tc.simulate(pendulum, 0.02, 0.01, compiled=False)
    mesh = frames(tc.export_vtk(swing, tmp_path / "swing.pvd", model=pendulum))[1][0]
    assert mesh.point_data["pinned"].sum() == 1
    assert mesh.cell_data["kind"][0].tolist() == [0] * len(swing.bars)


def test_frames_hold_faces_of_bodies(tmp_path):
    corners = 0.1 * np.vstack([np.zeros(3), np.eye(3)])
    plate = tc.RigidBody(range(4), 1.0, faces=[(0, 1, 2), (0, 1, 3)])
    free = tc.simulate(tc.Model(tc.Scene(tc.Structure(corners, bodies=[plate]))), 0.01, 0.01)
    folder = tc.export_vtk(free, tmp_path / "body.pvd").with_suffix("")
    mesh = pytest.importorskip("meshio").read(min(folder.iterdir()))
    assert mesh.cells_dict["triangle"].tolist() == [[0, 1, 2], [0, 1, 3]]
    assert mesh.cell_data_dict["kind"]["triangle"].tolist() == [2.0, 2.0]


def test_controls_and_parameters_are_those_of_the_run(tmp_path):
    pytest.importorskip("meshio", reason="tenscasadi[exchange] is not installed")
    structure = tc.shapes.prism(stiffness=1000.0, prestress=50.0)
    model = tc.Model(
        tc.Scene(structure, control=tc.ForceDensity(), parameters=tc.Parameters("bar_mass"))
    )
    run = tc.simulate(
        model,
        0.02,
        0.01,
        parameters={"bar_mass": 2.0},
        control=2 * model.initial_control,
        compiled=False,
    )
    mesh = frames(tc.export_vtk(run, tmp_path / "x.pvd", model=model))[1][0]
    assert mesh.cell_data["force_density"][0][:3] == pytest.approx(
        -2 * 86.60254037844386
    )  # twice the self-stress
    with pytest.raises(ValueError, match="model is not that of the trajectory"):
        tc.export_vtk(run, tmp_path / "x.pvd", model=tc.Model(tc.Scene(structure)))


def test_wrong_arguments_are_named(run, tmp_path, monkeypatch):
    for changes, error, named in (
        ({"trajectory": 3}, TypeError, "trajectory is 3"),
        (
            {"path": tmp_path / "run.vtk"},
            ValueError,
            r"run\.vtk': give a file name that ends in \.pvd",
        ),
        ({"every": 0}, ValueError, "every is 0"),
        ({"model": 3}, TypeError, "model is 3"),
    ):
        with pytest.raises(error, match=named):
            tc.export_vtk(**{"trajectory": run, "path": tmp_path / "run.pvd", **changes})
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(
        ImportError, match=r"export_vtk needs meshio: pip install 'tenscasadi\[exchange\]'"
    ):
        tc.export_vtk(run, tmp_path / "run.pvd")
    assert not list(tmp_path.iterdir())

"""Export to glTF, read back by trimesh."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import tenscasadi as tc

PRISM = tc.shapes.prism(prestress=50.0, pinned=[0])
trimesh = pytest.importorskip("trimesh", reason="tenscasadi[exchange] is not installed")


def convert(points):
    """Convert points (m, 3) of glTF, with y upward, to z upward."""
    return np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)


def test_objects_have_names_places_and_colors(tmp_path):
    ground = tc.Ground(height=-0.5)
    scene = tc.Scene(PRISM, ground=ground)
    picture = trimesh.load(tc.export_gltf(scene, tmp_path / "prism.glb"))
    names = set(picture.graph.nodes_geometry)
    assert {"bar 2", "string top[1]", "node bottom[0]", "support 0", "ground 0"} <= names
    assert len(names) == 3 + 9 + 6 + 1 + 1
    transform, geometry = picture.graph["bar 0"]
    ends = transform[:3, 3] + np.outer([-0.5, 0.5], transform[:3, 2])
    assert convert(ends) == pytest.approx(PRISM.nodes[PRISM.bars[0]], abs=1e-6)
    assert picture.graph["node top[0]"][0][1, 3] == pytest.approx(PRISM.nodes[3, 2])
    assert picture.graph["bar 1"][1] == geometry
    colors = {picture.graph[f"string {name}[0]"][1] for name in ("top", "vertical")}
    assert len(colors) == 2
    floor = convert(picture.geometry[picture.graph["ground 0"][1]].vertices @ np.eye(3))
    assert np.ptp(floor, axis=0).max() > 1


def test_motions_are_drawn_at_a_time(tmp_path):
    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    run = tc.simulate(model, 0.3, 1e-3, save_every=10, compiled=False)
    picture = trimesh.load(tc.export_gltf(run, tmp_path / "swing.glb", time=0.2))
    place = convert(picture.graph["node 1"][0][:3, 3][None])[0]
    assert place == pytest.approx(run.nodes[20, 1], abs=1e-5)
    with pytest.raises(ValueError, match=r"time is 0\.4 s: give a time from 0 to 0\.3 s"):
        tc.export_gltf(run, tmp_path / "swing.glb", time=0.4)


def test_rollouts_have_objects_of_each_motion(tmp_path):
    model = tc.Model(tc.Scene(tc.shapes.pendulum()))
    runs = tc.rollouts(model, 0.02, 0.01, states=[model.initial_state] * 2)
    picture = trimesh.load(tc.export_gltf(runs, tmp_path / "runs.glb"))
    assert {"bar 0 of motion 0", "bar 0 of motion 1"} <= set(picture.graph.nodes_geometry)


def test_wrong_files_are_named(tmp_path, monkeypatch):
    with pytest.raises(ValueError, match=r"ends in \.glb"):
        tc.export_gltf(PRISM, tmp_path / "prism.obj")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(ImportError, match="export_gltf needs trimesh"):
        tc.export_gltf(PRISM, tmp_path / "prism.glb")

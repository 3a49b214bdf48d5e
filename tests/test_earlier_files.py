"""Files that an earlier version wrote still load: scene files, plans, trajectories, rollouts, trade-offs, models."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.plan.serialize import rebuilt
from tenscasadi.dynamics.serialize import find_differences, model_from_arrays

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILES = Path(__file__).parent / "data/version_0_1"
LOADERS = {
    "plan": ocp.Plan.load,
    "rollouts": tc.Rollouts.load,
    "tradeoff": tc.Tradeoff.load,
    "trajectory": tc.Trajectory.load,
}


@pytest.mark.parametrize("path", sorted(FILES.glob("*.toml")), ids=lambda path: path.stem)
def test_scene_files_come_back(path, tmp_path):
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    again = tmp_path / "again.toml"
    if "plan" in data:
        arguments = ocp.load_arguments(path)
        ocp.save_problem(arguments.pop("problem"), again, **arguments)
    elif "simulation" in data:
        tc.save_scene(tc.load_simulation(path), again)
    else:
        tc.save_scene(tc.load_scene(path), again)
    assert tomllib.loads(again.read_text(encoding="utf-8")) == data


@pytest.mark.parametrize("name", LOADERS)
def test_results_load(name):
    assert LOADERS[name](FILES / f"{name}.npz").summary()


@pytest.mark.parametrize("path", sorted(FILES.glob("told_*.npz")), ids=lambda path: path.stem)
def test_solved_problems_load(path):
    with np.load(path) as archive:
        content = dict(archive)
    model = tc.Model(
        tc.Scene(tc.shapes.prism(3, stiffness=1000.0, bar_radius=0.005), control=tc.ForceDensity())
    )
    found = rebuilt(content, model, None)
    assert found["unknown"] == ""
    told = json.loads(str(content["solved"]))
    for name in ("transcription", "solver"):
        assert type(found[name]).__name__ == told[name]["class"]
    assert len(found["problem"].bounds) == 12


@pytest.mark.parametrize(
    "path", sorted((FILES / "models").glob("*.npz")), ids=lambda path: path.stem
)
def test_models_load(path):
    with np.load(path) as archive:
        content = dict(archive)
    model = model_from_arrays(content)
    assert (model is None) is bool(content["scene.functions"].size)
    assert model is None or not find_differences(content, model)

"""Files that earlier versions wrote still load: scene files, plans, trajectories, rollouts, trade-offs, models, sweeps."""

from __future__ import annotations

import json
import shutil
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.plan.older_files import upgrade
from tenscasadi.util.archive import Fields

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DATA = Path(__file__).parent / "data"
FOLDERS = [DATA / "version_0_1", DATA / "before_one_schema"]
LOADERS = {
    "plan": ocp.Plan.load,
    "rollouts": tc.Rollouts.load,
    "tradeoff": tc.Tradeoff.load,
    "trajectory": tc.Trajectory.load,
}
SCENES = sorted(path for folder in FOLDERS for path in folder.glob("*.toml"))

PRESENT_NAMES = {
    "CentreOfMass": "CenterOfMass",
    "Arrays": "TrajectoryGuess",
    "Equilibrium": "EquilibriumGuess",
    "centre": "center",
    "stands": "contact_nodes",
    "until": "end_time",
    "speed": "rate",
    "seconds": "time_limit",
    "starts": "n_starts",
    "warm": "warm_start",
    "restart": "restart_at_saddle",
    "changes": "max_changes",
    "finest": "min_scale",
}

PRESENT_CLASSES = {"Fatrop": "Ipopt", "Collocation": "DirectCollocation"}


def rename(tree):
    """Replace names of earlier versions by present ones."""
    if isinstance(tree, dict):
        return {PRESENT_NAMES.get(name, name): rename(value) for name, value in tree.items()}
    if isinstance(tree, list):
        return [rename(value) for value in tree]
    return PRESENT_NAMES.get(tree, tree) if isinstance(tree, str) else tree


@pytest.mark.parametrize("path", SCENES, ids=lambda path: f"{path.parent.name} {path.stem}")
def test_scene_files_come_back(path, tmp_path):
    data = tomllib.loads(path.read_text(encoding="utf-8"))
    again = tmp_path / "again.toml"
    if "plan" in data:
        arguments = ocp.load_solve_arguments(path)
        ocp.save_problem(arguments.pop("problem"), again, **arguments)
    elif "simulation" in data:
        tc.save_scene(tc.load_simulation(path), again)
    else:
        tc.save_scene(tc.load_scene(path), again)
    for name in ("transcription", "solver"):
        if given := data.get("plan", {}).get(name):
            given["kind"] = PRESENT_CLASSES.get(given["kind"], given["kind"])
    if "numbers" not in data:  # no names nor formulas, which are not written
        assert rename(tomllib.loads(again.read_text(encoding="utf-8"))) == rename(data)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
@pytest.mark.parametrize("name", LOADERS)
def test_results_load(name, folder):
    assert LOADERS[name](folder / f"{name}.npz").summary()


def test_sweeps_are_not_computed_again(tmp_path):
    folder = shutil.copytree(DATA / "before_one_schema/sweep", tmp_path / "sweep")
    cases = [
        {"x": 1.5, "name": "a", "list": np.arange(3.0)},
        {"x": 2.5, "name": "γ", "list": (1, 2, 3)},
        {"x": 3.0, "name": "", "list": [True, False]},
    ]
    with ThreadPoolExecutor(1) as executor:
        table = tc.sweep(study, cases, executor, folder)
    assert "3 read" in table.message
    assert table["double"].tolist() == [3.0, 5.0, 6.0]


def study(case):
    raise AssertionError("computed again")


study.__module__ = "study"  # as when the files were written


@pytest.mark.parametrize("path", sorted(FOLDERS[0].glob("told_*.npz")), ids=lambda path: path.stem)
def test_solved_problems_load(path, tmp_path):
    with np.load(path) as told, np.load(FOLDERS[1] / "plan.npz") as plan:
        prism = tc.shapes.prism(3, bar_radius=0.005)  # what the problems are for
        own = {f"structure.{name}": getattr(prism, name) for name in ("nodes", "bar_radius")}
        np.savez(tmp_path / "plan.npz", **{**plan, **told, **own})
    loaded = ocp.Plan.load(tmp_path / "plan.npz")
    told = json.loads(loaded_text(path))
    assert len(loaded.problem.bounds) == 12, loaded.not_restored
    for name in ("transcription", "solver"):
        wanted = PRESENT_CLASSES.get(told[name]["class"], told[name]["class"])
        assert type(getattr(loaded, name)).__name__ == wanted


def loaded_text(path: Path) -> str:
    with np.load(path) as told:
        return str(told["solved"].item())


def scene_of(name: str) -> dict[str, object]:
    """Keywords of the scenes whose plans were saved."""
    prism = tc.shapes.prism(stiffness=1000.0, prestress=50.0, string_mass=0.01)
    grounds = [
        tc.Ground(height=-1, friction=0.4),
        tc.Terrain([[-5, -4], [-4, -5]], (-2, -2), (2, 2), nodes=[0, 1]),
    ]
    own = {
        "grounds": {"gravity": tc.Gravity(), "ground": grounds},
        "segments": {"segments": 2, "ends": "lumped", "fractions": (0.4, 0.6)},
        "rest_length": {
            "control": tc.RestLength(),
            "slack": {0: tc.Linear(), 1: tc.Smooth(0.1), 2: tc.Clip("unclamped")},
        },
        "tables": {
            "gravity": tc.Gravity([(0, 0, -1), (0, 0, -2)], times=[0, 1]),
            "pressure": tc.Pressure([(0, 1, 2)], [1.0, 2.0], times=[0, 1]),
            "forces": tc.NodalForce(np.arange(36.0).reshape(2, 6, 3) / 50, times=[0, 0.5]),
        },
        "function": {
            "forces": tc.NodalForce(lambda t: [[np.sin(t), 0, 0]] + [[0, 0, 0]] * 5),
        },
        "parameters": {
            "parameters": tc.Parameters("stiffness", "bar_mass", groups={"bar_mass": "all"})
        },
        "pins": {"structure": prism.replace(pinned={0: "xyz"}, rollers={1: (1, 0, 1)})},
        "constant": {},
    }
    return {"structure": prism, "control": tc.ForceDensity(), **own[name]}


@pytest.mark.parametrize("path", sorted(FOLDERS[1].glob("plan_*.npz")), ids=lambda path: path.stem)
def test_plans_load_with_their_models(path):
    name = path.stem.removeprefix("plan_")
    options = {"pins": {"coordinates": "full"}, "constant": {"bar_length": "constant"}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of parameters without effect
        model = tc.Model(tc.Scene(**scene_of(name)), **options.get(name, {}))
    loaded = ocp.Plan.load(path)
    assert (loaded.model is None) is (name == "function")
    assert loaded.trajectory.sampled == (("forces",) if name == "function" else ())
    problem = ocp.Problem(
        model,
        0.1,
        bounds=[ocp.ForceDensityLimits(0.0, 500.0)] if name != "rest_length" else [],
        costs=[ocp.Effort()] if name != "rest_length" else [],
    )
    assert ocp.Plan.load(path, problem).model is problem.model
    other = tc.Model(tc.Scene(**scene_of("constant") | {"gravity": tc.Gravity((1.0, 0, 0))}))
    with pytest.raises(ValueError, match="other in"):
        ocp.Plan.load(path, ocp.Problem(other, 0.1))


MODELS = sorted((FOLDERS[0] / "models").glob("*.npz"))


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_models_load(path):
    motion = tc.Trajectory.load(FOLDERS[1] / "trajectory.npz")
    with np.load(path) as archive:
        content = Fields(archive)
    found = upgrade(content, motion)
    scene = found["trajectory"].scene
    assert (found["model"] is None) is bool(content["scene.functions"].size)
    assert scene.structure is found["structure"]
    assert found["trajectory"].sampled == tuple(content["scene.functions"].tolist())

"""Commands `plan` and `control` with refinement, robustness and controllers of scene files."""

from __future__ import annotations

import json

import pytest

import ocp
import tenscasadi as tc
from tenscasadi.cli.main import main

ARM = """
format = 1
units = "SI"
[structure]
nodes = [[0, 0, 0], [0, 0, 1], [-1, 0, 0], [1, 0, 0]]
bars = [[0, 1]]
strings = [[1, 2], [1, 3]]
pinned = [0, 2, 3]
[plan]
goals = [{ kind = "NodePositions", positions = { 1 = [0.3, 0, "free"] } }, "AtRest"]
bounds = [{ kind = "ForceDensityLimits", lower = 0.0, upper = 50.0 }]
costs = ["Effort"]
transcription = { kind = "MultipleShooting", intervals = 10 }
"""


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(text):
        (tmp_path / "arm.toml").write_text(ARM + text, encoding="utf-8")

    return write


def test_plan_refines_and_replays_many_times(arm, tmp_path, capsys):
    arm("[refinement]\ntolerance = 1e-6\n[robustness]\nparameters.bar_mass = 0.1\nsamples = 100")
    assert main(["plan", "arm.toml", "--json", "--no-plots"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["files"] == ["arm-plan.npz"]
    assert found["replay_error"] < 1e-6
    assert ocp.Plan.load("arm-plan.npz").replay_error == found["replay_error"]
    assert found["robustness"]["importance"]["bar_mass"] > 0.9
    assert 0 < found["robustness"]["error"]["5 %"] < found["robustness"]["error"]["95 %"]


@pytest.mark.slow  # draws pictures
def test_robustness_is_drawn(arm, tmp_path, capsys):
    arm("[robustness]\nstart = 1e-3\nsamples = 20")
    assert main(["plan", "arm.toml"]) == 0
    assert "replays       20" in capsys.readouterr().out
    assert (tmp_path / "arm-robustness.png").stat().st_size > 5000


def test_control_simulates_under_the_controller(arm, tmp_path, capsys):
    arm("[closed_loop]\nt_end = 0.5\ncontroller = { period = 0.1, intervals = 5 }")
    assert main(["control", "arm.toml", "--t-end", "1.5", "-o", "out"]) == 0
    out = capsys.readouterr().out
    for words in ("decisions     15", "controller = {'kind': 'Mpc', 'period': 0.1", "goals  "):
        assert words in out
    assert (tmp_path / "out" / "arm-control.png").stat().st_size > 5000
    motion = tc.Trajectory.load(tmp_path / "out" / "arm-control.npz")
    assert motion.nodes[-1, 1, 0] == pytest.approx(0.3, abs=0.01)


def test_control_prints_one_json_object(arm, capsys):
    arm("[closed_loop]\nt_end = 0.2\ncontroller = { period = 0.1, intervals = 2 }")
    assert main(["control", "arm.toml", "--json", "--no-plots"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"goal_error", "goal_speed_error", "slowest_decision", "success"} <= found.keys()
    assert found["goal_error"] > 0.01


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "it has no [closed_loop]: give one"),
        ("[closed_loop]\nt_end = 0", "t_end is 0"),
        ("[closed_loop]\nt_end = 1\ncontroller = { period = -1 }", "closed_loop: period is -1"),
        ("[closed_loop]\nt_end = 1\nparameters.bar_mass = 2", "closed_loop: "),
    ],
)
def test_control_rejects_bad_tables(text, message, arm, tmp_path, capsys):
    arm(text)
    assert main(["control", "arm.toml"]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["arm.toml"]


def test_info_checks_and_lists_the_tables(arm, capsys):
    arm("[refinement]\ntolerance = 1e-6\n[closed_loop]\nt_end = 2")
    assert main(["info", "arm.toml"]) == 0
    out = capsys.readouterr().out
    assert "refinement    tolerance = 1e-06\n" in out
    assert "closed_loop   t_end = 2.0\n" in out
    arm("[refinement]\ntolerance = -1")
    assert main(["info", "arm.toml"]) == 2

"""Every example runs, in a folder of its own, and its claims hold."""

from __future__ import annotations

import inspect
import os
import subprocess
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from browser import chromium
from loading import EXAMPLES, load_example


def simulate_ball(rows: Any) -> None:
    plain, corrected = (
        [row for row in rows if (row.correction is None) == without] for without in (True, False)
    )
    assert max(row.bar_length for row in corrected) < 1e-15
    for kind in (plain, corrected):  # ten times the step, order 4
        assert 2e3 < kind[0].position / kind[-1].position < 5e4


def double_pendulum(errors: Any) -> None:
    assert max(errors["reduced"], errors["full"]) < 1e-10
    assert errors["pin force"] < 1e-11


def plan_prism(plan: Any) -> None:
    assert plan.success
    assert plan.replay_error < 1e-3


def plate_on_strings(plan: Any) -> None:
    assert plan.success, plan.message
    replay = plan.replay()
    R, spin = replay.orientation(0)[-1], replay.angular_velocity(0)[:, 2]
    assert abs(np.degrees(np.arctan2(R[1, 0], R[0, 0])) - 40) < 0.05
    assert abs(np.degrees(np.arccos(R[2, 2])) - 8) < 0.05
    assert spin.max() < 1.25


def two_motors(plan: Any) -> None:
    assert plan.success, plan.message
    assert plan.replay_error < 1e-3
    assert (plan.control[:, 1] == plan.control[:, 2]).all()  # wound by one motor
    tension = plan.replay().tension
    np.testing.assert_allclose(tension[:, :3], tension[:, 3:6], rtol=1e-9)  # along each cable


def swing_up(plan: Any) -> None:
    assert plan.success, plan.message
    nodes = plan.replay().nodes
    np.testing.assert_allclose(nodes[-1, 2], (0, 0, 2), atol=1e-3)
    assert nodes[:, 1, 0].min() < -0.3  # it swings to one side, then to the other
    assert nodes[:, 1, 0].max() > 0.3


def standing_balance(result: Any) -> None:
    plan, motion = result
    assert plan.success, plan.message
    assert plan.tracked
    assert plan.error_growth > 1e6
    side = np.abs(motion.nodes[:, 1:4, 0])
    assert side.max() < 0.1
    assert side[-1].max() < 1e-4


def catch_prism(plan: Any) -> None:
    assert plan.success, plan.message
    replay = plan.replay()
    np.testing.assert_allclose(replay.nodes[-1, :6].mean(axis=0), (0.2, 0, 1.2), atol=1e-2)
    assert np.abs(replay.velocities[-1]).max() < 1e-2
    assert np.linalg.norm(replay.velocities[0, :6].mean(axis=0)) > 1.8


def bars_touch(distances: Any) -> None:
    assert distances["no contact"].min() < 0.03
    assert distances["contact"].min() > 0.078  # of radii of 0.04 m
    assert np.ptp(distances["contact"][:50] - distances["no contact"][:50]) < 1e-9  # before


def plan_landing(plan: Any) -> None:
    assert plan.success, plan.message
    replay = plan.replay()
    assert abs(replay.nodes[:, :, 2].mean(axis=1).max() - 0.6) < 0.02  # it has risen 0.3 m
    assert np.abs(replay.velocities[-1]).max() < 0.1
    assert np.abs(replay.nodes[-1, :3, 2]).max() < 0.01  # it stands on its feet


def ball_rolls(result: Any) -> None:
    plan, after = result
    assert plan.success, plan.message
    behind, *face = after.nodes[-1][[11, 3, 7, 1], 2]
    assert max(face) < 0.0  # it stands on the face beyond the edge
    assert behind > 0.2


def ball_on_terrain(result: Any) -> None:
    field, run = result
    assert run.success, run.message
    assert abs(run.energy_error).max() < 1e-3 * run.energy[0]
    depth = field.depth(run.nodes[-1].T).full()
    assert (depth > 0).sum() >= 3  # it stands
    assert depth.max() < 0.02
    assert 0.6 < run.nodes[..., 0].max() < 0.7  # the wall has held it


def ball_travels(rows: Any) -> None:
    for row in rows:
        assert row.ahead > 0.3 * row.motion.time[-1]
        assert row.motion.nodes[:, :, 2].mean(axis=1).min() > 0.2  # it has not collapsed


def contact_problems(plans: Any) -> None:
    for name, plan in plans.items():
        assert plan.success, f"{name}: {plan.message}"


def learn_to_travel(learned: Any) -> None:
    medians = np.median(learned.distance, axis=1)
    assert medians[-1] > medians[0] + 0.05
    assert [count for count, _ in learned.speeds] == [1, 1024]
    assert learned.speeds[1][1] > learned.speeds[0][1]


def prism_gait(result: Any) -> None:
    plan, walk = result
    assert plan.replay_error < 0.02, (
        plan.message
    )  # whether the cost is settled, too, depends on rounding
    assert walk[0, 2] < 0.02  # one period of the plan itself
    forward, _, departure = walk[1]
    assert forward > 0.25
    assert departure < 0.08


def benchmark_rollouts(rows: Any) -> None:
    assert all(
        row.ours > 0 and row.other > 0 for row in rows
    )  # an idle machine gives the figures of the README
    assert rows[-1].ratio > 1  # values of a parameter take no compiler


def benchmark_rhs(rows: Any) -> None:
    shapes, drives = ("prism", "six-bar ball"), ("force densities", "elastic strings")
    assert [row.scene for row in rows] == [
        f"{shape}, {drive}" for shape in shapes for drive in drives
    ]
    for row in rows:  # figures of time are no verdict
        assert row.virtual_machine > 0
        assert row.numpy > 0
        assert row.compiled is None or row.compiled > 0


def paper_prism(errors: Any) -> None:
    assert errors["interior", 9] == pytest.approx(0.0068, abs=5e-5)
    assert errors["lumped", 9] == pytest.approx(0.0009, abs=5e-6)
    lumped = [errors["lumped", n] for n in range(1, 10)]
    assert lumped == sorted(lumped, reverse=True)
    assert all(errors["lumped", n] < errors["interior", n] for n in range(1, 10))


def paper_dbar(rows: Any) -> None:
    kept = rows["projection"]
    assert kept.end == 5.0
    assert max(kept.bar_length, kept.joint) < 1e-14
    assert kept.energy < 1e-4
    assert kept.position < 1e-4
    assert rows["Appendix C"].joint > 1e-10  # what the design says of closed loops


def paper_membrane(rows: Any) -> None:
    for size, peak in {(8, 5): 0.0477, (16, 9): 0.0495, (24, 13): 0.0501}.items():
        assert rows[size].peak == pytest.approx(peak, abs=5e-5)
        assert rows[size].time == pytest.approx(7e-3, abs=5e-4)
        assert rows[size].axial < 1e-12


def paper_lander(heights: Any) -> None:
    np.testing.assert_allclose(heights, [2.304, 1.551, 1.101, 0.827, 0.675], atol=6e-4)


def stiff_strings(tables: Any) -> None:
    for rows in tables:
        assert max(row.error for row in rows) < 1e-6
        assert max(row.steps for row in rows if "Collocation" in row.scheme) * 100 < min(
            row.steps for row in rows if "Runge" in row.scheme
        )


def extremes(rows: Any) -> None:
    assert len(rows) > 40
    for row in rows:
        assert row.error <= row.stated, row


def sweep_stiffness(table: Any) -> None:
    assert table.success.all(), table.errors
    assert table["success"].all()
    soft, stiff = table["stiffness"] < 1e3, table["stiffness"] > 1e3
    assert table["tension"][stiff].min() > 2 * table["tension"][soft].max()
    assert table["crushed"][soft].min() > 3 * table["crushed"][stiff].max() > 0


def identify_prism(found: Any) -> None:
    assert (abs(found.values - found.true) < 4 * found.deviation).all(), found
    assert (found.deviation < 0.01 * found.true).all()


CLAIMS = (
    bars_touch,
    identify_prism,
    extremes,
    simulate_ball,
    double_pendulum,
    plan_prism,
    plate_on_strings,
    swing_up,
    standing_balance,
    catch_prism,
    two_motors,
    plan_landing,
    ball_rolls,
    ball_on_terrain,
    ball_travels,
    contact_problems,
    learn_to_travel,
    prism_gait,
    benchmark_rhs,
    benchmark_rollouts,
    paper_prism,
    paper_dbar,
    paper_membrane,
    paper_lander,
    stiff_strings,
    sweep_stiffness,
)


IN_A_BROWSER = "benchmark_viewer"
SLOW = (  # two seconds and more
    "ball_on_terrain",
    "ball_rolls",
    "ball_travels",
    "catch_prism",
    "bars_touch",
    "contact_problems",
    "extremes",
    "identify_prism",
    "learn_to_travel",
    "ocp_suite",
    "ocp_tradeoff",
    "paper_dbar",
    "paper_lander",
    "paper_membrane",
    "paper_prism",
    "plan_growth",
    "plan_landing",
    "prism_gait",
    "standing_balance",
    "stiff_strings",
    "sweep_stiffness",
    "swing_up",
    "tradeoff_prism",
)
PICTURES_OF_THE_PAPER = {"paper_prism": 6, "paper_dbar": 4, "paper_membrane": 3, "paper_lander": 3}
NAMES = sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,
            marks=[pytest.mark.slow] * (name in SLOW or name.startswith("benchmark_")),
        )
        for name in NAMES
    ],
)
def test_example(name, tmp_path, monkeypatch, capsys):
    if name == IN_A_BROWSER and chromium() is None:
        pytest.skip("there is no browser: install chromium, or name one in TENSCASADI_BROWSER")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, name, ModuleType(name))  # leaves with the test
    main = load_example(name).main
    pictures = tmp_path / "new" / "folder"
    possible = {"folder": pictures, "quick": True}
    arguments = {
        key: value for key, value in possible.items() if key in inspect.signature(main).parameters
    }
    result = main(**arguments)
    assert len(capsys.readouterr().out) > 100
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert all(
        path.suffix == ".png" and path.stem.startswith(name) and path.stat().st_size > 5000
        for path in written
    )
    assert {path.parent for path in written} == ({pictures} if "folder" in arguments else set())
    assert len(written) == PICTURES_OF_THE_PAPER.get(name, len(written))
    for claim in CLAIMS:
        if claim.__name__ == name:
            claim(result)


@pytest.mark.parametrize(
    "name",
    sorted(
        path.stem
        for path in EXAMPLES.glob("*.py")
        if "folder: Path" in path.read_text(encoding="utf-8")
    ),
)
def test_a_folder_that_cannot_be_made_is_told_before_all_else(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, name, ModuleType(name))
    main = load_example(name).main
    (tmp_path / "taken").write_text("")
    for builds in ("Model", "Scene", "simulate"):
        monkeypatch.delattr(f"tenscasadi.{builds}")
    with pytest.raises(FileExistsError, match="taken"):
        main(folder=tmp_path / "taken")
    assert capsys.readouterr().out == ""


def test_claims_are_of_examples():
    assert {claim.__name__ for claim in CLAIMS} <= {path.stem for path in EXAMPLES.glob("*.py")}


def test_examples_run_as_scripts(tmp_path):
    command = [sys.executable, str(EXAMPLES / "two_motors.py"), str(tmp_path)]
    path = {**os.environ, "PYTHONPATH": str(EXAMPLES.parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=path)
    assert done.returncode == 0, done.stderr
    assert "rest lengths of the cables change" in done.stdout
    assert {path.suffix for path in tmp_path.iterdir()} == {".png"}


def test_code_does_not_grow_with_large_structures(monkeypatch):
    monkeypatch.setitem(
        sys.modules, "benchmark_scale", ModuleType("benchmark_scale")
    )  # leaves with the test
    example = load_example("benchmark_scale")
    for make in (example.chain, example.links):
        small, large = (example.measure("", make(n)) for n in (150, 300))
        assert large.instructions == small.instructions

"""Every example runs, in a folder of its own, and its claims hold."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its classes look for their module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "modules", dict(sys.modules))


def test_simulate_ball(tmp_path):
    rows = load("simulate_ball").main(tmp_path)
    plain, corrected = ([row for row in rows if (row.correction is None) == without] for without in (True, False))
    assert max(row.bar_length for row in corrected) < 1e-15
    for coarse, fine in ((plain[0], plain[-1]), (corrected[0], corrected[-1])):  # ten times the step, order 4
        assert 2e3 < coarse.position / fine.position < 5e4
    assert (tmp_path / "simulate_ball.png").stat().st_size < 200_000


def test_double_pendulum(tmp_path):
    errors = load("double_pendulum").main(tmp_path)
    assert max(errors["reduced"], errors["full"]) < 1e-10
    assert errors["pin force"] < 1e-11
    assert (tmp_path / "double_pendulum.png").exists()


def test_benchmark_rhs(capsys):
    rows = load("benchmark_rhs").main(quick=True)
    assert len(capsys.readouterr().out.splitlines()) == 1 + len(rows)
    assert all(row.virtual_machine > row.numpy for row in rows)


def test_every_example_is_tested():
    tested = {name.removeprefix("test_") for name in globals() if name.startswith("test_")}
    assert {path.stem for path in EXAMPLES.glob("*.py")} <= tested


def test_examples_run_as_scripts(tmp_path):
    command = [sys.executable, str(EXAMPLES / "double_pendulum.py"), str(tmp_path)]
    path = {**os.environ, "PYTHONPATH": str(EXAMPLES.parent)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=path)
    assert done.returncode == 0, done.stderr
    assert "Newton's second law" in done.stdout
    assert {path.suffix for path in tmp_path.iterdir()} == {".png"}

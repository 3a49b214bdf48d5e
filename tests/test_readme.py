"""What the README and the documents say is so: their snippets run, their commands exist, their files are there."""

from __future__ import annotations

import re
import runpy
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tenscasadi as tc
from ocp.problem.goals.goal import Goal
from tenscasadi.cli.main import COMMANDS
from tenscasadi.cli.parser import parse
from tenscasadi.integrators.scheme import NamedScheme
from tenscasadi.structure.shapes import ShapeFamily

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
DOCUMENTS = [str(path.relative_to(ROOT)) for path in sorted((ROOT / "docs").rglob("*.md"))]
GENERATED = (
    "api/",
    "command_line.md",
    "scene_fields.md",
    "viewer/",
)  # pages that the site makes of the code
SLOW = (  # two seconds and more
    "docs/cables.md",
    "docs/exchange.md",
    "docs/planning.md",
    "docs/rollouts.md",
    "docs/scene_files.md",
    "docs/statics.md",
    "docs/viewer.md",
    "docs/tutorials/closed_loop.md",
    "docs/tutorials/from_mujoco.md",
    "docs/tutorials/own_model.md",
    "docs/tutorials/plan.md",
    "docs/tutorials/simulate.md",
    "docs/tutorials/size_a_structure.md",
    "docs/tutorials/sweep.md",
)


def blocks(language: str, text: str = README) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)


def run_snippets(text: str, folder: Path) -> dict[str, Any]:
    """Runs the Python blocks of a document as one script, in `folder`; all else is an empty line, so that a failure tells the document's line."""
    code, inside = [], False
    for line in text.splitlines():
        fence = line.startswith("```")
        code.append(line if inside and not fence else "")
        inside = line == "```python" if fence else inside
    script = folder / "snippets.py"
    script.write_text("\n".join(code), encoding="utf-8")
    return runpy.run_path(str(script))


def test_snippets_run_in_order(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = run_snippets(README, tmp_path)
    assert names["plan"].success
    assert names["plan"].replay_error < 1e-3
    assert {path.name for path in tmp_path.iterdir()} == {"snippets.py", "replay.npz"}
    assert tc.Trajectory.load(tmp_path / "replay.npz").success


def test_readme_fits_a_screen():
    assert len(README.splitlines()) <= 150


@pytest.mark.slow
def test_snippets_of_modeling_page(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "modeling.md").read_text(encoding="utf-8")
    names = run_snippets(page, tmp_path)
    assert names["trajectory"].success
    assert names["gamma"].min() >= 10.0
    named = re.findall(r'"([\w.]+\.(?:npz|png|gif))"', "\n".join(blocks("python", page)))
    assert {path.name for path in tmp_path.iterdir()} - {"snippets.py"} == set(named)
    assert "finished 1000 steps" in capsys.readouterr().out


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))
        for name in sorted(set(DOCUMENTS) - {"docs/modeling.md"})
    ],
)
def test_snippets_of_documents_run(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    try:
        run_snippets((ROOT / name).read_text(encoding="utf-8"), tmp_path)
    except ImportError as error:  # of an optional package
        if "pip install 'tenscasadi[" not in str(error):
            raise
        pytest.skip(str(error))


def test_scene_files_of_documents_run(tmp_path):
    found = [
        text
        for name in DOCUMENTS
        for text in blocks("toml", (ROOT / name).read_text(encoding="utf-8"))
        if text.startswith("format")
    ]
    assert len(found) >= 3
    for text in found:
        (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
        if "[simulation]" in text:
            run = replace(tc.load_simulation(tmp_path / "scene.toml"), t_end=0.05).run(
                compiled=False
            )
            assert run.success, run.message
        else:
            tc.load_scene(tmp_path / "scene.toml")


def test_recipes_do_what_they_say(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for family in (Goal, NamedScheme, ShapeFamily):  # the recipes register their classes in these
        monkeypatch.setattr(family, "members", dict(family.members))
    names = run_snippets((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), tmp_path)
    assert names["ratio"] == pytest.approx(8, rel=0.1)  # Heun's method is of order 3
    assert names["plan"].success, names["plan"].message
    ends = names["plan"].replay().nodes[-1]
    assert np.linalg.norm(ends[5] - ends[0]) == pytest.approx(names["wanted"], abs=1e-3)
    assert names["run"].success
    assert names["again"] == names["problem"].goals[0]
    assert ShapeFamily.members["tripod"] is names["tripod"]
    assert NamedScheme.members["Heun3"] is names["Heun3"]
    assert np.all(np.asarray(names["W"]) == -0.5)


@pytest.mark.parametrize("name", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", *DOCUMENTS])
def test_files_that_documents_name_exist(name):
    text = (ROOT / name).read_text(encoding="utf-8")
    folder = (ROOT / name).parent
    for path in re.findall(r"\]\(((?!http)[^)#]+)\)", text):
        assert (
            (folder / path).exists()
            or path.startswith(GENERATED)
            or path.removeprefix("../").startswith(GENERATED)
        ), path
    for path in re.findall(r"`((?:tenscasadi|ocp|tests|examples|docs)/[\w/.]*)`", text):
        assert (ROOT / path).exists(), path


def test_two_commands_do_all_set_up():
    main_job, tests = blocks("sh")
    for command in (main_job, tests):
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install -q ")
    assert "pytest" in tests


COMMAND = re.compile(
    r"(?<![\w/.])(?:\.venv/bin/)?tenscasadi (?:plan|control|simulate|tradeoff|info|new|view|export) [^`\n>]+"
)
SHELL = "\n".join(
    block for name in DOCUMENTS for block in blocks("sh", (ROOT / name).read_text(encoding="utf-8"))
)
IN_DOCUMENTS = re.findall(r"^tenscasadi [^\n>|]+", SHELL, re.MULTILINE)


@pytest.mark.parametrize("command", COMMAND.findall(README) + IN_DOCUMENTS)
def test_commands_are_understood(command):
    assert callable(parse(shlex.split(command, comments=True)[1:], COMMANDS))


def test_folders_named_exist_and_all_are_named():
    for package in ("tenscasadi", "ocp"):
        table = ARCHITECTURE.split(f"| in `{package}/` |")[1].split("\n\n")[0]
        named = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
        assert sorted(named) == sorted(
            path.parent.name for path in (ROOT / package).glob("*/__init__.py")
        )


def test_pictures_are_small():
    sizes = [picture.stat().st_size for picture in (ROOT / "docs").rglob("*.png")]
    assert max(sizes) < 200_000
    assert sum(sizes) < 3_000_000

"""What the README says is so: its snippets run, its commands exist, its files are there."""

from __future__ import annotations

import re
import runpy
import shlex
from pathlib import Path

import pytest

from tenscasadi.cli.main import _parser

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)


def test_snippets_run_in_order(tmp_path, monkeypatch, capsys):
    # everything else becomes an empty line, so that a failure tells the README's own line
    code, inside = [], False
    for line in README.splitlines():
        fence = line.startswith("```")
        code.append(line if inside and not fence else "")
        inside = line == "```python" if fence else inside
    script = tmp_path / "readme.py"
    script.write_text("\n".join(code), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(script))
    assert names["trajectory"].success
    assert names["plan"].success
    assert names["plan"].replay_error < 1e-3
    assert names["gamma"].min() >= 10.0
    assert {path.name for path in tmp_path.iterdir()} - {"readme.py"} == set(re.findall(r'"([\w.]+\.(?:npz|png|gif))"', "\n".join(blocks("python"))))
    assert "finished 1000 steps" in capsys.readouterr().out


def test_two_commands_do_all_set_up():
    main_job, tests = blocks("sh")
    for command in (main_job, tests):
        assert command.startswith("python3 -m venv .venv && .venv/bin/pip install -q ")
    assert "pytest" in tests


@pytest.mark.parametrize("command", re.findall(r"(?<![\w/.])(?:\.venv/bin/)?tenscasadi (?:plan|simulate|tradeoff|info) [^`\n]+", README))
def test_commands_are_understood(command):
    assert callable(_parser().parse_args(shlex.split(command)[1:]).run)


def test_folders_named_exist_and_all_are_named():
    for package in ("tenscasadi", "ocp"):
        table = README.split(f"| in `{package}/` |")[1].split("\n\n")[0]
        named = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
        assert sorted(named) == sorted(path.parent.name for path in (ROOT / package).glob("*/__init__.py"))
    for path in re.findall(r"\]\((docs/[^)]+)\)", README) + re.findall(r"`(examples/\w+\.py)`", README):
        assert (ROOT / path).exists(), path


def test_pictures_are_small():
    for picture in (ROOT / "docs").glob("*.png"):
        assert picture.stat().st_size < 200_000

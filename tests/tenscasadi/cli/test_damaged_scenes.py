"""Damaged and wrong scene files on the command line: one line each, exit code 2, and nothing is run, read or written but what the format says."""

from __future__ import annotations

import re
import sys
import sysconfig
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from damaged_scenes import damaged_scene
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tenscasadi.cli.main import main
from tenscasadi.cli.source import TEMPLATES

WANTED = 200
LINE = re.compile(r"tenscasadi: scene\.toml(, line \d+)?(, [\w.\[\]\-…' \"]+)?: [^\n]+\n")
CURE = re.compile(
    r"\b(give|did you mean|leave|correct it|begin with|must|change|move|write|add|lower|keep)\b"
)
FORBIDDEN = (
    *("subprocess.", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "os.fork", "socket."),
    *("os.remove", "os.rename", "os.mkdir", "shutil."),
)
CODE = [
    Path(path).resolve()
    for path in {*sys.path, *sysconfig.get_paths().values(), Path(__file__).parents[3]}
    if path and Path(path).is_dir()
]

_seen: list[tuple[str, tuple[object, ...]]] = []
_watching = False


def _hook(event: str, arguments: tuple[object, ...]) -> None:
    if _watching and (
        event in ("open", "exec", "compile", "import") or event.startswith(FORBIDDEN)
    ):
        _seen.append((event, arguments))


sys.addaudithook(_hook)


@contextmanager
def watched() -> Iterator[list[tuple[str, tuple[object, ...]]]]:
    """Collect what Python's own audit tells of files, code and processes."""
    global _watching
    _seen.clear()
    _watching = True
    try:
        yield _seen
    finally:
        _watching = False


def faults(events: list[tuple[str, tuple[object, ...]]], folder: Path) -> Iterator[str]:
    """Events that reading a scene file has no business with: importing a module of the package for the first time is none."""
    for event, arguments in events:
        if event.startswith(FORBIDDEN):
            yield f"{event} {arguments}"
        elif event == "exec" and not _is_code(getattr(arguments[0], "co_filename", "")):
            yield f"exec {arguments}"
        elif event == "compile" and not _is_code(arguments[1]):
            yield f"compile {arguments}"
        elif event == "open" and isinstance(arguments[0], str):
            path, mode, flags = (*arguments, None)[:3]
            writing = any(letter in str(mode or "r") for letter in "wax+")
            if writing or not (Path(path).resolve().is_relative_to(folder) or _is_code(path)):
                yield f"open {path} {mode} {flags}"


def _is_code(path: object) -> bool:
    text = path.decode() if isinstance(path, bytes) else str(path)
    return text.startswith(("<frozen", "<formula>")) or any(
        Path(text).resolve().is_relative_to(root) for root in CODE
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a scene file, and beside it what no scene file may reach."""
    outside = tmp_path_factory.mktemp("outside")
    (outside / "outside.toml").write_text('format = 1\nunits = "SI"\n')
    inside = outside / "inside"
    inside.mkdir()
    (inside / "link.toml").symlink_to(outside / "outside.toml")
    return inside


@pytest.mark.slow
def test_wrong_scene_files_give_one_line_each(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    for slow in ("fastest_rate", "stable_step"):
        monkeypatch.setattr(f"tenscasadi.cli.commands.{slow}", lambda *_, **__: 1.0)
    monkeypatch.setattr("tenscasadi.dynamics.model.Model.describe", lambda _: "")
    assert main(["schema"]) == 0  # evaluates the annotations of all classes
    for shape in TEMPLATES:  # modules are loaded by files that are right
        (folder / "scene.toml").write_bytes(TEMPLATES[shape].read_bytes())
        assert main(["info", "scene.toml"]) == 0
    capsys.readouterr()
    told: dict[bytes, str] = {}

    @settings(
        max_examples=WANTED + WANTED // 2, deadline=None, suppress_health_check=list(HealthCheck)
    )
    @given(st.data(), st.sampled_from(["prism", "d-bar", "six-bar-ball", "reach"]))
    def one(data: st.DataObject, shape: str) -> None:
        content = damaged_scene(data.draw, TEMPLATES[shape].read_text(encoding="utf-8"))
        (folder / "scene.toml").write_bytes(content)
        with warnings.catch_warnings(), watched() as events:
            warnings.simplefilter("ignore")
            code = main(["info", "scene.toml"])
        error = capsys.readouterr().err
        assert not list(faults(events, folder))
        assert sorted(path.name for path in folder.iterdir()) == ["link.toml", "scene.toml"]
        assert code in (0, 2), error
        if code == 2:
            assert LINE.fullmatch(error), error
            assert CURE.search(error), error
            told[content] = error

    one()
    assert len(told) >= WANTED

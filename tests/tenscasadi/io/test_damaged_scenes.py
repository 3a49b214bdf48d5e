"""Damaged and wrong scene files: one line that tells file and cure, never another exception, no other file opened, soon."""

from __future__ import annotations

import builtins
import os
import re
import socket
import subprocess
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tenscasadi as tc

ROOT = Path(__file__).parents[3]
GUIDE = (ROOT / "docs/scene_files.md").read_text(encoding="utf-8")
TEXTS = [
    path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "examples/scenes").glob("*.toml"))
    if path.stem != "paper_membrane"
]
TEXTS += re.findall(r"^```toml\n(format.*?)^```", GUIDE, flags=re.MULTILINE | re.DOTALL)
ODD = [
    *(
        "-1",
        "0",
        "1e300",
        "-1e-300",
        "nan",
        "inf",
        "1e9",
        "99999999999999999999",
        "true",
        '""',
        "[]",
        "{}",
        "[[]]",
        "[[[1]]]",
        "1979-05-27",
    ),
    *(
        '"nodes"',
        '"9**9**9**9"',
        "\"__import__('os').system('true')\"",
        '"1/0"',
        '"t"',
        '{ kind = "Clip" }',
        '["foot"]',
        "3.5",
    ),
    *(
        '"\\u0000"',
        '"/etc/passwd"',
        '"../x.toml"',
        '"x * y"',
        '"sqrt(-1)"',
        "[1, 2, 3]",
        "[-1, 0, 1000000]",
        "{ a = { b = { c = 1 } } }",
    ),
    *('"é"', "0x7f", "'''a\nb'''"),
]
VALUE = re.compile(r"(?<== )[^\n#]+")


@st.composite
def damaged(draw: Any) -> str:
    """A scene with one to three faults: bytes changed, lines lost or doubled, values and keys replaced."""
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(
            st.sampled_from(
                [
                    "byte",
                    "cut",
                    "line",
                    "double",
                    "value",
                    "value",
                    "value",
                    "key",
                    "number",
                    "number",
                    "insert",
                ]
            )
        )
        lines = text.splitlines(keepends=True) or [""]
        place = draw(st.integers(0, len(text)))
        row = draw(st.integers(0, len(lines) - 1))
        if kind == "byte":
            text = text[:place] + draw(st.characters(codec="utf-8")) + text[place + 1 :]
        elif kind == "cut":
            text = text[:place]
        elif kind == "line":
            text = "".join(lines[:row] + lines[row + 1 :])
        elif kind == "double":
            text = "".join([*lines[: row + 1], *lines[row:]])
        elif kind == "insert":
            keys = [
                "include",
                "slack",
                "control",
                "nodes",
                "pinned",
                "rollers",
                "supports",
                "parameters",
                "pressure",
                "state",
                "fractions",
                "scheme",
            ]
            added = f"{draw(st.sampled_from(keys))} = {draw(st.sampled_from(ODD))}\n"
            text = "".join([*lines[: row + 1], added, *lines[row + 1 :]])
        else:
            pattern = {
                "value": VALUE,
                "key": re.compile(r"^[a-z_]+(?= =)", re.MULTILINE),
                "number": re.compile(r"(?<![\w.])[\d.]+(?:e-?\d+)?"),
            }[kind]
            places = list(pattern.finditer(text))
            if places:
                found = draw(st.sampled_from(places))
                new = (
                    draw(st.sampled_from(["lenght", "mass", "x", "kind", "a.b", '"c d"']))
                    if kind == "key"
                    else draw(st.sampled_from(ODD))
                )
                text = text[: found.start()] + new + text[found.end() :]
    return text


def refused(*_: Any, **__: Any) -> Any:
    raise AssertionError("a file made the program run or reach something")


@contextmanager
def guarded() -> Iterator[list[str]]:
    """Yield the files that are opened meanwhile; programs, connections, eval and exec fail."""
    opened: list[str] = []
    real = builtins.open

    def watched(file: Any, *arguments: Any, **options: Any) -> Any:
        opened.append(str(file))
        return real(file, *arguments, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(builtins, "open", watched)
        for owner, name in (
            (subprocess, "Popen"),
            (os, "system"),
            (socket, "socket"),
            (builtins, "eval"),
            (builtins, "exec"),
        ):
            patch.setattr(owner, name, refused)
        yield opened


@pytest.fixture(scope="module", autouse=True)
def _modules() -> None:
    """Import what reading imports: that runs code, of the package's own."""
    for path in (ROOT / "examples/scenes").glob("*.toml"):
        tc.load_simulation(path)
    with pytest.raises(UnicodeDecodeError):
        b"\xff".decode("utf-8-sig")


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(damaged())
def test_damaged_files_give_one_line_or_are_read(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    began = time.process_time()
    with guarded() as opened, warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.RedundantConstraints)
        try:
            tc.load_simulation(path)
        except tc.SceneFileError as error:
            message = str(error)
            assert message.startswith("scene.toml")
            assert len(message.splitlines()) == 1
            assert ": " in message
            assert len(message) < 1200
    assert set(opened) <= {str(path)}
    assert [entry.name for entry in tmp_path.iterdir()] == ["scene.toml"]
    assert time.process_time() - began < 20

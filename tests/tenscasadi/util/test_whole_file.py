"""Pictures, films, tables and C code: whole or not at all, and never in place of a pipe."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import ocp
import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.animation import animate
from tenscasadi.plots import animation
from tenscasadi.util.whole_file import whole_path

PRISM = tc.shapes.prism()
MODEL = tc.Model(tc.Scene(PRISM, control=tc.ForceDensity()))
RUN = tc.simulate(MODEL, 0.02, 0.01, compiled=False)
PROBLEM = ocp.Problem(MODEL, goals=[ocp.AtRest()], costs=[ocp.Effort()])
with ThreadPoolExecutor(1) as threads:
    TABLE = tc.sweep(lambda a: {"b": a}, [{"a": 1}], executor=threads)


def film(path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    animate(RUN, path)


WRITERS: dict[str, Callable[[Path], Any]] = {  # by the name of a file that they write
    "picture.png": lambda path: plots.structure(PRISM, path=path),
    "picture.pdf": lambda path: plots.structure(PRISM, path=path),
    "motion.gif": lambda path: animate(RUN, path),
    "motion.mp4": film,
    "sweep.csv": lambda path: TABLE.to_csv(path),
    "tensegrity.c": lambda path: tc.export_c(MODEL, path.parent),
    "main.c": lambda path: tc.export_c(MODEL, path.parent),
    "program.h": lambda path: ocp.export_program(PROBLEM, ocp.Variational(3), path.parent),
    "rows.csv": lambda path: ocp.export_program(PROBLEM, ocp.Variational(3), path.parent),
}


@pytest.mark.parametrize("name", WRITERS)
def test_pipes_stay_what_they_are(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(OSError, match="Not a regular file"):
        WRITERS[name](tmp_path / name)
    assert (tmp_path / name).is_fifo()
    assert not [file for file in os.listdir(tmp_path) if file.startswith(".")]


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_was_there_is_replaced_as_a_whole(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"old")
    kept = os.open(tmp_path / name, os.O_RDONLY)
    WRITERS[name](tmp_path / name)
    assert os.read(kept, 10) == b"old"  # it was not written into
    os.close(kept)
    assert (tmp_path / name).stat().st_size > 3


def test_a_film_that_fails_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_next(*_: Any, **__: Any) -> None:
        monkeypatch.setattr(animation.Canvas3D, "draw", lambda *_: 1 / 0)

    (tmp_path / "motion.gif").write_bytes(b"old")
    monkeypatch.setattr(animation.Canvas3D, "draw", fail_next)
    with pytest.raises(ZeroDivisionError):
        animate(RUN, tmp_path / "motion.gif", frames_per_second=100)
    assert (tmp_path / "motion.gif").read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["motion.gif"]


def test_a_picture_without_an_ending_is_a_png(tmp_path: Path) -> None:
    plots.structure(PRISM, path=tmp_path / "picture")
    assert os.listdir(tmp_path) == ["picture.png"]


def test_an_unfinished_file_is_named_like_the_whole_one(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="full") as fault, whole_path(tmp_path / "x.txt") as part:  # noqa: PT012
        assert part.suffix == ".txt"
        part.write_text("half")
        raise OSError(28, "full", "elsewhere")
    assert fault.value.filename == str(tmp_path / "x.txt")
    assert not os.listdir(tmp_path)

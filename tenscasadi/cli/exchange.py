"""The commands that write what other tools read, and read what they write: by the endings of the files."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tenscasadi.cli.output import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import find_source
from tenscasadi.files.mjcf.export import export_mjcf

# What writes scenes, and what writes motions and plans, by the ending of the file.
_SCENES: dict[str, Callable[[Any, Path], object]] = {".xml": export_mjcf}
_MOTIONS: dict[str, Callable[[Any, Path], object]] = {".csv": lambda motion, path: motion.to_csv(path)}
_IMPORTED: dict[str, Callable[[Path], Any]] = {}


def run_export(arguments: argparse.Namespace) -> int:
    """Write a scene, a motion or a plan for another tool. Raises ValueError."""
    is_result = arguments.source.endswith(".npz")
    writers, whose = (_MOTIONS, "motions and plans (.npz)") if is_result else (_SCENES, "scenes")
    write = _by_ending(writers, arguments.out, f"{whose} are written as")
    check_file("OUT", arguments.out)
    write(load_result(arguments.source) if is_result else find_source(arguments.source).scene(), arguments.out)
    print(f"wrote {arguments.out}")
    return 0


def _by_ending(known: dict[str, Callable[..., Any]], path: Path, told: str) -> Callable[..., Any]:
    ending = path.suffix.lower()
    if ending not in known:
        raise ValueError(f"{path} ends in {ending or 'nothing'}: {told} {', '.join(sorted(known))}")
    return known[ending]

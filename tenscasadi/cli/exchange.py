"""The commands that write what other tools read, and read what they write: by the endings of the files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tenscasadi.cli.output import check_file
from tenscasadi.cli.results import load_result
from tenscasadi.cli.source import find_source
from tenscasadi.exchange.matlab.save import save_mat
from tenscasadi.exchange.matlab.structures import load_mat
from tenscasadi.exchange.mjcf import export_mjcf, import_mjcf
from tenscasadi.exchange.ntrt.load import load_ntrt
from tenscasadi.exchange.vtk import export_vtk
from tenscasadi.io.scene_files import save_scene
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.trajectory import Trajectory

_SCENES: dict[str, Callable[[Scene, Path], object]] = {
    ".xml": export_mjcf,
    ".mat": lambda scene, path: save_mat(scene.structure, path),
    ".toml": save_scene,
}
_MOTIONS: dict[str, Callable[[Any, Path], object]] = {
    ".csv": lambda motion, path: motion.to_csv(path),
    ".mat": lambda motion, path: save_mat(_trajectory(motion), path),
    ".pvd": lambda motion, path: export_vtk(
        _trajectory(motion), path, model=getattr(motion, "model", None)
    ),  # a plan's, for forces of bars
}


def _import_mat(arguments: argparse.Namespace) -> Scene:
    structure = load_mat(arguments.source, strict=not arguments.lenient)
    # in MATLAB's programs, nodes carry the mass of strings
    return Scene(structure, ends="lumped" if structure.string_mass.any() else "interior")


def _import_ntrt(arguments: argparse.Namespace) -> Scene:
    structure = load_ntrt(
        arguments.source,
        length_unit=arguments.length_unit,
        ball_joints=arguments.ball_joints,
        strict=not arguments.lenient,
    )
    return Scene(structure)


_FOREIGN: dict[str, Callable[[argparse.Namespace], Scene]] = {
    ".xml": lambda arguments: import_mjcf(arguments.source, strict=not arguments.lenient),
    ".mat": _import_mat,
    **dict.fromkeys((".yaml", ".yml"), _import_ntrt),
}


def run_export(arguments: argparse.Namespace) -> int:
    """Write a scene, a motion or a plan for another tool. Raises ValueError, OSError, ImportError."""
    is_result = arguments.source.endswith(".npz")
    write = _by_ending(
        _MOTIONS if is_result else _SCENES,
        arguments.out,
        "motions and plans" if is_result else "scenes",
    )
    check_file("OUT", arguments.out)
    source = None if is_result else find_source(arguments.source)
    if source is not None and arguments.out.exists() and arguments.out.samefile(source.path):
        raise ValueError(f"OUT is {arguments.out}, the file that is read: give another")
    content = load_result(arguments.source) if source is None else source.scene()
    if isinstance(content, Rollouts):
        raise ValueError(f"{arguments.source} holds rollouts: give a trajectory or a plan")
    write(content, arguments.out)
    print(f"wrote {arguments.out}")
    if source is not None and (
        left := [f"[{name}]" for name in _not_held(arguments.out) if source.has(name)]
    ):
        print(f"tenscasadi: left out: {', '.join(left)}", file=sys.stderr)
    return 0


def _not_held(path: Path) -> tuple[str, ...]:
    """Return the tables of a scene file that have no place in the exported file."""
    return (*(("scene",) if path.suffix.lower() == ".mat" else ()), "start", "simulation", "plan")


def run_import(arguments: argparse.Namespace) -> int:
    """Write what another tool wrote as a scene file. Raises ValueError, OSError, ImportError."""
    read = _by_ending(_FOREIGN, Path(arguments.source), "scenes")
    _by_ending({".toml": save_scene}, arguments.out, "scene files")
    check_file("OUT", arguments.out)
    save_scene(read(arguments), arguments.out)
    print(f"wrote {arguments.out}")
    return 0


def _trajectory(motion: Any) -> Trajectory:
    return motion if isinstance(motion, Trajectory) else motion.trajectory


def _by_ending(known: dict[str, Callable[..., Any]], path: Path, what: str) -> Callable[..., Any]:
    if path.suffix.lower() not in known:
        raise ValueError(
            f"{path} does not end as the files of {what} do: give one of {', '.join(sorted(known))}"
        )
    return known[path.suffix.lower()]

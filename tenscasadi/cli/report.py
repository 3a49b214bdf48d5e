"""Output of a command: text, a JSON object, and files."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tenscasadi.schema.stored import Stored, array_fields

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130  # exit codes beside 0
FOLDER = {"bash": "_shtab_compgen_dirs", "zsh": "_files -/"}

Writers = Mapping[str, Callable[[Path], object]]  # by the end of the file's name


@dataclass
class CommandReport:
    """Output options of a command, and functions that write.

    Parameters
    ----------
    output : Path
        Folder for the files, made if need be (default: the current one; `info` writes none).
    set : list of str
        Change of the scene file, such as simulation.step=0.01; may be repeated.
    quiet : bool
        Print errors only.
    json : bool
        Print one JSON object in place of text.
    no_plots : bool
        Write no pictures.
    """

    output: Annotated[Path | None, {"metavar": "DIR", "complete": FOLDER}] = None
    set: Annotated[list[str] | None, {"action": "append", "metavar": "KEY=VALUE"}] = None
    quiet: bool = False
    json: bool = False
    no_plots: bool = False
    content: dict[str, Any] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        if self.output is not None:
            check_folder("output", self.output)

    def say(self, *lines: str) -> None:
        """Print text unless the report is quiet or JSON."""
        if not self.quiet and not self.json:
            print(*lines, sep="\n")

    def write(self, stem: str, files: Writers, pictures: Writers) -> None:
        """Write files whose names begin with `stem`, and list them.

        `files` and `pictures` are functions that write a path, by the ends of the file names.
        """
        began = time.perf_counter()
        folder = self.output or Path()
        folder.mkdir(parents=True, exist_ok=True)
        wanted = files if self.no_plots else {**files, **pictures}
        for ending, write in wanted.items():
            write(folder / f"{stem}{ending}")
        names = [str(folder / f"{stem}{ending}") for ending in wanted]
        if names:
            self.say(f"\nwrote in {time.perf_counter() - began:.2f} s:", *(f"  {x}" for x in names))
        self.content["files"] = [*self.content.get("files", []), *names]

    def finish(self, code: int, **content: Any) -> int:
        """Print the JSON object with --json.

        Returns the exit code.
        """
        self.content |= {"success": code == 0, **content}
        if self.json:
            print(json.dumps(_plain(self.content), ensure_ascii=False))
        return code


def find_scalars(result: Stored) -> dict[str, Any]:
    """Return the scalar fields of a result by name."""
    own = array_fields(type(result)).items()
    return {name: getattr(result, name) for name, (letters, _) in own if letters == ""}


def _plain(value: Any) -> Any:
    """Convert a value to JSON types; non-finite numbers become null."""
    if isinstance(value, Mapping):
        return {str(name): _plain(own) for name, own in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(own) for own in value]
    value = value.item() if isinstance(value, np.generic) else value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)


def check_folder(name: str, folder: Path) -> None:
    """Raise OSError unless a folder exists or can be made.

    `name` is that of the option, for the message.
    """
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        fault = "cannot be written to" if there.is_dir() else "is a file"
        raise OSError(f"{name} is {folder}: {there} {fault}, give another folder")


def check_file(name: str, path: Path) -> None:
    """Raise OSError unless a file can be written.

    Its folder must exist. `name` is that of the option, for the message.
    """
    if path.is_dir():
        raise OSError(f"{name} is {path}: that is a folder, give a file")
    if not path.parent.is_dir():
        fault = f"there is no folder {path.parent}"
        raise OSError(f"{name} is {path}: {fault}, make it or give another")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise OSError(f"{name} is {path}: it cannot be written, give another")

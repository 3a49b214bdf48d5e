"""Folders and files that the commands write: checked before a long run, named after the scene."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

FAILED, BAD_INPUT, INTERRUPTED = 1, 2, 130  # exit codes, beside 0

Writers = dict[str, Callable[[Path], object]]  # what writes a file, by the end of its name


def check_folder(name: str, folder: Path) -> None:
    """Raise OSError unless there is such a folder, or it can be made: told now instead of after a long run."""
    there = next(path for path in (folder, *folder.parents) if path.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        raise OSError(
            f"{name} is {folder}: {there} {'cannot be written to' if there.is_dir() else 'is a file'}, give another folder"
        )


def check_file(name: str, path: Path) -> None:
    """Raise OSError unless a file of that name can be written; its folder must be there."""
    if path.is_dir():
        raise OSError(f"{name} is {path}: that is a folder, give a file")
    if not path.parent.is_dir():
        raise OSError(
            f"{name} is {path}: there is no folder {path.parent}, make it or give another"
        )
    if not os.access(path.parent, os.W_OK | os.X_OK) or (
        path.exists() and not os.access(path, os.W_OK)
    ):
        raise OSError(f"{name} is {path}: it cannot be written, give another")


def write_files(folder: Path, begin: str, writers: Writers) -> None:
    """Write the files that begin with `begin`, then print which they are."""
    began = time.perf_counter()
    folder.mkdir(parents=True, exist_ok=True)
    files = {folder / f"{begin}{ending}": write for ending, write in writers.items()}
    for path, write in files.items():
        write(path)
    print(f"\nwrote in {time.perf_counter() - began:.2f} s:")
    for path in files:
        print(f"  {path}")

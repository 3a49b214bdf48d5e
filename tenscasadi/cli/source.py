"""Scene files and templates, with changes from the command line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from tenscasadi.exchange.readers import READERS
from tenscasadi.io.document import ENDINGS, Change, read_document
from tenscasadi.io.scene_files import read_scene
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.reading import Document
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.simulation_files import read_simulation

FOLDER = Path(__file__).with_name("templates")
TEMPLATES = {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}

# arguments of commands: files, and scenes
FILE: dict[str, Any] = {
    "metavar": "FILE",
    "complete": {"bash": "_tenscasadi_files", "zsh": "_tenscasadi_files"},
}
SCENE: dict[str, Any] = {
    "metavar": "NAME|FILE",
    "complete": {"bash": "_tenscasadi_scenes", "zsh": "_tenscasadi_scenes"},
}


@dataclass(frozen=True)
class SceneSource:
    """Template or scene file, with changes from the command line.

    Attributes
    ----------
    name : str
        Name as it was given.
    path : Path
        The file.
    changes : sequence of Change
        Changes from the command line.
    """

    name: str
    path: Path
    changes: Sequence[Change] = ()

    @cached_property
    def document(self) -> Document:
        """Parsed content of the file."""
        return read_document(self.path, self.changes)

    @property
    def stem(self) -> str:
        """First part of the names of output files."""
        return self.path.stem

    def scene(self) -> Scene:
        """Read the scene from the file.

        Raises SceneFileError, OSError.
        """
        return read_scene(self.document)

    def simulation(self) -> Simulation:
        """Read the simulation from the file.

        Raises SceneFileError, OSError.
        """
        return read_simulation(self.document, self.scene())

    @property
    def string_groups(self) -> dict[str, list[int]]:
        """Indices of strings by the names of their groups."""
        groups = self.scene().structure.names.named["string"].items()
        return {name: list(strings) for name, strings in groups if not name.endswith("]")}

    def has(self, section: str) -> bool:
        """Return whether the file has the table `section`."""
        return self.document.section(section) is not None


def read_title(template: str) -> str:
    """Read the description of a template, its first line."""
    with TEMPLATES[template].open(encoding="utf-8") as file:
        return file.readline().strip("# .\n")


def find_source(name: str, changes: Sequence[Change] = ()) -> SceneSource:
    """Find a template or a scene file by its name.

    `changes` replace values of the file. Raises ValueError, FileNotFoundError.
    """
    if name in TEMPLATES:
        return SceneSource(name, TEMPLATES[name], changes)
    if Path(name).suffix.lower() in READERS:
        cure = f"convert it by tenscasadi import {name} scene.toml"
        raise ValueError(f"{name} is a file of another program: {cure}")
    if not name.endswith(ENDINGS):
        known = ", ".join(TEMPLATES)
        cure = f"give one of {known}, or a scene file, whose name ends in .toml or .json"
        raise ValueError(f"unknown template {name!r}: {cure}")
    path = Path(name)
    if not path.exists():
        cure = f"`tenscasadi new prism > {path.name}` writes one to start from"
        raise FileNotFoundError(f"there is no file {name}: {cure}")
    return SceneSource(name, path, changes)

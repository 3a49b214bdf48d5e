"""Scenes by the name of a shape, or of a scene file: with their start, and how they are simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

from tenscasadi.integrators.stabilization import Projection
from tenscasadi.io.document import read_document
from tenscasadi.io.scene_files import read_scene
from tenscasadi.io.simulation_section import read_simulation
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.reading import Document
from tenscasadi.simulation.declared import Simulation
from tenscasadi.util.validate import positive_number

STARTING_FILES = Path(__file__).with_name("starting_files")

SHAPES = MappingProxyType(  # scene files of the package by name, and what help tells of them
    {
        "pendulum": "one bar of 1 m and 1 kg, released from rest 135° from hanging down, under gravity",
        "double-pendulum": "two bars of 1 m and 1 kg, released from rest 90° and 120° from hanging down, under gravity",
        "prism": (
            "three bars, nine strings of 1000 N/m with force densities of 50 and 87 N/m; top and bottom start turning against each other at 4 rad/s"
        ),
        "d-bar": "four bars in a diamond pinned at node 0, two strings of 1000 N/m with 50 N/m; swings about the pin at 3 rad/s",
        "six-bar-ball": "six bars of 1 m and 1 kg, 24 strings of 1000 N/m with 50 N/m; thrown at 3 m/s along x and 5 m/s up, tumbling, under gravity",
        "reach": "an arm, one bar on a hinge between four strings of 500 N/m with 50 N/m, pushed at 0.5 m/s, under gravity",
    }
)


@dataclass(frozen=True)
class Source:
    """A scene file, one of the package's or somebody's own: `name` as it was given, the `path` that is read, and `text` for people."""

    name: str
    path: Path
    text: str

    @cached_property
    def document(self) -> Document:
        """The file, read once."""
        return read_document(self.path)

    @property
    def stem(self) -> str:
        """Begin of the names of files that are written."""
        return self.path.stem

    def scene(self) -> Scene:
        """Return the scene. Raises SceneFileError, OSError."""
        return read_scene(self.document)

    def simulation(
        self, gravity: float | None = None, projection: int | None = None, **changes: Any
    ) -> Simulation:
        """Return the simulation, but for what is given here; gravity: m/s² downwards, 0: none; projection: steps from one to the next."""
        told = read_simulation(self.document, self.scene(), changes.get("t_end"))
        if gravity is not None:
            down = positive_number("gravity", gravity, zero=True)
            changes["scene"] = replace(
                told.scene, gravity=Gravity((0.0, 0.0, -down)) if down else None
            )
        if projection is not None:
            changes["correction"] = Projection(projection)
        return replace(
            told, **{name: value for name, value in changes.items() if value is not None}
        )

    @property
    def string_groups(self) -> dict[str, list[int]]:
        """Strings by the names of their groups."""
        names = self.scene().structure.names
        groups = names.named["string"].items()
        return {name: list(strings) for name, strings in groups if not name.endswith("]")}

    def has(self, section: str) -> bool:
        """Tell whether the file has a table of this name."""
        return self.document.section(section) is not None


def find_source(name: str) -> Source:
    """Return what a shape or a scene file is. Raises ValueError that lists the shapes, FileNotFoundError."""
    if name in SHAPES:
        return Source(name, STARTING_FILES / f"{name}.toml", SHAPES[name])
    if not name.endswith(".toml"):
        raise ValueError(
            f"unknown shape {name!r}: give one of {', '.join(SHAPES)}, or a scene file, whose name ends in .toml"
        )
    path = Path(name)
    if not path.exists():
        raise FileNotFoundError(
            f"there is no file {name}: `tenscasadi new prism > {path.name}` writes one to start from"
        )
    return Source(name, path, "scene file")

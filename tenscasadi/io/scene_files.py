"""Scene files: scenes and simulations from TOML and back, to the last bit."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tenscasadi.io.document import FORMAT, read_document
from tenscasadi.io.simulation_section import read_simulation, write_simulation
from tenscasadi.io.structure_section import STRUCTURE
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.reading import MOST_ENTRIES, Document, Item, Names, NotWritten, call
from tenscasadi.schema.toml_writer import to_toml
from tenscasadi.simulation.declared import Simulation
from tenscasadi.util.validate import file_path, instance, shown
from tenscasadi.util.whole_file import whole_file

HEAD: Mapping[str, Any] = {"format": FORMAT, "units": "SI"}

SCENE = definition(Scene)


def load_scene(path: str | os.PathLike[str]) -> Scene:
    """Read the structure and the scene of a scene file.

    Nothing in the file is run, and no file is opened but those that it includes from its own
    folder.

    Parameters
    ----------
    path : str or os.PathLike
        A file in TOML, as docs/scene_files.md describes it.

    Returns
    -------
    Scene
        What [structure] and [scene] tell.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    SceneFileError
        If it is no scene file, in one line: file, line, key, value and cure.

    See Also
    --------
    load_simulation : Also [start] and [simulation].
    save_scene : Write one.

    Examples
    --------
    >>> import tempfile
    >>> import tenscasadi as tc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tc.save_scene(tc.Scene(tc.shapes.prism(), gravity=tc.Gravity()), f"{folder}/prism.toml")
    ...     tc.load_scene(path).gravity
    Gravity(acceleration=(0.0, 0.0, -9.81))
    """
    return read_scene(read_document(path))[0]


def load_simulation(path: str | os.PathLike[str]) -> Simulation:
    """Read the scene of a scene file, its start, and how it is simulated.

    Parameters
    ----------
    path : str or os.PathLike
        A file in TOML with a table [simulation], as docs/scene_files.md describes it.

    Returns
    -------
    Simulation
        What all tables but [plan] tell.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    SceneFileError
        If it is no scene file or has no [simulation], in one line: file, line, key, value and cure.

    See Also
    --------
    load_scene : The scene alone.

    Examples
    --------
    >>> import tempfile
    >>> import tenscasadi as tc
    >>> swing = tc.Simulation(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), t_end=0.1, step=1e-3)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tc.save_scene(swing, f"{folder}/swing.toml")
    ...     tc.load_simulation(path).run(compiled=False).message
    'finished 100 steps of 0.001 s'
    """
    document = read_document(path)
    return read_simulation(document, *read_scene(document))


def save_scene(scene: Scene | Simulation, path: str | os.PathLike[str]) -> Path:
    """Write a scene or a simulation to a scene file, from which it comes back to the last bit.

    Parameters
    ----------
    scene : Scene or Simulation
        What is written.
    path : str or os.PathLike
        The file in TOML; one that is there is replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError
        If `scene` is neither.
    ValueError
        If a part of it cannot be written, by its name: functions of time in Python, structures that
        `Structure.subdivide` or `Structure.from_matrices` made, schemes of your own.
    OSError
        If the file cannot be written.

    See Also
    --------
    load_scene : Read it.

    Examples
    --------
    >>> import tempfile
    >>> import tenscasadi as tc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = tc.save_scene(tc.Scene(tc.shapes.pendulum()), f"{folder}/pendulum.toml")
    ...     print(path.read_text().splitlines()[:2])
    ['format = 1', 'units = "SI"']
    """
    instance("scene", scene, (Scene, Simulation), "a tenscasadi.Scene or a tenscasadi.Simulation")
    target = file_path("path", path)
    return write_document(target, write_scene(scene))


def read_scene(document: Document) -> tuple[Scene, Names]:
    """Return the scene of [structure] and [scene], and what nodes and members are called. Raises SceneFileError."""
    item = document.section("structure")
    if item is None:
        raise document.root.error(
            'it has no [structure]: give one with nodes, or with shape = "prism"'
        )
    structure, names = STRUCTURE.read(item, Names())
    given = document.section("scene")
    table: dict[str, Item] = {} if given is None else given.table()
    fields = SCENE.read_fields(table, names)
    segments = fields.get("segments", 1)
    if (
        sum(segments) if isinstance(segments, list) else segments * len(structure.strings)
    ) > MOST_ENTRIES:
        raise table["segments"].error(
            f"is {shown(segments)}: give less, all strings together may have {MOST_ENTRIES} segments"
        )
    return call(
        Scene, item if given is None else given, table, {"structure": structure, **fields}
    ), names


def write_scene(scene: Scene | Simulation) -> dict[str, Any]:
    """Return the tables of a scene or a simulation. Raises ValueError where a part cannot be written, by its name."""
    own = scene.scene if isinstance(scene, Simulation) else scene
    try:
        tables = {"structure": STRUCTURE.write(own.structure), "scene": SCENE.write(own)}
        if isinstance(scene, Simulation):
            tables |= write_simulation(scene)
    except NotWritten as error:
        raise ValueError(f"scene cannot be written, {error}") from None
    return {name: table for name, table in tables.items() if table}


def write_document(path: Path, tables: Mapping[str, Any]) -> Path:
    """Write tables to a scene file, its head before them, and return its path. Raises OSError."""
    text = to_toml({**HEAD, **tables})
    with whole_file(path) as file:
        file.write(text.encode("utf-8"))
    return path

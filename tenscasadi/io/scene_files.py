"""Scene files: scenes and simulations from TOML and back, to the last bit."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from tenscasadi.io.document import read_document, write_document
from tenscasadi.io.simulation_section import read_simulation, write_simulation
from tenscasadi.io.structure_section import StructureSection
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.reading import Document, Item, NotWritten
from tenscasadi.simulation.declared import Simulation
from tenscasadi.util.validate import file_path, instance

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
    return read_scene(read_document(path))


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
    return read_simulation(document, read_scene(document))


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
    try:
        tables = write_scene(scene)
    except NotWritten as error:
        raise ValueError(f"scene cannot be written, {error}") from None
    return write_document(target, tables)


def read_scene(document: Document) -> Scene:
    """Read [structure] and [scene]. Raises SceneFileError."""
    item = document.section("structure")
    if item is None:
        cure = 'give one with nodes, or with shape = "prism"'
        raise document.root.error(f"it has no [structure]: {cure}")
    structure = StructureSection().read(item)
    given = document.section("scene") or Item({}, item.key, document)
    return SCENE.read(given._replace(names=structure.names), structure=structure)  # type: ignore[no-any-return]


def write_scene(scene: Scene | Simulation) -> dict[str, Any]:
    """Write the tables of a scene or a simulation. Raises NotWritten."""
    own = scene.scene if isinstance(scene, Simulation) else scene
    tables = {"structure": StructureSection().write(own.structure), "scene": SCENE.write(own)}
    if isinstance(scene, Simulation):
        tables |= write_simulation(scene)
    return {name: table for name, table in tables.items() if table}

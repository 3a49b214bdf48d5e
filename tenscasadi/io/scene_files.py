"""Reading and writing of scene files without loss."""

from __future__ import annotations

from functools import singledispatch
from pathlib import Path
from typing import Any

from tenscasadi.io.document import read_document, write_document
from tenscasadi.io.structure_section import StructureSection
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.reading import Document, Item, NotWritten
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import FilePath, file_path, format_value

SCENE = definition(Scene)


def load_scene(path: FilePath) -> Scene:
    """Read the structure and the scene of a scene file.

    Nothing in the file is run, and no file is opened but those that it includes from its own
    folder.

    Parameters
    ----------
    path : str or os.PathLike
        Scene file in TOML or JSON, see docs/scene_files.md.

    Returns
    -------
    Scene
        Scene of the sections [structure] and [scene].

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    SceneFileError
        If it is no scene file. The message names file, line, key, value and cure.

    See Also
    --------
    load_simulation : Also read [start] and [simulation].
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


def save_scene(scene: Any, path: FilePath) -> Path:
    """Write a scene or a simulation to a scene file.

    Numbers read back are equal to the last bit.

    Parameters
    ----------
    scene : Scene or Simulation
        Scene or simulation to write.
    path : str or os.PathLike
        File in JSON if its name ends in ".json", otherwise in TOML. An existing one is replaced.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError
        If `scene` is neither.
    ValueError
        If a part of it cannot be written, by its name: a function of time in Python, or a
        user-defined scheme or string law.
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
    target = file_path("path", path)
    try:
        tables = write_tables(scene)
    except NotWritten as error:
        raise add_address(ValueError(f"scene cannot be written, {error}")) from None
    return write_document(target, tables)


def read_scene(document: Document) -> Scene:
    """Read the tables [structure] and [scene].

    They are those of a scene file, `document`. Raises SceneFileError.
    """
    item = document.section("structure")
    if item is None:
        cure = 'give one with nodes, or with shape = "prism"'
        raise document.root.error(f"it has no [structure]: {cure}")
    structure = StructureSection().read(item)
    given = document.section("scene") or Item({}, item.key, document)
    return SCENE.read(given._replace(names=structure.names), structure=structure)  # type: ignore[no-any-return]


@singledispatch
def write_tables(value: Any) -> dict[str, Any]:
    """Convert a scene or a simulation (`value`) to tables of a scene file.

    Raises NotWritten, TypeError.
    """
    raise TypeError(
        f"scene is {format_value(value)}: give a tenscasadi.Scene or a tenscasadi.Simulation"
    )


@write_tables.register
def write_scene(scene: Scene) -> dict[str, Any]:
    """Convert a scene to the tables [structure] and [scene].

    Raises NotWritten.
    """
    tables = {"structure": StructureSection().write(scene.structure), "scene": SCENE.write(scene)}
    return {name: table for name, table in tables.items() if table}

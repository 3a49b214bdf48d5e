"""Simulations in scene files: tables [start] and [simulation]."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tenscasadi.io.document import read_document
from tenscasadi.io.scene_files import read_scene, write_scene, write_tables
from tenscasadi.scene.scene import Scene
from tenscasadi.schema.containers import Either, for_items
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.field_types import POINTS, TIMES, VECTOR, Index
from tenscasadi.schema.reading import Document, call
from tenscasadi.simulation.declared import Simulation
from tenscasadi.util.validate import Array, FilePath

_ROWS = for_items("node", VECTOR, POINTS)


@dataclass(frozen=True)
class StartSection:
    """Initial positions and velocities in a scene file.

    Parameters
    ----------
    nodes : array_like, shape (n, 3), or mapping of int to array_like, shape (3,)
        Positions at the start [m]. Nodes that are not in a table have the positions of the
        structure.
    velocities : array_like, shape (n, 3), or mapping of int to array_like, shape (3,)
        Velocities at the start [m/s], in addition to `velocity` and `spin`. They are zero for nodes
        that are not in a table.
    velocity : sequence of float, shape (3,)
        Velocity of the whole structure [m/s].
    spin : sequence of float, shape (3,)
        Angular velocity of the whole structure [rad/s].
    about : int or sequence of float, shape (3,)
        Node or point of the spin axis; by default the mean of the nodes.
    project : bool
        Whether the start is projected onto bars and joints: the nearest state that satisfies them.
    state : array_like, shape (nx,)
        State of the model at the start, in place of all other fields.
    """

    nodes: Annotated[Any, _ROWS] = None
    velocities: Annotated[Any, _ROWS] = None
    velocity: Annotated[Any, VECTOR] = None
    spin: Annotated[Any, VECTOR] = None
    about: Annotated[Any, Either((list,), VECTOR, Index("node"))] = None
    project: bool = False
    state: Annotated[Any, TIMES] = None

    def __post_init__(self) -> None:
        if self.about is not None and self.spin is None:
            raise ValueError("about is given without spin: give spin = [x, y, z], or leave it out")
        for name in ("nodes", "velocities", "velocity", "spin"):
            if self.state is not None and getattr(self, name) is not None:
                cure = "leave one of them out"
                raise ValueError(f"{name} is given beside state, which defines it, too: {cure}")

    def options(self, scene: Scene) -> dict[str, Any]:
        """Convert the table to the fields of `Simulation`."""
        rest = scene.structure.nodes
        nodes = _fill_rows(self.nodes, rest)
        velocities = _fill_rows(self.velocities, np.zeros_like(rest))
        if self.velocity is not None or self.spin is not None:
            places = rest if nodes is None else nodes
            rigid = np.zeros_like(rest) if self.velocity is None else np.asarray(self.velocity)
            if self.spin is not None:
                rigid = rigid + np.cross(self.spin, places - self._center(places))
            velocities = rigid + (np.zeros_like(places) if velocities is None else velocities)
        moved = {"nodes": nodes, "velocities": velocities}
        return {**moved, "project": self.project, "state": self.state}

    def _center(self, nodes: Array) -> Array:
        if self.about is None:
            return np.asarray(nodes.mean(axis=0))
        return np.asarray(nodes[self.about] if isinstance(self.about, int) else self.about)


def _fill_rows(given: Any, others: Array) -> Array | None:
    if not isinstance(given, Mapping):
        return None if given is None else np.array(given, dtype=float).reshape(-1, 3)
    rows = np.array(others)
    for node, row in given.items():
        rows[node] = row
    return rows


SIMULATION = definition(Simulation)
START = definition(StartSection, "start")


def load_simulation(path: FilePath) -> Simulation:
    """Read a simulation from a scene file.

    Parameters
    ----------
    path : str or os.PathLike
        Scene file in TOML or JSON with a section [simulation], see docs/scene_files.md.

    Returns
    -------
    Simulation
        Simulation of all sections but [plan].

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    SceneFileError
        If it is no scene file or has no [simulation]. The message names file, line, key, value and
        cure.

    See Also
    --------
    load_scene : Read the scene alone.

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


def read_simulation(document: Document, scene: Scene) -> Simulation:
    """Read the tables [start] and [simulation] of a scene file.

    `document` is its content. Raises SceneFileError.
    """
    item, first = document.section("simulation"), document.section("start")
    if item is None:
        cure = "give one with t_end, the end of the run in s"
        raise document.root.error(f"it has no [simulation]: {cure}")
    item = item._replace(names=scene.structure.names)
    table = item.table()
    options: dict[str, Any] = {"scene": scene, **SIMULATION.read_fields(table)}
    where: dict[str, Any] = {}
    if first is not None:
        options |= START.read(first._replace(names=item.names)).options(scene)
        where = first.table()
        moving = [where[name] for name in ("velocities", "velocity", "spin") if name in where]
        where |= {"velocities": moving[0]} if moving else {}
    if "t_end" not in options:
        raise item.error("has no t_end: give the end of the run, s")
    simulation: Simulation = call(Simulation, item, where | table, options)
    call(simulation.check, item, where | table, {})
    return simulation


@write_tables.register
def write_simulation(simulation: Simulation) -> dict[str, Any]:
    """Convert a simulation to the tables of a scene file.

    Raises NotWritten.
    """
    start = {name: getattr(simulation, name) for name in START.fields if hasattr(simulation, name)}
    tables = {"start": START.write(start), "simulation": SIMULATION.write(vars(simulation))}
    return write_scene(simulation.scene) | {name: own for name, own in tables.items() if own}

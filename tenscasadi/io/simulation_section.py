"""The [start] and [simulation] of scene files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from tenscasadi.scene.scene import Scene
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.forms import POINTS, TIMES, VECTOR, Index
from tenscasadi.schema.reading import Document, Names, call
from tenscasadi.simulation.declared import Simulation
from tenscasadi.util.validate import Array

_ROWS = Either((Mapping,), MapOf("node", VECTOR), POINTS)


@dataclass(frozen=True)
class Start:
    """How a motion starts.

    Parameters
    ----------
    nodes : array_like, shape (n, 3), or mapping of int to array_like, shape (3,)
        Positions at the start, m; nodes that a table does not name are where the structure has
        them.
    velocities : array_like, shape (n, 3), or mapping of int to array_like, shape (3,)
        Velocities at the start, m/s, beside `velocity` and `spin`; nodes that a table does not name
        have none.
    velocity : sequence of float, shape (3,)
        Velocity of the whole structure, m/s.
    spin : sequence of float, shape (3,)
        Angular velocity of the whole structure, rad/s.
    about : int or sequence of float, shape (3,)
        Node or point that it spins about; by default the mean of the nodes.
    project : bool
        Whether the start is moved onto bars and joints: the nearest state that keeps them.
    state : array_like, shape (nx,)
        The start as a state of the model, in place of all others.
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
            raise ValueError(
                "about is given without spin: give spin = [x, y, z], too, or leave it out"
            )
        if self.state is not None:
            for name in ("nodes", "velocities", "velocity", "spin"):
                if getattr(self, name) is not None:
                    raise ValueError(
                        f"{name} stands beside state, which says it all: leave one of them out"
                    )

    def options(self, scene: Scene) -> dict[str, Any]:
        """Return what `Simulation` has in place of these."""
        rest = scene.structure.nodes
        nodes = None if self.nodes is None else self._rows(self.nodes, rest)
        velocities = (
            None if self.velocities is None else self._rows(self.velocities, np.zeros_like(rest))
        )
        if self.velocity is not None or self.spin is not None:
            velocities = (0.0 if velocities is None else velocities) + self._rigid(
                rest if nodes is None else nodes
            )
        return {
            "nodes": nodes,
            "velocities": velocities,
            "project": self.project,
            "state": self.state,
        }

    def _rigid(self, nodes: Array) -> Array:
        moved = np.zeros_like(nodes) + (0.0 if self.velocity is None else np.asarray(self.velocity))
        if self.spin is None:
            return moved
        middle = (
            nodes.mean(axis=0)
            if self.about is None
            else nodes[self.about]
            if isinstance(self.about, int)
            else np.asarray(self.about)
        )
        return np.asarray(moved + np.cross(self.spin, nodes - middle))

    @staticmethod
    def _rows(given: Any, others: Array) -> Array:
        if not isinstance(given, Mapping):
            return np.array(given, dtype=float).reshape(-1, 3)
        rows = np.array(others)
        for node, row in given.items():
            rows[node] = row
        return rows


SIMULATION = definition(Simulation)
START = definition(Start, "start")


def read_simulation(
    document: Document, scene: Scene, names: Names, t_end: float | None = None
) -> Simulation:
    """Return the simulation of [start] and [simulation]; `t_end`, s, is told where the file need not. Raises SceneFileError."""
    told = document.section("simulation")
    if told is None and t_end is None:
        raise document.root.error(
            "it has no [simulation]: give one with t_end, the end of the run in s"
        )
    item, table = (document.root, {}) if told is None else (told, told.table())
    options = SIMULATION.read_fields(table, names)
    first = document.section("start")
    started = START.read(first, names).options(scene) if first is not None else {}
    begun = first.table() if first is not None else {}
    moved = [begun[name] for name in ("velocities", "velocity", "spin") if name in begun]
    where = {**begun, **({"velocities": moved[0]} if moved else {}), **table}
    if "t_end" not in table:
        if t_end is None:
            raise item.error("has no t_end: give the end of the run, s")
        options["t_end"] = t_end
    simulation: Simulation = call(Simulation, item, where, {"scene": scene, **options, **started})
    call(simulation.check, item, where, {})
    return simulation


def write_simulation(simulation: Simulation) -> dict[str, Any]:
    """Return the tables [start] and [simulation]. Raises NotWritten."""
    start = {
        name: getattr(simulation, name) for name in ("nodes", "velocities", "project", "state")
    }
    tables = {"start": START.write(Start(**start)), "simulation": SIMULATION.write(simulation)}
    return {name: table for name, table in tables.items() if table}

"""Goal that the final state equals the initial state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals.goal import FREE_AXIS, Goal
from ocp.problem.rows import Rows
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.field_types import POINT, POINTS, ListOf
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Check, coordinates, finite_array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True, eq=False)
class Periodic(Goal, kind="Periodic"):
    """Goal that the final state equals the initial state.

    Each node returns to its initial position, displaced by ``shift``, with its initial velocity.

    Parameters
    ----------
    shift : sequence of float or None, length 3, optional
        Displacement (x, y, z) of all nodes in one period [m], as of a gait. None for an axis: all
        nodes move by the same distance, which is free.
    start : tuple of two array_like of shape (n, 3), optional
        Initial nodes [m] and velocities [m/s]. None for those of the problem, which may be free
        (`FreeStart`).

    Raises
    ------
    TypeError, ValueError
        If ``shift`` is not three numbers or None, or if ``start`` is not a pair. In a `Problem`: if
        a pinned node would have to move, or if the shape of ``start`` is wrong.

    Examples
    --------
    >>> import ocp
    >>> ocp.Periodic(shift=(0.3, None, 0.0)).shift
    (0.3, None, 0.0)
    """

    timing: ClassVar[str] = "period"
    shift: Annotated[Sequence[float | None], POINT, Check(partial(coordinates, none=FREE_AXIS))] = (
        0.0,
        0.0,
        0.0,
    )
    start: Annotated[
        tuple[ArrayLike, ArrayLike] | None, ListOf(OfStructure("nodes", POINTS), count=2)
    ] = None

    @property
    def repeats_start(self) -> bool:
        """Whether the goal is relative to the problem's initial state."""
        return self.start is None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.start is not None and (
            not isinstance(self.start, (tuple, list)) or len(self.start) != 2
        ):
            raise TypeError(
                "Periodic.start is no pair: give (nodes, velocities), or None for the start of the problem"
            )

    def check(self, structure: Structure) -> None:
        """Check that the goal can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a pinned node would have to move, or if the shape of ``start`` is wrong.
        """
        for name, given in zip(("nodes", "velocities"), self.start or (), strict=False):
            finite_array(f"Periodic.start: {name}", given, structure.nodes.shape)
        for axis, value in enumerate(self.shift):
            if value and structure.fixed[:, axis].any():
                node = int(np.argmax(structure.fixed[:, axis]))
                raise ValueError(
                    f"Periodic.shift moves node {node}, which is pinned along {'xyz'[axis]}: give 0 for that axis"
                )

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Store the initial positions and velocities in the goal.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Initial state; None if it is free.

        Returns
        -------
        Goal
            The same goal, with the initial state by default.
        """
        if self.start is not None or start is None:
            return self
        count = len(model.scene.structure.nodes)
        return replace(self, start=(model.nodes(start)[:count], model.velocities(start)[:count]))

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build the final minus the initial positions and velocities.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : casadi.SX
            Node positions, 3×n [m].
        velocities : casadi.SX
            Node velocities, 3×n [m/s].

        Returns
        -------
        Rows
            Named residuals, zero if the goal is satisfied.
        """
        if self.start is None:
            raise ValueError("Periodic.start is None: give it to a Problem, which knows its start")
        before, speeds = (
            value if isinstance(value, (ca.SX, ca.MX)) else np.asarray(value)
            for value in self.start
        )
        places, rates = [], []
        for node, axis in np.argwhere(~structure.fixed).tolist():
            name, shift = f"Periodic: node {node} {'xyz'[axis]}", self.shift[axis]
            moved = nodes[axis, 0] - before[0, axis] if shift is None else shift
            if shift is not None or node:
                places.append((nodes[axis, node] - before[node, axis] - moved, name))
            rates.append((velocities[axis, node] - speeds[node, axis], f"{name} velocity"))
        values, names = zip(*places, *rates, strict=True)
        return Rows(ca.vertcat(*values), names, ("m",) * len(places) + ("m/s",) * len(rates))

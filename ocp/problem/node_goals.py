"""Goals of where nodes, or all of them together, are at the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.goals import Goal
from ocp.problem.rows import Rows
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, coordinates, finite_array, nonnegative


@dataclass(frozen=True, eq=False)
class CentreOfMass(Goal):
    """The centre of mass is in a given place at the end, such as at the height of a jump.

    All mass of the model counts: of bars, nodes and strings, also of those that are pinned.

    Parameters
    ----------
    position : sequence of float or None, length 3
        (x, y, z), m, None for an axis that is free.
    masses : array_like of shape (n,), optional
        What each node of the model weighs, kg, those inside strings last; None for the masses of the problem's model.

    Raises
    ------
    TypeError, ValueError
        If the position has not three coordinates, or all are None; or masses are no numbers, negative, or all zero.

    Examples
    --------
    >>> import ocp
    >>> ocp.CentreOfMass((None, None, 1.2)).position
    (None, None, 1.2)
    """

    position: Sequence[float | None]
    masses: ArrayLike | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", coordinates("CentreOfMass.position", self.position, "an axis that is free", some=True))
        if self.masses is not None:
            masses = nonnegative("CentreOfMass.masses", finite_array("CentreOfMass.masses", self.masses, (None,)), "node")
            if not masses.any():
                raise ValueError("CentreOfMass.masses are all 0: give those of the nodes, or None for those of the model")
            object.__setattr__(self, "masses", masses)

    def check(self, structure: Structure) -> None:
        """Refuse a structure that this does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        ValueError
            If there are fewer masses than nodes.
        """
        if self.masses is not None and len(np.asarray(self.masses)) < len(structure.nodes):
            given = len(np.asarray(self.masses))
            raise ValueError(f"CentreOfMass.masses has {given} entries: give one for each of {len(structure.nodes)} nodes, or None")

    def complete(self, model: Model, start: Array | None) -> Goal:
        """Return the goal with what a problem knows.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Its start; None where it is free.

        Returns
        -------
        Goal
            The same goal, with the masses of the model where it has none.

        Raises
        ------
        ValueError
            If the masses are not one for each node of the model.
        """
        count = len(model.structure.nodes)
        if self.masses is None:
            mechanism = model.mechanism
            return replace(self, masses=np.bincount(mechanism.physical, mechanism.node_weight, count))
        finite_array("CentreOfMass.masses", self.masses, (count,))
        return self

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Return coordinate minus wanted coordinate of the centre of mass, m.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are cut into segments.
        nodes : casadi.SX
            Node positions, 3×n, m.
        velocities : casadi.SX
            Node velocities, 3×n, m/s.

        Returns
        -------
        Rows
            Named rows that vanish where the goal is met.

        Raises
        ------
        ValueError
            If the masses are not known: a `Problem` knows them.
        """
        if self.masses is None:
            raise ValueError("CentreOfMass.masses is None: give it to a Problem, which knows its model")
        masses = np.asarray(self.masses)
        centre = ca.mtimes(nodes, ca.DM(masses / masses.sum()))
        wanted = {axis: value for axis, value in enumerate(self.position) if value is not None}
        value = ca.vertcat(*(centre[axis] - value for axis, value in wanted.items()))
        return Rows(value, tuple(f"CentreOfMass: {'xyz'[axis]}" for axis in wanted), ("m",) * len(wanted))

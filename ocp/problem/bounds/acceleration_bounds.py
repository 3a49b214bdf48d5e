"""Bounds on the accelerations of nodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import Limit, PathBound
from ocp.problem.rows import RESOLUTION
from tenscasadi.schema.field_types import Members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import IndexOrName, Positive, check_indices

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


@dataclass(frozen=True, eq=False)
class NodeAccelerationLimits(PathBound, kind="NodeAccelerationLimits"):
    """Limits of the magnitude of node accelerations.

    They hold at both ends of every interval, for example to protect a payload.

    Parameters
    ----------
    magnitude : float
        Largest acceleration [m/s²], > 0.
    nodes : iterable of int or str, optional
        Nodes with this limit; None for all that are not pinned.

    Raises
    ------
    TypeError, ValueError
        If the magnitude is not a positive number. In a `Problem`: if a node does not exist or is
        pinned, or if no node can move.

    Examples
    --------
    >>> import ocp
    >>> ocp.NodeAccelerationLimits(20.0, nodes=[3, 4]).nodes
    (3, 4)
    """

    magnitude: Positive
    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist or is pinned, or if no node can move.
        """
        check_indices("NodeAccelerationLimits.nodes", self.nodes or (), len(structure.nodes))
        for node in self.nodes or ():
            if structure.fixed[node].all():
                raise ValueError(
                    f"NodeAccelerationLimits.nodes has node {node}, which is pinned: leave it out"
                )
        if not self._moving(structure):
            raise ValueError("NodeAccelerationLimits.nodes is empty: give nodes that can move")

    def _moving(self, structure: Structure) -> list[int]:
        """List the indices of the nodes whose acceleration is limited."""
        if self.nodes is not None:
            return list(self.nodes)
        return [int(node) for node in np.flatnonzero(~structure.fixed.all(axis=1))]

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Magnitude of the acceleration of each node [m/s²].
        """
        nodes = self._moving(now.model.scene.structure)
        # smooth at rest, where the norm has no derivative; 5e-7 above the norm at the limit
        own, rounding = now.accelerations[:, nodes], RESOLUTION * self.magnitude
        value = ca.sqrt(ca.sum1(own * own) + rounding**2).T
        names = tuple(f"acceleration of node {node}" for node in nodes)
        upper = np.full(len(nodes), self.magnitude)
        return Limit(value, np.full(len(nodes), -np.inf), upper, names, "m/s²")

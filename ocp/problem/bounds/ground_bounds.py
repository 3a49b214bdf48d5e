"""Bound that keeps nodes above a ground of any shape."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np

from ocp.problem.bounds.bound import Limit, PathBound
from tenscasadi.scene.ground import Surface
from tenscasadi.schema.field_types import Members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import IndexOrName, Number, check_indices, of_type

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


@dataclass(frozen=True, eq=False)
class AboveSurface(PathBound, kind="AboveSurface"):
    """Smallest permitted distance of nodes from a ground.

    It holds at the end of every interval.

    Parameters
    ----------
    ground : Ground or Terrain
        Surface; only its shape is used, not its stiffness.
    distance : float, optional
        Least distance above the surface [m]. A negative distance allows the penetration of nodes
        into a soft ground.
    nodes : iterable of int or str, optional
        Nodes that stay above; None for all.

    Raises
    ------
    TypeError, ValueError
        If ``ground`` is not a ground, ``distance`` not a number, or ``nodes`` not a list. In a
        `Problem`: if a node does not exist, if all of them are pinned, or if the start is below.

    See Also
    --------
    AboveGround : The same for a level ground.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> ocp.AboveSurface(tc.Ground(normal=(-0.5, 0, 1)), distance=0.05).distance
    0.05
    """

    ground: Annotated[Surface, of_type(Surface, "a tenscasadi.Ground or Terrain")]
    distance: Number = 0.0
    nodes: Annotated[Iterable[IndexOrName] | None, Members("node")] = None

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or all are pinned.
        """
        check_indices("AboveSurface.nodes", self.nodes or (), len(structure.nodes))
        if not self._chosen(structure):
            raise ValueError("AboveSurface.nodes has pinned nodes only: leave the bound out")

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Distances of the nodes that can move [m].
        """
        nodes, kind = self._chosen(now.model.scene.structure), type(self.ground).__name__
        names = tuple(f"distance of node {node} from the {kind}" for node in nodes)
        value = -self.ground.depth(now.nodes[:, nodes]).T
        lower = np.full(len(nodes), self.distance)
        return Limit(value, lower, np.full(len(nodes), np.inf), names, "m")

    def _chosen(self, structure: Structure) -> list[int]:
        """List the nodes that must stay above the ground.

        Nodes that are pinned along all axes are omitted.
        """
        nodes = range(len(structure.nodes)) if self.nodes is None else self.nodes
        return [node for node in nodes if not structure.fixed[node].all()]

"""Nodes above a ground of any shape, as a limit of instants."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint
from ocp.problem.instant import symbolic
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Surface
from tenscasadi.schema.field_types import Members
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import as_tuple, instance, node_index, number


@dataclass(frozen=True, eq=False)
class AboveSurface(PathBound, kind="AboveSurface"):
    """Nodes at least a distance above a plane or a height field, at the end of every interval.

    Parameters
    ----------
    ground : Ground or Terrain
        The surface; only its shape counts, not how hard it is.
    distance : float, optional
        Least distance from it, m; negative where nodes that stand on a soft ground are in it.
    nodes : iterable of int, optional
        The nodes that stay above; None for all.

    Raises
    ------
    TypeError, ValueError
        If the ground is none, the distance no number, or nodes no list; with a problem, if a node
        does not exist, or the start is below.

    See Also
    --------
    AboveGround : the same for a level ground.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> ocp.AboveSurface(tc.Ground(normal=(-0.5, 0, 1)), distance=0.05).distance
    0.05
    """

    ground: Surface
    distance: float = 0.0
    nodes: Annotated[Iterable[int] | None, Members("node")] = None

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def __post_init__(self) -> None:
        instance("AboveSurface.ground", self.ground, Surface, "a tenscasadi.Ground or Terrain")
        object.__setattr__(self, "distance", number("AboveSurface.distance", self.distance))
        if self.nodes is not None:
            object.__setattr__(self, "nodes", as_tuple("AboveSurface.nodes", self.nodes, "[0, 1]"))

    def check(self, structure: Structure) -> None:
        """Refuse a structure that this does not fit.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If a node does not exist, or all are pinned.
        """
        for node in self.nodes or ():
            node_index("AboveSurface.nodes", node, len(structure.nodes))
        if not self._chosen(structure):
            raise ValueError("AboveSurface.nodes names nodes that are pinned alone: leave it out")

    def constraint(self, model: Model) -> PathConstraint:
        """Return the distances of the nodes that may move, m, with the limit, as a path constraint.

        Parameters
        ----------
        model : Model
            The model of the problem.

        Returns
        -------
        PathConstraint
            Expressions of an instant of symbols, between their limits.
        """
        now, nodes = symbolic(model), self._chosen(model.scene.structure)
        names = tuple(
            f"distance of node {node} from the {type(self.ground).__name__}" for node in nodes
        )
        least, most = np.full(len(nodes), self.distance), np.full(len(nodes), np.inf)
        return PathConstraint(
            -self.ground.depth(now.nodes[:, nodes]).T,
            least,
            most,
            names,
            "m",
            now.symbols,
            self.ends,
        )

    def _chosen(self, structure: Structure) -> list[int]:
        """Return the nodes that stay above, but for those that cannot move."""
        nodes = range(len(structure.nodes)) if self.nodes is None else self.nodes
        return [node for node in nodes if not structure.fixed[node].all()]

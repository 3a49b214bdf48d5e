"""Goals for the orientation of rigid bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np

from ocp.problem.goals.goal import Goal
from ocp.problem.goals.rotation import Rotation, rotation_matrix
from ocp.problem.rows import Rows
from tenscasadi.dynamics.body_motion import find_body
from tenscasadi.structure.structure import Structure
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.validate import Array, whole


@dataclass(frozen=True, eq=False)
class BodyOrientation(Goal, kind="BodyOrientation"):
    """Goal for the final orientation of a rigid body.

    Parameters
    ----------
    body : int
        Index of the body in ``Structure.bodies``.
    rotation : array_like, shape (3, 3) or (3,)
        Rotation from the orientation of the structure's nodes to the final one: a matrix, or a
        rotation vector [rad]. Its axes are x, y, z.

    Raises
    ------
    TypeError, ValueError
        If the index is not a whole number, or the matrix is not a rotation. In a `Problem`: if there
        is no such body, or it is a thin rod.

    Examples
    --------
    >>> import ocp
    >>> ocp.BodyOrientation(0, (0, 0, 0.5)).matrix.round(3).tolist()
    [[0.878, -0.479, 0.0], [0.479, 0.878, 0.0], [0.0, 0.0, 1.0]]
    """

    body: Annotated[int, whole(0)]
    rotation: Rotation

    @property
    def matrix(self) -> Array:
        """Matrix (3, 3) of the rotation.

        It rotates vectors between nodes of the body from their directions in ``Structure.nodes`` to
        the final ones.
        """
        return rotation_matrix(self.rotation)

    def check(self, structure: Structure) -> None:
        """Check that the structure has the goal's rigid body.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If there is no such body, or its nodes lie on a line.
        """
        find_body(structure, self.body)

    def rows(self, structure: Structure, nodes: Any, velocities: Any) -> Rows:
        """Build displacements of the body's nodes from the goal.

        All positions are relative to the mean of the body's nodes.

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
        own = list(find_body(structure, self.body).nodes)
        start = structure.nodes[own]
        wanted = self.matrix @ (start - start.mean(axis=0)).T
        center = ca.sum2(nodes[:, own]) / len(own)
        apart = nodes[:, own] - ca.repmat(center, 1, len(own)) - ca.DM(wanted)
        names = tuple(
            f"BodyOrientation: node {node} {axis} of body {self.body}"
            for node in own
            for axis in "xyz"
        )
        return Rows(ca.vec(apart), names, ("m",) * len(names))

    def move(self, structure: Structure, nodes: Array) -> Array:
        """Turn the nodes of the body about their mean.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model, before strings are divided into segments.
        nodes : ndarray, shape (n, 3)
            Nodes [m], with the nodes inside strings last.

        Returns
        -------
        ndarray, shape (n, 3)
            Nodes with the body in its orientation.
        """
        own = list(find_body(structure, self.body).nodes)
        start, moved = structure.nodes[own], np.array(nodes)
        now = nodes[own] - nodes[own].mean(axis=0)
        turn = self.matrix @ fit_rotation(start - start.mean(axis=0), now).T
        moved[own] = now @ turn.T + nodes[own].mean(axis=0)
        return moved

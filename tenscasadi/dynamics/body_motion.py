"""Orientation and angular velocity of rigid bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.util.linear_algebra import fit_rotation, fit_velocities
from tenscasadi.util.validate import NEGLIGIBLE, Array, whole_number


class BodyFrame(NamedTuple):
    """Weights that convert a body's node positions to its axes.

    The axes of the body are orthonormal; each is a constant linear combination of its node positions.

    Attributes
    ----------
    nodes : list of int
        Nodes of the body.
    weights : ndarray, shape (k, d)
        Weights of the k nodes for each axis [1/m]. d is 2 for nodes in a plane, else 3.
    directions : ndarray, shape (3, 3)
        Axes in the initial configuration, as columns.
    """

    nodes: list[int]
    weights: Array
    directions: Array

    def rotation(self, nodes: Any) -> Any:
        """Compute the rotation matrix (3×3) since the initial configuration.

        `nodes` (3×n) are the positions of all nodes of the structure [m].
        """
        F = ca.mtimes(nodes[:, self.nodes], ca.DM(self.weights))
        if F.shape[1] == 2:
            F = ca.horzcat(F, ca.cross(F[:, 0], F[:, 1]))
        return ca.mtimes(F, ca.DM(self.directions.T))

    def angular_velocity(self, nodes: Any, velocities: Any) -> Any:
        """Compute the angular velocity (3) [rad/s].

        `nodes` and `velocities` (3×n) are those of all nodes of the structure [m, m/s].
        """
        weights = ca.DM(self.weights)
        F, G = (ca.mtimes(Z[:, self.nodes], weights) for Z in (nodes, velocities))
        if F.shape[1] == 2:
            F, G = (
                ca.horzcat(F, ca.cross(F[:, 0], F[:, 1])),
                ca.horzcat(G, ca.cross(G[:, 0], F[:, 1]) + ca.cross(F[:, 0], G[:, 1])),
            )
        return sum(ca.cross(F[:, k], G[:, k]) for k in range(3)) / 2  # of orthonormal directions


def find_body(structure: Any, body: Any) -> Any:
    """Return a body of a structure by its index.

    Raises TypeError, or ValueError if it does not exist or its nodes lie on a line.
    """
    count = len(structure.bodies)
    if not count:
        raise ValueError("body: the structure has no bodies: give Structure(bodies=[...])")
    own = structure.bodies[whole_number("body", body, 0, count - 1)]
    places = structure.nodes[list(own.nodes)]
    sizes = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
    if sizes[1] <= NEGLIGIBLE * sizes[0]:
        raise ValueError(f"body {body} is a thin rod: its nodes define no orientation")
    return own


def body_frame(structure: Any, body: Any) -> BodyFrame:
    """Build the frame of a body.

    Parameters
    ----------
    structure : Structure
        The structure.
    body : int
        Index of the body.

    Returns
    -------
    BodyFrame
        Directions that its nodes span.

    Raises
    ------
    TypeError, ValueError
        If there is no such body, or its nodes lie on a line.
    """
    nodes = list(find_body(structure, body).nodes)
    arms = structure.nodes[nodes] - structure.nodes[nodes].mean(axis=0)
    _, sizes, right = np.linalg.svd(arms)
    count = int(np.sum(sizes > NEGLIGIBLE * sizes[0]))
    directions = right.T * np.array([1.0, 1.0, np.linalg.det(right)])
    along = directions[:, :count]
    weights = np.linalg.pinv((arms @ along).T)  # (k, d): arms' combination is a direction
    return BodyFrame(nodes, weights, directions)


def body_orientation(structure: Any, body: Any, nodes: Array) -> Array:
    """Compute a body's rotation matrix from node positions.

    Parameters
    ----------
    structure : Structure
        The structure.
    body : int
        Index of the body.
    nodes : ndarray, shape (…, n, 3)
        Positions [m].

    Returns
    -------
    ndarray, shape (…, 3, 3)
        Rotation matrices from the structure's nodes.
    """
    own = list(find_body(structure, body).nodes)
    start, places = structure.nodes[own], nodes[..., own, :]
    return fit_rotation(start - start.mean(axis=0), places - places.mean(axis=-2, keepdims=True))


def body_angular_velocity(structure: Any, body: Any, nodes: Array, velocities: Array) -> Array:
    """Compute a body's angular velocity from node velocities.

    Parameters
    ----------
    structure : Structure
        The structure.
    body : int
        Index of the body.
    nodes, velocities : ndarray, shape (…, n, 3)
        Positions [m] and velocities [m/s].

    Returns
    -------
    ndarray, shape (…, 3)
        Angular velocities [rad/s].
    """
    own = list(find_body(structure, body).nodes)
    return fit_velocities(nodes[..., own, :], velocities[..., own, :])[1]

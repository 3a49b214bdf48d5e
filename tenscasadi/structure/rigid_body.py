"""Class `RigidBody`: nodes that move as one body, with its inertia."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from tenscasadi.schema.field_types import VECTOR, ListOf, Members, Numbers
from tenscasadi.schema.reading import Names
from tenscasadi.schema.value import Value
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    SMALLEST,
    Array,
    IndexOrName,
    Positive,
    as_tuple,
    finite_array,
    format_value,
    index_or_name,
    instance,
    nesting,
)


class MassProperties(NamedTuple):
    """Mass [kg], center (3,) [m] and second moments (3, 3) [kg m²].

    The moments are about the center.
    """

    mass: float
    center: Array
    moments: Array  # ∫ r rᵀ dm = ½ tr(I) E − I, kg m²


@dataclass(frozen=True)
class RigidBody(Value, kind="RigidBody"):
    """Rigid body with a mass, to which nodes of a structure belong.

    Bodies that share one node are joined by a ball joint, by two nodes by a hinge, and by three
    rigidly. A node can also belong to bars.

    Parameters
    ----------
    nodes : sequence of int or str
        Nodes that the body holds, at least two.
    mass : float
        Mass [kg], greater than 0. Masses of bars and nodes are added to it.
    center : array_like, shape (3,), optional
        Center of mass in the frame of the structure's nodes [m]. Default: the mean of its nodes.
    inertia : array_like, shape (3, 3) or (3,), optional
        Inertia matrix about the center, along the axes of the structure's nodes, or its diagonal
        [kg m²]. Default: that of equal point masses on the nodes.
    faces : sequence of triples of int or str, optional
        Triangles between nodes of the body, which pictures show. Default: the convex hull.

    Raises
    ------
    TypeError, ValueError
        If a field is wrong, or no mass distribution has this inertia.

    Examples
    --------
    A box of 0.4 × 0.2 × 0.1 m:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> a, b, c, m = 0.4, 0.2, 0.1, 3.0
    >>> corners = [(0, 0, 0), (a, 0, 0), (0, b, 0), (0, 0, c)]
    >>> box = tc.RigidBody(range(4), m, (a / 2, b / 2, c / 2), m / 12 * np.array([b * b + c * c, a * a + c * c, a * a + b * b]))
    >>> tc.Structure(corners, bodies=[box])
    Structure(4 nodes, 0 bars, 0 strings, 0 pinned, 1 body)
    """

    nodes: Annotated[Sequence[IndexOrName], Members("node")]
    mass: Positive
    center: Annotated[Any, VECTOR] = None
    inertia: Annotated[Any, Numbers(((3,), (3, 3)))] = None
    faces: Annotated[Any, ListOf(Members("node"))] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        nodes = tuple(
            index_or_name(f"RigidBody.nodes[{k}]", node) for k, node in enumerate(self.nodes)
        )
        if len(nodes) < 2:
            raise ValueError(
                f"RigidBody.nodes is {format_value(nodes)}: give at least two nodes, "
                "or the mass as node_mass"
            )
        for k, node in enumerate(nodes):
            if node in nodes[:k]:
                raise ValueError(f"RigidBody.nodes has node {node} twice: remove one")
        own: dict[str, Any] = {"nodes": nodes}
        if self.center is not None:
            own["center"] = tuple(self.center.tolist())
        if self.inertia is not None:
            matrix = _read_inertia(self.inertia)
            diagonal = np.array_equal(matrix, np.diag(matrix.diagonal()))
            entries = matrix.diagonal() if diagonal else matrix
            own["inertia"] = _as_tuple(entries.tolist())
        if self.faces is not None:
            own["faces"] = _read_faces(self.faces)
        vars(self).update(own)

    def mass_properties(self, positions: Array) -> MassProperties:
        """Compute mass, center and second moments.

        Parameters
        ----------
        positions : ndarray, shape (k, 3)
            Positions of its nodes [m].

        Returns
        -------
        MassProperties
            Given values, or those of point masses on the nodes.
        """
        mean = positions.mean(axis=0)
        center = mean if self.center is None else np.array(self.center)
        if self.inertia is None:
            arms = positions - mean
            return MassProperties(self.mass, center, self.mass / len(arms) * arms.T @ arms)
        inertia = np.array(self.inertia)
        inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
        moments = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        return MassProperties(self.mass, center, moments)

    def follow(self, before: Array, after: Array) -> RigidBody:
        """Move the body's center and inertia with its nodes.

        Parameters
        ----------
        before, after : ndarray, shape (k, 3)
            Positions of its nodes [m]. The motion is the rigid one nearest to their change.

        Returns
        -------
        RigidBody
            Body whose center and inertia have moved.
        """
        if np.array_equal(before, after) or (self.center is None and self.inertia is None):
            return self
        own = self.mass_properties(before)
        start, end = before.mean(axis=0), after.mean(axis=0)
        R = fit_rotation(before - start, after - end)
        moments = R @ own.moments @ R.T
        inertia = np.trace(moments) * np.eye(3) - moments
        center = None if self.center is None else end + R @ (own.center - start)
        turned = None if self.inertia is None else (inertia + inertia.T) / 2
        return replace(self, center=center, inertia=turned)


def read_bodies(given: Any, names: Names) -> tuple[RigidBody, ...]:
    """Read the bodies of a structure.

    Node names are replaced by indices. `given` is the argument of `Structure`, and `names` are
    those of its nodes. Raises TypeError or ValueError.
    """
    example = "give a list of tenscasadi.RigidBody"
    if isinstance(given, RigidBody) or not isinstance(given, Iterable):
        raise TypeError(f"bodies is {format_value(given)}: {example}")
    bodies = list(given)
    for k, body in enumerate(bodies):
        instance(f"bodies[{k}]", body, RigidBody, "a tenscasadi.RigidBody")
        nodes = names.resolve_all(f"bodies[{k}].nodes", "node", body.nodes)
        for node in nodes:
            names.index(f"bodies[{k}].nodes", "node", node)
        faces = body.faces and names.resolve_lists(f"bodies[{k}].faces", "node", body.faces)
        for j, face in enumerate(faces or ()):
            for node in set(face) - set(nodes):
                raise ValueError(f"bodies[{k}].faces[{j}] has node {node}: give nodes of the body")
        same = nodes is body.nodes and faces is body.faces
        bodies[k] = body if same else replace(body, nodes=nodes, faces=faces)
    return tuple(bodies)


def reject_bodies(structure: Any, user: str) -> None:
    """Raise ValueError if a structure has rigid bodies.

    `user` names the function that does not support them.
    """
    if structure.bodies:
        raise ValueError(
            f"Structure.bodies has {len(structure.bodies)} bodies, which {user} does not take: "
            "give structure.replace(bodies=()) with bars in their place"
        )


def move_bodies(bodies: Iterable[RigidBody], before: Array, after: Any) -> tuple[RigidBody, ...]:
    """Move bodies with the nodes (n, 3) of a structure.

    The nodes are at `before` and then at `after` [m]; see `RigidBody.follow`. Raises TypeError or
    ValueError.
    """
    nodes = finite_array("nodes", after, before.shape)
    return tuple(body.follow(before[list(body.nodes)], nodes[list(body.nodes)]) for body in bodies)


def _read_inertia(given: Any) -> Array:
    """Read an inertia matrix (3, 3) [kg m²].

    `given` is the matrix (3, 3) or the diagonal (3,). Raises TypeError, or ValueError if no mass
    distribution has it.
    """
    shape = (3,) if nesting(given) < 2 else (3, 3)
    matrix = np.array(finite_array("RigidBody.inertia", given, shape))
    matrix = np.diag(matrix) if matrix.ndim == 1 else matrix
    size = float(np.abs(matrix).max())
    if np.abs(matrix - matrix.T).max() > NEGLIGIBLE * size:
        raise ValueError(
            f"RigidBody.inertia is {format_value(matrix.tolist())}: give a symmetric matrix"
        )
    matrix = (matrix + matrix.T) / 2
    principal = np.linalg.eigvalsh(matrix)
    if principal[0] < -NEGLIGIBLE * size or principal[2] < SMALLEST:
        raise ValueError(
            f"RigidBody.inertia has the principal moments {principal.tolist()} kg m²: "
            "they must be at least 0, and two of them greater"
        )
    if principal[0] + principal[1] < (1 - NEGLIGIBLE) * principal[2]:
        raise ValueError(
            f"RigidBody.inertia has the principal moments {principal.tolist()} kg m²: "
            "none may exceed the sum of the others"
        )
    return matrix


def _read_faces(given: Any) -> tuple[tuple[IndexOrName, ...], ...]:
    """Convert triangles between nodes to tuples.

    `given` are triples of node names or indices. Raises TypeError or ValueError.
    """
    found = []
    for k, face in enumerate(as_tuple("RigidBody.faces", given, "[(0, 1, 2)]")):
        field = f"RigidBody.faces[{k}]"
        corners = tuple(
            index_or_name(field, corner) for corner in as_tuple(field, face, "(0, 1, 2)")
        )
        if len(corners) != 3 or len(set(corners)) < 3:
            raise ValueError(f"{field} is {format_value(corners)}: give three different nodes")
        found.append(corners)
    return tuple(found)


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value

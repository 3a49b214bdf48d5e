"""Rotations as matrices or rotation vectors."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from tenscasadi.schema.field_types import Numbers
from tenscasadi.util.validate import TOLERANCE, Array, Check, finite_array, format_value, nesting


def read_rotation(field: str, given: Any) -> Array:
    """Read a rotation matrix (3, 3) or a rotation vector (3,) [rad].

    ``given`` is the argument ``field``. Raises TypeError, ValueError.
    """
    rotation = finite_array(field, given, (3,) if nesting(given) < 2 else (3, 3))
    R = rotation_matrix(rotation)
    if np.abs(R @ R.T - np.eye(3)).max() > TOLERANCE or np.linalg.det(R) < 0.0:
        raise ValueError(
            f"{field} is {format_value(rotation.tolist())}: give a rotation "
            "matrix, which is orthonormal with determinant 1, or a rotation vector [rad]"
        )
    return rotation


Rotation = Annotated[ArrayLike, Numbers(((3,), (3, 3))), Check(read_rotation)]


def rotation_matrix(given: Any) -> Array:
    """Convert a rotation matrix or vector [rad] to a matrix (3, 3)."""
    rotation = np.asarray(given)
    if rotation.ndim == 2:
        return rotation
    x, y, z = rotation
    return np.asarray(expm(np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])))

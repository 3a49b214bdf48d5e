"""Pendulums of one and two bars."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.field_types import PAIR
from tenscasadi.structure.shapes.family import shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, finite_array, number, positive_number


@shape
def pendulum(length: float = 1.0, angle: float = np.pi / 4, **options: Any) -> Structure:
    """Build a pendulum of one bar in the x-z plane.

    Node 0 is pinned at the origin.

    ::

        0 ●────> x
           ╲
            ╲
             1

    Parameters
    ----------
    length : float
        Length of the bar [m].
    angle : float
        Angle from the downward vertical towards +x [rad].
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The pendulum, which has no strings.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.pendulum(2.0, angle=0.0).nodes.round(6).tolist()
    [[0.0, 0.0, 0.0], [0.0, 0.0, -2.0]]
    """
    length = positive_number("length", length)
    angle = number("angle", angle)
    return Structure(
        np.array([np.zeros(3), _hanging(length, angle)]),
        bars=[(0, 1)],
        **{"pinned": (0,), **options},
    )


@shape
def double_pendulum(
    lengths: Annotated[ArrayLike, PAIR] = (1.0, 1.0),
    angles: Annotated[ArrayLike, PAIR] = (np.pi / 4, np.pi / 4),
    **options: Any,
) -> Structure:
    """Build a double pendulum in the x-z plane (class 2).

    Both bars share node 1. Node 0 is pinned at the origin.

    ::

        0 ●────> x
           ╲
            1
             ╲
              2

    Parameters
    ----------
    lengths : array_like, shape (2,)
        Lengths of bar 0, (0, 1), and of bar 1, (1, 2) [m].
    angles : array_like, shape (2,)
        Angle of each bar from the downward vertical towards +x [rad].
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The double pendulum, which has no strings.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.shapes.double_pendulum(angles=(0.0, 0.0)).nodes[:, 2].tolist()
    [0.0, -1.0, -2.0]
    """
    first, second = finite_array("lengths", lengths, (2,))
    upper, lower = finite_array("angles", angles, (2,))
    elbow = _hanging(positive_number("lengths", first), upper)
    tip = elbow + _hanging(positive_number("lengths", second), lower)
    return Structure(
        np.array([np.zeros(3), elbow, tip]), bars=[(0, 1), (1, 2)], **{"pinned": (0,), **options}
    )


def _hanging(length: float, angle: float) -> Array:
    return np.array([length * np.sin(angle), 0.0, -length * np.cos(angle)])

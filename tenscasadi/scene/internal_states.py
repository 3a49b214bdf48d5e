"""States besides positions and velocities, such as rest lengths of winches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from tenscasadi.util.validate import Array


class InternalStates(NamedTuple):
    """Internal states of one kind, such as rest lengths.

    They have an entry for each cable and for each string that is not part of a cable.

    Attributes
    ----------
    quantity : str
        Name of an entry, such as "rest length".
    unit : str
        Unit of the entries.
    scale : ndarray, shape (m,)
        Typical size of the entries, for error norms and optimization.
    initial : ndarray, shape (m,)
        Initial values.
    least : float
        Lower limit, below which the equations have no meaning.
    """

    quantity: str
    unit: str
    scale: Array
    initial: Array
    least: float = -np.inf


def join_initial(parts: Sequence[InternalStates]) -> Array:
    """Join the initial values (na,) of all kinds of internal states."""
    return np.concatenate([np.zeros(0), *(part.initial for part in parts)])


def join_scales(parts: Sequence[InternalStates]) -> Array:
    """Join the scales (na,) of all kinds of internal states."""
    return np.concatenate([np.zeros(0), *(part.scale for part in parts)])

"""Limits along the coordinate axes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar

import numpy as np

from ocp.problem.bounds.bound import Limit, PathBound, drop_infinite
from tenscasadi.schema.field_types import POINT
from tenscasadi.util.validate import Array, Check, coordinates

Corner = Annotated[Sequence[float | None], POINT, Check(partial(coordinates, none="an open side"))]


@dataclass(frozen=True, eq=False)
class AxisLimits(PathBound):
    """Base class of limits along x, y and z.

    They limit a function of the state at the end of every interval of the mesh. `lower` and `upper`
    have a number for each axis, None without a limit.
    """

    lower: Corner = (None, None, None)
    upper: Corner = (None, None, None)

    ends: ClassVar[tuple[str, ...]] = ("end",)

    def __post_init__(self) -> None:
        name = type(self).__name__
        super().__post_init__()
        lower, upper = self.corners()
        if np.all(np.isinf(np.concatenate([lower, upper]))):
            raise ValueError(f"{name}.lower and .upper are open on all sides: give at least one")
        if np.any(lower >= upper):
            axis = int(np.argmax(lower >= upper))
            raise ValueError(
                f"{name}.lower is {lower[axis]:g} and .upper {upper[axis]:g} along {'xyz'[axis]}: give lower < upper"
            )

    def corners(self) -> tuple[Array, Array]:
        """Return the lower and upper limits along x, y, z.

        They are infinite along axes without limit.

        Returns
        -------
        lower : numpy.ndarray, shape (3,)
            Lower limits; −inf on open sides.
        upper : numpy.ndarray, shape (3,)
            Upper limits; inf on open sides.
        """
        lower = np.array([-np.inf if value is None else value for value in self.lower])
        return lower, np.array([np.inf if value is None else value for value in self.upper])

    def limit_vector(self, vector: Any, quantity: str, unit: str) -> Limit:
        """Build the limits of a vector (3,) along the limited axes.

        `quantity` and `unit` are those of its components, such as "velocity" and "m/s".
        """
        names = tuple(f"{quantity} along {axis}" for axis in "xyz")
        return drop_infinite(Limit(vector, *self.corners(), names, unit))

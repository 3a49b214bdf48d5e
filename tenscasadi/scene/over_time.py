"""Loads that may change over time: a constant, a table at times, or a function of time."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, TypeVar

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import find_breakpoints, short_beside_steep
from tenscasadi.scene.time_functions import (
    as_numbers,
    check_over_run,
    express,
    interpolate,
    trace,
)
from tenscasadi.schema.field_types import TIMES
from tenscasadi.schema.value import Value
from tenscasadi.util.casadi_tools import is_expression
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import Array, finite_array

Timed = TypeVar("Timed", bound=type)


def takes_breaks(kind: Timed) -> Timed:
    """Let a class take the earlier name `breaks` of its field `breakpoints`, with a warning."""
    made: Any = kind
    made.earlier_names = {"breaks": "breakpoints"}
    made.__init__ = rename_keywords(**made.earlier_names)(made.__init__)
    return kind


class OverTime(Value):
    """Base of loads with one quantity that is constant, a table over time, or a function of time.

    A function is called with a CasADi symbol: write it with NumPy's or CasADi's mathematics,
    without ``if`` on the time. A table is linear between its times and constant before and after
    them.
    """

    _quantity: ClassVar[str]  # name of the field that may change over time
    times: Annotated[Any, TIMES]
    breakpoints: Annotated[Any, TIMES]
    factor: ClassVar[Any] = None  # that parameters multiply the quantity by

    @property
    def varies(self) -> bool:
        """Whether the load is a function of time."""
        return self.times is not None or self.is_function

    @property
    def is_function(self) -> bool:
        """Whether what changes is given as a function, not as a table."""
        return callable(self.quantity)

    @property
    def quantity(self) -> Any:
        """The constant, the table or the function that is given."""
        return getattr(self, self._quantity)

    @property
    def quantity_name(self) -> str:
        """Name of the field that may change over time."""
        return self._quantity

    @property
    def field(self) -> str:
        """Name of that quantity, as messages tell it."""
        return f"{type(self).__name__}.{self._quantity}"

    def _read(self, shape: tuple[int | None, ...]) -> None:
        """Check the fields of a frozen value whose quantity has this shape at each time; arrays take their place."""
        name, value = type(self).__name__, self.quantity
        given = finite_array(f"{name}.breakpoints", self.breakpoints, (None,))
        if len(given) and not callable(value):
            raise ValueError(
                f"{name}.breakpoints is {given}: give them with a function of time alone, a table has its times"
            )
        checked: dict[str, Any] = {"breakpoints": given}
        if self.times is not None:
            times = finite_array(f"{name}.times", self.times, (None,))
            if len(times) < 2 or np.any(np.diff(times) <= 0):
                raise ValueError(f"{name}.times is {times}: give two or more increasing times")
            checked |= {
                "times": times,
                self._quantity: finite_array(self.field, value, (len(times), *shape)),
            }
        elif not callable(value):
            checked[self._quantity] = finite_array(self.field, value, shape)
        for field, array in checked.items():
            object.__setattr__(self, field, array)

    def _check_function(self, shape: tuple[int, ...]) -> None:
        """Raise ValueError unless a function returns finite numbers of this shape at t = 0, and entries as many on a CasADi time."""
        function, wanted = (
            self.quantity,
            f"({', '.join(map(str, shape))})" if shape else "one number",
        )
        try:
            sample = function(0.0)
        except Exception as error:  # whatever the caller's function raises
            raise ValueError(
                f"{self.field} raised {error!r} at t = 0: give a function of time that returns {wanted}"
            ) from error
        read_sample(f"{self.field}(0.0)", sample, shape)
        found = express(self.field, function, ca.MX.sym("t")).shape
        if found not in (
            (shape,) if len(shape) == 2 else ((*shape, 1), (1, *shape)) if shape else ((1, 1),)
        ):
            raise ValueError(f"{self.field} returns shape {found} on a CasADi time: give {wanted}")

    def at(self, time: Any) -> Any:
        """Compute the quantity at a time.

        Parameters
        ----------
        time : casadi expression
            Time [s], which a constant does not need.

        Returns
        -------
        casadi matrix
            One number, or the columns (3, n) of n vectors.
        """
        value = self.quantity
        if self.times is not None:
            table = np.asarray(value)
            rows = 3 if table.ndim > 1 else 1
            value = interpolate(time, np.asarray(self.times), table.reshape(len(table), -1), rows)
        else:
            if self.is_function:
                value = express(self.field, value, time)
            elif not is_expression(value):
                value = ca.DM(np.asarray(value))
            value = value if value.shape[1] == 1 else value.T
        return value if self.factor is None else self.factor * value

    def check_run(self, first: float, last: float) -> None:
        """Raise ValueError where a function of time is not finite in a run or is not written in the mathematics of symbols.

        Parameters
        ----------
        first, last : float
            Times at which the run begins and ends, s.
        """
        if self.is_function:
            check_over_run(self.field, self.quantity, trace(self.at), first, last)

    def find_breakpoints(self, first: float, last: float) -> Array:
        """Find the times of a table, or the jumps and kinks of a function.

        Parameters
        ----------
        first, last : float
            Times at which the run begins and ends, s.

        Returns
        -------
        ndarray
            Times, s, in order.
        """
        if self.times is not None:
            return short_beside_steep(np.asarray(self.times))
        if not self.is_function:
            return np.empty(0)
        found = [self.breakpoints, find_breakpoints(trace(self.at), first, last)]
        return np.unique(np.concatenate(found))

    def changing(self) -> ca.Function | None:
        """Build the function of time that steps have to follow; None where it is a table, which they follow."""
        return trace(self.at) if self.is_function else None


def read_sample(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return what a function of time returned for a number, of this shape. Raises TypeError, ValueError."""
    return finite_array(field, as_numbers(value), shape)

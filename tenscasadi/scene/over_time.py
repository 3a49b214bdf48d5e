"""Time-varying loads: constants, tables over time, or functions of time."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any, ClassVar, TypeVar

import casadi as ca
import numpy as np

from tenscasadi.scene.breakpoints import add_guard_times, find_breakpoints
from tenscasadi.scene.interpolants import (
    VectorFunction,
    call_python,
    interpolate_function,
    is_traceable,
    read_function,
    sample_twice,
)
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
from tenscasadi.util.immutable import keep
from tenscasadi.util.validate import Array, finite_array

Load = TypeVar("Load", bound="OverTime")


class OverTime(Value):
    """Base class of loads with a quantity that can vary over time.

    The quantity is constant, a table or a function of time. A table is linear between its `times`
    and constant outside. A function becomes a CasADi expression, or else an interpolant over a run;
    steps end at its `breakpoints`. `factor` multiplies the quantity, if it is not None.
    """

    _quantity: ClassVar[str]  # name of the field that can vary over time
    times: Annotated[Any, TIMES]
    breakpoints: Annotated[Any, TIMES]
    factor: ClassVar[Any] = None  # factor of the quantity, from parameters

    @property
    def varies(self) -> bool:
        """Whether the load is a function of time."""
        return self.times is not None or self.is_function

    @property
    def is_function(self) -> bool:
        """Whether the quantity is a function of time."""
        return callable(self.quantity)

    @property
    def is_interpolated(self) -> bool:
        """Whether the quantity is a function of time that CasADi cannot trace."""
        if not self.is_function:
            return False
        return not keep(self, "traceable", lambda: is_traceable(self.field, self.quantity))

    @property
    def quantity(self) -> Any:
        """Constant, table or function of time of the load."""
        return getattr(self, self._quantity)

    @property
    def quantity_name(self) -> str:
        """Name of the field that can vary over time."""
        return self._quantity

    @property
    def field(self) -> str:
        """Name of the quantity in messages."""
        return f"{type(self).__name__}.{self._quantity}"

    def _read(self, shape: tuple[int | None, ...]) -> None:
        """Convert the fields to arrays and check them.

        `shape` is that of the quantity at each time.
        """
        name, value = type(self).__name__, self.quantity
        given = finite_array(f"{name}.breakpoints", self.breakpoints, (None,))
        if len(given) and not callable(value):
            raise ValueError(
                f"{name}.breakpoints is {given}: give breakpoints only with a function of time"
            )
        checked: dict[str, Any] = {"breakpoints": given}
        if self.times is not None:
            times = finite_array(f"{name}.times", self.times, (None,))
            if len(times) < 2 or np.any(np.diff(times) <= 0):
                raise ValueError(f"{name}.times is {times}: give two or more increasing times")
            checked |= {
                "times": times,
                self._quantity: self._read_values(value, (len(times), *shape)),
            }
        elif not callable(value):
            checked[self._quantity] = self._read_values(value, shape)
        vars(self).update(checked)

    def _read_values(self, value: Any, shape: tuple[int | None, ...]) -> Any:
        """Convert a constant or a table to an array.

        `value` must be finite and have this shape. Raises TypeError, ValueError.
        """
        return finite_array(self.field, value, shape)

    def _check_function(self, shape: tuple[int, ...]) -> None:
        """Check the results of a function of time.

        Raises ValueError unless they have this shape for t = 0 and a symbol, and are finite.
        """
        function = self.quantity
        wanted = f"({', '.join(map(str, shape))})" if shape else "one number"
        try:
            sample = function(0.0)
        except Exception as error:  # user code can raise anything
            raise ValueError(
                f"{self.field} raised {error!r} at t = 0: give a function of time that returns {wanted}"
            ) from error
        read_sample(f"{self.field}(0.0)", sample, shape)
        if self.is_interpolated:
            return
        found = express(self.field, function, ca.MX.sym("t")).shape
        row = (1, *shape) if shape else (1, 1)
        if found not in ((shape,) if len(shape) == 2 else (row, row[::-1])):
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
            A number, or n vectors as columns (3, n).
        """
        value = self.quantity
        if self.times is not None:
            table = np.asarray(value)
            rows = 3 if table.ndim > 1 else 1
            value = interpolate(time, np.asarray(self.times), table.reshape(len(table), -1), rows)
        else:
            if self.is_interpolated:
                value = express(self.field, *self._call_python(time))
            elif self.is_function:
                value = express(self.field, value, time)
            elif not is_expression(value):
                value = ca.DM(np.asarray(value))
            value = value if value.shape[1] == 1 else value.T
        return value if self.factor is None else self.factor * value

    def _call_python(self, time: Any) -> tuple[Any, Any]:
        """Wrap a function that CasADi cannot trace for a call at `time`.

        Returns the function, or for a symbol a CasADi Function of it, and the time.
        """
        if not isinstance(time, (ca.SX, ca.MX)):
            return self.quantity, float(time)
        call = keep(self, "call", lambda: call_python(self.field, self.quantity, self._shape))
        return call, time

    @property
    def _shape(self) -> tuple[int, ...]:
        """Shape of the function's results."""
        return np.shape(as_numbers(self.quantity(0.0)))

    def interpolate(self: Load, first: float, last: float) -> Load:
        """Interpolate a function of time that CasADi cannot trace.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        OverTime
            Load with an interpolant over the run; this one if there is none.

        Raises
        ------
        ValueError
            If the function raises, is not deterministic, or changes too fast. The message names the
            time.
        """
        if not self.is_interpolated:
            return self
        shape = self._shape
        sample = read_function(self.field, self.quantity, shape)
        sample_twice(self.field, sample, first, last)
        given = np.asarray(self.breakpoints)
        at, steep = interpolate_function(self.field, sample, first, last, given)
        own: Any = {
            self._quantity: VectorFunction(at, shape, (first, last)),
            "breakpoints": np.union1d(given, steep),
        }
        return replace(self, **own)  # type: ignore[type-var]

    def check_run(self, first: float, last: float) -> None:
        """Check a function of time over a run, see `check_over_run`.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].
        """
        if isinstance(self.quantity, VectorFunction):
            self.quantity.check_run(self.field, first, last)
        if self.is_function:
            check_over_run(self.field, self.quantity, trace(self.at), first, last)

    def find_breakpoints(self, first: float, last: float) -> Array:
        """Find the times of a table, or the jumps of a function.

        Parameters
        ----------
        first, last : float
            Start and end of the run [s].

        Returns
        -------
        ndarray
            Increasing times [s].
        """
        if self.times is not None:
            return add_guard_times(np.asarray(self.times))
        if not self.is_function:
            return np.empty(0)
        found = [self.breakpoints, find_breakpoints(trace(self.at), first, last)]
        return np.unique(np.concatenate(found))

    def changing(self) -> ca.Function | None:
        """Build the function of time that the steps must resolve.

        It is None for tables, as steps end at their times.
        """
        return trace(self.at) if self.is_function else None


def read_sample(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Convert the result of a function to a finite array.

    `value` is the result, which must have the given shape. Messages name `field`. Raises TypeError
    or ValueError.
    """
    return finite_array(field, as_numbers(value), shape)

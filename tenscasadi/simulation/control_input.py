"""Controls over time: a constant, a table or a function of time, sampled at the start of each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.util.validate import Array, finite_array

ControlInput = ArrayLike | Callable[[float], ArrayLike] | None


@dataclass(frozen=True)
class Signal:
    """A control for a run of `steps` steps; `varies` tells whether it may change from step to step."""

    steps: int
    varies: bool
    sample: Callable[[int, int], Array]

    def window(self, first: int, count: int) -> Array:
        """The control (count, nu) of the steps from `first` on; past the end of the run the last one is held."""
        inside = self.sample(first, max(0, min(count, self.steps - first)))
        if len(inside) == count:
            return inside
        last = inside[-1:] if len(inside) else self.sample(self.steps - 1, 1)
        return np.concatenate([inside, np.repeat(last, count - len(inside), axis=0)])


def signal(control: ControlInput, default: Array, t_end: float, steps: int) -> Signal:
    """`control` (see `simulate`) over [0, t_end] s in at least `steps` equal steps, in more where a table's intervals need it.

    `default` (nu,) is used for None. Raises TypeError, ValueError naming `control`; a function's results are checked when it is called.
    """
    nu = len(default)
    if callable(control):
        return Signal(steps, nu > 0, _of_function(control, nu, t_end / steps))
    value = default
    if control is not None:
        table = _array(control, nu)
        intervals = len(table)
        if table.ndim == 2 and intervals > 1 and nu:
            steps = intervals * -(-steps // intervals)  # so that the control changes between two steps
            # Integers only: a rounded time would put a change one step off.
            return Signal(steps, True, lambda first, count: table[np.arange(first, first + count) * intervals // steps])
        value = table.reshape(-1)
    return Signal(steps, False, lambda first, count: np.broadcast_to(value, (count, nu)))


def _array(control: Any, nu: int) -> Array:
    try:
        shape = np.shape(control)
    except ValueError:
        shape = ()  # ragged: finite_array says so
    if shape == (nu,):
        return finite_array("control", control, (nu,))
    if len(shape) == 2 and shape[0] > 0 and shape[1] == nu:
        return finite_array("control", control, (None, nu))
    array = finite_array("control", control, (None,) * len(shape))
    expected = f"({nu},), (intervals, {nu}) or a function of time that returns ({nu},)" if nu else "(0,) or None, as this scene has no control"
    raise ValueError(f"control has shape {array.shape}: give an array of shape {expected}")


def _of_function(function: Callable[[float], ArrayLike], nu: int, step: float) -> Callable[[int, int], Array]:
    def sample(first: int, count: int) -> Array:
        values = np.empty((count, nu))
        for k in range(count):
            time = (first + k) * step
            values[k] = finite_array(f"control({time:g})", function(time), (nu,))
        return values

    return sample

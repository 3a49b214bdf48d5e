"""Input and result arrays of the time loop."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.integrators.adaptive import Memory
from tenscasadi.util.validate import Array

Integers = NDArray[np.int64]

# Codes of `engine.hpp`. Up to BROKEN the run is lost; after the others it ends early.
FINISHED, NOT_FINITE, BEYOND, BROKEN, STOPPED, UNSOLVED, STUCK, TIRED = range(8)
MEASURED = ("bar_length_error", "joint_error", "kinetic", "elastic", "gravity")
WORST = (
    "bar_length_error",
    "joint_error",
    "energy_error",
    "kinetic",
    "elastic_low",
    "elastic_high",
    "gravity_low",
    "gravity_high",
)
CARRIED = ("energy", "bars", "work", "jumps", *Memory._fields)  # then the stacked input


class Intervals(NamedTuple):
    """Time intervals with constant control, in arrays (K,).

    They have the row of the control, the number of steps, and the length of a step [s]. The clock
    of the model starts at `clock` [s], without the rounding of the steps before; it continues if
    that is None or NaN.
    """

    row: Integers
    steps: Integers
    length: Array
    clock: Array | None = None

    def slice(self, first: int, last: int) -> Intervals:
        """Select the steps from `first` to before `last`."""
        ends = np.cumsum(self.steps)
        inside = (ends > first) & (ends - self.steps < last) & (first < last)
        steps = np.minimum(ends, last) - np.maximum(ends - self.steps, first)
        if self.clock is None:
            return Intervals(self.row[inside], steps[inside], self.length[inside])
        clock = np.where(ends - self.steps >= first, self.clock, np.nan)
        return Intervals(self.row[inside], steps[inside], self.length[inside], clock[inside])


class Rolled(NamedTuple):
    """Arrays that the time loop returns for n runs.

    A run that fails ends in NaN and costs inf. A field that was not requested is None.

    Attributes
    ----------
    states : ndarray, shape (n, nx)
        Final states, or those at which runs were stopped.
    saved : ndarray, shape (n, T, nx) or None
        Start, every `save_every`-th step, and end.
    cost : ndarray, shape (n,)
        Costs.
    status : ndarray, shape (n,)
        0, or the code of the failure.
    fault, good : ndarray, shape (n,)
        Step at which the failure was detected, and the last good one before.
    measured, worst, carry : ndarray, shapes (n, T, M + 1), (n, 8), (n, ·)
        Errors and energies of the saved rows, with the external work [J]; columns as in `WORST` and `CARRIED`.
    corrected : ndarray, shape (n, T, 2) or None
        Movement of a node [m] and energy [J] by the first correction after each saved row.
    compared : ndarray, shape (T, 3, nx) or None
        States of one run and of its copies with steps of 2 h and 4 h, every `compare_every`-th step.
    """

    states: Array
    saved: Array | None
    cost: Array
    status: Integers
    fault: Integers
    good: Integers
    measured: Array | None
    worst: Array | None
    corrected: Array | None
    carry: Array
    compared: Array | None = None

    @property
    def supplied(self) -> Array:
        """External work (n,) up to the end [J]."""
        work, jumps = (self.carry[:, CARRIED.index(name)] for name in ("work", "jumps"))
        return np.asarray(work + jumps)

    def memory(self, k: int) -> Memory:
        """Return the state of run k's step-size control."""
        first = CARRIED.index(Memory._fields[0])
        return Memory(*self.carry[k, first : len(CARRIED)].tolist())


def count_runs(joiner: str = ", ", /, **rows: int) -> int:
    """Find the number of runs from the row counts of arrays.

    All runs share an array with one row. The message joins the names of arrays by `joiner`. Raises
    ValueError.
    """
    several = {name: count for name, count in rows.items() if count != 1}
    if len(set(several.values())) > 1:
        text = joiner.join(f"{name} has {count} rows" for name, count in several.items())
        raise ValueError(f"{text}: give as many of each, or one row that all motions share")
    return next(iter(several.values()), 1)

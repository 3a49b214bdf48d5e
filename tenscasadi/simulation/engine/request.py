"""Input and result arrays of an integration loop.

Their names and order are those of the struct in `engine.hpp`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.integrators.adaptive import Memory
from tenscasadi.util.validate import Array

Integers = NDArray[np.int64]

# Codes of `engine.hpp`. Up to BROKEN the run is lost; after the others it ends early.
FINISHED, NOT_FINITE, BEYOND, BROKEN, STOPPED, UNSOLVED, STUCK, TIRED = range(8)
MEASURED = ("bar_length_error", "joint_error", "kinetic", "elastic", "gravity", "supplied")
KINETIC, SUPPLIED = (MEASURED.index(name) for name in ("kinetic", "supplied"))
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

_NUMBERS = "motions", "state_stride", "input_stride", "parameter_stride", "width", "intervals"
_INTERVALS = "row", "count", "length", "decides", "states", "inputs", "parameters"
_FEEDBACK = "decision", "given", "reference", "gains", "lower", "upper"
_EVERY = "correct_every", "save_every", "look_every", "rows", "begin", "total"
_RESULTS = "last", "saved", "measured", "corrected", "worst", "cost", "carry"
_SHARED = "status", "fault", "good", "next", "done", "stop"


def _fields(kind: Any, *names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names]


class RequestStruct(ctypes.Structure):
    """Struct with pointers into arrays that must outlive it."""

    _fields_ = [
        *_fields(ctypes.c_int64, *_NUMBERS),
        *_fields(ctypes.c_void_p, *_INTERVALS, *_FEEDBACK),
        *_fields(ctypes.c_int64, "referred"),
        *_fields(ctypes.c_void_p, "numbers"),
        *_fields(ctypes.c_int64, "counted", "trials"),
        *_fields(ctypes.c_double, "shortest"),
        *_fields(ctypes.c_int64, *_EVERY),
        *_fields(ctypes.c_double, "broken", "beyond", "largest"),
        *_fields(ctypes.c_void_p, *_RESULTS, *_SHARED),
    ]


def make_struct(values: Mapping[str, Any]) -> RequestStruct:
    """Build the struct from numbers and C-contiguous arrays.

    Missing values and None are 0.
    """
    return RequestStruct(
        **{
            name: value.ctypes.data if isinstance(value, np.ndarray) else value
            for name, value in values.items()
            if value is not None
        }
    )


class Intervals(NamedTuple):
    """Time intervals with constant input.

    Entries (K,): row of the inputs, number of steps, and length of a step [s].
    """

    row: Integers
    steps: Integers
    length: Array


class RunPiece(NamedTuple):
    """Part of a run.

    Its intervals select rows of the inputs (n or 1, K, ·).
    """

    intervals: Intervals
    inputs: Array


def gather_steps(held: Array, lengths: Array) -> RunPiece:
    """Merge steps of equal length and input into intervals.

    `held` (S, nw) are the inputs and `lengths` (S,) the lengths [s] of the steps.
    """
    changed = np.append(True, (held[1:] != held[:-1]).any(axis=1))
    begins = np.flatnonzero(changed | np.append(True, lengths[1:] != lengths[:-1]))
    row = np.cumsum(changed)[begins] - 1
    steps = np.diff(np.append(begins, len(lengths)))
    return RunPiece(Intervals(row, steps, lengths[begins]), held[changed][None])


class Rolled(NamedTuple):
    """Results of n runs.

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
    measured, worst, carry : ndarray, shapes (n, T, 6), (n, 8), (n, ·)
        Columns as in `MEASURED`, `WORST` and `CARRIED`.
    corrected : ndarray, shape (n, T, 2) or None
        Movement of a node [m] and energy [J] by the first correction after each saved row.
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

    @property
    def supplied(self) -> Array:
        """Energy supplied up to the end (n,) [J]."""
        work, jumps = (self.carry[:, CARRIED.index(name)] for name in ("work", "jumps"))
        return np.asarray(work + jumps)

    @property
    def memory(self) -> list[Memory]:
        """State of the step-size control of each run."""
        first = CARRIED.index(Memory._fields[0])
        return [Memory(*row[first : len(CARRIED)].tolist()) for row in self.carry]


def count_runs(joiner: str = ", ", /, **rows: int) -> int:
    """Count the runs that arrays with these rows describe.

    An array with one row is shared by all runs. Raises ValueError.
    """
    several = {name: count for name, count in rows.items() if count != 1}
    if len(set(several.values())) > 1:
        told = joiner.join(f"{name} has {count} rows" for name, count in several.items())
        raise ValueError(f"{told}: give as many of each, or one row that all motions share")
    return next(iter(several.values()), 1)

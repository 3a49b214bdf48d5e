"""Requests to an engine, and what comes back: arrays by name, in the order of the struct of `engine.hpp`."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tenscasadi.integrators.adaptive import Memory
from tenscasadi.util.validate import Array

Integers = NDArray[np.int64]

# the codes of `engine.hpp`; after those up to BROKEN a motion is lost, after others it ends early
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
CARRIED = ("energy", "bars", "work", "jumps", *Memory._fields)  # and the control, with parameters

_NUMBERS = "motions", "state_stride", "input_stride", "parameter_stride", "width", "intervals"
_INTERVALS = "row", "count", "length", "decides", "states", "inputs", "parameters"
_FEEDBACK = "decision", "given", "reference", "gains", "lower", "upper"
_EVERY = "correct_every", "save_every", "look_every", "rows", "begin", "total"
_RESULTS = "last", "saved", "measured", "corrected", "worst", "cost", "carry"
_SHARED = "status", "fault", "good", "next", "done", "stop"


def _fields(kind: Any, *names: str) -> list[tuple[str, Any]]:
    return [(name, kind) for name in names]


class Struct(ctypes.Structure):
    """The struct; it points into arrays, which have to outlive it."""

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


def make_struct(values: Mapping[str, Any]) -> Struct:
    """Return the struct of these numbers and C-contiguous arrays; what is missing or None is 0."""
    return Struct(
        **{
            name: value.ctypes.data if isinstance(value, np.ndarray) else value
            for name, value in values.items()
            if value is not None
        }
    )


class Intervals(NamedTuple):
    """Intervals of time, (K,) each: the row of the inputs that holds in it, its steps, and their length, s."""

    row: Integers
    steps: Integers
    length: Array


class Piece(NamedTuple):
    """Part of a run: intervals, and the inputs (n or 1, K, ·) that they name."""

    intervals: Intervals
    inputs: Array


class Rolled(NamedTuple):
    """Ends of n motions; one that is lost ends in NaN and costs inf.

    states (n, nx): their ends, or where they were stopped. saved (n, T, nx): the start, each
    `save_every`-th step and the end; None where nothing is saved. cost (n,). status (n,): 0, or the
    code of what went wrong; `fault`, `good` (n,): the step at which that was found, and the last one
    at which all was well. measured (n, T, 6), worst (n, 8), carry (n, ·): see `MEASURED`, `WORST`,
    `CARRIED`. corrected (n, T, 2): movement of a node, m, and energy added, J, by the first
    correction after each saved row. None: not measured.
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
        """Energy (n,) supplied up to the end, J."""
        work, jumps = (self.carry[:, CARRIED.index(name)] for name in ("work", "jumps"))
        return np.asarray(work + jumps)

    @property
    def memory(self) -> list[Memory]:
        """Memory of a scheme that controls its error, of each motion."""
        first = CARRIED.index(Memory._fields[0])
        return [Memory(*row[first : len(CARRIED)].tolist()) for row in self.carry]

"""Requests to the machine code of `motions.hpp`: numbers and arrays by name, in the order of its struct."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

# the codes of `motions.hpp`
FINISHED, NOT_FINITE, BEYOND, BROKEN, STOPPED = range(5)
MEASURED = ("bar_length_error", "joint_error", "kinetic", "elastic", "gravity", "supplied")
KINETIC, SUPPLIED = (
    MEASURED.index("kinetic"),
    MEASURED.index("supplied"),
)  # between them the energies
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

_NUMBERS, _ARRAY, _REAL = ctypes.c_int64, ctypes.c_void_p, ctypes.c_double
_FIELDS: dict[str, Any] = {
    **dict.fromkeys(
        ("motions", "state_stride", "input_stride", "parameter_stride", "width", "intervals"),
        _NUMBERS,
    ),
    **dict.fromkeys(
        ("row", "count", "length", "decides", "states", "inputs", "parameters"), _ARRAY
    ),
    **dict.fromkeys(("decision", "given", "reference", "gains", "lower", "upper"), _ARRAY),
    **dict.fromkeys(("referred", "correct_every", "save_every", "look_every", "rows"), _NUMBERS),
    **dict.fromkeys(("broken", "beyond", "largest"), _REAL),
    **dict.fromkeys(
        (
            "last",
            "saved",
            "measured",
            "worst",
            "cost",
            "status",
            "fault",
            "good",
            "next",
            "done",
            "stop",
        ),
        _ARRAY,
    ),
}


class Request(ctypes.Structure):
    """The struct; it points into arrays, which have to outlive it."""

    _fields_ = list(_FIELDS.items())


def make_request(values: Mapping[str, Any]) -> Request:
    """Return the struct of these numbers and C-contiguous arrays; what is missing or None is 0."""
    return Request(
        **{
            name: value.ctypes.data if isinstance(value, np.ndarray) else value
            for name, value in values.items()
            if value is not None
        }
    )

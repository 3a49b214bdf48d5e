"""Integration loop of `engine.hpp` as machine code.

One library is the loop of all models, another one the Functions of the model.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from tenscasadi.simulation.engine.request import make_struct
from tenscasadi.simulation.engine.step_code import (
    CALLS,
    MODEL_SIZES,
    KernelFunctions,
    room_sizes,
    write_engine,
    write_lanes,
    write_model,
)
from tenscasadi.util.compile import compile_library
from tenscasadi.util.validate import Array


class ModelStruct(ctypes.Structure):
    """Model of `engine.hpp`: sizes, and addresses of the Functions."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in MODEL_SIZES),
        *((name, ctypes.c_void_p) for name in CALLS),
    ]


class Native:
    """Backend in machine code.

    With one lane, a loop that all models share calls the library of the model, in single precision
    if `single`. With more lanes, loop and model are one library. Raises CompileError.
    """

    def __init__(self, program: KernelFunctions, lanes: int | None, single: bool = False) -> None:
        self._measures = program.sizes["measures"]
        self._model: ModelStruct | None = None
        if lanes == 1:
            self._code = compile_library("model", write_model(program, single), ".c")
            self._library = compile_library("engine", write_engine(program, single))
            calls = {name: _address(self._code, f"motion_{name}") for name in program.functions}
            self._model = ModelStruct(**program.sizes, **room_sizes(program), **calls)
        else:
            self._library = compile_library("motion", write_lanes(program, lanes))
        self.lanes = int(self._library.motion_lanes())
        self._at = None if self._model is None else ctypes.byref(self._model)

    def __call__(self, values: Mapping[str, Any]) -> None:
        """Fill the result arrays of a request.

        Raises MemoryError.
        """
        if self._library.motion_roll(self._at, ctypes.byref(make_struct(values))):
            raise MemoryError("there is no memory for the motions on their way")

    def observe(self, states: Array, inputs: Array) -> Array:
        """Compute the measures (T, M); it needs one lane.

        States are (T, nx), inputs (T, nw).
        """
        states, inputs = (np.ascontiguousarray(rows, dtype=float) for rows in (states, inputs))
        found = np.empty((len(states), self._measures))
        pointers = (ctypes.c_void_p(rows.ctypes.data) for rows in (states, inputs, found))
        if self._library.motion_observe(self._at, ctypes.c_int64(len(states)), *pointers):
            raise MemoryError("there is no memory to measure a motion")
        return found


def _address(library: ctypes.CDLL, name: str) -> int | None:
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value

"""Time loop `engine.hpp` as machine code.

For one run, a library is the loop of all models, another one the Functions of the model. With
several runs in lanes, both are one library.
"""

from __future__ import annotations

import ctypes
import struct
import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from tenscasadi.simulation.engine.step_code import (
    CALLS,
    MODEL_SIZES,
    KernelFunctions,
    room_sizes,
    write_engine,
    write_lane_model,
    write_lanes,
    write_model,
)
from tenscasadi.util.compile import CompileError, CompileTimeout, compile_library, find_compiler

# Fields of the struct of a request in `engine.hpp`, by kind: whole number, real number, pointer
_FIELDS = (
    ("q", "state_stride", "input_stride", "parameter_stride", "width", "intervals"),
    ("P", "row", "count", "length", "clock", "decides", "states", "inputs", "parameters"),
    ("P", "decision", "given", "reference", "gains", "lower", "upper"),
    ("q", "referred"),
    ("P", "numbers"),
    ("q", "counted", "trials"),
    ("d", "shortest"),
    ("q", "correct_every", "save_every", "look_every", "rows", "begin", "total"),
    ("d", "broken", "beyond", "largest"),
    ("P", "last", "saved", "measured", "corrected", "worst", "cost", "carry"),
    ("P", "status", "fault", "good", "stop"),
    ("q", "compare_every"),
    ("P", "compared", "companions"),
)
_NAMES = [name for _, *names in _FIELDS for name in names]
_STRUCT = struct.Struct("".join(kind * len(names) for kind, *names in _FIELDS))


def _pack_request(values: Mapping[str, Any]) -> bytes:
    """Pack the C struct with the arguments of the time loop.

    Values are numbers and C-contiguous arrays, which must outlive the struct. Missing values and
    None are 0. Unknown names are ignored.
    """
    given = [values.get(name) for name in _NAMES]
    return _STRUCT.pack(
        *(
            value.__array_interface__["data"][0] if isinstance(value, np.ndarray) else value or 0
            for value in given
        )
    )


class ModelStruct(ctypes.Structure):
    """C struct of a model: sizes, and addresses of its Functions."""

    _fields_ = [
        *((name, ctypes.c_int64) for name in MODEL_SIZES),
        *((name, ctypes.c_void_p) for name in CALLS),
    ]


COMPANION_LANES = 4  # a run, its companions in steps of 2 h and 4 h, and one to spare


class NativeCode:
    """Source code of the machine-code backend, before compilation.

    With `lanes` None, their number fills the registers of the processor. `single` selects single
    precision. With `companions`, lanes hold one run and its copies with longer steps, for the error
    estimate.
    """

    def __init__(
        self,
        program: KernelFunctions,
        lanes: int | None,
        single: bool = False,
        companions: bool = False,
    ) -> None:
        self._program, self.companions = program, companions
        if companions:
            model = "model", write_lane_model(program, COMPANION_LANES), ".cpp"
            engine = "engine", write_engine(program, lanes=COMPANION_LANES), ".cpp"
            self._sources = [model, engine]
        elif lanes == 1:
            model = "model", write_model(program, single), ".c"
            self._sources = [model, ("engine", write_engine(program, single), ".cpp")]
        else:
            self._sources = [("motion", write_lanes(program, lanes, single), ".cpp")]

    def load(self, build: bool = True) -> Native:
        """Compile and load the code.

        Without `build`, only a library in the cache is loaded. Raises CompileError.
        """
        libraries = [compile_library(*source, build=build) for source in self._sources]
        return Native(self._program, libraries, self.companions)


class Native:
    """Machine-code backend, loaded from the libraries of `NativeCode`."""

    chunk = 1

    def __init__(
        self, program: KernelFunctions, libraries: list[ctypes.CDLL], companions: bool = False
    ) -> None:
        self.companions = companions
        self._library = libraries[-1]
        self._model: ModelStruct | None = None
        if len(libraries) == 2:
            self._code = libraries[0]  # holds the addresses
            calls = {name: _address(self._code, f"motion_{name}") for name in program.functions}
            self._model = ModelStruct(**program.sizes, **room_sizes(program), **calls)
        self._at = None if self._model is None else ctypes.byref(self._model)
        self._library.motion_room.restype = ctypes.c_int64
        self.lanes = 1 if companions else int(self._library.motion_lanes())

    def __call__(self, values: Mapping[str, Any], first: int, last: int) -> None:
        """Compute the runs `first` to `last` − 1.

        Their result arrays are filled.
        """
        counted = ctypes.c_int64(values["counted"])
        room = np.zeros(self._library.motion_room(self._at, counted), dtype=np.uint8)
        span = ctypes.c_int64(first), ctypes.c_int64(last)
        memory = ctypes.c_void_p(room.ctypes.data)
        self._library.motion_roll(self._at, _pack_request(values), *span, memory)


def _address(library: ctypes.CDLL, name: str) -> int | None:
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value


class Compilation:
    """Compilation in a thread of its own, one at a time (`_running`).

    `found` contains the backend, or the reason if compilation failed.
    """

    _running: threading.Thread | None = None

    def __init__(self, compile_: Callable[[], tuple[Native | None, str]]) -> None:
        self.found: tuple[Native | None, str] = None, "the compiler was stopped"
        self._thread = threading.Thread(target=self._work, args=(compile_,), daemon=True)
        Compilation._running = self._thread
        self._thread.start()

    def _work(self, compile_: Callable[[], tuple[Native | None, str]]) -> None:
        self.found = compile_()

    @property
    def done(self) -> bool:
        """Whether the compiler has ended."""
        return not self._thread.is_alive()

    @classmethod
    def is_possible(cls) -> bool:
        """Return whether no compiler is running."""
        return cls._running is None or not cls._running.is_alive()


def compile_first(codes: list[NativeCode], build: bool = True) -> tuple[Native | None, str]:
    """Compile the first code that the compiler accepts.

    Unless `build`, code is only loaded from the cache. Returns the backend, None if all codes
    failed, and the reason if a code failed, else "".
    """
    note = ""
    for code in codes:
        try:
            return code.load(build), note
        except CompileError as error:
            if code.companions and code is not codes[-1]:
                continue  # the next code computes the same, without companions
            how = "not compiled in lanes" if code is not codes[-1] else "not compiled"
            note = f"{how}: {_reason(error)}"
    return None, note


def _reason(error: CompileError) -> str:
    """Extract the first error line from a compiler's output."""
    lines, found = str(error).splitlines(), find_compiler()
    for line in lines:
        if "error: " in line:
            return line.split("error: ")[1]
    ran = found is not None and not isinstance(error, CompileTimeout) and "failed with" in lines[0]
    return f"{found[0]} failed" if found and ran else lines[0]

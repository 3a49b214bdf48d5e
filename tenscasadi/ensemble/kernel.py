"""The kernel of rollouts: many motions of one model, arrays in, arrays out."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from tenscasadi.dynamics.model import Model
from tenscasadi.ensemble.lanes import write_source
from tenscasadi.ensemble.one_by_one import OneByOne
from tenscasadi.ensemble.program import Program, write_program
from tenscasadi.ensemble.request import MEASURED, STOPPED, WORST, make_request
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.simulation.diagnosis import BEYOND, BROKEN_BARS
from tenscasadi.util.compile import CompileError, compile_library
from tenscasadi.util.validate import LARGEST, Array

Integers = NDArray[np.int64]
_POLL = 0.05  # s between two looks at what other threads have done


class Intervals(NamedTuple):
    """Intervals of time, (K,) each: the row of the inputs that holds in it, its steps, and their length, s."""

    row: Integers
    steps: Integers
    length: Array


class KernelResult(NamedTuple):
    """Ends of n motions; one that failed ends in NaN and costs inf.

    states (n, nx): their ends. saved (n, T, nx): the start, each `save_every`-th step and the end;
    None where nothing is saved. cost (n,). status (n,): 0, or the code of what went wrong; `fault`,
    `good` (n,): the step at which that was found, and the last one at which all was well. measured
    (n, T, 6), worst (n, 8): see `request`; None where nothing is measured.
    """

    states: Array
    saved: Array | None
    cost: Array
    status: Integers
    fault: Integers
    good: Integers
    measured: Array | None
    worst: Array | None


class Kernel:
    """Steps of many motions of one model as machine code; `build_kernel` makes it.

    lanes: motions that each instruction moves; 0 without C++, `note` then says why, as it does
    where code that branches leaves one lane.
    """

    def __init__(self, program: Program, lanes: int | None) -> None:
        self._sizes, self._every, self.note = program.sizes, program.every, ""
        self._one_by_one: OneByOne | None = None
        self.lanes = 0
        for width in dict.fromkeys((lanes, 1)):
            try:
                self._library = compile_library("motion", write_source(program, width))
            except CompileError as error:
                self.note = f"{'not compiled' if width == 1 else 'not compiled in lanes'}: {_reason(str(error))}"
                continue
            self.lanes = int(self._library.motion_lanes())
            return
        self._one_by_one = OneByOne(program)

    def __call__(
        self,
        states: Array,
        inputs: Array,
        step: float,
        steps_per_interval: int,
        save_every: int | None = None,
        threads: int = 1,
    ) -> KernelResult:
        """Roll n motions through K equal intervals of `steps_per_interval` steps of `step` s.

        states (n or 1, nx); inputs (n or 1, K, nw), w = [u; p], constant in each interval. Ctrl-C
        waits for the end where there is one thread. Raises TypeError, ValueError.
        """
        count = inputs.shape[1] if np.ndim(inputs) == 3 else 0
        intervals = Intervals(
            np.arange(count), np.full(count, steps_per_interval), np.full(count, float(step))
        )
        result = self.run(states, inputs, intervals, save_every or 0, threads=threads)
        if threads > 1 and np.any(result.status == STOPPED):
            raise KeyboardInterrupt
        return result

    def run(
        self,
        states: Array,
        inputs: Array,
        intervals: Intervals,
        save_every: int = 0,
        *,
        look_every: int = 0,
        parameters: Array | None = None,
        feedback: Mapping[str, Any] | None = None,
        threads: int = 1,
        watch: Callable[[int], object] | None = None,
    ) -> KernelResult:
        """Roll n motions through `intervals`.

        look_every: steps from one measurement to the next, 0: only where a row is kept and at the
        end. parameters (n or 1, np): p, where the inputs hold u alone. feedback: controls that
        depend on the
        state, by name as `motions.hpp` reads them. watch: called with the steps done now and then;
        the work is then done in other threads, and after Ctrl-C motions that have not arrived have
        the status STOPPED.
        """
        sizes = self._sizes
        states = _rows("states", states, (None, sizes["NX"]))
        held = (
            np.empty((1, 0))
            if parameters is None
            else _rows("parameters", parameters, (None, sizes["NW"] - sizes["NU"]))
        )
        inputs = _rows("inputs", inputs, (None, None, sizes["NW"] - held.shape[1]))
        n = _common(states=len(states), inputs=len(inputs), parameters=len(held))
        steps = int(intervals.steps.sum())
        rows = 1 + -(-steps // save_every) if save_every else 0
        measured = sizes["M"] > 0
        status, fault, good = np.empty((3, n), dtype=np.int64)
        result = KernelResult(
            states=np.empty((n, sizes["NX"])),
            saved=np.empty((n, rows, sizes["NX"])) if save_every else None,
            cost=np.empty(n),
            status=status,
            fault=fault,
            good=good,
            measured=np.empty((n, rows, len(MEASURED))) if save_every and measured else None,
            worst=np.empty((n, len(WORST))) if measured else None,
        )
        values = {
            "motions": n,
            "state_stride": sizes["NX"] if len(states) > 1 else 0,
            "input_stride": inputs.shape[1] * inputs.shape[2] if len(inputs) > 1 else 0,
            "parameter_stride": held.shape[1] if len(held) > 1 else 0,
            "width": inputs.shape[2],
            "intervals": len(intervals.row),
            "row": np.ascontiguousarray(intervals.row, dtype=np.int64),
            "count": np.ascontiguousarray(intervals.steps, dtype=np.int64),
            "length": np.ascontiguousarray(intervals.length, dtype=float),
            "states": states,
            "inputs": inputs,
            "parameters": held,
            **(feedback or {}),
            **{
                "correct_every": self._every,
                "save_every": save_every,
                "look_every": look_every,
                "rows": rows,
            },
            **{"broken": BROKEN_BARS, "beyond": BEYOND, "largest": LARGEST},
            **{
                "last": result.states,
                "saved": result.saved,
                "measured": result.measured,
                "worst": result.worst,
                "cost": result.cost,
            },
            **{"status": result.status, "fault": result.fault, "good": result.good},
            **dict(zip(("next", "done", "stop"), np.zeros((3, 1), dtype=np.int64), strict=True)),
        }
        self._roll(values, threads, watch)
        return result

    def _roll(
        self, values: Mapping[str, Any], threads: int, watch: Callable[[int], object] | None
    ) -> None:
        if self._one_by_one is not None:
            work: Callable[[], Any] = lambda: self._one_by_one(values)  # type: ignore[misc]  # noqa: E731
            threads = 1
        else:
            request = make_request(values)
            work = lambda: failed.append(self._library.motion_roll(ctypes.byref(request)))  # noqa: E731
        failed: list[int] = []
        if threads == 1 and watch is None:
            work()
        else:
            _share(work, threads, values, watch)
        if any(failed):
            raise (
                MemoryError("there is no memory for the motions on their way")
                if 2 in failed
                else RuntimeError("CasADi could not evaluate a step")
            )


def _reason(told: str) -> str:
    """Return the line of a compiler's words that says what is wrong."""
    lines = told.splitlines()
    return next((line.split("error: ")[1] for line in lines if "error: " in line), lines[0])


def _share(
    work: Callable[[], Any],
    threads: int,
    values: Mapping[str, Any],
    watch: Callable[[int], object] | None,
) -> None:
    """Let `threads` threads do the work, and wait; Ctrl-C, or whatever else ends the wait, tells them to stop before memory goes that they use."""
    ended: list[bool] = []
    wake = threading.Event()

    def labour() -> None:
        try:
            work()
        finally:
            ended.append(True)
            wake.set()

    workers = [threading.Thread(target=labour, daemon=True) for _ in range(threads)]
    try:
        for worker in workers:
            worker.start()
        _wait(wake, lambda: len(ended) == threads, values, watch)
    except BaseException as error:
        values["stop"][0] = 1
        interrupted = isinstance(error, KeyboardInterrupt)
        _wait(
            wake,
            lambda: len(ended) == sum(worker.ident is not None for worker in workers),
            values,
            watch if interrupted else None,
        )
        if not interrupted:
            raise


def _wait(
    wake: threading.Event,
    over: Callable[[], bool],
    values: Mapping[str, Any],
    watch: Callable[[int], object] | None,
) -> None:
    """Wait for what sets `wake` until it is over. Threads are not joined: a join that Ctrl-C ends takes them for dead (CPython issue 89437)."""
    while not over():
        wake.wait(_POLL)
        wake.clear()
        if watch is not None:
            watch(int(values["done"][0]))
    if watch is not None:
        watch(int(values["done"][0]))


def _rows(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise ValueError(
            f"{field} has shape {array.shape}: give an array of shape {shape}".replace(
                "None", "any"
            )
        )
    return array


def _common(**rows: int) -> int:
    """Return the number of motions that these rows make, of which each is as many or one that all share. Raises ValueError."""
    several = {name: count for name, count in rows.items() if count != 1}
    if len(set(several.values())) > 1:
        told = " and ".join(f"{name} has {count} rows" for name, count in several.items())
        raise ValueError(f"{told}: give as many of each, or one row that all motions share")
    return next(iter(several.values()), 1)


def build_kernel(
    model: Model,
    scheme: Scheme,
    correction: Correction | None = None,
    stage: ca.Function | None = None,
    final: ca.Function | None = None,
    *,
    measured: bool = False,
    lanes: int | None = None,
) -> Kernel:
    """Compile the steps of a model for many motions at once.

    Parameters
    ----------
    model : Model
        The model of all motions.
    scheme : Scheme
        Scheme of fixed, explicit steps, such as `RungeKutta4`, `Rattle` or `DormandPrince853`.
    correction : Projection or BarLengthCorrection, optional
        Applied after every `correction.every`-th step.
    stage, final : casadi.Function, optional
        Costs (x, w) → (1), w = [u; p]: of each interval, at its end, times its length; and of the
        end. Their w may be longer, by what only costs depend on, such as the time; so are then the
        inputs.
    measured : bool
        Whether to measure errors of bars and joints, and energies.
    lanes : int, optional
        Motions in each instruction. Default: what the processor's registers hold.

    Returns
    -------
    Kernel
        Call it with states and inputs. Where there is no C++ compiler it goes one by one, to the
        same numbers.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the scheme chooses its own steps or iterates.
    """
    return Kernel(write_program(model, scheme, correction, stage, final, measured), lanes)

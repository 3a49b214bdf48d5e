"""Execution of runs in time slices, threads, and by different backends."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, NamedTuple, Protocol

import numpy as np

from tenscasadi.simulation.engine.native import Compilation, NativeCode, compile_first
from tenscasadi.simulation.engine.request import (
    CARRIED,
    FINISHED,
    STOPPED,
    WORST,
    Intervals,
    Rolled,
    count_runs,
)
from tenscasadi.simulation.engine.step_code import KernelFunctions
from tenscasadi.util.processes import on_interrupt
from tenscasadi.util.validate import LARGEST, Array

BROKEN_BARS = 0.1  # relative length error of a diverged run
SLICE = 0.05  # s between checks of progress, deadline and Ctrl-C
WORTH_COMPILING = 0.1  # s in CasADi's virtual machine after which the compiler is started


class Backend(Protocol):
    """Interface of objects that compute time steps.

    `lanes` is the number of runs per instruction, 0 without machine code. Time slices are multiples
    of `chunk` steps. `companions` is whether a run with longer steps can be computed at the same
    time, for the error estimate.
    """

    lanes: int
    chunk: int
    companions: bool

    def __call__(self, values: Mapping[str, Any], first: int, last: int) -> None:
        """Compute the runs `first` to `last` − 1.

        Their result arrays are filled.
        """


class Watch(NamedTuple):
    """Progress callback and deadline of runs.

    `seen` receives the number of completed steps. Runs stop when `time.monotonic` passes
    `deadline`.
    """

    seen: Callable[[int], object] = lambda _: None
    deadline: float = np.inf


NOBODY = Watch()


class SchemeNumbers(NamedTuple):
    """Options of a scheme that its compiled code receives as input.

    `values` are tolerances. `trials` is the largest number of trial steps in a time step, 0 without
    error control. Constraint corrections follow each `correct_every`-th step.
    """

    values: Array
    trials: int
    correct_every: int


class _KernelArrays(NamedTuple):
    """Input and result arrays (`values`) of n runs, with their time intervals.

    The names of arrays are those of `engine.hpp`.
    """

    values: dict[str, Any]
    intervals: Intervals
    n: int


class _Threads(NamedTuple):
    """Pool of threads, with their number `size`."""

    pool: ThreadPoolExecutor
    size: int


@contextlib.contextmanager
def _start_threads(count: int, always: bool = False) -> Iterator[_Threads | None]:
    """Start a pool of `count` threads if there are several, or `always`.

    Without a pool, it yields None.
    """
    if count == 1 and not always:
        yield None
        return
    with ThreadPoolExecutor(count) as pool:
        yield _Threads(pool, count)


class Kernel:
    """Compiled or interpreted time loop of a model.

    `build_kernel` builds it. `lanes` is the number of runs that one instruction advances, 0 for
    code that is not compiled. `note` gives the reason if code cannot be compiled, or has one lane
    only. With `codes`, the compiler starts once this saves wall time. Runs continue with the
    compiled code as soon as it is available.
    """

    def __init__(
        self,
        program: KernelFunctions,
        numbers: SchemeNumbers,
        backend: Backend,
        note: str = "",
        codes: list[NativeCode] | None = None,
    ) -> None:
        self._program, self._numbers = program, numbers
        self.backend, self.note, self._codes = backend, note, codes or []
        self._compilation: Compilation | None = None
        self._interpreted = 0.0  # s
        self._rates: dict[int, float] = {}  # steps of a run per second, by lanes

    @property
    def lanes(self) -> int:
        """Number of runs per instruction."""
        return self.backend.lanes

    @property
    def trials(self) -> int:
        """Limit of trial steps in a time step.

        A run that needs more fails. It is 0 for schemes with fixed steps.
        """
        return self._numbers.trials

    def __call__(
        self,
        states: Array,
        inputs: Array,
        step: float,
        steps_per_interval: int,
        save_every: int | None = None,
        threads: int = 1,
    ) -> Rolled:
        """Integrate n runs over K equal intervals.

        An interval has `steps_per_interval` steps of `step` s. The states are (n or 1, nx). The
        inputs w = [u; p] (n or 1, K, nw) are constant in each interval. Ctrl-C takes effect at the
        end. Raises TypeError, ValueError.
        """
        count = inputs.shape[1] if np.ndim(inputs) == 3 else 0
        intervals = Intervals(
            np.arange(count), np.full(count, steps_per_interval), np.full(count, float(step))
        )
        return self.run(states, inputs, intervals, save_every or 0, threads=threads)

    def run(
        self,
        states: Array,
        inputs: Array,
        intervals: Intervals,
        save_every: int = 0,
        *,
        look_every: int = 0,
        longest: float = 0.0,
        parameters: Array | None = None,
        feedback: Mapping[str, Any] | None = None,
        threads: int = 1,
        watch: Watch = NOBODY,
        compare_every: int = 0,
    ) -> Rolled:
        """Integrate n runs over time intervals.

        Parameters
        ----------
        states : ndarray, shape (n or 1, nx)
            Initial states.
        inputs : ndarray, shape (n or 1, ·, nw)
            Rows of inputs, selected by the intervals.
        intervals : Intervals
            Consecutive parts of the runs.
        save_every : int
            Steps between saved rows; 0 saves none.
        look_every : int
            Average number of steps between measurements; 0 measures only saved rows and the end.
        longest : float
            Longest step of a scheme with error control [s].
        parameters : ndarray, shape (n or 1, np), optional
            Parameters, if the inputs contain only the control.
        feedback : dict, optional
            State feedback, with the names of `engine.hpp`.
        threads : int
            Threads that share the runs.
        watch : Watch, optional
            Progress and deadline. After Ctrl-C or the deadline, unfinished runs have the status
            STOPPED.
        compare_every : int
            Steps between rows that compare a single run of steps h with runs of steps 2 h and 4 h, a
            multiple of 4, as are the steps of all intervals; 0: none. It needs a backend with
            `companions`.

        Returns
        -------
        Rolled
            Final states and saved rows.
        """
        sizes, numbers = self._program.sizes, self._numbers
        states = _rows("states", states, (None, sizes["nx"]))
        known = 0 if parameters is None else sizes["nw"] - sizes["nu"]
        p = (
            np.empty((1, 0))
            if parameters is None
            else _rows("parameters", parameters, (None, known))
        )
        inputs = _rows("inputs", inputs, (None, None, sizes["nw"] - known))
        n = count_runs(" and ", states=len(states), inputs=len(inputs), parameters=len(p))
        total = int(intervals.steps.sum())
        result = self._reserve(n, total, save_every, longest)
        values = {**self._values(result, states, inputs, p), **(feedback or {})}
        if compare_every and n == 1 and self.backend.companions:
            compared = np.full((1 + -(-total // compare_every), 3, sizes["nx"]), np.nan)
            result = result._replace(compared=compared)
            companions = np.empty((2, sizes["nx"] + sizes["work"]))
            values |= {
                "compare_every": compare_every,
                "compared": compared,
                "companions": companions,
            }
        scheme = numbers.values.copy()
        scheme[0] = longest if numbers.trials else scheme[0]
        values |= {"numbers": scheme, "counted": len(scheme), "save_every": save_every}
        values |= {"look_every": look_every, "total": total}
        work = _KernelArrays(values, intervals, n)
        short = self.lanes and n * total < self.rate * SLICE and time.monotonic() < watch.deadline
        if watch is NOBODY or (short and not numbers.trials):
            with _start_threads(threads) as pool:
                self.take(work, (0, n), (0, total), pool)
            watch.seen(n * total)
            return result
        values["deadline"] = watch.deadline
        # Steps with error control may take long: a separate thread computes them.
        with (
            _start_threads(threads, always=numbers.trials > 0) as pool,
            on_interrupt(lambda: _stop(values), then_raise=False),
        ):
            _March(self, work, pool, watch).go()
        return result

    def _reserve(self, n: int, steps: int, save_every: int, longest: float) -> Rolled:
        sizes = self._program.sizes
        rows = 1 + -(-steps // save_every) if save_every else 0
        status, fault, good = np.zeros((3, n), dtype=np.int64)
        measures = sizes["measures"]
        carry = np.zeros((n, len(CARRIED) + sizes["nw"]))
        carry[:, CARRIED.index("step")] = longest
        return Rolled(
            states=np.empty((n, sizes["nx"])),
            saved=np.empty((n, rows, sizes["nx"])) if save_every else None,
            cost=np.empty(n),
            status=status,
            fault=fault,
            good=good,
            measured=np.empty((n, rows, measures + 1)) if save_every and measures else None,
            worst=np.empty((n, len(WORST))) if measures else None,
            corrected=np.zeros((n, rows, 2)) if save_every and self._corrects else None,
            carry=carry,
        )

    @property
    def _corrects(self) -> bool:
        return "project" in self._program.functions

    def _values(self, result: Rolled, states: Array, inputs: Array, p: Array) -> dict[str, Any]:
        sizes = self._program.sizes
        return {
            "state_stride": sizes["nx"] if len(states) > 1 else 0,
            "input_stride": inputs.shape[1] * inputs.shape[2] if len(inputs) > 1 else 0,
            "parameter_stride": p.shape[1] if len(p) > 1 else 0,
            "width": inputs.shape[2],
            "states": states,
            "inputs": inputs,
            "parameters": p,
            "trials": self.trials,
            "shortest": 1e-13,  # × grid step: shorter trial steps make no progress
            "correct_every": self._numbers.correct_every if self._corrects else 0,
            "rows": 0 if result.saved is None else result.saved.shape[1],
            "broken": BROKEN_BARS,
            "beyond": 1e12,  # not physical in any unit
            "largest": LARGEST,
            "last": result.states,
            **{name: value for name, value in result._asdict().items() if name != "states"},
            "compare_every": 0,
            "stop": np.zeros(1, dtype=np.int64),
        }

    def take(
        self,
        work: _KernelArrays,
        runs: tuple[int, int],
        steps: tuple[int, int],
        threads: _Threads | None,
    ) -> None:
        """Advance a range of runs by a range of steps.

        `work` contains their arrays. Both ranges exclude their end. Without `threads`, one run
        follows the other.
        """
        began, backend, (first, last) = time.perf_counter(), self.backend, runs
        given = _select(work, steps)
        if threads is None:
            backend(given, first, last)
        else:
            size, several = max(backend.lanes, 1), threads.size if backend.lanes else 1
            share = -(-(last - first) // several)
            share = -(-share // size) * size or 1
            begins = range(first, last, share)
            _wait(
                [threads.pool.submit(backend, given, k, min(k + share, last)) for k in begins],
                work.values,
            )
        seconds, count = time.perf_counter() - began, (last - first) * (steps[1] - steps[0])
        if not work.values["status"][first:last].any():  # others may have ended at once
            self._rates[backend.lanes] = count / max(seconds, 1e-9)
        self._interpreted += 0.0 if backend.lanes else seconds

    # --- compilation once it pays ---

    def prepare(self, seconds: float) -> None:
        """Start the compiler, or switch to the compiled code.

        The compiler starts if the remaining wall time without machine code, `seconds`, justifies
        it.
        """
        if self._compilation is None:
            if self._codes and seconds > WORTH_COMPILING and Compilation.is_possible():
                codes = self._codes
                self._compilation = Compilation(lambda: compile_first(codes))
        elif self._compilation.done:
            native, self.note = self._compilation.found
            self.backend, self._codes, self._compilation = native or self.backend, [], None

    def expect(self, steps: int) -> float:
        """Estimate the total wall time without machine code [s].

        `steps` is the number of remaining steps.
        """
        rate = self._rates.get(0, np.inf)
        return self._interpreted + steps / rate

    @property
    def rate(self) -> float:
        """Speed of the backend as last measured [steps/s].

        It is a low estimate before the first measurement.
        """
        return self._rates.get(self.lanes, self.backend.chunk * max(self.lanes, 1) / SLICE)


class _March:
    """Execution of runs in blocks and time slices.

    Each slice takes about `SLICE` s of wall time.
    """

    def __init__(
        self, kernel: Kernel, work: _KernelArrays, threads: _Threads | None, watch: Watch
    ) -> None:
        self._kernel, self._work, self._threads, self._watch = kernel, work, threads, watch
        self._total, self._done = work.values["total"], 0

    def go(self) -> None:
        """Advance all runs, until they end or are stopped."""
        first, n = 0, self._work.n
        while first < n and not self._stopped:
            together = int(self._kernel.rate * SLICE / max(self._total, 1))
            least = max(self._kernel.lanes, 1) * (
                1 if self._threads is None else self._threads.size
            )
            last = min(first + max(together, least), n)
            self._advance(first, last)
            first = last
        if first < n:
            self._finish(first, n, 0)

    @property
    def _stopped(self) -> bool:
        if time.monotonic() > self._watch.deadline:
            _stop(self._work.values)
        return bool(self._work.values["stop"][0])

    def _advance(self, first: int, last: int) -> None:
        begin, status = 0, self._work.values["status"][first:last]
        while begin < self._total and not status.all():
            if self._stopped:
                self._finish(first, last, begin)
                return
            end = min(begin + self._choose_slice(last - first), self._total)
            self._kernel.take(self._work, (first, last), (begin, end), self._threads)
            self._done += (last - first) * (end - begin)
            self._watch.seen(self._done)
            begin = end

    def _choose_slice(self, runs: int) -> int:
        kernel, chunk = self._kernel, self._kernel.backend.chunk
        kernel.prepare(kernel.expect(self._work.n * self._total - self._done))
        return max(chunk, int(kernel.rate * SLICE / runs) // chunk * chunk)

    def _finish(self, first: int, last: int, step: int) -> None:
        """Save the states of stopped runs.

        They are the runs `first` to `last` − 1, and have taken `step` steps.
        """
        values = self._work.values
        alive = np.flatnonzero(values["status"][first:last] == FINISHED) + first
        own = self._work._replace(values={**values, "total": step})
        self._kernel.backend(_select(own, (step, step)), first, last)
        going = alive[values["status"][alive] == FINISHED]
        values["status"][going], values["fault"][going] = STOPPED, step
        if values["save_every"]:
            row = -(-step // values["save_every"]) + 1
            for rows in (values["saved"], values["measured"]):
                if rows is not None:
                    rows[alive, row:] = np.nan


def _select(work: _KernelArrays, steps: tuple[int, int]) -> dict[str, Any]:
    """Select the part of the arrays `work` for a range of steps.

    `steps` are its first step and its end.
    """
    values, whole = work.values, work.intervals
    part = whole if steps[1] - steps[0] == whole.steps.sum() else whole.slice(*steps)
    given = values | {
        "begin": steps[0],
        "intervals": len(part.row),
        "row": np.ascontiguousarray(part.row, dtype=np.int64),
        "count": np.ascontiguousarray(part.steps, dtype=np.int64),
        "length": np.ascontiguousarray(part.length, dtype=float),
        "clock": None if part.clock is None else np.ascontiguousarray(part.clock, dtype=float),
    }
    if steps[0]:  # the runs continue
        given |= {"states": values["last"], "state_stride": values["last"].shape[1]}
    if values.get("gains") is not None:
        given |= _select_feedback(values, whole, steps)
    return given


def _wait(work: list[Future[None]], values: Mapping[str, Any]) -> None:
    """Wait for threads, and stop them at the deadline.

    `work` are their results to come, and `values` the arrays that they use. After an exception they
    are stopped before their arrays are freed.
    """
    try:
        while wait(work, timeout=SLICE).not_done:
            if time.monotonic() > values.get("deadline", np.inf):
                _stop(values)
    except BaseException:
        _stop(values)
        raise
    for future in work:
        future.result()


def _stop(values: Mapping[str, Any]) -> None:
    values["stop"][0] = 1


def _select_feedback(
    values: Mapping[str, Any], intervals: Intervals, steps: tuple[int, int]
) -> dict[str, Any]:
    """Select the feedback updates of a range of steps.

    `values` are all arrays by name. A range that begins within an interval continues with the
    control of that interval.
    """
    ends = np.cumsum(intervals.steps)
    begins = ends - intervals.steps
    inside = (ends > steps[0]) & (begins < steps[1])
    decides = values["decides"][inside].copy()
    decides[:1] *= begins[inside][:1] >= steps[0]
    return {"decides": decides, "decision": values["decision"][inside]}


def _rows(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise ValueError(
            f"{field} has shape {array.shape}: give an array of shape {shape}".replace(
                "None", "any"
            )
        )
    return array

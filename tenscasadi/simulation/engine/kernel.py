"""Kernel of a run: backend, result arrays and threads."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import EmbeddedRungeKutta
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.simulation.engine.interpreted import Interpreted
from tenscasadi.simulation.engine.native import Native
from tenscasadi.simulation.engine.request import (
    CARRIED,
    FINISHED,
    MEASURED,
    STOPPED,
    WORST,
    Intervals,
    Rolled,
    RunPiece,
    count_runs,
)
from tenscasadi.simulation.engine.step_code import (
    Account,
    KernelFunctions,
    Measured,
    write_program,
)
from tenscasadi.simulation.engine.sundials_runs import SundialsRuns
from tenscasadi.util.compile import (
    Compiled,
    CompileError,
    CompileTimeout,
    Single,
    find_compiler,
)
from tenscasadi.util.validate import LARGEST, Array

BROKEN_BARS = 0.1  # relative length error of a diverged run
SHORTEST = 1e-13  # × grid spacing: shorter trial steps make no progress


class Backend(Protocol):
    """Interface of objects that take the steps."""

    lanes: int

    def __call__(self, values: Mapping[str, Any]) -> None:
        """Fill the result arrays of a request."""

    def observe(self, states: Array, inputs: Array) -> Array:
        """Compute the measures (T, M).

        States are (T, nx), inputs (T, nw).
        """


class Watch(NamedTuple):
    """Progress callback and deadline of a run.

    `seen` receives the number of completed steps. The run stops when `time.monotonic` passes
    `deadline`.
    """

    seen: Callable[[int], object]
    deadline: float = np.inf


class Kernel:
    """Integrator of one or many runs of a model.

    `build_kernel` makes it. `lanes` is the number of runs that one instruction advances, 0 for
    code that is not compiled. `note` gives the reason if it is not compiled or has one lane only.
    """

    def __init__(
        self,
        program: KernelFunctions,
        numbers: Array,
        trials: int,
        every: int,
        backend: Backend,
        note: str,
    ) -> None:
        self._program, self.backend, self.note = program, backend, note
        self._numbers, self.trials = numbers, trials
        self._every = every if "project" in program.functions else 0
        self.lanes = backend.lanes

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
        inputs w = [u; p] (n or 1, K, nw) are constant in each interval. With one thread, Ctrl-C
        takes effect at the end. Raises TypeError, ValueError.
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
        **options: Any,
    ) -> Rolled:
        """Integrate n runs over `intervals`; see `march` for the rest."""
        return self.march(
            states, [RunPiece(intervals, inputs)], int(intervals.steps.sum()), save_every, **options
        )

    def march(
        self,
        states: Array,
        pieces: Iterable[RunPiece],
        steps: int,
        save_every: int = 0,
        *,
        look_every: int = 0,
        longest: float = 0.0,
        parameters: Array | None = None,
        feedback: Mapping[str, Any] | None = None,
        threads: int = 1,
        watch: Watch | None = None,
    ) -> Rolled:
        """Integrate n runs over `steps` steps, piece by piece.

        Parameters
        ----------
        states : ndarray, shape (n or 1, nx)
            Initial states.
        pieces : iterable of RunPiece
            Consecutive parts of the run.
        steps : int
            Total number of steps.
        save_every : int
            Steps between saved rows; 0 saves none.
        look_every : int
            Steps between measurements; 0 measures only saved rows and the end.
        longest : float
            Longest step of a scheme with error control [s].
        parameters : ndarray, shape (n or 1, np), optional
            Parameters, if the inputs hold only the control.
        feedback : dict, optional
            State feedback, with the names of `engine.hpp`.
        threads : int
            Threads that share the runs.
        watch : Watch, optional
            Progress and deadline. Other threads then do the work. After Ctrl-C or the deadline,
            unfinished runs have the status STOPPED.

        Returns
        -------
        Rolled
            Final states and saved rows.
        """
        sizes = self._program.sizes
        states = _rows("states", states, (None, sizes["nx"]))
        known = 0 if parameters is None else sizes["nw"] - sizes["nu"]
        held = (
            np.empty((1, 0))
            if parameters is None
            else _rows("parameters", parameters, (None, known))
        )
        numbers = self._numbers.copy()
        numbers[0] = longest if self.trials else numbers[0]
        result: Rolled | None = None
        begin = 0
        try:
            for intervals, given in pieces:
                inputs = _rows("inputs", given, (None, None, sizes["nw"] - known))
                n = count_runs(
                    " and ", states=len(states), inputs=len(inputs), parameters=len(held)
                )
                if result is None:
                    result = self._reserve(n, steps, save_every, longest)
                at = states if begin == 0 else result.states.copy()
                values = self._values(result, at, held, intervals, inputs, numbers)
                values |= {"begin": begin, "total": steps, "save_every": save_every}
                values |= {"look_every": look_every, **(feedback or {})}
                self._roll(values, threads, watch)
                begin += int(intervals.steps.sum())
                if result.status.all():
                    break
        except KeyboardInterrupt:  # while pieces were generated
            if result is None or watch is None:
                raise
            going = result.status == FINISHED
            result.status[going], result.fault[going] = STOPPED, begin
        if result is None:
            raise ValueError("there is nothing to roll through: give one piece of a run or more")
        return result

    def observe(self, states: Array, inputs: Array) -> Array:
        """Compute the measures (T, M).

        States are (T, nx), inputs (T, nw).
        """
        return self.backend.observe(states, inputs)

    def _reserve(self, n: int, steps: int, save_every: int, longest: float) -> Rolled:
        sizes = self._program.sizes
        rows = 1 + -(-steps // save_every) if save_every else 0
        status, fault, good = np.zeros((3, n), dtype=np.int64)
        measured = sizes["measures"] > 0
        carry = np.zeros((n, len(CARRIED) + sizes["nw"]))
        carry[:, CARRIED.index("step")] = longest
        return Rolled(
            states=np.empty((n, sizes["nx"])),
            saved=np.empty((n, rows, sizes["nx"])) if save_every else None,
            cost=np.empty(n),
            status=status,
            fault=fault,
            good=good,
            measured=np.empty((n, rows, len(MEASURED))) if save_every and measured else None,
            worst=np.empty((n, len(WORST))) if measured else None,
            corrected=np.zeros((n, rows, 2)) if save_every and self._every else None,
            carry=carry,
        )

    def _values(
        self,
        result: Rolled,
        states: Array,
        held: Array,
        intervals: Intervals,
        inputs: Array,
        numbers: Array,
    ) -> dict[str, Any]:
        n, sizes = len(result.states), self._program.sizes
        return {
            "motions": n,
            "state_stride": sizes["nx"] if len(states) > 1 else 0,
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
            "numbers": numbers,
            "counted": len(numbers),
            "trials": self.trials,
            "shortest": SHORTEST,
            "correct_every": self._every,
            "rows": 0 if result.saved is None else result.saved.shape[1],
            "broken": BROKEN_BARS,
            "beyond": 1e12,  # not physical in any unit
            "largest": LARGEST,
            "last": result.states,
            **{name: value for name, value in result._asdict().items() if name != "states"},
            **dict(zip(("next", "done", "stop"), np.zeros((3, 1), dtype=np.int64), strict=True)),
        }

    def _roll(self, values: Mapping[str, Any], threads: int, watch: Watch | None) -> None:
        if threads == 1 and watch is None:
            self.backend(values)
        else:
            _share(lambda: self.backend(values), threads if self.lanes else 1, values, watch)


def _share(
    work: Callable[[], Any], threads: int, values: Mapping[str, Any], watch: Watch | None
) -> None:
    """Execute the work in `threads` threads and wait for them.

    Ctrl-C and other exceptions stop the threads before their arrays are freed.
    """
    ended: list[BaseException | None] = []
    wake = threading.Event()

    def labor() -> None:
        error = None
        try:
            work()
        except BaseException as raised:  # noqa: BLE001  the waiting thread raises it again
            error = raised
        ended.append(error)
        wake.set()

    workers = [threading.Thread(target=labor, daemon=True) for _ in range(threads)]
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
    for raised in ended:
        if raised is not None:
            raise raised


def _wait(
    wake: threading.Event,
    over: Callable[[], bool],
    values: Mapping[str, Any],
    watch: Watch | None,
) -> None:
    """Wait until `over` returns True; `wake` ends a pause early.

    Threads are not joined. A join that Ctrl-C interrupts marks them as finished (CPython issue
    89437).
    """
    done = False
    while not done:
        wake.wait(0.05)  # s between two progress reports
        wake.clear()
        done = over()
        if watch is not None:
            watch.seen(int(values["begin"] * values["motions"] + values["done"][0]))
            if time.monotonic() > watch.deadline:
                values["stop"][0] = 1


def _rows(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise ValueError(
            f"{field} has shape {array.shape}: give an array of shape {shape}".replace(
                "None", "any"
            )
        )
    return array


def build_kernel(
    model: Model,
    scheme: Scheme,
    correction: Correction | None = None,
    stage: ca.Function | None = None,
    final: ca.Function | None = None,
    *,
    measured: bool | Measured = False,
    account: Account | None = None,
    lanes: int | None = None,
    compiled: Compiled = None,
) -> Kernel:
    """Build the kernel of a model.

    The model caches it.

    Parameters
    ----------
    model : Model
        Model of all runs.
    scheme : Scheme
        Integration scheme.
    correction : Projection or BarLengthCorrection, optional
        Applied after every `correction.every`-th step.
    stage, final : casadi.Function, optional
        Stage cost, evaluated at the end of each interval and multiplied by its length, and
        terminal cost: Functions (x, w) → (1) with w = [u; p]. Their w, and then the inputs, may
        have further entries for the costs alone, such as the time.
    measured : bool or {"nothing", "errors", "all"}
        Measure errors of bars and joints, and energies; "all" adds force densities and tensions
        to `Kernel.observe`.
    account : Account, optional
        Energies to integrate. Default: all of them if something is measured.
    lanes : int, optional
        Runs per instruction. Default: as many as the registers hold; 1 for schemes whose steps
        differ between runs.
    compiled : bool or Single, optional
        True: machine code. False: CasADi. None: machine code if there is a compiler.

    Returns
    -------
    Kernel
        Integrator to call with states and inputs.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.
    CompileError
        `compiled` is True and compilation fails.
    """
    check_scheme(scheme)
    told: Measured = (
        ("errors" if measured else "nothing") if isinstance(measured, bool) else measured
    )
    if account is None:
        account = Account(told != "nothing", told != "nothing" and model.nu > 0)
    branches = scheme.adaptive or scheme.implicit or isinstance(compiled, Single)
    width = 1 if branches else lanes
    options = scheme, correction, stage, final, told, account, width, compiled
    if not isinstance(scheme, Hashable):  # user-defined scheme
        return _build(model, *options)
    return model.keep(("kernel", *options, find_compiler()), lambda: _build(model, *options))


def _build(
    model: Model,
    scheme: Any,
    correction: Correction | None,
    stage: ca.Function | None,
    final: ca.Function | None,
    measured: Measured,
    account: Account,
    lanes: int | None,
    compiled: Compiled,
) -> Kernel:
    every = 1 if correction is None else correction.every
    if isinstance(scheme, Sundials):
        if compiled:
            raise CompileError(
                f"{type(scheme).__name__} is an integrator of SUNDIALS, which makes no C code: give compiled=None or another scheme"
            )
        backend = SundialsRuns(model, scheme, correction, account, measured)
        return Kernel(backend.program, np.zeros(1), 0, every, backend, "")
    if scheme.adaptive and every != 1:
        raise ValueError(
            f"correction.every is {every}: {type(scheme).__name__} with rtol corrects after each of its own steps, give every=1"
        )
    single = isinstance(compiled, Single)
    if single:
        check_single(scheme)
    numbers, trials = np.zeros(1), 0
    if isinstance(scheme, EmbeddedRungeKutta) and scheme.adaptive:
        numbers, trials = np.array([0.0, *scheme.tolerances(model)]), scheme.max_attempts
    elif isinstance(scheme, Collocation):
        numbers, scheme = (
            np.full(1, scheme.tolerance),
            replace(scheme, tolerance=Collocation.tolerance),
        )
    program = write_program(model, scheme, correction, account, measured, (stage, final))
    note = ""
    for width in dict.fromkeys((lanes, 1)) if compiled is not False else ():
        try:
            native = Native(program, width, single)
        except CompileError as error:
            if compiled:
                raise
            note = f"{'not compiled' if width == 1 else 'not compiled in lanes'}: {_reason(error)}"
            continue
        return Kernel(program, numbers, trials, every, native, note)
    return Kernel(program, numbers, trials, every, Interpreted(program), note)


def check_single(scheme: Scheme) -> None:
    """Raise ValueError for tolerances below single precision."""
    least = 1e-6  # about ten times the rounding error of float, as 1e-15 of double
    for name in ("rtol", "tolerance"):
        asked = getattr(scheme, name, None)
        if asked is not None and asked < least:
            raise ValueError(
                f"{type(scheme).__name__}.{name} is {asked:g}: give {least:g} or more in single precision, less is rounding"
            )


def _reason(error: CompileError) -> str:
    """Extract the error line from a compiler's output."""
    lines, found = str(error).splitlines(), find_compiler()
    for line in lines:
        if "error: " in line:
            return line.split("error: ")[1]
    ran = found is not None and not isinstance(error, CompileTimeout) and "failed with" in lines[0]
    return f"{found[0]} failed" if found and ran else lines[0]

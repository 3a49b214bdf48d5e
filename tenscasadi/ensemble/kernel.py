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
from tenscasadi.ensemble.request import MEASURED, STOPPED, WORST, make_request
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta
from tenscasadi.integrators.scheme import Scheme, add_work, check_scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.tableaux import Tableau
from tenscasadi.util.compile import CompileError, compile_library
from tenscasadi.util.validate import Array

Integers = NDArray[np.int64]
_POLL = 0.05  # s between two looks at what other threads have done
_BROKEN_BARS = 0.1
_BEYOND = 1e12


class Intervals(NamedTuple):
    """Intervals of time, (K,) each: the row of the inputs that holds in it, its steps, and their length, s."""

    row: Integers
    steps: Integers
    length: Array


class KernelResult(NamedTuple):
    """What became of n motions; one that failed ends in NaN and costs inf.

    states (n, nx): their ends. saved (n, T, nx): the start, each `save_every`-th step and the end; None where nothing is saved.
    cost (n,). status (n,): 0, or the code of what went wrong; `fault`, `good` (n,): the step at which that was found, and the last one at
    which all was well. measured (n, T, 6), worst (n, 8): see `request`; None where nothing is measured.
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

    lanes: motions that each instruction moves; 0 without C++, `note` then says why.
    """

    def __init__(
        self, functions: Mapping[str, ca.Function], sizes: Mapping[str, int], tableau: Tableau | None, every: int, lanes: int | None
    ) -> None:
        self._sizes, self._every, self.note = sizes, every, ""
        self._one_by_one: OneByOne | None = None
        self.lanes = 0
        for width in dict.fromkeys((lanes, 1)):
            try:
                self._library = compile_library("motion", write_source(functions, sizes, tableau, width))
            except CompileError as error:
                self.note = f"not compiled: {str(error).splitlines()[0]}"
                continue
            self.lanes, self.note = int(self._library.motion_lanes()), ""
            return
        self._one_by_one = OneByOne(functions, sizes, tableau)

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

        states (n or 1, nx); inputs (n or 1, K, nw), w = [u; p], constant in each interval. Ctrl-C waits for the end where there is one thread.
        Raises TypeError, ValueError.
        """
        count = inputs.shape[1] if np.ndim(inputs) == 3 else 0
        intervals = Intervals(np.arange(count), np.full(count, steps_per_interval), np.full(count, float(step)))
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
        feedback: Mapping[str, Any] | None = None,
        threads: int = 1,
        watch: Callable[[int], object] | None = None,
    ) -> KernelResult:
        """Roll n motions through `intervals`.

        look_every: steps from one measurement to the next, 0: only where a row is kept and at the end. feedback: controls that depend on the
        state, by name as `motions.hpp` reads them. watch: called with the steps done now and then; the work is then done in other
        threads, and after Ctrl-C motions that have not arrived have the status STOPPED.
        """
        sizes = self._sizes
        states = _rows("states", states, (None, sizes["NX"]))
        inputs = _rows("inputs", inputs, (None, None, sizes["NW"]))
        n = _common(len(states), len(inputs))
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
            "input_stride": inputs.shape[1] * sizes["NW"] if len(inputs) > 1 else 0,
            "intervals": len(intervals.row),
            "row": np.ascontiguousarray(intervals.row, dtype=np.int64),
            "count": np.ascontiguousarray(intervals.steps, dtype=np.int64),
            "length": np.ascontiguousarray(intervals.length, dtype=float),
            "states": states,
            "inputs": inputs,
            **(feedback or {}),
            **{"correct_every": self._every, "save_every": save_every, "look_every": look_every, "rows": rows},
            **{"broken": _BROKEN_BARS, "beyond": _BEYOND},
            **{"last": result.states, "saved": result.saved, "measured": result.measured, "worst": result.worst, "cost": result.cost},
            **{"status": result.status, "fault": result.fault, "good": result.good},
            **dict(zip(("next", "done", "stop"), np.zeros((3, 1), dtype=np.int64), strict=True)),
        }
        self._roll(values, threads, watch)
        return result

    def _roll(self, values: Mapping[str, Any], threads: int, watch: Callable[[int], object] | None) -> None:
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
            raise MemoryError("there is no memory for the motions on their way") if 2 in failed else RuntimeError("CasADi could not evaluate a step")


def _share(work: Callable[[], Any], threads: int, values: Mapping[str, Any], watch: Callable[[int], object] | None) -> None:
    """Let `threads` threads do the work, and wait; Ctrl-C tells them to stop."""
    workers = [threading.Thread(target=work, daemon=True) for _ in range(threads)]
    try:
        for worker in workers:
            worker.start()
        for worker in workers:
            while worker.is_alive():
                worker.join(_POLL)
                if watch is not None:
                    watch(int(values["done"][0]))
    except KeyboardInterrupt:
        values["stop"][0] = 1
    finally:
        for worker in workers:
            if worker.ident is not None:
                worker.join()


def _rows(field: str, value: Any, shape: tuple[int | None, ...]) -> Array:
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or array.shape[-1] != shape[-1]:
        raise ValueError(f"{field} has shape {array.shape}: give an array of shape {shape}".replace("None", "any"))
    return array


def _common(states: int, inputs: int) -> int:
    if states != inputs and 1 not in (states, inputs):
        raise ValueError(f"states has {states} rows and inputs {inputs}: give as many of both, or one row that all share")
    return 0 if 0 in (states, inputs) else max(states, inputs)


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
        Costs (x, w) → (1), w = [u; p]: of each interval, at its end, times its length; and of the end.
    measured : bool
        Whether to measure errors of bars and joints, and energies.
    lanes : int, optional
        Motions in each instruction. Default: what the processor's registers hold.

    Returns
    -------
    Kernel
        Call it with states and inputs. Where there is no C++ compiler it goes one by one, to the same numbers.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or the scheme chooses its own steps or iterates.
    """
    check_scheme(scheme)
    if scheme.adaptive or scheme.implicit:
        raise ValueError(f"scheme is {scheme}: motions side by side take the same steps, give a scheme of fixed explicit ones such as RungeKutta4()")
    power = _stacked(model, model.power) if measured and model.power is not None else None
    jumps = measured and model.nu > 0
    tableau = _tableau(scheme)
    if tableau is None:
        step = _with_account("motion_step", scheme.advance(model, power), model.nx, jumps and power is None)
    else:
        ode = _stacked(model, model.ode)
        step = _with_account("motion_ode", ode if power is None else add_work(ode, power), model.nx, jumps and power is None)
    functions = {step.name(): step}
    nw = step.size1_in(1)
    project = None if correction is None else correction.step(model)
    for name, function in (("motion_project", project), ("motion_stage", stage), ("motion_final", final)):
        if function is not None:
            functions[name] = function
    if measured:
        functions["motion_measure"] = _measure(_stacked(model, model.observe))
        if jumps:
            functions["motion_energy"] = _stacked(model, model.energy_function)
    given = {name: function if function is step else _renamed(name, function) for name, function in functions.items()}
    sizes = {"NX": model.nx, "NW": nw, "NU": model.nu, "WORK": int(power is not None or jumps), "JUMPS": int(jumps), "M": 5 * measured}
    return Kernel(given, sizes, tableau, 0 if project is None or correction is None else correction.every, lanes)


def _stacked(model: Model, function: ca.Function) -> ca.Function:
    """Return a Function of the model as one of (x, w)."""
    return model.stacked(function) if hasattr(model, "stacked") else function


def _tableau(scheme: Scheme) -> Tableau | None:
    """Return the tableau of a scheme that steps as it says, None for others."""
    own = (
        isinstance(scheme, ExplicitRungeKutta) and type(scheme).advance is ExplicitRungeKutta.advance and type(scheme).step is ExplicitRungeKutta.step
    )
    return scheme.tableau if own and isinstance(scheme, ExplicitRungeKutta) else None


def _with_account(name: str, function: ca.Function, nx: int, account: bool) -> ca.Function:
    """Return a step (z, w, h) or an ode (z, w) under this name, where `account` asks for it with one entry more in z, which does not change."""
    if not account:
        return _renamed(name, function)
    z, *others = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    z = type(z).sym("z", nx + 1)
    return ca.Function(name, [z, *others], [ca.vertcat(function(z[:nx], *others), z[nx] if name == "motion_step" else 0)])


def _measure(observe: ca.Function) -> ca.Function:
    """Return (x, w) -> errors of bars and joints, and the three energies: what `observe` tells, without the rest."""
    kind: Any = ca.SX if observe.is_a("SXFunction") else ca.MX
    x, w = kind.sym("x", observe.size1_in(0)), kind.sym("w", observe.size1_in(1))
    found = dict(zip(observe.name_out(), observe.call([x, w]), strict=True))
    return ca.Function("measure", [x, w], [ca.vertcat(*(found[name] for name in ("bar_length_error", "joint_error", "energy")))])


def _renamed(name: str, function: ca.Function) -> ca.Function:
    """Return the Function under another name, without a call of the one in the other where that can be: it would copy what comes out."""
    scalar = function.is_a("SXFunction")
    inputs = function.sx_in() if scalar else function.mx_in()
    outputs = function.call(inputs, not scalar and function.is_a("MXFunction"), False)
    return ca.Function(name, inputs, outputs)

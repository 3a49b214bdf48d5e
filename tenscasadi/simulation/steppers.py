"""Steppers: they take a run from one time of its grid to the next, as machine code where there is a compiler."""

from __future__ import annotations

import re
import time
from collections.abc import Hashable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.adaptive import ATTEMPTS, Limits, Memory, build_attempts
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.events import build_switching
from tenscasadi.integrators.runge_kutta import EmbeddedRungeKutta
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.integrators.sundials_events import EventSteps
from tenscasadi.simulation.control_input import SampledControl
from tenscasadi.simulation.time_loop import chunk_function, chunk_steps
from tenscasadi.util.compile import (
    Compiled,
    CompileError,
    CompileTimeout,
    Single,
    compile_function,
    find_compiler,
)
from tenscasadi.util.validate import Array

_SINGLE = 1e-6  # some ten times the rounding of float, as 1e-15 is of double
_SUNDIALS_STEPS = (
    50  # grid steps a call, if corrections leave it: each call starts anew, at low order
)
# rtol above which a motion that takes no end of steps is more likely one that has broken down than
# one that is hard to follow
_LOOSE = 1e-5
_REST, _STEP = Memory._fields.index("rest"), Memory._fields.index("step")
_STUCK = 1e-13  # of the grid's spacing: a step as short as this makes no headway


class Report(NamedTuple):
    """Account of a run: in words, the mean length of a step, s, and how many steps were computed, in vain or not."""

    text: str
    step: float
    attempts: int


class StepFailure(RuntimeError):
    """Raised where a scheme cannot go on; the message says why and what to do."""


class OutOfTime(Exception):
    """Raised where the wall time of a run is over."""


class Stepper(Protocol):
    """Object that advances z (nz,), the state and one entry for the energy supplied where that is asked for, `steps` grid steps a call."""

    steps: int
    # by the clock `time.perf_counter`, s: a call that is made in pieces raises OutOfTime then
    deadline: float

    def hold(self, controls: Array, lengths: Array) -> None:
        """Set the lengths (steps,), s, of the grid steps of the next calls, and the controls (steps + 1, nu) of these and of the one after."""

    def __call__(self, z: Array, count: int) -> Array:
        """Return z after each of the next `count` ≤ `steps` grid steps (count or more, nz), valid until the next call. Raises StepFailure."""

    def report(self, taken: int, step: float) -> Report:
        """Tell what was done in `taken` grid steps of `step` s in the mean."""


class Built(NamedTuple):
    """A stepper, whether it is machine code, and why not."""

    stepper: Stepper
    compiled: bool
    note: str


class Task(NamedTuple):
    """Run to make: `power` and `jumps` ask for the energy supplied by forces outside `model.energy` and by changes of the control.

    chunk: steps of a call in machine code, a multiple of `correction.every`; None: what suits runs
    of any length.
    """

    model: Model
    scheme: Scheme
    correction: Correction | None
    power: bool
    jumps: bool
    chunk: int | None = None


def check_single(scheme: Scheme) -> None:
    """Raise ValueError where a scheme asks for more than single precision holds."""
    for name in ("rtol", "tolerance"):
        asked = getattr(scheme, name, None)
        if asked is not None and asked < _SINGLE:
            raise ValueError(
                f"{type(scheme).__name__}.{name} is {asked:g}: give {_SINGLE:g} or more in single precision, less is rounding"
            )


def make_stepper(task: Task, inputs: SampledControl, compiled: Compiled) -> Built:
    """Build the stepper of a task on the grid of `inputs`; `compiled` as for `simulate`. Raises CompileError, ValueError."""
    scheme, every = task.scheme, 1 if task.correction is None else task.correction.every
    if isinstance(scheme, Sundials):
        if compiled:
            raise CompileError(
                f"{type(scheme).__name__} is an integrator of SUNDIALS, which makes no C code: give compiled=None or another scheme"
            )
        return Built(SundialsStepper(task, scheme, inputs.longest), False, "")
    if scheme.adaptive and every != 1:
        raise ValueError(
            f"correction.every is {every}: {type(scheme).__name__} with rtol corrects after each of its own steps, give every=1"
        )
    function, is_code, note = _build_function(task, every, inputs.steps, compiled)
    if isinstance(scheme, EmbeddedRungeKutta) and scheme.adaptive:
        return Built(AdaptiveStepper(task, scheme, function, inputs.longest), is_code, note)
    return Built(LoopStepper(function, scheme), is_code, note)


def _build_function(
    task: Task, every: int, steps: int, compiled: Compiled
) -> tuple[ca.Function, bool, str]:
    """Build the Function that takes `steps` steps, some at a time; tell whether it is machine code, and why not."""
    chunk, single = task.chunk or chunk_steps(task.model, every), isinstance(compiled, Single)
    if single:
        check_single(task.scheme)
    note = ""
    if compiled is not False:
        try:
            function = _write_function(
                task, every if task.scheme.implicit else chunk
            )  # Newton's method takes longer than a call
            return (
                compile_function(function, single=single),
                True,
                "; in single precision" if single else "",
            )
        except CompileError as error:
            if compiled:
                raise
            found = find_compiler()
            refused = found and not isinstance(error, CompileTimeout)
            note = "; not compiled: " + (
                f"{found[0]} failed, compiled=True shows why" if found and refused else str(error)
            )
    longest = (
        1 if task.scheme.implicit else chunk // every
    )  # many iterations in the virtual machine would let Ctrl-C wait
    return (
        _write_function(task, every * min(longest, -(-steps // every))),
        False,
        note,
    )  # nothing is reused: no longer than the run


def _write_function(task: Task, steps: int) -> ca.Function:
    """Write the Function that takes `steps` steps, once for each model: further runs find it there."""
    if not isinstance(task.scheme, Hashable):  # a scheme of somebody's own
        return _new_function(task, steps)
    if isinstance(task.scheme, Collocation):  # tolerances are inputs
        task = task._replace(scheme=replace(task.scheme, tolerance=Collocation.tolerance))
    key = ("steps", *task[1:], steps)
    return task.model.keep(key, lambda: _new_function(task, steps))


def _new_function(task: Task, steps: int) -> ca.Function:
    if isinstance(task.scheme, EmbeddedRungeKutta) and task.scheme.adaptive:
        return build_attempts(task.model, task.scheme, task.correction, task.power)
    return chunk_function(*task[:5], steps)


class LoopStepper:
    """Calls of `chunk_function`'s Function on NumPy memory, without conversions."""

    deadline = np.inf

    def __init__(self, function: ca.Function, scheme: Scheme) -> None:
        self.steps = function.size2_in(1)
        self._z, self._h = np.zeros(function.size1_in(0)), np.zeros(self.steps)
        self._u = np.zeros((self.steps + 1, function.size1_in(2)))
        self._out = np.zeros((self.steps, len(self._z)))
        self._buffer: Any
        self._buffer, self._trigger = function.buffer()
        self._tolerance = np.full(
            self.steps, scheme.tolerance if isinstance(scheme, Collocation) else np.nan
        )
        inputs = {
            "z": self._z,
            "h": self._h,
            "u": self._u[:-1],
            "u_next": self._u[1:],
            "tolerance": self._tolerance,
        }
        for i, values in enumerate(inputs[name] for name in function.name_in()):
            if values.size:
                self._buffer.set_arg(i, values.reshape(-1).data)
        self._buffer.set_res(0, self._out.reshape(-1).data)

    def hold(self, controls: Array, lengths: Array) -> None:
        """See `Stepper.hold`."""
        self._u[:], self._h[:] = controls, lengths

    def __call__(self, z: Array, count: int) -> Array:
        """See `Stepper.__call__`."""
        self._z[:], self._h[count:] = z, 0.0  # blocks of steps without length are passed over
        self._trigger()
        if self._buffer.ret():
            raise StepFailure("CasADi could not evaluate a step: try a smaller step")
        return self._out

    def report(self, taken: int, step: float) -> Report:
        """See `Stepper.report`."""
        return Report(f"{taken} steps of {step:g} s", step, taken)


class AdaptiveStepper:
    """One grid step a call, by as many attempts of `build_attempts` as the scheme's error control asks for."""

    steps = 1
    deadline = np.inf

    def __init__(
        self, task: Task, scheme: EmbeddedRungeKutta, function: ca.Function, step: float
    ) -> None:
        self._scheme, self._step, self._calls = scheme, step, 0
        self._nx, self._nz = task.model.nx, function.size1_in(0)
        self._energy = task.model.stacked(task.model.energy_function) if task.jumps else None
        self._z, self._out = (
            np.zeros(self._nz),
            np.zeros((1, task.model.nx + (task.power or task.jumps))),
        )
        self._memory = np.zeros(len(Memory._fields))
        self._memory[_STEP] = step
        self._u, self._next_u = np.zeros(task.model.nw), np.zeros(task.model.nw)
        self._limits = np.array(Limits(step, *scheme.tolerances(task.model)))
        self._buffer: Any
        self._buffer, self._trigger = function.buffer()
        for i, values in enumerate((self._z, self._memory, self._u, self._limits)):
            if values.size:
                self._buffer.set_arg(i, values.data)
        self._after = np.zeros(self._nz), np.zeros(len(self._memory))
        for i, values in enumerate(self._after):
            self._buffer.set_res(i, values.data)

    def hold(self, controls: Array, lengths: Array) -> None:
        """See `Stepper.hold`."""
        self._u[:], self._next_u[:] = controls
        self._step = float(lengths[0])

    def __call__(self, z: Array, count: int) -> Array:
        """See `Stepper.__call__`; one step."""
        self._z[:] = z[: self._nz]
        self._memory[_REST] = self._step
        self._calls += 1
        for _ in range(0, self._scheme.max_attempts, ATTEMPTS):
            self._trigger()
            self._z[:], self._memory[:] = self._after
            if self._buffer.ret() or not np.all(np.isfinite(self._memory)):
                raise StepFailure(
                    "the state is not finite, whatever the step: give a start that can move"
                )
            if self._memory[_REST] <= 0:
                break
            if time.perf_counter() > self.deadline:
                raise OutOfTime
            if self._memory[_STEP] < _STUCK * self._step:
                raise StepFailure(
                    f"{type(self._scheme).__name__} needs steps shorter than {_STUCK * self._step:.2g} s: the motion breaks down here, "
                    f"or rtol={self._scheme.rtol:g} asks for more than rounding leaves"
                )
        else:
            raise StepFailure(
                f"{self._scheme.max_attempts} attempts did not reach the end of a grid step of {self._step:g} s, "
                f"the last of {self._memory[_STEP]:.2g} s: "
                f"try a larger {type(self._scheme).__name__}(rtol), a smaller step, an implicit scheme or a larger max_attempts"
            )
        supplied = z[self._nz :] if self._nz == self._nx else self._z[self._nx :]
        self._out[0, : self._nx], self._out[0, self._nx :] = self._z[: self._nx], supplied
        if self._energy is not None and np.any(self._u != self._next_u):
            x = self._z[: self._nx]
            self._out[0, self._nx] += float(self._energy(x, self._next_u)) - float(
                self._energy(x, self._u)
            )
        return self._out

    def report(self, taken: int, step: float) -> Report:
        """See `Stepper.report`."""
        m = Memory(*self._memory)
        mean = (self._calls * step - m.rest) / m.accepted if m.accepted else step
        text = f"{m.accepted:.0f} steps of {mean:.3g} s in the mean, {m.rejected:.0f} more rejected"
        text += f", {m.located:.0f} to locate {m.events:.0f} events" if m.events else ""
        return Report(text, mean, round(m.accepted + m.rejected + m.located))


class SundialsStepper:
    """`steps` grid steps a call of CasADi's integrator on a grid of output times.

    What is corrected is what it returns: a start from a corrected state would cost its order, so
    that only each call makes one.
    """

    deadline = np.inf

    def __init__(self, task: Task, scheme: Sundials, step: float) -> None:
        model, correction = task.model, task.correction
        if model.nx == 0:
            raise ValueError(
                f"{type(scheme).__name__} needs something that can move: this scene has no free node"
            )
        power = model.stacked(model.power) if task.power and model.power is not None else None
        self._every = 1 if correction is None else correction.every
        self.steps = self._every * max(1, _SUNDIALS_STEPS // self._every)
        self._model, self._scheme = model, scheme
        self._project = None if correction is None else correction.step(model)
        self._energy = model.stacked(model.energy_function) if task.jumps else None
        self._extra = (
            task.jumps and power is None
        )  # an entry for the energy supplied that the integrator does not know
        self._integrators: dict[
            int, ca.Function
        ] = {}  # by the steps of a call: none goes on past the end of the run
        self._equations = scheme.equations(model, power)
        self._start = scheme.algebraic_start(model)
        self._advance = scheme.advance(model, power)
        self._step = step
        gaps = build_switching(model) if scheme.locate_events else None
        self._events = (
            None
            if gaps is None
            else EventSteps(scheme, model, gaps, power is not None, self._pause)
        )

    def hold(self, controls: Array, lengths: Array) -> None:
        """See `Stepper.hold`."""
        self._controls, self._lengths = controls, lengths

    def __call__(self, z: Array, count: int) -> Array:
        """See `Stepper.__call__`."""
        nx, u, lengths = self._model.nx, self._controls[: count + 1], self._lengths[:count]
        start = z[: len(z) - self._extra]
        try:
            if (u[:count] == u[0]).all() and (lengths == self._step).all():
                rows = (
                    self._run(start, u[:count])
                    if self._events is None
                    else self._events(start, u[0], lengths)
                )
                self._correct(rows[self._every - 1 :: self._every])
            else:  # CVODES steps over a change of the control: each grid step starts anew
                parts = [start]
                for k, (control, length) in enumerate(zip(u[:count], lengths, strict=True), 1):
                    if self._events is None:
                        parts.append(
                            np.asarray(self._advance(parts[-1], control, length).full()).ravel()
                        )
                    else:
                        parts.append(self._events(parts[-1], control, lengths[k - 1 : k])[0])
                    if k % self._every == 0:
                        self._correct(parts[-1][None])
                rows = np.array(parts[1:])
        except RuntimeError as error:
            found = re.search(r'(\w+) returned "(\w+)"', str(error))
            words = (
                f"{found[1]} returned {found[2]}" if found else str(error).strip().splitlines()[-1]
            )
            rtol = self._scheme.rtol
            cure = (
                "a smaller rtol or step"
                if rtol > _LOOSE
                else "a larger rtol, a smaller step or a larger max_steps"
            )
            raise StepFailure(
                f"{type(self._scheme).__name__} gave up, {words}: rtol is {rtol:g}, try {cure}"
            ) from None
        if self._extra:
            rows = np.hstack([rows, np.full((count, 1), z[-1])])
        if self._energy is not None:
            changed = np.flatnonzero(np.any(u[1:] != u[:-1], axis=1))
            for k in changed.tolist():
                rows[k:, nx] += float(self._energy(rows[k, :nx], u[k + 1])) - float(
                    self._energy(rows[k, :nx], u[k])
                )
        return rows

    def _correct(self, rows: Array) -> None:
        """Correct states (k, nx or more) in place."""
        if self._project is not None:
            nx = self._model.nx
            p = self._controls[0, self._model.nu :]
            rows[:, :nx] = (
                self._project(rows[:, :nx].T, *([np.tile(p[:, None], len(rows))] if len(p) else []))
                .full()
                .T
            )

    def _run(self, start: Array, controls: Array) -> Array:
        steps = len(controls)
        if steps not in self._integrators:
            grid = (np.arange(1, steps + 1) * self._step).tolist()
            self._integrators[steps] = self._scheme.integrator(
                self._equations, grid, self._scheme.absolute(self._model)
            )
        guess = (
            {} if self._start is None else {"z0": self._start(start[: self._model.nx], controls[0])}
        )
        return np.array(self._integrators[steps](x0=start, u=controls.T, **guess)["xf"].full()).T

    def report(self, taken: int, step: float) -> Report:
        """See `Stepper.report`."""
        events = self._events.events if self._events else 0
        located = (
            f", {self._events.trials} trials to locate {events} events"
            if self._events and events
            else ""
        )
        return Report(
            f"{taken} times {step:g} s apart, by {type(self._scheme).__name__}{located}",
            step,
            taken,
        )

    def _pause(self) -> None:
        if time.perf_counter() > self.deadline:
            raise OutOfTime

"""Runners: what takes a run from one time of its grid to the next, as machine code where there is a compiler."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.adaptive import ATTEMPTS, Limits, Memory, attempts_function
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.scheme import EmbeddedRungeKutta, Scheme
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.integrators.sundials import GRID, Sundials, SundialsRunner
from tenscasadi.simulation.time_loop import LoopRunner, Report, StepFailure, chunk_function, chunk_steps, energy_function
from tenscasadi.util.compile import CompileError, compile_function, find_compiler
from tenscasadi.util.precision import Compiled, Single
from tenscasadi.util.validate import Array

_SINGLE = 1e-6  # some ten times the rounding of float, as 1e-15 is of double
_STUCK = 1e-13  # of the grid's spacing: a step as short as this makes no headway


class Runner(Protocol):
    """Advances z (nz,), the state and one entry for the energy supplied where that is asked for, `steps` grid steps a call."""

    steps: int

    def hold(self, controls: Array) -> None:
        """Sets the control of each grid step of the next calls and of the one after: (steps + 1, nu)."""

    def __call__(self, z: Array) -> Array:
        """z after each grid step (steps, nz), valid until the next call. Raises StepFailure."""

    def report(self, taken: int, step: float) -> Report:
        """What was done in `taken` grid steps of `step` s."""


class Built(NamedTuple):
    """A runner, whether it is machine code, and why not."""

    runner: Runner
    compiled: bool
    note: str


class Task(NamedTuple):
    """What to run: `power` and `jumps` ask for the energy supplied by forces outside `model.energy` and by changes of the control."""

    model: Model
    scheme: Scheme
    correction: Correction | None
    power: bool
    jumps: bool


def own_steps(scheme: Scheme) -> bool:
    """Whether a scheme takes steps of its own size between the times of the grid."""
    return isinstance(scheme, Sundials) or (isinstance(scheme, EmbeddedRungeKutta) and scheme.adaptive)


def check_single(scheme: Scheme) -> None:
    """ValueError where a scheme asks for more than single precision holds."""
    name = "rtol" if isinstance(scheme, EmbeddedRungeKutta) else "tolerance"
    asked = getattr(scheme, name, None)
    if asked is not None and asked < _SINGLE:
        raise ValueError(f"{type(scheme).__name__}.{name} is {asked:g}: give {_SINGLE:g} or more in single precision, less is rounding")


def make_runner(task: Task, step: float, steps: int, compiled: Compiled) -> Built:
    """The runner of a task on a grid of `steps` steps of `step` s; `compiled` as for `simulate`. Raises CompileError, ValueError."""
    model, scheme, correction = task.model, task.scheme, task.correction
    every = 1 if correction is None else correction.every
    if isinstance(scheme, Sundials):
        if compiled:
            raise CompileError(f"{type(scheme).__name__} is an integrator of SUNDIALS, which makes no C code: give compiled=None or another scheme")
        project = None if correction is None else correction.step(model)
        power = model.power if task.power else None
        calls = GRID if correction is None else every
        return Built(SundialsRunner(model, scheme, power, task.jumps, project, step, calls), False, "")
    if own_steps(scheme) and every != 1:
        raise ValueError(f"correction.every is {every}: {type(scheme).__name__} with rtol corrects after each of its own steps, give every=1")
    single = isinstance(compiled, Single)
    if single:
        check_single(scheme)
    note = ""
    if compiled is not False:
        try:
            chunk = every if isinstance(scheme, Collocation) else chunk_steps(model, every)  # Newton's method takes longer than a call
            function = compile_function(_function(task, chunk), single=single)
            return Built(_wrapped(task, function, step), True, "; in single precision" if single else "")
        except CompileError as error:
            if compiled:
                raise
            found = find_compiler()
            note = "; not compiled: " + (f"{found[0]} failed, compiled=True shows why" if found else str(error))
    short = every * min(chunk_steps(model, every) // every, -(-steps // every))  # nothing is reused: no longer than the run
    return Built(_wrapped(task, _function(task, short), step), False, note)


def _function(task: Task, steps: int) -> ca.Function:
    if isinstance(task.scheme, EmbeddedRungeKutta) and task.scheme.adaptive:
        return attempts_function(task.model, task.scheme, task.correction, task.power)
    return chunk_function(*task, steps)


def _wrapped(task: Task, function: ca.Function, step: float) -> Runner:
    if isinstance(task.scheme, EmbeddedRungeKutta) and task.scheme.adaptive:
        return AdaptiveRunner(task, function, task.scheme, step)
    return LoopRunner(function, step)


class AdaptiveRunner:
    """One grid step a call, by as many attempts of `attempts_function` as the scheme's error control asks for."""

    steps = 1

    def __init__(self, task: Task, function: ca.Function, scheme: EmbeddedRungeKutta, step: float) -> None:
        self._scheme, self._step, self._calls = scheme, step, 0
        self._nx, self._nz = task.model.nx, function.size1_in(0)
        self._energy = energy_function(task.model) if task.jumps else None
        self._z, self._out = np.zeros(self._nz), np.zeros((1, task.model.nx + (task.power or task.jumps)))
        self._memory = np.zeros(len(Memory._fields))
        self._memory[_STEP] = step
        self._u, self._next_u = np.zeros(task.model.nu), np.zeros(task.model.nu)
        self._limits = np.array(Limits(step, *scheme.tolerances(task.model)))
        self._buffer: Any
        self._buffer, self._trigger = function.buffer()
        for i, values in enumerate((self._z, self._memory, self._u, self._limits)):
            if values.size:
                self._buffer.set_arg(i, values.data)
        self._after = np.zeros(self._nz), np.zeros(len(self._memory))
        for i, values in enumerate(self._after):
            self._buffer.set_res(i, values.data)

    def hold(self, controls: Array) -> None:
        """Sets the control of the next grid step and of the one after: (2, nu)."""
        self._u[:], self._next_u[:] = controls

    def __call__(self, z: Array) -> Array:
        """z at the end of the grid step (1, nz). Raises StepFailure."""
        self._z[:] = z[: self._nz]
        self._memory[_REST] = self._step
        self._calls += 1
        for _ in range(0, self._scheme.max_attempts, ATTEMPTS):
            self._trigger()
            self._z[:], self._memory[:] = self._after
            if self._buffer.ret() or not np.all(np.isfinite(self._memory)):
                raise StepFailure("the state is not finite, whatever the step: give a start that can move")
            if self._memory[_REST] <= 0:
                break
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
            self._out[0, self._nx] += float(self._energy(x, self._next_u)) - float(self._energy(x, self._u))
        return self._out

    def report(self, taken: int, step: float) -> Report:
        """See `Runner.report`."""
        m = Memory(*self._memory)
        mean = (self._calls * self._step - m.rest) / m.accepted if m.accepted else step
        text = f"{m.accepted:.0f} steps of {mean:.3g} s in the mean, {m.rejected:.0f} more rejected"
        text += f", {m.located:.0f} to locate {m.events:.0f} events" if m.events else ""
        return Report(text, mean, round(m.accepted + m.rejected + m.located))


_REST, _STEP = Memory._fields.index("rest"), Memory._fields.index("step")

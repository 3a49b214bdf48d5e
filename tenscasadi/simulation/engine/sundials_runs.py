"""Runs of SUNDIALS' integrators, one after the other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_events, count_breakable
from tenscasadi.integrators.stabilization import Correction, build_correction
from tenscasadi.integrators.sundials import Sundials
from tenscasadi.integrators.sundials_events import EventSteps
from tenscasadi.simulation.engine.interpreted import Interpreted, Loop, StepRows, Values
from tenscasadi.simulation.engine.request import STOPPED, UNSOLVED
from tenscasadi.simulation.engine.step_code import (
    Account,
    KernelFunctions,
    Measured,
    write_observer,
)
from tenscasadi.util.validate import Array


class Stopped(Exception):
    """Raised to stop a run within a time step."""


class SundialsRuns(Interpreted):
    """Backend that calls an integrator of SUNDIALS.

    A call of the integrator takes up to 50 time steps, since each call restarts at low order.
    Constraint corrections change the saved states; the integrator continues from a corrected state
    only at its next call.
    """

    def __init__(
        self,
        model: Model,
        scheme: Sundials,
        correction: Correction | None,
        account: Account,
        measured: Measured,
    ) -> None:
        if model.nx == 0:
            raise ValueError(
                f"{type(scheme).__name__} needs something that can move: this scene has no free node"
            )
        self.program: KernelFunctions = write_observer(model, account, measured)
        super().__init__(self.program)
        power = (
            model.with_stacked_input(model.power)
            if account.power and model.power is not None
            else None
        )
        self._every = 1 if correction is None else correction.every
        self.chunk = self._every * max(1, 50 // self._every)
        self._scheme, self._nx = scheme, model.nx
        self._project = None if correction is None else build_correction(model, correction)
        self._integrators: dict[tuple[int, float], ca.Function] = {}  # by number and length
        self._equations, self._atol = scheme.equations(model, power), scheme.absolute(model)
        self._start, self._advance = scheme.algebraic_start(model), scheme.advance(model, power)
        if count_breakable(model) and not scheme.locate_events:
            raise ValueError(
                f"{type(scheme).__name__}.locate_events is False, and strings of the scene can break: "
                "give locate_events=True, or another scheme"
            )
        gaps = build_events(model) if scheme.locate_events else None
        self._events = (
            None
            if gaps is None
            else EventSteps(scheme, model, gaps, power is not None, self._pause)
        )
        self._stop: Mapping[str, Any] = {}
        self.failure = ""

    @property
    def located(self) -> tuple[int, int]:
        """Numbers of located events, and of integrations to locate them."""
        return (0, 0) if self._events is None else (self._events.events, self._events.trials)

    def __call__(self, values: Values, first: int, last: int) -> None:
        """Compute the runs `first` to `last` − 1.

        Their result arrays are filled.
        """
        self._stop, self.failure = values, ""
        if self._events is not None and not values["begin"]:
            self._events.events = self._events.trials = 0
        super().__call__(values, first, last)

    def _pause(self) -> None:
        if self._stop["stop"][0]:
            raise Stopped

    def take(self, loop: Loop, lengths: Array, w: Array) -> StepRows:
        """Advance the run by at least one of the next steps.

        All steps have the same `lengths` [s] and inputs `w`. `loop` contains the current state.
        """
        length, count = float(lengths[0]), min(len(lengths), self.chunk - loop.step % self.chunk)
        try:
            rows = self._take(loop.z[0], w[0, 0], length, count)
        except Stopped:
            return StepRows(loop.z[None], None, STOPPED)
        except RuntimeError as error:
            self.failure = str(error)
            return StepRows(loop.z[None], None, UNSOLVED)
        corrected = np.arange(loop.step + 1, loop.step + count + 1) % self._every == 0
        self._correct(rows, w[0, 0], corrected)
        return StepRows(rows[:, None])

    def _take(self, z: Array, w: Array, length: float, count: int) -> Array:
        """Compute z = (state, work) after each of the next steps (count, nz).

        They start at z, have equal `length` [s] and the input w (nw,).
        """
        if self._events is not None:
            return self._events(z, w, np.full(count, length))
        if count == 1:
            return np.asarray(self._advance(z, w, length).full()).T
        key = count, length
        if key not in self._integrators:
            grid = (np.arange(1, count + 1) * length).tolist()
            self._integrators[key] = self._scheme.integrator(self._equations, grid, self._atol)
        guess = {} if self._start is None else {"z0": self._start(z[: self._nx], w)}
        held = np.tile(w[:, None], count)
        return np.array(self._integrators[key](x0=z, u=held, **guess)["xf"].full()).T

    def _correct(self, rows: Array, w: Array, which: Any) -> None:
        """Project states onto the constraints, in place.

        The states are the first entries of `rows` (k, nz), with the input w (nw,). `which` (k,)
        marks those to project.
        """
        if self._project is not None and which.any():
            held = np.tile(w[:, None], int(which.sum()))
            states = self._project(rows[which, : self._nx].T, held).full().T
            rows[which, : self._nx] = states

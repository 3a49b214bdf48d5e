"""Checked inputs of runs: initial states, parameters, controls, steps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import contact_step, find_limit
from tenscasadi.scene.control_function import ControlFunction
from tenscasadi.scene.time_functions import values_at
from tenscasadi.simulation.engine.request import count_runs
from tenscasadi.simulation.inputs.controls import Controls, drive_model, read_controls
from tenscasadi.simulation.inputs.feedback import Feedback
from tenscasadi.simulation.inputs.grid import Grid, build_grid
from tenscasadi.util.validate import (
    Array,
    Indices,
    finite_array,
    format_value,
    nesting,
    positive_number,
    real_array,
)


class RunInputs(NamedTuple):
    """Checked inputs of n runs of a model.

    All runs share an array with one row.

    Attributes
    ----------
    model : Model
        Model of the runs. It includes the control if that is a function of time.
    base : Model
        The same model without the control. Interpolants replace functions of time that CasADi
        cannot trace.
    starts : ndarray, shape (n or 1, nx)
        Initial states.
    controls : ndarray, shape (n or 1, K, nu)
        Controls, selected by the rows of the grid.
    parameters : ndarray, shape (n or 1, np)
        Parameters.
    grid : Grid
        Time steps.
    first : float
        Initial time of the clock [s].
    feedback : Feedback, optional
        State feedback, which replaces the controls.
    """

    model: Model
    base: Model
    starts: Array
    controls: Array
    parameters: Array
    grid: Grid
    first: float
    feedback: Feedback | None = None

    @property
    def runs(self) -> int:
        """Number of runs."""
        rows = {"states": self.starts, "controls": self.controls, "parameters": self.parameters}
        return count_runs(**{name: len(values) for name, values in rows.items()})

    def select(self, runs: Indices) -> RunInputs:
        """Select runs by their numbers."""
        rows = (self.starts, self.controls, self.parameters)
        starts, controls, p = (part if len(part) == 1 else part[runs] for part in rows)
        return self._replace(starts=starts, controls=controls, parameters=p)

    def stack(self, k: int, steps: Indices) -> Array:
        """Stack control and parameters of run k at the start of steps.

        The result is (T, nw). A control that is a function of time is not included.
        """
        controls = self.controls[k if len(self.controls) > 1 else 0]
        p = self.parameters[k if len(self.parameters) > 1 else 0]
        held = controls[self.grid.rows[self.grid.locate(steps)]]
        return np.hstack([held, np.broadcast_to(p, (len(held), len(p)))])

    def sample_controls(self) -> Array:
        """Sample the controls (n or 1, K, nu) of the runs.

        With feedback, they are its reference controls.
        """
        if self.feedback is not None:
            return np.asarray(self.feedback.controls[None])
        if self.model.schedule is None:
            return self.controls
        return np.asarray(self.model.schedule.sample(self.first, self.first + self.grid.t_end))[
            None
        ]

    def add_schedule(self, w: Array, time: Array) -> Array:
        """Add a control that is a function of time to inputs w (T, nw).

        `time` (T,) is the time since the start [s].
        """
        schedule = self.model.schedule
        if schedule is None:
            return w
        total = w.copy()
        total[:, : self.model.nu] += values_at(schedule.at, self.first + time)
        return total

    def append_clock(self, time: Array, states: Array) -> Array:
        """Append the clock to states (T, ·) if the control depends on time.

        `time` (T,) [s] counts from the start.
        """
        if states.shape[1] == self.model.nx:
            return states
        return np.column_stack([states, self.first + time])

    def include_schedule(self, function: ca.Function) -> ca.Function:
        """Add the control function of time to a Function's input w.

        The Function has the arguments (x, w).
        """
        if self.model.schedule is None:
            return function
        x, w = ca.MX.sym("x", self.model.nx), ca.MX.sym("w", self.model.nw)
        time = self.model.split(x).clock
        value = function(x[: function.size1_in(0)], self.model.add_schedule(w, time))
        return ca.Function(function.name(), [x, w], [ca.densify(value)])


def read_inputs(
    model: Model,
    t_end: Any,
    step: Any,
    scheme: Scheme,
    states: Any,
    controls: Any,
    parameters: Any,
    many: bool,
) -> RunInputs:
    """Read the inputs of a batch, or of one run.

    `many` selects a batch. Arguments are those of `rollouts` or `simulate`, which messages name.
    Raises TypeError, ValueError.
    """
    end = positive_number("t_end", t_end)
    p = _read_parameters(model, parameters) if many else model.parameters.values(parameters)[None]
    starts = _read_starts(model, states, p, many)
    clocks = model.split(starts).clock
    clocks = clocks[np.isfinite(clocks)]
    first = float(clocks[0]) if clocks.size else 0.0
    given, model = model, model.interpolate_functions(first, first + end)
    if model is not given:
        starts = _read_starts(model, states, p, many)
    largest = (
        choose_step(model, scheme, starts[0], p[0], end)
        if step is None
        else positive_number("step", step)
    )
    driven = model
    if callable(controls) or isinstance(controls, ControlFunction):
        driven = drive_model(model, controls, first, end)
        found = Controls(np.zeros((1, 1, model.nu)), np.array([0.0, end]))
        if driven.has_clock and not model.has_clock:
            starts = np.column_stack([starts, np.full(len(starts), first)])
    else:
        field, shapes = ("controls", ("u", "nu", "nKu")) if many else ("control", ("u", "Ku"))
        found = read_controls(model, controls, p, end, field, shapes)
    grid = build_grid(found.edges, largest, driven.over_time, first, found.fewest)
    if driven.has_clock:
        _check_clock("states" if many else "state", abs(first) + end, grid.step)
    if model.scene.supports is not None and model.scene.structure.bodies:
        model.scene.supports.check_bodies(model.scene.structure, first, first + end)
    grid, values = found.hold(grid)
    inputs = RunInputs(driven, model, starts, values, p, grid, first, found.feedback)
    inputs.runs  # noqa: B018  raises if the rows do not match
    return inputs


def choose_step(model: Model, scheme: Scheme, state: Array, p: Array, t_end: float) -> float:
    """Choose the default step [s] from the initial state (nx,).

    It is a hundredth of the run for schemes with error control. Otherwise it is 1 ms, or less if
    stability or ground contact requires a smaller step. `p` (np,) are the parameters, and `t_end`
    is the end of the run [s].
    """
    if scheme.adaptive:
        return t_end / 100
    stable = np.inf if scheme.implicit else find_limit(model, scheme, state, parameters=p)
    return float(np.nanmin([1e-3, contact_step(model, p), 0.9 * stable]))


def _read_starts(model: Model, states: Any, p: Array, many: bool) -> Array:
    """Read the initial states (n or 1, nx).

    They are those of a batch (`many`), or of one run. None selects the model's initial state with
    the parameters `p` (n or 1, np). A state of a batch that is not finite makes only its own run
    fail.
    """
    if not many:
        if states is None:
            return np.array(model.start_at(p[0]))[None]
        return np.array(finite_array("state", states, (model.nx,)))[None]
    wanted = f"states of shape (n, {model.nx}) or ({model.nx},)"
    given = (
        _stack_rows([model.start_at(row) for row in p], model.nx)
        if states is None
        else real_array("states", states, wanted)
    )
    if given.ndim not in (1, 2) or given.shape[-1] != model.nx:
        raise ValueError(f"states has shape {given.shape}: give {wanted}")
    starts = np.atleast_2d(given)
    clocks = model.split(starts).clock
    if clocks.size and len(np.unique(clocks[np.isfinite(clocks)])) > 1:
        raise ValueError(
            f"states[:, {model.nx - 1}] are clocks from {np.nanmin(clocks):g} to {np.nanmax(clocks):g} s: start all motions at one time"
        )
    return starts


def _stack_rows(rows: list[Array], size: int) -> Array:
    """Stack arrays as rows (k, size); one row if all are the same object."""
    kept = rows[:1] if all(row is rows[0] for row in rows) else rows
    return np.array(kept).reshape(len(kept), size)


def _read_parameters(model: Model, given: Any) -> Array:
    """Read the parameters (n or 1, np) of a batch.

    `given` is an array, or a mapping from names to values.
    """
    layout = model.parameters
    if isinstance(given, Mapping):
        tables = {name: value for name, value in given.items() if nesting(value) >= 2}
        shared = layout.values(
            {name: value for name, value in given.items() if name not in tables}
            | dict.fromkeys(tables.keys() - layout.places, 0)
        )
        checked = {}
        for name, value in tables.items():
            place = layout.places[name]
            shape = (None, place.stop - place.start)
            checked[name] = finite_array(f"parameters[{format_value(name)}]", value, shape)
        counts = {f"parameters[{name!r}]": len(value) for name, value in checked.items()}
        rows = np.tile(shared, (count_runs(**counts), 1))
        for name, value in checked.items():
            rows[:, layout.places[name]] = value
    elif nesting(given) < 2:
        return layout.values(given)[None]
    else:
        rows = finite_array("parameters", given, (None, len(layout)))
    layout.check(rows)
    return rows


def _check_clock(field: str, latest: float, step: float) -> None:
    """Check that the clock resolves the steps.

    `latest` is the largest magnitude of its time, and `step` the step [s]. Messages name `field`.
    Raises ValueError if rounding errors dominate.
    """
    if np.spacing(latest) > 1e-6 * step:
        raise ValueError(
            f"{field}: the clock runs to {latest:g} s, where steps of {step:g} s are lost in rounding: start it nearer to 0"
        )

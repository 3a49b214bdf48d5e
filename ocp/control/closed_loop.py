"""Simulation of a model under a controller."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np
from tqdm import tqdm

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.breaks import split_at_breaks
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strength import count_states
from tenscasadi.simulation.string_breaks import describe_failures
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.simulation.verdict.starts import off_constraints
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import (
    LARGEST,
    MAX_ENTRIES,
    Array,
    call_user_function,
    finite_array,
    flag,
    format_value,
    instance,
    positive_number,
    whole_number,
)


@runtime_checkable
class Controller(Protocol):
    """Feedback controller: control of the strings from time and state."""

    @property
    def period(self) -> float:
        """Sampling period [s]."""

    @property
    def model(self) -> Model:
        """Model of the controller."""

    def control(self, time: float, state: Array) -> Array:
        """Compute the control (nu,) for the next sampling period.

        It begins at `time` [s] in the state `state` (nx,).
        """


@dataclass(frozen=True, eq=False)
class ClosedLoop(ReadOnlyArrays):
    """Result of `run`: simulated trajectory and computation times.

    Attributes
    ----------
    trajectory : Trajectory
        States at all time steps.
    seconds : ndarray, shape (D,)
        Wall time to compute the control of each sampling period [s].
    failed : ndarray of bool, shape (D,)
        Whether the controller reported a failure, such as `Mpc.failed`.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> controller = ocp.Mpc(ocp.Problem(cross, goals=goals), period=0.1, intervals=5)
    >>> loop = ocp.run(controller, 0.5)
    >>> loop.seconds.shape, loop.trajectory.success
    ((5,), True)
    """

    trajectory: Trajectory
    seconds: Array
    failed: Array

    def __repr__(self) -> str:
        slowest = f"{self.seconds.max(initial=0.0):.2g} s"
        return (
            f"ClosedLoop({len(self.seconds)} decisions of at most {slowest}, "
            f"t = {self.trajectory.time[-1]:g} s, success={self.trajectory.success})"
        )


def run(
    controller: Controller,
    t_end: float,
    model: Model | None = None,
    state: Any = None,
    steps: int = 10,
    disturbance: Callable[[float, Array], Array] | None = None,
    parameters: Any = None,
    progress: bool = False,
) -> ClosedLoop:
    """Simulate a model under a controller.

    Parameters
    ----------
    controller : Mpc, Tracker or Controller
        Controller, with a `model`, a `period` [s] and `control(time, state)`, which returns the
        control (nu,), such as force densities [N/m].
    t_end : float
        End of the run [s]. The last decision may be shorter than the period.
    model : Model, optional
        Plant. It may differ from the controller's model in masses, gravity and loads such as gusts
        (`tenscasadi.NodalForce` of time), but not in nodes, strings and kind of control. Its strings
        can break or yield (`tenscasadi.Breaking`). Default: the controller's model.
    state : array_like, shape (nx,), optional
        Initial state, which satisfies bars and joints. If it has a clock, this is the time that
        the controller receives; it need not begin at 0. Default: the model's initial state.
    steps : int
        Number of steps of `RungeKutta4` in each period.
    disturbance : callable, optional
        Function (time, state) → state before each decision, such as a push. The result is
        projected onto bars and joints.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the plant's parameters, see `tenscasadi.ParameterLayout.values`. Default: the
        nominal ones.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    ClosedLoop
        Motion. If it diverges, or after Ctrl-C, it ends there, and its trajectory has `success`
        False.

    Raises
    ------
    TypeError, ValueError
        If an argument or a decision has another type or is out of bounds. Also if a function of
        time of the plant is not finite, raises an error, or is not deterministic.

    Examples
    --------
    A planar cross moves to another shape and stays there:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> controller = ocp.Mpc(ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()]), period=0.1, intervals=5)
    >>> reached = cross.structure.replace(nodes=ocp.run(controller, 2.0).trajectory.nodes[-1])
    >>> bool(abs(reached.string_lengths - lengths).max() < 0.01)
    True
    """
    period = _check_controller(controller)
    plant = controller.model if model is None else model
    if model is None and parameters is not None and not plant.np:
        raise ValueError(
            "parameters are given, and the controller's model has none: give the plant, a model of Scene(..., parameters=...)"
        )
    _check_plant(plant, controller.model)
    plant = plant.with_parameters(parameters)
    n = whole_number("steps", steps, 1, MAX_ENTRIES)
    flag("progress", progress)
    if disturbance is not None and not callable(disturbance):
        raise TypeError(
            f"disturbance is {format_value(disturbance)}: give a function (time, x) -> x, or None"
        )
    ends = _find_decision_times(t_end, period)
    x = _find_start(plant, state)
    traced = _trace_functions(plant, x, float(ends[-1]))
    periods = _run_periods(controller, traced, x, ends, n, disturbance)
    states, controls, seconds, failed, interrupted = [x[None]], [], [], [], False
    try:
        for part, u, waited in tqdm(
            periods, total=len(ends) - 1, unit=" decisions", disable=not progress
        ):
            seconds.append(waited)
            failed.append(bool(getattr(controller, "failed", False)))
            if part is not None:
                states.append(part)
                controls.append(np.repeat(u[None], n, axis=0))
    except KeyboardInterrupt:
        interrupted = True
    trajectory = _record(traced, plant.scene, states, controls, ends, n, sum(seconds), interrupted)
    if count := sum(failed):
        note = f"the controller found no solution in {count} of {len(failed)} decisions"
        trajectory = replace(trajectory, message=f"{trajectory.message}; {note}")
    return ClosedLoop(trajectory, np.array(seconds), np.array(failed, dtype=bool))


def _trace_functions(plant: Model, x: Array, duration: float) -> Model:
    """Check the functions of time of the simulated model.

    `plant` is this model with the initial state `x` (nx,), and `duration` is in seconds. In the
    result, interpolants replace functions that CasADi cannot trace.
    """
    if not plant.has_clock:
        return plant
    first = float(plant.split(x).clock[0])
    traced = plant.interpolate_functions(first, first + duration)
    for part in traced.over_time:
        part.check_run(first, first + duration)
    return traced


def _check_controller(controller: Any) -> float:
    """Check a controller and return its sampling period [s]."""
    if (
        isinstance(controller, type)
        or not isinstance(controller, Controller)
        or not callable(controller.control)
    ):
        raise TypeError(
            f"controller is {format_value(controller)}: give an ocp.Mpc(...), ocp.track(plan), or an object with model, period, control(time, state)"
        )
    instance("controller.model", controller.model, Model, "a tenscasadi.Model")
    return positive_number("controller.period", controller.period)


def _find_decision_times(t_end: float, period: float) -> Array:
    """Compute the start times of the sampling periods, and the end [s].

    The closed loop lasts `t_end` s; `period` is the sampling period [s].
    """
    ratio = positive_number("t_end", t_end) / period
    if ratio > MAX_ENTRIES:
        raise ValueError(
            f"t_end is {t_end:g}: that takes {ratio:.1g} decisions of {period:g} s, give at most {MAX_ENTRIES:g}"
        )
    return np.append(period * np.arange(max(1, np.ceil(ratio - 1e-9))), t_end)


def _record(
    plant: Model,
    scene: Scene,
    states: list[Array],
    controls: list[Array],
    ends: Array,
    n: int,
    seconds: float,
    interrupted: bool,
) -> Trajectory:
    """Build the trajectory of the simulated sampling periods.

    `plant` is the simulated model, `scene` that of the user. States and controls have an entry for
    each period. Each period has `n` time steps; `ends` are the limits of the periods [s]. `seconds`
    is the wall time of the run [s], and `interrupted` tells whether Ctrl-C ended it.
    """
    rows = np.concatenate(states)
    done = len(controls) == len(ends) - 1
    held = np.concatenate([*controls, controls[-1][-1:]]) if controls else np.zeros((1, plant.nu))
    times = np.interp(np.arange(len(rows)) / n, np.arange(len(ends)), ends)
    cause = "interrupted" if interrupted else "diverged"
    reason = "the trajectory ends there" if interrupted else "the state is not finite"
    message = (
        f"finished {len(controls)} decisions"
        if done
        else f"{cause} after t = {times[-1]:g} s: {reason}"
    )
    message += describe_failures(plant.scene, times, rows)
    return record_trajectory(
        plant,
        times,
        rows,
        held,
        step=float(ends[1] - ends[0]) / n,
        message=message,
        success=done,
        scene=scene,
        seconds=seconds,
        interrupted=interrupted,
    )


def _run_periods(
    controller: Controller,
    plant: Model,
    x: Array,
    ends: Array,
    steps: int,
    disturbance: Callable[[float, Array], Array] | None,
) -> Iterator[tuple[Array | None, Array, float]]:
    """Simulate the sampling periods one after the other.

    For each, yields the states (steps, nx), or None after a divergence; the control (nu,); and the
    wall time of the controller [s]. `plant` is the simulated model, `x` its initial state. `ends`
    are the limits of the periods [s], each of which has `steps` time steps. `disturbance` changes
    the state at the start of each period.
    """
    chain = split_at_breaks(RungeKutta4().step(plant.ode), plant).mapaccum(steps)
    project = build_projection(plant, 2)
    for now, after in pairwise(ends):
        if disturbance is not None:
            pushed = call_user_function(
                "disturbance",
                lambda seen: disturbance(*seen),
                (now, x.copy()),
                "give a function (time, x) -> x",
            )
            x = finite_array("disturbance(time, x)", pushed, (plant.nx,))
            x = project(x).full().ravel()
        seen = _observe(controller.model, plant, x, now)
        began = clock.perf_counter()
        decided = controller.control(now, seen)
        waited = clock.perf_counter() - began
        u = finite_array(f"controller.control({now:g}, state)", decided, (plant.nu,))
        held = ca.repmat(ca.DM(u), 1, steps)
        part = chain(x, held, (after - now) / steps).full().T
        if not np.all(np.abs(part) <= LARGEST):
            yield None, u, waited
            return
        x = project(part[-1]).full().ravel()
        part[-1] = x
        yield part, u, waited


def _check_plant(plant: Any, believed: Model) -> None:
    """Raise ValueError if simulated and controller model do not match.

    `plant` is the simulated model, `believed` that of the controller.
    """
    instance("model", plant, Model, "a tenscasadi.Model or None")
    own_control, known = plant.scene.control, believed.scene.control
    if own_control is None or type(own_control) is not type(known):
        raise ValueError(
            f"model has the control {own_control}: give a model of Scene(..., control={known})"
        )
    own, other = plant.structure, believed.structure
    same = (
        np.array_equal(own.strings, other.strings)
        and np.array_equal(own.fixed, other.fixed)
        and own.rollers == other.rollers
    )
    sizes = [(one.nu, one.nq, one.na - count_states(one.scene)) for one in (plant, believed)]
    if not same or sizes[0] != sizes[1]:
        raise ValueError(
            "model has other nodes, pins or strings than the controller's: give one with the same"
        )


def _find_start(plant: Model, state: Any) -> Array:
    """Check the initial state and project it onto the constraints.

    None is the initial state of the simulated model `plant`.
    """
    x = plant.initial_state if state is None else finite_array("state", state, (plant.nx,))
    # rounded lengths and speeds are projected
    if off := off_constraints(plant, x, 1e-3):
        raise ValueError(f"state is {off}")
    return np.asarray(build_projection(plant, 10)(x).full()).ravel()


def _observe(believed: Model, plant: Model, x: Array, now: float) -> Array:
    """Convert the plant's state to that of the controller's model.

    The controller's model may lack states of the plant, such as the clock. `plant` is the simulated
    model with the state `x`, and `believed` the controller's model. `now` is the time [s].
    """
    known, own = believed.moving.stop, plant.moving.stop
    passed = x[own:] if plant.nx > own else np.array([now])
    return np.append(x[:known], passed[: believed.nx - known])

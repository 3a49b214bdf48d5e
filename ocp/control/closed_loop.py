"""Controllers at work: the motion of a model whose force densities are decided anew again and again."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import projection
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.simulation.diagnosis import off_constraints
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import LARGEST, Array, finite_array, instance, positive_number, whole_number

MOST = 1e7  # decisions in a run
ROUNDED = 1e-3  # of a start's largest entry: what bars and joints may move it by


@runtime_checkable
class Controller(Protocol):
    """Decides force densities from time and state, every `period` s."""

    @property
    def period(self) -> float:
        """Seconds from one decision to the next."""

    @property
    def model(self) -> Model:
        """What the controller believes in."""

    def control(self, time: float, state: Array) -> Array:
        """γ (α,), N/m, until the next decision."""


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """trajectory: the controlled motion, at the decisions and the steps between; seconds (D,): wall time of each decision."""

    trajectory: Trajectory
    seconds: Array

    def __repr__(self) -> str:
        slowest = f"{self.seconds.max(initial=0.0):.2g} s"
        return (
            f"ClosedLoop({len(self.seconds)} decisions of at most {slowest}, t = {self.trajectory.time[-1]:g} s, success={self.trajectory.success})"
        )


def run(
    controller: Controller,
    t_end: float,
    model: Model | None = None,
    state: Any = None,
    steps: int = 10,
    disturbance: Callable[[float, Array], Array] | None = None,
) -> ClosedLoop:
    """The motion of `model` (None: the controller's own) from `state` (None: its initial one), in `steps` steps of RK4 for each decision.

    t_end: s; the last decision holds for what is left of its period. model: a plant that may differ from what the controller believes: other
    masses, gusts (`tenscasadi.NodalForce` of time), gravity; nodes and strings are the same. state: (nx,), with bars of their lengths; its
    clock, which need not begin at 0, is what the controller sees, and times count from the beginning. disturbance: (time, x) → x, called
    before each decision, such as a push; what bars and joints do not allow of it is taken off. Stops where the motion diverges.
    Raises TypeError, ValueError.
    """
    if isinstance(controller, type) or not isinstance(controller, Controller) or not callable(controller.control):
        raise TypeError(f"controller is {controller!r}: give an ocp.Mpc(...), ocp.track(plan), or what has model, period and control(time, state)")
    instance("controller.model", controller.model, Model, "a tenscasadi.Model")
    period = positive_number("controller.period", controller.period)
    plant = controller.model if model is None else model
    _check_plant(plant, controller.model)
    n = whole_number("steps", steps, 1)
    if disturbance is not None and not callable(disturbance):
        raise TypeError(f"disturbance is {disturbance!r}: give a function (time, x) -> x, or None")
    ratio = positive_number("t_end", t_end) / period
    if ratio > MOST:
        raise ValueError(f"t_end is {t_end:g}: that takes {ratio:.1g} decisions of {period:g} s, give at most {MOST:g}")
    ends = np.append(period * np.arange(max(1, np.ceil(ratio - 1e-9))), t_end)  # of the decisions' times
    chain = RungeKutta4().step(plant.ode).mapaccum(n)
    project = projection(plant, 2)
    x = _start(plant, state)
    states, controls, seconds = [x[None]], [], []
    for now, after in pairwise(ends):
        if disturbance is not None:
            x = finite_array("disturbance(time, x)", disturbance(now, x.copy()), (plant.nx,))
            x = np.asarray(project(x).full()).ravel()
        seen = _seen(controller.model, plant, x, now)
        began = clock.perf_counter()
        decided = controller.control(now, seen)
        seconds.append(clock.perf_counter() - began)
        u = finite_array("controller.control(time, state)", decided, (plant.nu,))
        part = np.asarray(chain(x, ca.repmat(ca.DM(u), 1, n), (after - now) / n).full()).T
        if not np.all(np.abs(part) <= LARGEST):
            break
        x = np.asarray(project(part[-1]).full()).ravel()
        part[-1] = x
        states.append(part)
        controls.append(np.repeat(u[None], n, axis=0))
    rows = np.concatenate(states)
    done = len(controls) == len(ends) - 1
    held = np.concatenate([*controls, controls[-1][-1:]]) if controls else np.zeros((1, plant.nu))
    times = np.interp(np.arange(len(rows)) / n, np.arange(len(ends)), ends)
    message = f"finished {len(controls)} decisions" if done else f"diverged after t = {times[-1]:g} s: the state is not finite"
    trajectory = record_trajectory(plant, times, rows, held, step=period / n, message=message, success=done, seconds=sum(seconds))
    return ClosedLoop(trajectory, np.array(seconds))


def _check_plant(plant: Any, believed: Model) -> None:
    """The plant's state and control mean what the controller's do."""
    instance("model", plant, Model, "a tenscasadi.Model or None")
    if not isinstance(plant.scene.control, ForceDensity):
        raise ValueError(f"model has the control {plant.scene.control}: give a model of Scene(..., control=ForceDensity())")
    own, other = plant.structure, believed.structure
    same = np.array_equal(own.strings, other.strings) and np.array_equal(own.fixed, other.fixed)
    if not same or plant.nu != believed.nu or plant.nq != believed.nq:
        raise ValueError("model has other nodes, pins or strings than the controller's: give one with the same")


def _start(plant: Model, state: Any) -> Array:
    """The state (nx,), put right where it is rounded."""
    x = plant.initial_state if state is None else finite_array("state", state, (plant.nx,))
    right, off = off_constraints(plant, x, ROUNDED, iterations=10)
    if off:
        raise ValueError(f"state is {off}")
    return right


def _seen(believed: Model, plant: Model, x: Array, now: float) -> Array:
    """The plant's state as the controller knows it, with or without a clock: the plant's, or what has passed."""
    known = 2 * believed.nq
    passed = x[known:] if plant.nx > known else np.array([now])
    return np.append(x[:known], passed[: believed.nx - known])

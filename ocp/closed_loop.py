"""Controllers at work: the motion of a model whose force densities are decided anew again and again."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import casadi as ca
import numpy as np

from tenscasadi.correction import projection
from tenscasadi.model import Model
from tenscasadi.record import record
from tenscasadi.schemes import RungeKutta4
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array, finite_array, instance, positive_number, whole_number


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

    model: a plant that may differ from what the controller believes: other masses, gusts (`tenscasadi.NodalForce` of time), gravity;
    nodes and strings are the same. disturbance: (time, x) → x, called before each decision, such as a push. Stops where the motion diverges.
    Raises TypeError, ValueError.
    """
    if isinstance(controller, type) or not isinstance(controller, Controller):
        raise TypeError(f"controller is {controller!r}: give an ocp.Mpc(...), ocp.track(plan), or what has model, period and control(time, state)")
    plant = controller.model if model is None else model
    instance("model", plant, Model, "a tenscasadi.Model or None")
    known = 2 * plant.nq
    if plant.nu != controller.model.nu or known != 2 * controller.model.nq:
        raise ValueError("model has other nodes, pins or strings than the controller's: give one with the same")
    count = max(1, round(positive_number("t_end", t_end) / controller.period))
    n = whole_number("steps", steps, 1)
    h = controller.period / n
    chain = RungeKutta4().step(plant.ode).mapaccum(n)
    project = projection(plant, 2) if plant.mechanism.constrained else None
    x = np.array(plant.initial_state if state is None else finite_array("state", state, (plant.nx,)))
    states, controls, seconds = [x[None]], [], []
    for k in range(count):
        now = k * controller.period
        if disturbance is not None:
            x = finite_array("disturbance(time, x)", disturbance(now, x.copy()), (plant.nx,))
        seen = np.append(x[:known], np.full(controller.model.nx - known, now))
        began = clock.perf_counter()
        u = controller.control(now, seen)
        seconds.append(clock.perf_counter() - began)
        part = np.asarray(chain(x, ca.repmat(ca.DM(u), 1, n), h).full()).T
        if not np.all(np.isfinite(part)):
            break
        x = part[-1] if project is None else np.asarray(project(part[-1]).full()).ravel()
        part[-1] = x
        states.append(part)
        controls.append(np.repeat(u[None], n, axis=0))
    rows = np.concatenate(states)
    done = len(rows) == count * n + 1
    held = np.concatenate([*controls, controls[-1][-1:]]) if controls else np.zeros((1, plant.nu))
    message = f"finished {count} decisions" if done else f"diverged after t = {(len(rows) - 1) * h:g} s: the state is not finite"
    times = np.linspace(0.0, (len(rows) - 1) * h, len(rows))
    trajectory = record(plant, times, rows, held, step=h, message=message, success=done, seconds=sum(seconds))
    return ClosedLoop(trajectory, np.array(seconds))

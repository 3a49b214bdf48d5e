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
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.simulation.verdict.starts import off_constraints
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import (
    LARGEST,
    Array,
    call_user_function,
    finite_array,
    format_value,
    instance,
    positive_number,
    whole_number,
)

MOST = 1e7  # decisions in a run
MOST_STEPS = 1000  # in a decision
ROUNDED = 1e-3  # of lengths and speeds: what a start may be off its bars and joints by


@runtime_checkable
class Controller(Protocol):
    """Decides force densities from time and state, every `period` s."""

    @property
    def period(self) -> float:
        """Seconds from one decision to the next."""

    @property
    def model(self) -> Model:
        """The model that the controller believes in."""

    def control(self, time: float, state: Array) -> Array:
        """γ (α,), N/m, until the next decision."""


@dataclass(frozen=True, eq=False)
class ClosedLoop(ReadOnlyArrays):
    """Controlled motion, and how long the decisions took; see `run`.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, at the decisions and the steps between them.
    seconds : ndarray, shape (D,)
        Wall time of each decision, s.

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
) -> ClosedLoop:
    """Simulate a model under a controller, which decides its force densities anew and anew.

    Parameters
    ----------
    controller : Mpc, Tracker or Controller
        What decides: it has a `model`, a `period`, s, and `control(time, state)`, which returns
        force densities (α,), N/m.
    t_end : float
        End of the run, s. The last decision holds for what is left of its period.
    model : Model, optional
        The plant. It may differ from what the controller believes: in masses, gravity, gusts
        (`tenscasadi.NodalForce` of time); nodes and strings are the same. Default: the controller's
        own model.
    state : array_like, shape (nx,), optional
        Where the run starts, with bars of their lengths. A clock need not begin at 0: the
        controller sees it; times count from the beginning. Default: the model's initial state.
    steps : int
        Steps of `RungeKutta4` for each decision.
    disturbance : callable, optional
        Function (time, state) → state, called before each decision, such as a push. What bars and
        joints do not allow of it is taken off.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the plant's parameters, see `tenscasadi.ParameterLayout.values`. Default: the
        nominal ones.

    Returns
    -------
    ClosedLoop
        The motion; it ends where it diverges, and its trajectory then has `success` False.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or what the controller decides.

    Examples
    --------
    A planar cross is brought to another shape, and kept there:

    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> lengths = tc.shapes.d_bar(angle=0.7).string_lengths
    >>> controller = ocp.Mpc(ocp.Problem(cross, goals=[ocp.StringLengths(lengths), ocp.AtRest()]), period=0.1, intervals=5)
    >>> reached = cross.structure.replace(nodes=ocp.run(controller, 2.0).trajectory.nodes[-1])
    >>> bool(abs(reached.string_lengths - lengths).max() < 0.01)
    True
    """
    if (
        isinstance(controller, type)
        or not isinstance(controller, Controller)
        or not callable(controller.control)
    ):
        raise TypeError(
            f"controller is {format_value(controller)}: give an ocp.Mpc(...), ocp.track(plan), or what has model, period and control(time, state)"
        )
    instance("controller.model", controller.model, Model, "a tenscasadi.Model")
    period = positive_number("controller.period", controller.period)
    plant = controller.model if model is None else model
    if model is None and parameters is not None and not plant.np:
        raise ValueError(
            "parameters are given, and the controller's model has none: give the plant, a model of Scene(..., parameters=...)"
        )
    _check_plant(plant, controller.model)
    plant = plant.with_parameters(parameters)
    n = whole_number("steps", steps, 1, MOST_STEPS)
    if disturbance is not None and not callable(disturbance):
        raise TypeError(
            f"disturbance is {format_value(disturbance)}: give a function (time, x) -> x, or None"
        )
    ratio = positive_number("t_end", t_end) / period
    if ratio > MOST:
        raise ValueError(
            f"t_end is {t_end:g}: that takes {ratio:.1g} decisions of {period:g} s, give at most {MOST:g}"
        )
    ends = np.append(
        period * np.arange(max(1, np.ceil(ratio - 1e-9))), t_end
    )  # of the decisions' times
    chain = RungeKutta4().step(plant.ode).mapaccum(n)
    project = build_projection(plant, 2)
    x = _start(plant, state)
    states, controls, seconds = [x[None]], [], []
    for now, after in pairwise(ends):
        if disturbance is not None:
            pushed = call_user_function(
                "disturbance",
                lambda seen: disturbance(*seen),
                (now, x.copy()),
                "give a function (time, x) -> x",
            )
            x = finite_array("disturbance(time, x)", pushed, (plant.nx,))
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
    message = (
        f"finished {len(controls)} decisions"
        if done
        else f"diverged after t = {times[-1]:g} s: the state is not finite"
    )
    trajectory = record_trajectory(
        plant,
        times,
        rows,
        held,
        step=period / n,
        message=message,
        success=done,
        seconds=sum(seconds),
    )
    return ClosedLoop(trajectory, np.array(seconds))


def _check_plant(plant: Any, believed: Model) -> None:
    """Refuse a plant whose state and control do not mean what the controller's do."""
    instance("model", plant, Model, "a tenscasadi.Model or None")
    if not isinstance(plant.scene.control, ForceDensity):
        raise ValueError(
            f"model has the control {plant.scene.control}: give a model of Scene(..., control=ForceDensity())"
        )
    own, other = plant.structure, believed.structure
    same = (
        np.array_equal(own.strings, other.strings)
        and np.array_equal(own.fixed, other.fixed)
        and own.rollers == other.rollers
    )
    if not same or plant.nu != believed.nu or plant.nq != believed.nq:
        raise ValueError(
            "model has other nodes, pins or strings than the controller's: give one with the same"
        )


def _start(plant: Model, state: Any) -> Array:
    """Return the state (nx,), put right where it is rounded."""
    x = plant.initial_state if state is None else finite_array("state", state, (plant.nx,))
    if off := off_constraints(plant, x, ROUNDED):
        raise ValueError(f"state is {off}")
    return np.asarray(build_projection(plant, 10)(x).full()).ravel()


def _seen(believed: Model, plant: Model, x: Array, now: float) -> Array:
    """Return the plant's state as the controller knows it, with or without a clock: the plant's, or what has passed."""
    known = 2 * believed.nq
    passed = x[known:] if plant.nx > known else np.array([now])
    return np.append(x[:known], passed[: believed.nx - known])

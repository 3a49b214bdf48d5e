"""Definition of a control task for reinforcement learning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import Correction, Projection
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.simulation.diagnosis import off_constraints
from tenscasadi.util.validate import (
    Array,
    finite_array,
    instance,
    nesting,
    nonnegative,
    per_item,
    positive_number,
    shown,
    text,
    whole_number,
)

CORRECTION = Projection(10)
MOST_STEPS = 1_000_000  # steps per period, about a second of computation
ROUNDED = 1e-3  # relative to lengths and speeds: constraint tolerance of the initial state


@dataclass(frozen=True, eq=False)
class Transition:
    """One control period of n episodes.

    Rewards and terminations are functions of it.

    Attributes
    ----------
    nodes, velocities : ndarray, shape (n, N, 3)
        Nodes, m, and their velocities, m/s, at the end of the period.
    nodes_before, velocities_before : ndarray, shape (n, N, 3)
        The same at its start.
    control : ndarray, shape (n, α)
        Force densities in the period, N/m, or rest lengths at its end, m.
    action : ndarray, shape (n, α)
        Actions, from −1 to 1.
    time : ndarray, shape (n,)
        Time since the start of the episode, at the end of the period, s.

    Examples
    --------
    A reward for each meter that the center moves along x:

    >>> def forward(now):
    ...     return (now.nodes - now.nodes_before)[:, :, 0].mean(axis=1)
    """

    nodes: Array
    velocities: Array
    nodes_before: Array
    velocities_before: Array
    control: Array
    action: Array
    time: Array


@dataclass(frozen=True, eq=False)
class Task:
    """Control task: model, action limits, reward, and random variations.

    Parameters
    ----------
    model : Model
        The model. Under ``control=ForceDensity()`` actions are force densities, under
        ``RestLength()`` rates of rest lengths; they run from −1 to 1 in either case.
    reward : callable
        Function of a `Transition` of n episodes that returns rewards (n,).
    lower, upper : array_like, scalar or shape (α,)
        Force densities at the actions −1 and 1 [N/m], or limits of rest lengths [m].
    speed : array_like, scalar or shape (α,), optional
        Rate of rest lengths at the action 1 [m/s]. Only for `RestLength`.
    period : float
        Control period [s].
    steps : int
        Number of `RungeKutta4` steps per period.
    duration : float
        Time after which an episode is truncated [s].
    state : array_like, shape (nx,), optional
        Initial state. Default: that of the model.
    start : float or (float, float)
        Spread of the initial positions [m] and velocities [m/s]. They are then projected onto the
        constraints.
    parameters : mapping of str to float, optional
        Relative spreads of the model's parameters by name, at least 0 and less than 1. Each episode
        has its own values (domain randomization).
    observation : callable, optional
        Function of nodes (n, N, 3), velocities (n, N, 3) and control (n, α) that returns
        observations (n, k), clipped to ±1e6. Default: all of these, under force densities without
        the control.
    terminated : callable, optional
        Function of a `Transition` that returns the terminated episodes (n,). Default: those that
        diverge.
    correction : Projection or BarLengthCorrection, optional
        Constraint stabilization after every `correction.every`-th step of a period, or after the
        last step of a shorter period; None for none.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or does not fit the model.

    Notes
    -----
    All draws are uniform within ± their spread. An episode is terminated if it diverges or a bar
    length has an error over 10 %. Its reward is then 0, and its last state is kept.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.envs import Task
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> task = Task(model, lambda now: -((now.nodes[:, 2, 0] - 0.3) ** 2), lower=0.0, upper=20.0)
    >>> task.period, task.decisions
    (0.05, 100)
    """

    model: Model
    reward: Callable[[Transition], ArrayLike]
    lower: ArrayLike
    upper: ArrayLike
    speed: ArrayLike | None = None
    period: float = 0.05
    steps: int = 10
    duration: float = 5.0
    state: ArrayLike | None = None
    start: float | tuple[float, float] = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    observation: Callable[[Array, Array, Array], ArrayLike] | None = None
    terminated: Callable[[Transition], ArrayLike] | None = None
    correction: Correction | None = CORRECTION

    def __post_init__(self) -> None:
        model, own = self.model, self.__dict__
        instance("Task.model", model, Model, "a tenscasadi.Model")
        if not isinstance(model.scene.control, (ForceDensity, RestLength)) or not model.nu:
            raise ValueError(
                f"Task.model has the control {model.scene.control}: give Scene(..., control=ForceDensity() or RestLength())"
            )
        for name in ("reward", "observation", "terminated"):
            if not callable(getattr(self, name)) and (
                name == "reward" or getattr(self, name) is not None
            ):
                raise TypeError(f"Task.{name} is {shown(getattr(self, name))}: give a function")
        for name in ("lower", "upper"):
            own[name] = nonnegative(
                f"Task.{name}",
                per_item(f"Task.{name}", getattr(self, name), model.nu),
                "string",
                strict=self.winds,
            )
        crossed = np.less_equal(*reversed(self.limits))
        if np.any(crossed):
            k = int(np.argmax(crossed))
            raise ValueError(f"Task.lower of string {k} is not below upper: give lower < upper")
        if self.winds != (self.speed is not None):
            raise ValueError(
                f"Task.speed is {shown(self.speed)}: give the greatest rate, m/s, for RestLength(), and None for ForceDensity()"
            )
        if self.speed is not None:
            own["speed"] = nonnegative(
                "Task.speed", per_item("Task.speed", self.speed, model.nu), "string"
            )
        own["period"] = positive_number("Task.period", self.period)
        whole_number("Task.steps", self.steps, 1, MOST_STEPS)
        own["duration"] = positive_number("Task.duration", self.duration)
        if self.duration < self.period:
            raise ValueError(
                f"Task.duration is {self.duration:g}, shorter than the period of {self.period:g} s: give a longer one"
            )
        own["state"] = (
            model.initial_state
            if self.state is None
            else finite_array("Task.state", self.state, (model.nx,))
        )
        if off := off_constraints(model, own["state"], ROUNDED):
            raise ValueError(f"Task.state is {off}")
        own["start"] = pair("Task.start", self.start)
        own["parameters"] = _spreads(model, self.parameters)
        if self.correction is not None and not hasattr(self.correction, "every"):
            raise TypeError(
                f"Task.correction is {shown(self.correction)}: give Projection(every), BarLengthCorrection(weight) or None"
            )

    @property
    def winds(self) -> bool:
        """Whether actions are rates of rest lengths."""
        return isinstance(self.model.scene.control, RestLength)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (α,)."""
        return np.asarray(self.lower, dtype=float), np.asarray(self.upper, dtype=float)

    @property
    def decisions(self) -> int:
        """Number of control periods in a complete episode."""
        return max(1, int(np.ceil(self.duration / self.period - 1e-9)))

    @property
    def spread(self) -> Array:
        """Spread of each entry of p (np,)."""
        values = np.zeros(self.model.np)
        for name, share in self.parameters.items():
            place = self.model.parameters.places[name]
            values[place] = share * np.abs(self.model.parameters.nominal[place])
        return values


def pair(field: str, value: Any) -> tuple[float, float]:
    """Read the spreads of positions and velocities.

    One number is the spread of positions. Raises TypeError, ValueError.
    """
    if nesting(value) == 0:
        return positive_number(field, value, zero=True), 0.0
    place, speed = finite_array(field, value, (2,))
    return positive_number(f"{field}[0]", place, zero=True), positive_number(
        f"{field}[1]", speed, zero=True
    )


def _spreads(model: Model, given: Any) -> dict[str, float]:
    if not isinstance(given, Mapping):
        raise TypeError(
            f"Task.parameters is {shown(given)}: give spreads by name, such as {{'bar_mass': 0.1}}"
        )
    known = ", ".join(model.parameters.places) or "none"
    found = {}
    for name, value in given.items():
        text("Task.parameters: a name", name)
        if name not in model.parameters.places:
            raise ValueError(
                f"Task.parameters has {shown(name)}, and the model's parameters are {known}: give Scene(..., parameters=Parameters({shown(name)}))"
            )
        found[name] = positive_number(f"Task.parameters[{shown(name)}]", value, zero=True)
        if found[name] >= 1:
            raise ValueError(
                f"Task.parameters[{shown(name)}] is {value:g}: give a spread relative to the value, less than 1"
            )
    return found

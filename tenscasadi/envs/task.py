"""Definition of a control task for reinforcement learning."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import Correction, Projection, check_correction
from tenscasadi.scene.strings import RestLength
from tenscasadi.schema.value import check_fields
from tenscasadi.simulation.verdict.starts import off_constraints
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import (
    MAX_ENTRIES,
    Array,
    Boolean,
    Positive,
    finite_array,
    format_value,
    instance,
    nesting,
    nonnegative,
    per_item,
    positive_number,
    text,
    whole,
)


@dataclass(frozen=True, eq=False)
class Transition:
    """Simulated control period of n episodes.

    Rewards and terminations are functions of it.

    Attributes
    ----------
    nodes, velocities : ndarray, shape (n, N, 3)
        Node positions [m] and velocities [m/s] at the end of the period.
    nodes_before, velocities_before : ndarray, shape (n, N, 3)
        The same at its start.
    control : ndarray, shape (n, α)
        Force densities in the period [N/m], or rest lengths at its end [m].
    action : ndarray, shape (n, α)
        Actions, from −1 to 1.
    time : ndarray, shape (n,)
        Time since the start of the episode, at the end of the period [s].

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


@rename_fields(speed="rest_length_rate")
@dataclass(frozen=True, eq=False)
class Task:
    """Control task: model, action limits, reward, and random variations.

    Parameters
    ----------
    model : Model
        The model. Under ``control=ForceDensity()`` actions are force densities, under ``Tension()``
        tensions, under ``RestLength()`` and ``RestLengthRate()`` rates of rest lengths, under
        ``Winch(...)`` torques; they run from −1 to 1 in each case.
    reward : callable
        Function of a `Transition` of n episodes that returns rewards (n,).
    lower, upper : array_like, scalar or shape (nu,)
        Controls at the actions −1 and 1, such as force densities [N/m]; under ``RestLength()``,
        limits of rest lengths [m].
    rest_length_rate : array_like, scalar or shape (nu,), optional
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
        Function of nodes (n, N, 3), velocities (n, N, 3) and control (n, nu) that returns
        observations (n, k), clipped to ±1e6. Default: nodes and velocities, rest lengths that are
        controlled, and internal states of winches and of strings that can fail.
    terminated : callable, optional
        Function of a `Transition` that returns the terminated episodes (n,). Default: those that
        diverge.
    end_on_failure : bool
        Whether an episode is terminated once a string breaks or yields, see `Scene.strength`.
        Otherwise it continues with the failed string.
    correction : Projection or BarLengthCorrection, optional
        Constraint stabilization after every `correction.every`-th step of a period, or after the
        last step of a shorter period; None for none.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or does not fit the model.

    Notes
    -----
    All draws are uniform within ± their spread. An episode is terminated if it diverges, a bar
    length has an error over 10 %, or a winch has wound up a whole string. Its reward is then 0, and
    its last state is kept.

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
    rest_length_rate: ArrayLike | None = None
    period: Positive = 0.05
    steps: Annotated[int, whole(1, MAX_ENTRIES)] = 10
    duration: Positive = 5.0
    state: ArrayLike | None = None
    start: float | tuple[float, float] = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    observation: Callable[[Array, Array, Array], ArrayLike] | None = None
    terminated: Callable[[Transition], ArrayLike] | None = None
    correction: Correction | None = Projection(10)  # noqa: RUF009  frozen
    end_on_failure: Boolean = False

    def __post_init__(self) -> None:
        model = self.model
        instance("Task.model", model, Model, "a tenscasadi.Model")
        if model.scene.control is None or not model.nu:
            cure = "give Scene(..., control=ForceDensity()), Tension(), RestLength() or a winch"
            raise ValueError(f"Task.model has the control {model.scene.control}: {cure}")
        for name in ("reward", "observation", "terminated"):
            given = getattr(self, name)
            if not callable(given) and (name == "reward" or given is not None):
                raise TypeError(f"Task.{name} is {format_value(given)}: give a function")
        check_fields(self)
        state = model.initial_state if self.state is None else self.state
        own: dict[str, Any] = {
            "lower": self._per_string("lower", strict=self.controls_rest_lengths),
            "upper": self._per_string("upper", strict=self.controls_rest_lengths),
            "state": finite_array("Task.state", state, (model.nx,)),
            "start": read_spread("Task.start", self.start),
            "parameters": _read_spreads(model, self.parameters),
        }
        if self.controls_rest_lengths != (self.rest_length_rate is not None):
            cure = "give the greatest rate, m/s, for RestLength(), and None for other controls"
            raise ValueError(
                f"Task.rest_length_rate is {format_value(self.rest_length_rate)}: {cure}"
            )
        if self.rest_length_rate is not None:
            own["rest_length_rate"] = self._per_string("rest_length_rate")
        vars(self).update(own)
        if np.any(crossed := np.greater_equal(*self.limits)):
            k = int(np.argmax(crossed))
            raise ValueError(f"Task.lower of string {k} is not below upper: give lower < upper")
        if self.duration < self.period:
            fault = f"{self.duration:g}, shorter than the period of {self.period:g} s"
            raise ValueError(f"Task.duration is {fault}: give a longer one")
        if off := off_constraints(model, own["state"], 1e-3):  # rounded numbers are projected
            raise ValueError(f"Task.state is {off}")
        check_correction(self.correction, "Task.correction")

    def _per_string(self, name: str, strict: bool = False) -> Array:
        field = f"Task.{name}"
        array = per_item(field, getattr(self, name), self.model.nu)
        scene = self.model.scene
        if scene.locked.control is not scene.control:  # rates and torques have two directions
            return array
        return nonnegative(field, array, "string", strict=strict)

    @property
    def controls_rest_lengths(self) -> bool:
        """Whether actions are rates of rest lengths."""
        return isinstance(self.model.scene.control, RestLength)

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (α,) of the control."""
        return np.asarray(self.lower, dtype=float), np.asarray(self.upper, dtype=float)

    @property
    def decisions(self) -> int:
        """Number of control periods in a complete episode."""
        return max(1, int(np.ceil(self.duration / self.period - 1e-9)))

    @property
    def spread(self) -> Array:
        """Half-width of the random variation of each parameter (np,)."""
        values = np.zeros(self.model.np)
        for name, share in self.parameters.items():
            place = self.model.parameters.places[name]
            values[place] = share * np.abs(self.model.parameters.nominal[place])
        return values


def read_spread(field: str, value: Any) -> tuple[float, float]:
    """Read the random variations of initial positions and velocities.

    They are in m and m/s. `field` is the name of the argument `value`. One number is that of
    positions. Raises TypeError, ValueError.
    """
    if nesting(value) == 0:
        return positive_number(field, value, zero=True), 0.0
    pair = enumerate(finite_array(field, value, (2,)))
    position, speed = (positive_number(f"{field}[{k}]", x, zero=True) for k, x in pair)
    return position, speed


def _read_spreads(model: Model, given: Any) -> dict[str, float]:
    instance("Task.parameters", given, Mapping, "spreads by name, such as {'bar_mass': 0.1}")
    places, found = model.parameters.places, {}
    for name, value in given.items():
        text("Task.parameters: a name", name)
        if name not in places:
            known = f"the model's parameters are {', '.join(places) or 'none'}"
            cure = f"give Scene(..., parameters=Parameters({format_value(name)}))"
            raise ValueError(f"Task.parameters has {format_value(name)}, and {known}: {cure}")
        field = f"Task.parameters[{format_value(name)}]"
        found[name] = positive_number(field, value, zero=True)
        if found[name] >= 1:
            cure = "give a spread relative to the value, less than 1"
            raise ValueError(f"{field} is {value:g}: {cure}")
    return found

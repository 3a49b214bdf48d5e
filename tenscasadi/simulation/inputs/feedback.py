"""State feedback along a plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.util.validate import Array, finite_array, format_value, real_array


@dataclass(frozen=True, eq=False)
class Feedback:
    """State feedback along a plan.

    The controls u = u_k − G_k (x − x_k), within limits, are updated at the times of the plan and
    constant between them. After the end of the plan, the last gain regulates the last state. The
    control period is then that of the last interval.

    Parameters
    ----------
    time : array_like, shape (K + 1,)
        Times of the control updates [s], increasing from 0, and the end of the plan.
    controls : array_like, shape (K, nu)
        Controls u_k of the plan.
    states : array_like, shape (K + 1, nx)
        States x_k of the plan. The clock is not fed back.
    gains : array_like, shape (K, nu, nx)
        Gains G_k.
    lower, upper : array_like, scalar or shape (nu,)
        Limits of the controls; -inf and inf: none.

    Raises
    ------
    TypeError, ValueError
        If an argument has another type or shape, times do not increase from 0, or limits contradict
        each other.

    See Also
    --------
    rollouts : Simulate a batch of runs, also under feedback.

    Examples
    --------
    A force of 1 N pulls a mass outwards. Feedback of position and velocity to the force density of
    its string keeps the mass at 0.5 m:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> pins = {0: "xyz", 1: "yz"}
    >>> s = tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=pins)
    >>> model = tc.Model(tc.Scene(s, control=tc.ForceDensity(), forces=tc.NodalForce([(0, 0, 0), (1, 0, 0)])))
    >>> plan = dict(time=[0.0, 0.1], controls=[[2.0]], states=[[0.5, 0.0], [0.5, 0.0]])
    >>> feedback = tc.Feedback(**plan, gains=[[[-20.0, -10.0]]], lower=0.0)
    >>> many = tc.rollouts(model, 5.0, 0.01, states=[[0.9, 0.0], [0.3, 0.0]], controls=feedback)
    >>> bool(many.success.all()), np.round(many.final[:, 0], 2).tolist()
    (True, [0.5, 0.5])
    """

    time: Any
    controls: Any
    states: Any
    gains: Any
    lower: Any = -np.inf
    upper: Any = np.inf

    def __post_init__(self) -> None:
        time = finite_array("Feedback.time", self.time, (None,))
        if len(time) < 2 or time[0] != 0 or np.any(np.diff(time) <= 0):
            raise ValueError(
                f"Feedback.time is {time}: give two or more times that increase from 0"
            )
        count = len(time) - 1
        controls = finite_array("Feedback.controls", self.controls, (count, None))
        states = finite_array("Feedback.states", self.states, (count + 1, None))
        values = {"time": time, "controls": controls, "states": states}
        values["gains"] = finite_array(
            "Feedback.gains", self.gains, (count, controls.shape[1], states.shape[1])
        )
        values |= {
            name: _limit(name, getattr(self, name), controls.shape[1])
            for name in ("lower", "upper")
        }
        if np.any(values["lower"] > values["upper"]):
            k = int(np.argmax(values["lower"] > values["upper"]))
            raise ValueError(
                f"Feedback.lower[{k}] is {values['lower'][k]:g}, above upper[{k}] = {values['upper'][k]:g}: give lower ≤ upper"
            )
        vars(self).update(values)


def _limit(name: str, value: Any, size: int) -> Array:
    wanted = f"one number or ({size},)"
    given = real_array(f"Feedback.{name}", value, wanted)
    if given.shape not in ((), (size,)) or np.any(np.isnan(given)):
        raise ValueError(f"Feedback.{name} is {format_value(value)}: give {wanted}, inf for none")
    limit = np.broadcast_to(given, (size,)).copy()
    limit.flags.writeable = False
    return limit

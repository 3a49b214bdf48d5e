"""Controls over time, sampled at the steps of a run.

A control is a constant, a table, or a profile on a mesh.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.scene.control_function import ControlFunction
from tenscasadi.util.validate import SMALLEST, Array, Indices, finite_array

ControlInput = ArrayLike | Callable[[float], ArrayLike] | ControlFunction | None


@dataclass(frozen=True, eq=False)
class ControlProfile:
    """Control on a mesh of intervals of any lengths.

    The mesh covers a run from time 0 to its end.

    Parameters
    ----------
    time : ndarray, shape (K + 1,)
        Nodes of the mesh, s, increasing from 0.
    values : ndarray, shape (K, nu) or (K + 1, nu)
        The control in each interval, or at the nodes and linear between them: it is then held at
        its mean over each step.
    steps : int
        Fewest steps of an interval; a run takes more where none may be longer than its `step`.
    """

    time: Array
    values: Array
    steps: int = 1


@dataclass(frozen=True, eq=False)
class SampledControl:
    """Steps of a run, each with a constant control.

    The run ends at `t_end` [s]. With `varies`, the control may change from step to step. The steps
    lie between `ends` (steps + 1,) [s]; None stands for equal steps. The last step is shorter by
    `early` s, which is below rounding.
    """

    steps: int
    t_end: float
    varies: bool
    sample: Callable[[int, int], Array]
    ends: Array | None = None
    early: float = 0.0

    @property
    def step(self) -> float:
        """Mean step [s]."""
        return self.t_end / self.steps

    @property
    def longest(self) -> float:
        """Longest step [s]."""
        return self.step if self.ends is None else float(np.diff(self.ends).max())

    def window(self, first: int, count: int) -> Array:
        """Return the control (count, nu) from step `first` on.

        Past the end of the run the last one is held.
        """
        inside = self.sample(first, max(0, min(count, self.steps - first)))
        if len(inside) == count:
            return inside
        last = inside[-1:] if len(inside) else self.sample(self.steps - 1, 1)
        return np.concatenate([inside, np.repeat(last, count - len(inside), axis=0)])

    def lengths(self, first: int, count: int) -> Array:
        """Return the step lengths (count,) from `first` on [s].

        Past the end of the run the last length is repeated.
        """
        if self.ends is None:
            return np.full(count, self.step)
        indices = np.minimum(np.arange(first, first + count), self.steps - 1)
        return np.asarray(np.diff(self.ends)[indices] - self.early * (indices == self.steps - 1))

    def times(self, rows: Indices) -> Array:
        """Compute the start times of steps, counted from 0 [s].

        Step `steps` stands for the end of the run.
        """
        if self.ends is not None:
            return np.asarray(self.ends[rows])
        return np.where(rows == self.steps, self.t_end, rows * self.step)


def sample_control(
    control: ControlInput | ControlProfile,
    default: Array,
    t_end: float,
    steps: int,
    positive: bool = False,
) -> SampledControl:
    """Sample a control over [0, t_end] at equal steps.

    There are at least `steps` steps, and more if the intervals of a table or mesh need it. See
    `simulate` for `control`.

    `default` (nu,) is used for None; `positive`: these are lengths, greater than 0.

    Raises TypeError, ValueError naming `control`.
    """
    nu = len(default)
    if isinstance(control, ControlProfile):
        return _sample_profile(control, nu, t_end, t_end / steps, positive)
    value = default
    if control is not None:
        table = _check_lengths("control", _array(control, nu), positive)
        intervals = len(table)
        if table.ndim == 2 and intervals > 1 and nu:
            steps = intervals * -(-steps // intervals)  # the control changes between steps
            # Integers only, since a rounded time could shift a change by one step.
            return SampledControl(
                steps,
                t_end,
                True,
                lambda first, count: table[np.arange(first, first + count) * intervals // steps],
            )
        value = table.reshape(-1)
    return SampledControl(
        steps, t_end, False, lambda first, count: np.broadcast_to(value, (count, nu))
    )


def append_constants(inputs: SampledControl, values: Array) -> SampledControl:
    """Append constants (k,) to the control of each step."""

    def sample(first: int, count: int) -> Array:
        control = inputs.sample(first, count)
        return np.concatenate(
            [control, np.broadcast_to(values, (len(control), len(values)))], axis=1
        )

    return replace(inputs, sample=sample)


def cut_steps(inputs: SampledControl, breaks: Array, near: float | None = None) -> SampledControl:
    """Cut the steps at `breaks` [s] after the start.

    The parts of a step have the same control. A break within `near` s of an end of a step is
    ignored, by default 1e-9 of the step.
    """
    inside = breaks[(breaks > 0) & (breaks < inputs.t_end)]
    if not len(inside):
        return inputs
    ends = inputs.times(np.arange(inputs.steps + 1))
    place = np.clip(np.searchsorted(ends, inside), 1, inputs.steps)
    away = np.minimum(abs(inside - ends[place]), abs(inside - ends[place - 1]))
    least = 1e-9 * (ends[place] - ends[place - 1]) if near is None else near
    inside = inside[away > np.maximum(least, 4 * np.spacing(inputs.t_end))]
    if not len(inside):
        return inputs
    cut = np.union1d(ends, inside)
    owner = np.searchsorted(ends, cut[:-1], side="right") - 1

    def sample(first: int, count: int) -> Array:
        owners = owner[first : first + count]
        return (
            inputs.sample(int(owners[0]), int(owners[-1] - owners[0]) + 1)[owners - owners[0]]
            if len(owners)
            else inputs.sample(0, 0)
        )

    return SampledControl(len(owner), inputs.t_end, inputs.varies, sample, cut)


def _sample_profile(
    profile: ControlProfile, nu: int, t_end: float, longest: float, positive: bool
) -> SampledControl:
    """Cut each interval into equal steps, at most `longest`."""
    nodes = finite_array("control.time", profile.time, (None,))
    count = len(nodes) - 1
    if count < 1 or nodes[0] != 0 or nodes[-1] != t_end or np.any(np.diff(nodes) <= 0):
        raise ValueError(
            f"control.time is {nodes}: give times that increase from 0 to t_end = {t_end:g}"
        )
    linear = len(profile.values) == count + 1
    values = _check_lengths(
        "control.values",
        finite_array("control.values", profile.values, (count + linear, nu)),
        positive,
    )
    intervals = np.diff(nodes)
    cuts = np.maximum(profile.steps, np.ceil(intervals / longest - 1e-9)).astype(int)
    owner = np.repeat(np.arange(count), cuts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(cuts) - cuts, cuts)) / cuts[owner]
    ends = np.append(nodes[owner] + share * intervals[owner], t_end)
    held = values[owner]
    if linear:
        middle = (share + 0.5 / cuts[owner])[:, None]
        held = (1 - middle) * held + middle * values[owner + 1]
    return SampledControl(
        len(owner),
        t_end,
        count > 1 or linear,
        lambda first, count: held[first : first + count],
        ends,
    )


def _array(control: Any, nu: int) -> Array:
    try:
        shape = np.shape(control)
    except Exception:  # noqa: BLE001  what is no array, finite_array refuses by name
        shape = ()
    if shape == (nu,):
        return finite_array("control", control, (nu,))
    if len(shape) == 2 and shape[0] > 0 and shape[1] == nu:
        return finite_array("control", control, (None, nu))
    array = finite_array("control", control, (None,) * len(shape))
    expected = (
        f"({nu},), (intervals, {nu}) or a function of time that returns ({nu},)"
        if nu
        else "(0,) or None, as this scene has no control"
    )
    raise ValueError(f"control has shape {array.shape}: give an array of shape {expected}")


def _check_lengths(field: str, values: Array, positive: bool) -> Array:
    """Check that `values` are lengths greater than 0."""
    bad = np.argwhere(values < SMALLEST)
    if positive and len(bad):
        place = tuple(int(i) for i in bad[0])
        raise ValueError(
            f"{field}[{', '.join(map(str, place))}] is {values[place]:g}: rest lengths (RestLength) must be greater than 0"
        )
    return values

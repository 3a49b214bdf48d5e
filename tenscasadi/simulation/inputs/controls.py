"""Controls of runs.

They are constants, tables, profiles on a mesh, functions of time, or state feedback.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.control_function import ControlFunction, build_schedule, read_controls_at
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.inputs.feedback import Feedback
from tenscasadi.simulation.inputs.grid import Grid
from tenscasadi.util.validate import SMALLEST, Array, finite_array

ControlInput = ArrayLike | Callable[[float], ArrayLike] | ControlFunction | None


@dataclass(frozen=True, eq=False)
class ControlProfile:
    """Control on a nonuniform mesh of intervals.

    The mesh covers a run from time 0 to its end.

    Parameters
    ----------
    time : ndarray, shape (K + 1,)
        Mesh points, increasing from 0 [s].
    values : ndarray, shape (K, nu) or (K + 1, nu)
        Control in each interval, or at the mesh points and linear between them. A linear control is
        constant at its mean over each step.
    steps : int
        Smallest number of steps of an interval.
    """

    time: Array
    values: Array
    steps: int = 1


class Controls(NamedTuple):
    """Controls of n runs.

    Attributes
    ----------
    values : ndarray, shape (n or 1, K, nu)
        Control in each interval; (n or 1, K + 1, nu) at its ends if `linear`.
    edges : ndarray, shape (K + 1,)
        Ends of the intervals, from 0 [s].
    linear : bool
        Whether the control is linear in each interval.
    fewest : int
        Smallest number of steps of an interval.
    feedback : Feedback, optional
        State feedback, which replaces the values.
    """

    values: Array
    edges: Array
    linear: bool = False
    fewest: int = 1
    feedback: Feedback | None = None

    def hold(self, grid: Grid) -> tuple[Grid, Array]:
        """Replace piecewise-linear controls by their mean in each step.

        Returns the time grid and the control (n or 1, K, nu) of its rows.
        """
        if not self.linear:
            return grid, self.values
        lengths = np.repeat(grid.lengths, grid.counts)
        edges = np.append(grid.times(np.arange(grid.steps)), grid.t_end)
        middle = edges[:-1] + lengths / 2
        held = [np.interp(middle, self.edges, column) for column in self.values[0].T]
        values = np.array(held).reshape(-1, grid.steps).T[None]
        counts = np.ones(grid.steps, dtype=np.int64)
        return Grid(edges, counts, np.arange(grid.steps), grid.early), values


def read_controls(
    model: Model, controls: Any, p: Array, t_end: float, field: str, shapes: Sequence[str]
) -> Controls:
    """Read the controls of runs.

    Parameters
    ----------
    model : Model
        Model of the runs.
    controls : array_like, ControlProfile, Feedback or None
        The controls.
    p : ndarray, shape (n or 1, np)
        Parameters of the runs.
    t_end : float
        End of the runs [s].
    field : str
        Name of the argument, for messages.
    shapes : sequence of str
        Shapes of arrays with one and more dimensions, for instance "u" and "Ku". The letters stand
        for runs (n), intervals (K) and the entries of a control (u).

    Returns
    -------
    Controls
        Checked controls.

    Raises
    ------
    TypeError, ValueError
        The controls are wrong; the message names the field.
    """
    if isinstance(controls, Feedback):
        return _read_feedback(model, controls, t_end)
    letters = "Ku"
    if controls is None:
        found = Controls(_find_initial(model, p)[:, None], np.array([0.0, t_end]))
    elif isinstance(controls, ControlProfile):
        found, field = _read_profile(controls, model.nu, t_end), f"{field}.values"
    else:
        table, letters = _read_table(controls, model.nu, field, shapes)
        found = Controls(table, np.linspace(0.0, t_end, table.shape[1] + 1))
    bad = np.argwhere(found.values < SMALLEST)
    if isinstance(model.scene.control, RestLength) and len(bad):
        place = ", ".join(str(bad[0]["nKu".index(letter)]) for letter in letters)
        raise ValueError(
            f"{field}[{place}] is {found.values[tuple(bad[0])]:g}: rest lengths (RestLength) must be greater than 0"
        )
    return found


def drive_model(model: Model, control: Any, first: float, t_end: float) -> Model:
    """Build the model in which a control is a function of time.

    The model caches it. `first` is the time of its clock at the start, and `t_end` the duration of
    the run [s]. Raises ValueError.
    """
    if not isinstance(control, ControlFunction):
        control = ControlFunction(control)
    positive = isinstance(model.scene.control, RestLength)
    if not model.nu:
        read_controls_at(control.function, 0, positive)(0.0)  # it must return an empty array
        return model
    key = (control.function, *control.breakpoints.tolist(), control.resolution, first, t_end)
    if model.driven is None or model.driven[0] != key:
        schedule = build_schedule(control, model.nu, first, t_end, positive)
        model.driven = key, model.with_schedule(schedule)
    return model.driven[1]


def _find_initial(model: Model, p: Array) -> Array:
    """Compute the model's initial controls (n or 1, nu).

    p (n or 1, np) are the parameters of the runs.
    """
    controls = np.array([model.control_at(row) for row in p]).reshape(len(p), model.nu)
    return controls[:1] if len(controls) and not np.ptp(controls, axis=0).any() else controls


def _read_table(controls: Any, nu: int, field: str, shapes: Sequence[str]) -> tuple[Array, str]:
    """Read a table of controls (n or 1, K, nu).

    `shapes` are the permitted shapes by their letters, such as "nKu", from one axis to most.
    Messages name `field`. Also returns the letters that name the axes of its original shape.
    """
    try:
        shape = np.shape(controls)
    except Exception:  # noqa: BLE001  finite_array rejects it by name
        shape = ()
    if 0 < len(shape) <= len(shapes) and shape[-1] == nu and 0 not in shape[:-1]:
        letters = shapes[len(shape) - 1]
        table = finite_array(field, controls, (*[None] * (len(letters) - 1), nu))
        table = table if "n" in letters else table[None]
        table = table if "K" in letters else table[:, None]
        return table if nu else table[:, :1], letters
    array = finite_array(field, controls, (None,) * len(shape))
    names = {"u": str(nu), "K": "intervals", "n": "n"}
    known = [", ".join(names[letter] for letter in letters) for letters in shapes]
    expected = (
        f"({known[0]},), ({'), ('.join(known[1:])}) or a function of time that returns ({nu},)"
        if nu
        else "(0,) or None, as this scene has no control"
    )
    raise ValueError(f"{field} has shape {array.shape}: give an array of shape {expected}")


def _read_profile(profile: ControlProfile, nu: int, t_end: float) -> Controls:
    edges = finite_array("control.time", profile.time, (None,))
    count = len(edges) - 1
    if count < 1 or edges[0] != 0 or edges[-1] != t_end or np.any(np.diff(edges) <= 0):
        raise ValueError(
            f"control.time is {edges}: give times that increase from 0 to t_end = {t_end:g}"
        )
    linear = len(profile.values) == count + 1
    values = finite_array("control.values", profile.values, (count + linear, nu))
    return Controls(values[None], edges, linear, profile.steps)


def _read_feedback(model: Model, feedback: Feedback, t_end: float) -> Controls:
    """Check feedback, and extend its updates to the run's end.

    The run ends at `t_end` [s].
    """
    given, known = feedback.controls.shape[1], feedback.states.shape[1]
    clock = known - model.moving.stop  # not fed back
    if given != model.nu or clock not in (0, 1):
        raise ValueError(
            f"controls is a Feedback of {given} controls and {known} states: the model has {model.nu} and {model.nx}"
        )
    if isinstance(model.scene.control, RestLength):
        _check_rest_lengths(feedback)
    edges = feedback.time
    period = edges[-1] - edges[-2]
    if t_end > 1e7 * period:  # bounds the memory
        raise ValueError(
            f"t_end is {t_end:g} s, more than 1e+07 control periods of {period:g} s: give a smaller t_end"
        )
    later = edges[-1] + period * np.arange(1, max(0, np.ceil((t_end - edges[-1]) / period)) + 1)
    edges = np.append(edges, later)
    edges = np.append(edges[edges < t_end - 1e-9 * period], t_end)
    return Controls(np.zeros((1, 1, model.nu)), edges, feedback=feedback)


def _check_rest_lengths(feedback: Feedback) -> None:
    """Check that feedback keeps rest lengths positive.

    Raises ValueError.
    """
    least = np.where(np.any(feedback.gains, axis=(0, 2)), -np.inf, feedback.controls.min(axis=0))
    bad = np.flatnonzero(
        (np.maximum(least, feedback.lower) < SMALLEST) | (feedback.upper < SMALLEST)
    )
    if bad.size:
        k = bad[0]
        limits = f"controls is a Feedback whose limits of string {k} are {feedback.lower[k]:g} and {feedback.upper[k]:g}"
        raise ValueError(
            f"{limits}: rest lengths (RestLength) must be greater than 0, give Feedback(lower=...) above it"
        )

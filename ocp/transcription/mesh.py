"""Mesh of a plan: intervals, control profiles, interpolation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Protocol

import casadi as ca
import numpy as np

from ocp.problem.reading import read_groups
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.schema.field_types import ListOf, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.casadi_tools import hermite_cubic
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import (
    MAX_COUNT,
    Array,
    IndexOrName,
    Indices,
    check_indices,
    finite_array,
    positive_number,
    whole,
    whole_number,
)

Intervals = int | Sequence[float]


def check_intervals(field: str, value: Any) -> int | tuple[float, ...]:
    """Check a number of intervals, or normalize their lengths.

    `value` is a number of intervals, or their lengths relative to each other. Lengths are divided
    by their sum. `field` names the argument in messages. Raises TypeError or ValueError.
    """
    if isinstance(value, (bool, np.bool_, int, np.integer, float, str)):
        return whole_number(field, value, 1, MAX_COUNT)
    shares = finite_array(field, value, (None,))
    if not shares.size:
        raise ValueError(
            f"{field} is empty: give a number of intervals, or their lengths relative to each other"
        )
    for k, share in enumerate(shares):
        positive_number(f"{field}[{k}]", share)
    return tuple((shares / shares.sum()).tolist())


def fractions(intervals: Intervals) -> Array:
    """Compute interval lengths (K,) as fractions of the duration."""
    if isinstance(intervals, (int, np.integer)):
        return np.full(int(intervals), 1 / int(intervals))
    return np.asarray(intervals, dtype=float)


class Profile(Protocol):
    """Interface of control profiles over the mesh intervals."""

    @property
    def linear(self) -> bool:
        """Whether controls are piecewise linear, not piecewise constant."""

    @property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Groups of strings that share one control value."""

    @property
    def max_changes(self) -> int | None:
        """Maximum number of control changes; None if unlimited."""


@dataclass(frozen=True)
class NamedProfile(Value):
    """Base class of control profiles with a name in files.

    `groups` are groups of strings that share one control value.
    """

    groups: Annotated[tuple[tuple[IndexOrName, ...], ...], ListOf(Members("input"))] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        groups = read_groups(f"{type(self).__name__}.groups", self.groups)
        object.__setattr__(self, "groups", groups)


@rename_fields(changes="max_changes")
@dataclass(frozen=True)
class PiecewiseConstant(NamedProfile, kind="PiecewiseConstant"):
    """Controls that are constant on each interval.

    Parameters
    ----------
    groups : sequence of sequences of int or str
        Groups of strings with the same control, such as images under a symmetry.
    max_changes : int, optional
        Maximum number of control changes, at nearly equal times (move blocking). By default they
        change from interval to interval.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or a string is given twice.

    Examples
    --------
    >>> import ocp
    >>> ocp.PiecewiseConstant(groups=[(0, 1, 2), (3, 4, 5)]).groups
    ((0, 1, 2), (3, 4, 5))
    >>> ocp.PiecewiseConstant(max_changes=4).max_changes
    4
    """

    linear: ClassVar[bool] = False
    max_changes: Annotated[int | None, whole(0)] = None


@dataclass(frozen=True)
class PiecewiseLinear(NamedProfile, kind="PiecewiseLinear"):
    """Controls that are continuous, and linear on each interval.

    Parameters
    ----------
    groups : sequence of sequences of int or str
        Groups of strings with the same control, such as images under a symmetry.

    Raises
    ------
    TypeError, ValueError
        If a group is not a sequence of strings, or a string is given twice.

    Examples
    --------
    >>> import ocp
    >>> ocp.PiecewiseLinear(groups=[(0, 1, 2), (3, 4, 5)]).groups
    ((0, 1, 2), (3, 4, 5))
    """

    linear: ClassVar[bool] = True
    max_changes: ClassVar[int | None] = None


def group_matrix(profile: Profile, strings: int) -> Array:
    """Build the 0/1 matrix (strings, groups) of control groups.

    `strings` is the number of strings. One in no group forms its own. Raises ValueError for a
    string that does not exist.
    """
    for k, group in enumerate(profile.groups):
        check_indices(f"{type(profile).__name__}.groups[{k}]", group, strings, "string")
    leader = np.arange(strings)
    for group in profile.groups:
        leader[list(group)] = min(group)
    return np.asarray(leader[:, None] == np.unique(leader)[None], dtype=float)


def list_groups(profile: Profile, strings: int) -> list[Indices]:
    """List the strings of each column of `group_matrix`."""
    return [np.flatnonzero(column) for column in group_matrix(profile, strings).T]


def spans(profile: Profile, fractions: Array) -> Indices:
    """Find the move block to which each interval belongs.

    Controls are constant within a block. `fractions` are the interval lengths relative to the
    duration. The result is the block's number (K,).
    """
    if profile.max_changes is None or profile.max_changes + 1 >= len(fractions):
        return np.arange(len(fractions))
    middle = np.cumsum(fractions) - np.asarray(fractions) / 2
    within = np.floor(middle * (profile.max_changes + 1) * (1 - 1e-12)).astype(np.intp)
    return np.asarray(np.unique(within, return_inverse=True)[1])


def node_values(held: Array, lengths: Array) -> Array:
    """Interpolate interval values at the mesh points.

    `held` are control values (K, α) of the intervals, `lengths` (K,) the interval lengths in any
    unit. The result is (K + 1, α).
    """
    if len(held) == 1:
        return np.repeat(held, 2, axis=0)
    left, right = lengths[:-1, None], lengths[1:, None]
    inner = (right * held[:-1] + left * held[1:]) / (left + right)
    return np.concatenate([held[:1], inner, held[-1:]])


def held_values(values: Array, intervals: int) -> Array:
    """Compute the mean control values on each interval.

    `values` are those of the intervals (K, α), returned unchanged, or of the mesh points (K + 1,
    α).
    """
    return values if len(values) == intervals else (values[:-1] + values[1:]) / 2


def profile_at(values: Array, nodes: Array, time: Array) -> Array:
    """Evaluate a control profile at given times.

    `values` belong to the intervals (K, α) or to the mesh points (K + 1, α). `nodes` are the times
    (K + 1,) of the mesh points, in the unit of `time`.
    """
    last = len(nodes) - 2
    k = np.clip(np.searchsorted(nodes, time, side="right") - 1, 0, last)
    if len(values) == last + 1:
        return np.asarray(values[k])
    share = np.clip((time - nodes[k]) / (nodes[k + 1] - nodes[k]), 0.0, 1.0)[..., None]
    return np.asarray((1 - share) * values[k] + share * values[k + 1])


def locate_share(fractions: Array, share: float) -> tuple[int, float]:
    """Find the interval that contains a fraction of the duration.

    The intervals have the lengths `fractions` (K,) relative to the duration. `share` is the
    fraction. Returns the index of the interval, and the position in it as a fraction of its length.
    """
    ends = np.cumsum(fractions)
    k = min(int(np.searchsorted(ends, share - 1e-9)), len(ends) - 1)
    part = float((share - ends[k] + fractions[k]) / fractions[k])
    return k, 1.0 if part > 1 - 1e-9 else part


def hermite_state(model: Model, x: Any, y: Any, h: Any, share: float) -> Any:
    """Evaluate the cubic Hermite interpolant of two states.

    `x` and `y` (nx,) are the states at the start and the end of an interval of length `h` [s], as
    arrays or expressions. `share` is the fraction of the interval, from 0 to 1.
    """
    if share == 1.0:
        return y
    s, (q0, v0, a0, clock0), (q1, v1, a1, clock1) = share, model.split(x), model.split(y)
    q = hermite_cubic(q0, v0, q1, v1, h, s)
    change = (q1 - q0) / h
    v = 6 * s * (1 - s) * change + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
    linear = ((1 - s) * first + s * last for first, last in ((a0, a1), (clock0, clock1)))
    parts = q, v, *linear
    return np.concatenate(parts) if isinstance(x, np.ndarray) else ca.vertcat(*parts)


@dataclass(frozen=True, eq=False)
class Guess(ReadOnlyArrays):
    """Initial guess of states and controls on equal intervals.

    Attributes
    ----------
    states : ndarray, shape (K + 1, nx)
        States [m, m/s].
    force_density : ndarray, shape (K, α)
        Controls: force densities [N/m], or rest lengths [m].
    duration : float
        Duration [s].
    noise : ndarray, shape (α,), or None
        Random change of the controls that leads away from a saddle point.
    """

    states: Array
    force_density: Array
    duration: float
    noise: Array | None = None

    def perturb(self, lower: Array, upper: Array) -> Guess:
        """Add the noise to the controls, within limits (α,)."""
        if self.noise is None:
            return self
        noisy = np.clip(self.force_density + self.noise, lower, upper)
        return replace(self, force_density=noisy, noise=None)


def on_mesh(model: Model, guess: Guess, fractions: Array, profile: Profile) -> Guess:
    """Convert a guess to another mesh and control profile.

    The given guess has equal intervals. `profile` is the new control profile. The new mesh has the
    interval lengths `fractions` (K,) relative to the duration. Interpolated states are projected
    onto the constraints of bars and joints.
    """
    intervals, nodes = len(guess.states) - 1, np.append(0.0, np.cumsum(fractions))
    if intervals == len(fractions) and np.ptp(fractions) < 1e-12:
        states, held = guess.states, guess.force_density
    else:
        before = np.linspace(0.0, 1.0, intervals + 1)
        states = np.column_stack([np.interp(nodes, before, column) for column in guess.states.T])
        states[1:-1] = project_states(model, states, 3)[1:-1]
        held = profile_at(guess.force_density, before, (nodes[:-1] + nodes[1:]) / 2)
    return Guess(states, node_values(held, fractions) if profile.linear else held, guess.duration)


def project_states(model: Model, states: Array, iterations: int) -> Array:
    """Project states (P, nx) onto the constraints of bars and joints.

    `iterations` is the number of Newton steps.
    """
    if not model.mechanism.constrained:
        return states
    return np.asarray(build_projection(model, iterations).map(len(states))(states.T).full()).T

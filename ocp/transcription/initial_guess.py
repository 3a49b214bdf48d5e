"""Initial guesses: motions on equal intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
import scipy.interpolate
from numpy.typing import ArrayLike

from ocp.problem.control import winds
from ocp.problem.problem import Problem
from ocp.targets.target import Target
from ocp.transcription.inverse_dynamics import inverse_dynamics
from ocp.transcription.mesh import Guess, profile_at, project_states
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.schema.field_types import PATH, TABLE
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    Array,
    finite_array,
    format_value,
    positive_number,
    whole_number,
)

NOISE = 0.3  # relative to the strongest force density


class NamedGuess(Value):
    """Initial guess with a kind in files."""


@runtime_checkable
class InitialGuess(Protocol):
    """Protocol of initial guesses."""

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on equal intervals."""


@dataclass(frozen=True, eq=False)
class InverseDynamics(NamedGuess, kind="InverseDynamics"):
    """Initial guess by inverse dynamics along a path of the nodes.

    Accelerations are linear in the force densities, which therefore follow from a small convex
    problem in each interval.

    Parameters
    ----------
    path : array_like, shape (P, n, 3), optional
        Nodes [m] at equal times from the start to the end. They are projected onto bars and joints.
        Default: a smooth line from the start to the goals, which is also the default of `solve`.
    noise : float, optional
        Largest random change of a force density, relative to the strongest. Symmetric guesses are
        often next to a saddle, which costs a solver many iterations. The noise is smaller if the
        motion lasts more than 16 rad of the fastest vibration. Rest lengths get none. Default: 0.3,
        which `Ipopt` adds only if it meets a saddle, or if the start is free.
    seed : int
        Seed of the noise. With other seeds than 0, it is always added.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> structure = tc.shapes.d_bar(pinned=[0])
    >>> model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> path = [structure.nodes, tc.shapes.d_bar(angle=0.7).nodes]
    >>> ocp.solve(problem, ocp.Variational(6), guess=ocp.InverseDynamics(path)).success
    True
    """

    path: Annotated[ArrayLike | None, PATH] = None
    noise: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.noise is not None:
            object.__setattr__(
                self, "noise", positive_number("InverseDynamics.noise", self.noise, zero=True)
            )
        whole_number("InverseDynamics.seed", self.seed, 0)
        if self.path is not None:
            array = finite_array("InverseDynamics.path", self.path, (None, None, 3))
            if len(array) < 2:
                raise ValueError(
                    f"InverseDynamics.path has {len(array)} instants: give at least the start and the end"
                )
            object.__setattr__(self, "path", array)

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on equal intervals.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Target state of its goals.
        intervals : int
            Number of intervals K.

        Returns
        -------
        Guess
            States (K + 1, nx), controls (K, α) and duration [s].

        Raises
        ------
        ValueError
            If the path has another number of nodes.
        """
        guess = (
            make_guess(problem, target, intervals)
            if self.path is None
            else self._along_path(problem, target, intervals, self.path)
        )
        noisy = _attach_noise(
            problem, guess, NOISE if self.noise is None else self.noise, self.seed
        )
        return (
            noisy
            if self.noise is None and self.seed == 0
            else noisy.perturb(*problem.control_limits)
        )

    @staticmethod
    def _along_path(problem: Problem, target: Target, intervals: int, given: ArrayLike) -> Guess:
        model, duration = problem.model, problem.typical_duration
        path = finite_array("InverseDynamics.path", given, (None, len(model.structure.nodes), 3))
        before = np.linspace(0.0, 1.0, len(path))
        degree = min(3, len(path) - 1)
        columns = path.reshape(len(path), -1, 3)[:, model.mechanism.physical].reshape(len(path), -1)
        free = model.mechanism.free_index
        spline = scipy.interpolate.make_interp_spline(
            before, model.mechanism.local(columns)[:, free], k=degree
        )
        return follow(
            problem, target, np.asarray(spline(np.linspace(0.0, 1.0, intervals + 1))), duration
        )


@dataclass(frozen=True)
class Equilibrium(NamedGuess, kind="Equilibrium"):
    """Initial guess at rest, under force densities holding the start.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> structure = tc.shapes.d_bar(pinned=[0])
    >>> model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> ocp.solve(problem, ocp.Variational(6), guess=ocp.Equilibrium()).success
    True
    """

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on equal intervals.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Target state of its goals.
        intervals : int
            Number of intervals K.

        Returns
        -------
        Guess
            States (K + 1, nx), controls (K, α) and duration [s].
        """
        duration = problem.typical_duration
        states = np.repeat(target.start[None], intervals + 1, axis=0)
        model = problem.model
        _, _, clock = model.split(states)
        clock += np.linspace(0.0, duration, intervals + 1)[:, None][:, : clock.shape[1]]
        return Guess(states, inverse_dynamics(problem, states, duration / intervals), duration)


@dataclass(frozen=True, eq=False)
class Arrays(NamedGuess, kind="Arrays"):
    """Initial guess of given arrays at equal times.

    Parameters
    ----------
    states : array_like, shape (P, nx)
        States of the model, from the start to the end.
    force_density : array_like, shape (Q, α)
        Force densities [N/m] of Q equal intervals.
    duration : float, optional
        Duration [s]. Default: that of the problem, or the middle of its range.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, or an array does not fit the model.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> structure = tc.shapes.d_bar(pinned=[0])
    >>> model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> known = ocp.solve(problem, ocp.Variational(6))
    >>> guess = ocp.Arrays(known.trajectory.states, known.force_density)
    >>> ocp.solve(problem, ocp.Variational(6), guess=guess).success
    True
    """

    states: Annotated[ArrayLike, TABLE]
    force_density: Annotated[ArrayLike, TABLE]
    duration: float | None = None

    def __post_init__(self) -> None:
        for name in ("states", "force_density"):
            object.__setattr__(
                self, name, finite_array(f"Arrays.{name}", getattr(self, name), (None, None))
            )
        if self.duration is not None:
            object.__setattr__(self, "duration", positive_number("Arrays.duration", self.duration))

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on equal intervals.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Target state of its goals.
        intervals : int
            Number of intervals K.

        Returns
        -------
        Guess
            States (K + 1, nx), controls (K, α) and duration [s].

        Raises
        ------
        ValueError
            If an array does not fit the model.
        """
        model = problem.model
        states = finite_array("Arrays.states", self.states, (None, model.nx))
        gamma = finite_array("Arrays.force_density", self.force_density, (None, model.nu))
        if len(states) < 2 or not len(gamma):
            raise ValueError(
                f"Arrays has {len(states)} states and {len(gamma)} rows of force densities: give at least 2 and 1"
            )
        middle = problem.typical_duration if self.duration is None else self.duration
        return resample(
            problem,
            target,
            states,
            np.linspace(0, 1, len(states)),
            gamma,
            np.linspace(0, 1, len(gamma) + 1),
            intervals,
            middle,
        )


def evaluate_guess(
    value: InitialGuess | None, problem: Problem, target: Target, intervals: int
) -> Guess:
    """Compute a guess; None stands for `InverseDynamics()`. Raises TypeError, ValueError."""
    value = InverseDynamics() if value is None else value
    if isinstance(value, type) or not isinstance(value, InitialGuess):
        raise TypeError(
            f"guess is {format_value(value)}: give ocp.InverseDynamics(), ocp.Equilibrium(), ocp.Arrays(states, force_density) or an ocp.Plan"
        )
    return value.guess(problem, target, intervals)


def resample(
    problem: Problem,
    target: Target,
    states: Array,
    state_shares: Array,
    gamma: Array,
    gamma_shares: Array,
    intervals: int,
    duration: float,
) -> Guess:
    """Resample states and controls on equal intervals.

    They begin at the start, on the constraints, and keep the limits. Raises ValueError.
    """
    shares = np.linspace(0.0, 1.0, intervals + 1)
    moved = project_states(
        problem.model,
        np.column_stack([np.interp(shares, state_shares, column) for column in states.T]),
        3,
    )
    if not problem.free_start:
        moved[0] = target.start
    lost = ~np.isfinite(moved).all(axis=1)
    if lost.any():
        share = shares[int(np.argmax(lost))]
        raise ValueError(
            f"guess has states at {share:.3g} of the duration that are no motion, such as bars without a length: give others"
        )
    lower, upper = problem.control_limits
    held = np.clip(profile_at(gamma, gamma_shares, (shares[:-1] + shares[1:]) / 2), lower, upper)
    return Guess(moved, held, float(np.clip(duration, problem.shortest, problem.longest)))


def _attach_noise(problem: Problem, guess: Guess, share: float, seed: int) -> Guess:
    """Attach noise, relative to the strongest force density."""
    if winds(problem.model):  # small changes of rest lengths are large changes of forces
        return guess
    change = np.random.default_rng(seed).uniform(size=guess.force_density.shape[1])
    strength = float(np.abs(guess.force_density).max()) or 1.0
    noise = np.asarray(share * _limit_noise(problem.model, guess) * strength * change)
    return replace(guess, noise=noise)


def _limit_noise(model: Model, guess: Guess) -> float:
    """Compute the share of the noise along which errors hardly grow.

    They grow at up to √noise times the rate of the fastest vibration.
    """
    middle = len(guess.force_density) // 2
    turned = fastest_rate(model, guess.states[middle], guess.force_density[middle]) * guess.duration
    return min(1.0, (16.0 / turned) ** 3) if turned > 0.0 else 1.0  # NaN: no rate is known


def make_guess(problem: Problem, target: Target, intervals: int) -> Guess:
    """Compute a smooth motion from start to target, without noise."""
    duration = problem.typical_duration
    return follow(
        problem, target, _interpolate(target, problem.model, intervals, duration), duration
    )


def follow(problem: Problem, target: Target, positions: Array, duration: float) -> Guess:
    """Compute the motion along free coordinates and its controls."""
    states = _build_states(problem, target, positions, duration)
    return Guess(states, inverse_dynamics(problem, states, duration / (len(states) - 1)), duration)


def _interpolate(target: Target, model: Model, intervals: int, duration: float) -> Array:
    """Interpolate coordinates from start to target, through the waypoints."""
    start, end = target.start, target.start if target.state is None else target.state
    s = np.linspace(0.0, 1.0, intervals + 1)[:, None]
    rise, fall = s**3 * (10 - 15 * s + 6 * s**2), -4 * s**3 + 7 * s**4 - 3 * s**5
    # `out` leaves with the start's velocity; `fall` arrives with the target's
    out = s - 6 * s**3 + 8 * s**4 - 3 * s**5
    (q0, v0, _), (q1, v1, _) = model.split(start), model.split(end)
    q = q0 + rise * (q1 - q0) + duration * (out * v0 + fall * v1)
    waypoints = [
        (one.share, one.target.state) for one in target.waypoints if one.target.state is not None
    ]
    if waypoints:
        places = [q0, *(model.split(state)[0] for _, state in waypoints), q1]
        rates = [(1, duration * v) for v in (v0, v1)]
        q = scipy.interpolate.CubicSpline(
            [0.0, *(share for share, _ in waypoints), 1.0], places, bc_type=tuple(rates)
        )(s[:, 0])
    return np.asarray(q)


def _build_states(problem: Problem, target: Target, q: Array, duration: float) -> Array:
    model, intervals = problem.model, len(q) - 1
    start = target.start
    clock = (
        model.split(start)[2]
        + np.linspace(0.0, duration, intervals + 1)[:, None][:, : model.nx - 2 * model.nq]
    )
    q, _, _ = model.split(project_states(model, np.column_stack([q, np.zeros_like(q), clock]), 10))
    v = np.empty_like(q)
    v[0], v[-1] = (
        model.split(state)[1] for state in (start, start if target.state is None else target.state)
    )
    v[1:-1] = (q[2:] - q[:-2]) * (intervals / (2 * duration))
    states = project_states(model, np.column_stack([q, v, clock]), 10)
    states[0] = start
    if target.state is not None:
        states[-1] = target.state
    if not np.all(np.isfinite(states)):  # a bar vanished on the way
        return np.repeat(start[None], intervals + 1, axis=0)
    return states

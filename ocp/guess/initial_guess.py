"""Initial guesses: trajectories on equal intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
import scipy.interpolate
from numpy.typing import ArrayLike

from ocp.guess.path import follow, make_guess, select_coordinates, stay_at_start
from ocp.problem.control import has_elastic_strings
from ocp.problem.problem import Problem
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, profile_at, project_states
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.schema.field_types import PATH, TABLE
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    Array,
    NonNegative,
    Positive,
    finite_array,
    format_value,
    whole,
)

NOISE = 0.3  # relative to the largest force density
NOISY = 16.0  # rad, phase of the fastest vibration above which the noise decreases


class NamedGuess(Value):
    """Initial guess with a name in problem files."""


@runtime_checkable
class InitialGuess(Protocol):
    """Protocol of initial guesses."""

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on intervals of equal duration.

        `target` has the initial and the final state; `intervals` is their number.
        """


@dataclass(frozen=True, eq=False)
class InverseDynamics(NamedGuess, kind="InverseDynamics"):
    """Initial guess by inverse dynamics along a path.

    The path gives the positions of all nodes. Accelerations are linear in the force densities,
    which therefore follow from a small convex problem in each interval.

    Parameters
    ----------
    path : array_like, shape (P, n, 3), optional
        Positions of all nodes [m] at P equally spaced times, from the start to the end. They are
        projected onto the constraints of bars and joints. Default: a smooth path from the start to
        the goals, which is also the default of `solve`.
    noise : float, optional
        Largest random change of a force density, relative to the largest force density. Symmetric
        guesses are often close to a saddle point, which costs a solver many iterations. The noise
        is smaller if the phase of the fastest vibration grows by more than 16 rad within the
        duration. Rest lengths get no noise. Default: 0.3, which `Ipopt` adds only if it meets a
        saddle point, or if the start is free.
    seed : int
        Seed of the noise. With seeds other than 0, the noise is always added.

    Raises
    ------
    TypeError, ValueError
        If a value has the wrong type or is out of range.

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
    noise: NonNegative | None = None
    seed: Annotated[int, whole(0)] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.path is not None and (count := len(np.asarray(self.path))) < 2:
            raise ValueError(
                f"InverseDynamics.path has {count} instants: give at least the start and the end"
            )

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on intervals of equal duration.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Initial state, and the final state nearest to the goals.
        intervals : int
            Number of intervals K.

        Returns
        -------
        Guess
            States (K + 1, nx), controls (K, α) and duration [s].

        Raises
        ------
        ValueError
            If the number of nodes in ``path`` differs from that of the structure.
        """
        guess = (
            make_guess(problem, target, intervals)
            if self.path is None
            else self._along_path(problem, target, intervals, self.path)
        )
        noisy = add_noise(problem, guess, NOISE if self.noise is None else self.noise, self.seed)
        return (
            noisy
            if self.noise is None and self.seed == 0
            else noisy.perturb(*problem.control_limits)
        )

    @staticmethod
    def _along_path(problem: Problem, target: Target, intervals: int, given: ArrayLike) -> Guess:
        model = problem.model
        path = finite_array("InverseDynamics.path", given, (None, len(model.structure.nodes), 3))
        before = np.linspace(0.0, 1.0, len(path))
        degree = min(3, len(path) - 1)
        spline = scipy.interpolate.make_interp_spline(
            before, select_coordinates(model, path.reshape(len(path), -1, 3)), k=degree
        )
        return follow(problem, target, np.asarray(spline(np.linspace(0.0, 1.0, intervals + 1))))


@dataclass(frozen=True)
class EquilibriumGuess(NamedGuess, kind="EquilibriumGuess", earlier="Equilibrium"):
    """Initial guess that is constant in time.

    All states equal the initial state. The controls balance it as well as their limits permit.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> structure = tc.shapes.d_bar(pinned=[0])
    >>> model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> ocp.solve(problem, ocp.Variational(6), guess=ocp.EquilibriumGuess()).success
    True
    """

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on intervals of equal duration.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Initial state, and the final state nearest to the goals.
        intervals : int
            Number of intervals K.

        Returns
        -------
        Guess
            States (K + 1, nx), controls (K, α) and duration [s].
        """
        return stay_at_start(problem, target, intervals)


@dataclass(frozen=True, eq=False)
class TrajectoryGuess(NamedGuess, kind="TrajectoryGuess", earlier="Arrays"):
    """Initial guess given by arrays at equally spaced times.

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
        If a value has the wrong type or is out of range, or if an array does not fit the model.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> structure = tc.shapes.d_bar(pinned=[0])
    >>> model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> known = ocp.solve(problem, ocp.Variational(6))
    >>> guess = ocp.TrajectoryGuess(known.trajectory.states, known.force_density)
    >>> ocp.solve(problem, ocp.Variational(6), guess=guess).success
    True
    """

    states: Annotated[ArrayLike, TABLE]
    force_density: Annotated[ArrayLike, TABLE]
    duration: Positive | None = None

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on intervals of equal duration.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Initial state, and the final state nearest to the goals.
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
        states = finite_array("TrajectoryGuess.states", self.states, (None, model.nx))
        gamma = finite_array("TrajectoryGuess.force_density", self.force_density, (None, model.nu))
        if len(states) < 2 or not len(gamma):
            raise ValueError(
                f"TrajectoryGuess has {len(states)} states and {len(gamma)} rows of force densities: give at least 2 and 1"
            )
        middle = problem.typical_duration if self.duration is None else self.duration
        return resample_guess(
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
    """Evaluate an initial guess; see `InitialGuess.guess`.

    `value` is the guess; None stands for `InverseDynamics`. Raises TypeError, ValueError.
    """
    value = InverseDynamics() if value is None else value
    if isinstance(value, type) or not isinstance(value, InitialGuess):
        raise TypeError(
            f"guess is {format_value(value)}: give ocp.InverseDynamics(), ocp.EquilibriumGuess(), "
            "ocp.TrajectoryGuess(states, force_density) or an ocp.Plan"
        )
    return value.guess(problem, target, intervals)


def resample_guess(
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

    States (n, nx) and controls `gamma` are given at fractions of the duration (`…_shares`).
    Controls are linear between these, or constant if there is one less. The states are projected
    onto the constraints; unless the start is free, the first one is the initial state, that of
    `target`. `intervals` is the number of equal intervals. Controls and duration are clipped to
    their limits. Raises ValueError if a projection fails.
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
            f"guess has states at {share:.3g} of the duration with infinite accelerations, as where a bar has no length: give others"
        )
    lower, upper = problem.control_limits
    held = np.clip(profile_at(gamma, gamma_shares, (shares[:-1] + shares[1:]) / 2), lower, upper)
    return Guess(moved, held, float(np.clip(duration, problem.shortest, problem.longest)))


def add_noise(problem: Problem, guess: Guess, share: float, seed: int) -> Guess:
    """Add random control noise to a guess, for saddle points.

    A solver uses it if it stops at a saddle point. It differs from string to string, which breaks
    symmetries. It is at most ``share`` times the largest force density or tension. Guesses of rest
    lengths get none. `seed` is that of the random numbers.
    """
    if has_elastic_strings(
        problem.model
    ):  # such relative changes of rest lengths are far from equilibrium
        return guess
    change = np.random.default_rng(seed).uniform(size=guess.force_density.shape[1])
    strength = float(np.abs(guess.force_density).max()) or 1.0
    noise = np.asarray(share * _limit_noise(problem.model, guess) * strength * change)
    return replace(guess, noise=noise)


def _limit_noise(model: Model, guess: Guess) -> float:
    """Compute a factor (at most 1) that reduces noise.

    Perturbations grow at a rate of up to √noise times that of the fastest vibration. The factor
    keeps this growth small in long plans. The vibration is that at the middle of the guess.
    """
    middle = len(guess.force_density) // 2
    turned = fastest_rate(model, guess.states[middle], guess.force_density[middle]) * guess.duration
    return min(1.0, (NOISY / turned) ** 3) if turned > 0.0 else 1.0  # NaN: the rate is unknown

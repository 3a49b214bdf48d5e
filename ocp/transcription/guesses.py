"""Where a solver may be told to start, as values: a path of nodes, equilibrium, another plan, arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.interpolate
from numpy.typing import ArrayLike

from ocp.boundary.target import Target
from ocp.plan.plan import Plan
from ocp.problem.problem import Problem
from ocp.transcription.initial_guess import Guess, follow, make_guess, settled
from ocp.transcription.mesh import at
from tenscasadi.integrators.stabilization import projection
from tenscasadi.util.validate import Array, finite_array, positive_number


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """The force densities that make nodes follow a path best: accelerations are linear in γ, a small convex problem in each interval.

    path: nodes (P, n, 3), m, at equal times from the start to the end, projected onto bars and joints; None: from the start to the
    goals along a smooth line, which is what `solve` does by itself.
    """

    path: ArrayLike | None = None

    def __post_init__(self) -> None:
        if self.path is not None:
            array = finite_array("InverseDynamics.path", self.path, (None, None, 3))
            if len(array) < 2:
                raise ValueError(f"InverseDynamics.path has {len(array)} instants: give at least the start and the end")
            object.__setattr__(self, "path", array)

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals. Raises ValueError where the path has another number of nodes."""
        if self.path is None:
            return make_guess(problem, target, intervals)
        model, duration = problem.model, (problem.shortest + problem.longest) / 2
        path = finite_array("InverseDynamics.path", self.path, (None, len(model.structure.nodes), 3))
        before = np.linspace(0.0, 1.0, len(path))
        degree = min(3, len(path) - 1)
        columns = path.reshape(len(path), -1, 3)[:, model.mechanism.physical].reshape(len(path), -1)
        free = np.flatnonzero(model.mechanism.free.ravel())
        spline = scipy.interpolate.make_interp_spline(before, columns[:, free], k=degree)
        return follow(problem, target, np.asarray(spline(np.linspace(0.0, 1.0, intervals + 1))), duration)


@dataclass(frozen=True)
class Equilibrium:
    """Nothing moves: the start for all times, under the force densities that hold it as nearly as they can."""

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals."""
        duration = (problem.shortest + problem.longest) / 2
        states = np.repeat(target.start[None], intervals + 1, axis=0)
        model = problem.model
        if model.nx > 2 * model.nq:
            states[:, 2 * model.nq :] += np.linspace(0.0, duration, intervals + 1)[:, None]
        return Guess(states, settled(problem, states), duration)


@dataclass(frozen=True, eq=False)
class Arrays:
    """States (P, nx) and force densities (Q, α), N/m, at and between equal times; duration: s, None: the problem's, or its middle."""

    states: ArrayLike
    force_density: ArrayLike
    duration: float | None = None

    def __post_init__(self) -> None:
        for name in ("states", "force_density"):
            object.__setattr__(self, name, finite_array(f"Arrays.{name}", getattr(self, name), (None, None)))
        if self.duration is not None:
            object.__setattr__(self, "duration", positive_number("Arrays.duration", self.duration))

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The guess on equal intervals. Raises ValueError naming the array that does not fit the model."""
        model = problem.model
        states = finite_array("Arrays.states", self.states, (None, model.nx))
        gamma = finite_array("Arrays.force_density", self.force_density, (None, model.nu))
        if len(states) < 2 or not len(gamma):
            raise ValueError(f"Arrays has {len(states)} states and {len(gamma)} rows of force densities: give at least 2 and 1")
        middle = (problem.shortest + problem.longest) / 2 if self.duration is None else self.duration
        return resampled(problem, target, states, np.linspace(0, 1, len(states)), gamma, np.linspace(0, 1, len(gamma) + 1), intervals, middle)


GuessValue = InverseDynamics | Equilibrium | Arrays | Plan


def guess_of(value: GuessValue | None, problem: Problem, target: Target, intervals: int) -> Guess:
    """The guess that a value stands for. Raises TypeError, ValueError, also for states that no projection puts onto bars and joints."""
    if value is None:
        return make_guess(problem, target, intervals)
    if isinstance(value, Plan):
        if value.trajectory.states.shape[1] != problem.model.nx or value.force_density.shape[1] != problem.model.nu:
            raise ValueError("guess is a plan for another structure: give one whose model has the same nodes and strings")
        shares = value.time / value.time[-1]
        return resampled(problem, target, value.trajectory.states, shares, value.force_density, shares, intervals, float(value.time[-1]))
    if not isinstance(value, (InverseDynamics, Equilibrium, Arrays)):
        raise TypeError(f"guess is {value!r}: give ocp.InverseDynamics(), ocp.Equilibrium(), ocp.Arrays(states, force_density) or an ocp.Plan")
    return value.guess(problem, target, intervals)


def resampled(
    problem: Problem, target: Target, states: Array, state_shares: Array, gamma: Array, gamma_shares: Array, intervals: int, duration: float
) -> Guess:
    """States and force densities at shares of the duration, moved to equal intervals, within the limits, from the problem's start."""
    shares = np.linspace(0.0, 1.0, intervals + 1)
    on_grid = np.column_stack([np.interp(shares, state_shares, column) for column in states.T])
    if problem.model.mechanism.constrained:
        on_grid = np.asarray(projection(problem.model, 3).map(len(shares))(on_grid.T).full()).T
    if not problem.free_start:
        on_grid[0] = target.start
    lost = ~np.isfinite(on_grid).all(axis=1)
    if lost.any():
        share = shares[int(np.argmax(lost))]
        raise ValueError(f"guess has states at {share:.3g} of the duration that are no motion, such as bars without a length: give others")
    lower, upper = problem.force_density_limits
    held = np.clip(at(gamma, gamma_shares, (shares[:-1] + shares[1:]) / 2), lower, upper)
    return Guess(on_grid, held, float(np.clip(duration, problem.shortest, problem.longest)))

"""Planning in reduced coordinates for models in full coordinates.

Reduced coordinates have no joint constraints. The trajectory does not depend on the coordinates,
and methods are faster in reduced ones.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ocp.guess.initial_guess import EquilibriumGuess, InitialGuess, InverseDynamics, TrajectoryGuess
from ocp.problem.expressions import AtEnd, Constraint, Integral
from ocp.problem.instant import Instant
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array, finite_array

_OWN = Constraint, Integral, AtEnd  # with user-defined expressions
_GUESSES = type(None), InverseDynamics, EquilibriumGuess, TrajectoryGuess, PlanResult


@dataclass(frozen=True)
class ReducedCoordinates:
    """Problem in full coordinates and its equivalent in reduced ones.

    Attributes
    ----------
    given : Problem
        Problem in full coordinates.
    problem : Problem
        Equivalent problem in reduced coordinates.
    """

    given: Problem
    problem: Problem

    def guess(self, value: InitialGuess | None) -> InitialGuess | None:
        """Convert an initial guess to reduced coordinates.

        `value` is the guess; None remains None. Raises ValueError for arrays of another size.
        """
        full = self.given.model
        if isinstance(value, TrajectoryGuess):
            return replace(
                value,
                states=_lowered(
                    self, finite_array("TrajectoryGuess.states", value.states, (None, full.nx))
                ),
            )
        if isinstance(value, PlanResult) and value.trajectory.states.shape[1] == full.nx:
            motion = replace(value.trajectory, states=_lowered(self, value.trajectory.states))
            return replace(value, trajectory=motion, model=self.problem.model, problem=self.problem)
        return value

    def restore(self, plan: PlanResult) -> PlanResult:
        """Convert a plan from reduced to full coordinates."""
        motion = replace(plan.trajectory, states=_lifted(self, plan.trajectory.states))
        return replace(plan, trajectory=motion, model=self.given.model, problem=self.given)

    def lower(self, motion: Trajectory) -> Trajectory:
        """Convert a trajectory from full to reduced coordinates."""
        return replace(motion, states=_lowered(self, motion.states))


def reduce_coordinates(problem: Problem, guess: InitialGuess | None) -> ReducedCoordinates | None:
    """Convert a problem from full to reduced coordinates.

    Returns None if the model has no joints, if bounds, costs or guess have classes from outside
    this package, or if the conversion fails. If constraints are redundant, bar forces are those in
    reduced coordinates.
    """
    model = problem.model
    own = all(
        type(item).__module__.startswith("ocp.") for item in (*problem.bounds, *problem.costs)
    )
    if not model.mechanism.joints or not own or not isinstance(guess, _GUESSES):
        return None
    try:
        twin = _in_reduced(model)
        bounds = [_seen(bound, model) for bound in problem.bounds]
        costs = [_seen(cost, model) for cost in problem.costs]
        start = _lower(model, twin, problem.initial_state)
        return ReducedCoordinates(
            problem, replace(problem, model=twin, start=start, bounds=bounds, costs=costs)
        )
    except (
        TypeError,
        ValueError,
        RuntimeError,
    ):  # such as for a state expression that is SX in one model and MX in the other
        return None


def _in_reduced(model: Model) -> Model:
    """Build the model of the same scene in reduced coordinates.

    The given model caches it, as its functions take time to build.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        return model.keep("reduced", lambda: model.with_scene(model.scene, "reduced"))


class _Seen(Instant):
    """Instant of a model in reduced coordinates, with full coordinates as state.

    User-defined expressions receive it. Tensions and bar forces are those of the model in reduced
    coordinates.
    """

    def __init__(self, model: Model, now: Instant) -> None:
        N, V, clock = now.model.unpack(now.state)
        own = now.model.split(now.state).internal
        columns = model.mechanism.physical.tolist()
        super().__init__(
            model, model.pack(N[:, columns], V[:, columns], own, clock), now.control, now.time
        )
        self._now = now

    @cached_property
    def tension(self) -> Any:
        """Tensions of the modeled strings [N]."""
        return self._now.tension

    @cached_property
    def bar_force(self) -> Any:
        """Bar forces [N]."""
        return self._now.bar_force


def _seen(item: Any, model: Model) -> Any:
    """Adapt a user-defined bound or cost to reduced coordinates.

    Its expression receives instants in the full coordinates of `model`. Other bounds and costs
    (`item`) remain unchanged.
    """
    if not isinstance(item, _OWN):
        return item
    expression: Callable[[Instant], Any] = item.expression  # type: ignore[assignment]
    return replace(item, expression=lambda now: expression(_Seen(model, now)))


def _lowered(twin: ReducedCoordinates, states: Array) -> Array:
    return _lower(twin.given.model, twin.problem.model, states)


def _lower(full: Model, reduced: Model, states: Array) -> Array:
    """Convert states (…, nx) from full to reduced coordinates."""
    mech = reduced.mechanism
    parts = (
        values(states).reshape(*states.shape[:-1], -1) for values in (full.nodes, full.velocities)
    )
    return np.concatenate(
        [*(mech.local(flat)[..., mech.free_index] for flat in parts), *full.split(states)[2:]],
        axis=-1,
    )


def _lifted(twin: ReducedCoordinates, states: Array) -> Array:
    """Convert states (…, nx) from reduced to full coordinates.

    `twin` is the problem in both.
    """
    full, reduced = twin.given.model, twin.problem.model
    parts = (
        values(states)[..., full.mechanism.physical, :]
        for values in (reduced.nodes, reduced.velocities)
    )
    return np.concatenate(
        [
            *(columns.reshape(*states.shape[:-1], -1) for columns in parts),
            *reduced.split(states)[2:],
        ],
        axis=-1,
    )

"""Planning in reduced coordinates for models in full coordinates, and for flat structures.

Reduced coordinates have no joint constraints. Those of a flat structure have no coordinates across
its plane, which it cannot leave. The trajectory does not depend on the coordinates, and methods are
faster in reduced ones.
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
from ocp.targets.invariants import AXES, conserves_momentum
from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array, finite_array

_OWN = Constraint, Integral, AtEnd  # with user-defined expressions
_GUESSES = type(None), InverseDynamics, EquilibriumGuess, TrajectoryGuess, PlanResult


@dataclass(frozen=True)
class ReducedCoordinates:
    """Problem in the model's coordinates and its equivalent in reduced ones.

    Attributes
    ----------
    given : Problem
        Problem in the model's coordinates.
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
        motion = replace(
            plan.trajectory,
            states=_convert(self.problem.model, self.given.model, plan.trajectory.states),
        )
        return replace(plan, trajectory=motion, model=self.given.model, problem=self.given)

    def lower(self, motion: Trajectory) -> Trajectory:
        """Convert a trajectory from full to reduced coordinates."""
        return replace(motion, states=_lowered(self, motion.states))


def reduce_coordinates(problem: Problem, guess: InitialGuess | None) -> ReducedCoordinates | None:
    """Convert a problem from the coordinates of its model to reduced ones.

    Returns None if the model has no joints and is not flat, if bounds, costs or guess have classes
    from outside this package, or if the conversion fails. If constraints are redundant, bar forces
    are those in reduced coordinates.
    """
    model = problem.model
    own = all(
        type(item).__module__.startswith("ocp.") for item in (*problem.bounds, *problem.costs)
    )
    scene = _pin_plane(problem)
    same = scene is model.scene and not model.mechanism.joints
    if same or not own or not isinstance(guess, _GUESSES):
        return None
    try:
        twin = _in_reduced(model, scene)
        bounds = [_seen(bound, model) for bound in problem.bounds]
        costs = [_seen(cost, model) for cost in problem.costs]
        start = _convert(model, twin, problem.initial_state)
        return ReducedCoordinates(
            problem, replace(problem, model=twin, start=start, bounds=bounds, costs=costs)
        )
    except (
        TypeError,
        ValueError,
        RuntimeError,
    ):  # such as for a state expression that is SX in one model and MX in the other
        return None


def _pin_plane(problem: Problem) -> Scene:
    """Pin the nodes of a flat structure across its plane.

    Returns the scene of the problem's model if the structure can leave a plane of two axes.
    """
    model, scene = problem.model, problem.model.scene
    structure = scene.structure
    if problem.free_start or structure.bodies or structure.rollers or not conserves_momentum(scene):
        return scene
    start, nodes = problem.initial_state, model.structure.nodes
    flat = (np.ptp(nodes, axis=0) == 0) & (model.nodes(start) == nodes).all(axis=0)
    flat &= ~model.velocities(start).any(axis=0) & ~structure.fixed.all(axis=0)
    if scene.gravity is not None:
        flat &= np.equal(scene.gravity.acceleration, 0)
    axes = np.flatnonzero(flat)
    if len(axes) != 1:
        return scene
    across = AXES[int(axes[0])]
    pins = {
        k: structure.pinned.get(k, "").replace(across, "") + across
        for k in range(len(structure.nodes))
    }
    return replace(scene, structure=structure.replace(pinned=pins))


def _in_reduced(model: Model, scene: Scene) -> Model:
    """Build the model of a scene in reduced coordinates.

    The given model caches it, as its functions take time to build.
    """
    pins = tuple(scene.structure.pinned.items())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        return model.keep(f"reduced {pins}", lambda: model.with_scene(scene, "reduced"))


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
    return _convert(twin.given.model, twin.problem.model, states)


def _convert(given: Model, other: Model, states: Array) -> Array:
    """Convert states (…, nx) between the coordinates of two models of a structure."""
    mech, given_parts = other.mechanism, (given.nodes, given.velocities)
    parts = (values(states)[..., mech.physical, :] for values in given_parts)
    flat = (columns.reshape(*states.shape[:-1], -1) for columns in parts)
    own = (mech.local(columns)[..., mech.free_index] for columns in flat)
    return np.concatenate([*own, *given.split(states)[2:]], axis=-1)

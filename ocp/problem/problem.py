"""Optimal control problems."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StringLimits,
    TensionLimits,
    combine_rates,
)
from ocp.problem.control import (
    controls_force_densities,
    controls_rest_lengths,
    has_elastic_strings,
)
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal
from ocp.problem.phase import Phase
from ocp.problem.reading import limits_of
from ocp.problem.resolved import fraction_of, resolve, string_limits
from ocp.problem.start import FreeStart
from tenscasadi.scene.breaking import Strength
from tenscasadi.scene.winches import Winch
from tenscasadi.schema.value import Value
from tenscasadi.structure.names import name_errors
from tenscasadi.util.immutable import keep
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.validate import NEGLIGIBLE, Array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model
    from tenscasadi.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Problem(Value, kind="Problem"):
    """Optimal control problem: model, duration, start, goals, bounds and costs.

    Parameters
    ----------
    model : Model
        Model of a scene with ``control=ForceDensity()`` or ``control=RestLength()``. With the
        latter, the rest lengths of elastic strings are the control, force densities follow, and
        strings may go slack.
    duration : float or (float, float), optional
        Duration [s], or its limits (shortest, longest), between which the solver chooses.
    start : array_like of shape (n, 3) or (nx,), or FreeStart, optional
        Initial nodes at rest [m], or initial state. None for the model's initial state;
        ``FreeStart(...)`` to let the solver choose. It is projected onto the constraints of bars
        and joints, which corrects rounding. `dataclasses.replace` keeps it, also for another model:
        give ``start=None`` for that of the model.
    goals : iterable of goals, optional
        Terminal constraints, such as `StringLengths`, `NodePositions`, `NodeVelocities`,
        `CenterOfMass`, `Shape`, `AtRest` and `Periodic`. A `Waypoint` has goals at another instant.
        Soft goals (`Goal.soft`) are added to the costs.
    bounds : iterable of bounds, optional
        Limits along the whole plan, such as `ForceDensityLimits`, `TensionLimits`, `BarClearance`
        and `Constraint`. `strength` adds limits of the tension; strings of `Problem.model` then
        cannot fail.
    costs : iterable of costs, optional
        Terms of the objective, such as `Effort`, `Tracking` and `Integral`; their sum is minimized.
        Without costs, all feasible plans are equally good; if a force density has no upper limit,
        the default is `Effort`.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; None for the
        nominal values. `Problem.model` is then the model with these values as constants, and
        `Problem.parameters` is None. `with_parameters` builds the same problem for other values.
    phases : sequence of Phase, optional
        Consecutive phases with contact between nodes and the scene's ground, as in jumps, landings
        and steps. Their durations replace that of the problem. The problem's goals hold at the end
        of the last phase.
    strength : Breaking or Yielding, optional
        Tensions at which strings fail. Default: `Scene.strength` of the model. It adds limits of
        the tension to the bounds, and plans are checked against it. `dataclasses.replace` keeps it,
        also for another model: give ``strength=None`` for that of the model, if any.

    Raises
    ------
    TypeError, ValueError
        If a value has the wrong type, does not fit the structure, or contradicts another value. The
        message names the field and the cure.

    See Also
    --------
    solve : Find a plan for a problem.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> problem = ocp.Problem(
    ...     model, duration=(0.5, 1.5), goals=[ocp.StringLengths({6: 0.9}), ocp.AtRest()], bounds=[ocp.ForceDensityLimits(0, 200)]
    ... )
    >>> problem.shortest, problem.longest
    (0.5, 1.5)
    """

    model: Model
    duration: float | tuple[float, float] = 1.0
    start: ArrayLike | FreeStart | None = None
    goals: Iterable[Goal] = ()
    bounds: Iterable[Bound] = ()
    costs: Iterable[Cost] = ()
    parameters: Any = None
    phases: Sequence[Phase] = ()
    strength: Strength | None = None
    given: Mapping[str, Any] = field(init=False, repr=False)  # the arguments as given

    fixed = RenamedAttribute("with_parameters")
    first_state = RenamedAttribute("initial_state")
    start_goals = RenamedAttribute("initial_goals")
    final_goals = RenamedAttribute("terminal_goals")
    repeating = RenamedAttribute("periodic_goals")

    @name_errors
    def __post_init__(self) -> None:
        arguments = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        given: dict[str, Any] = {  # iterators are read once
            name: tuple(value) if isinstance(value, Iterator) else value
            for name, value in arguments.items()
        }
        resolved = {**resolve(**given)._asdict(), "parameters": None, "given": given}
        vars(self).update(resolved)

    def __repr__(self) -> str:
        parts = [type(part).__name__ for part in (*self.goals, *self.bounds, *self.costs)]
        return f"Problem({', '.join([f'duration={self.duration}', *parts])})"

    def to_fields(self) -> dict[str, Any]:
        """Return the keyword arguments that build the problem again.

        ``parameters`` is omitted, as the model contains their values.
        """
        names = [field.name for field in fields(self) if field.init and field.name != "parameters"]
        return {name: getattr(self, name) for name in names}

    def with_parameters(self, parameters: Any) -> Problem:
        """Build the problem for other values of its model's parameters.

        Parameters
        ----------
        parameters : array_like, shape (np,), or mapping of str to array_like
            Values of all parameters, see `tenscasadi.ParameterLayout.values`. They replace those of
            this problem; parameters missing from a mapping have their nominal values.

        Returns
        -------
        Problem
            Problem with the original arguments and a model with these values as constants.

        Raises
        ------
        TypeError, ValueError
            If the model has no parameters, or a value is wrong.

        Examples
        --------
        >>> import ocp
        >>> import tenscasadi as tc
        >>> scene = tc.Scene(tc.shapes.d_bar(), control=tc.ForceDensity(), parameters=tc.Parameters("bar_mass"))
        >>> problem = ocp.Problem(tc.Model(scene), goals=[ocp.AtRest()])
        >>> problem.with_parameters({"bar_mass": 2.0}).model.structure.bar_mass.tolist()
        [2.0, 2.0, 2.0, 2.0]
        """
        if not self.given["model"].np:
            raise ValueError(
                "parameters are given, and Problem.model has none: give a problem that was made with a model of "
                "Scene(..., parameters=Parameters(...)); one from a file or of dataclasses.replace holds values alone"
            )
        return Problem(**{**self.given, "parameters": parameters})

    @property
    def scene(self) -> Scene:
        """Scene of the model, with the strength of its strings."""
        strength, scene = self.strength, self.model.scene
        if strength is None or (scene.commands_forces and not strength.breaks):
            return scene  # commanded forces do not yield
        return replace(scene, strength=strength)

    @property
    def shortest(self) -> float:
        """Shortest duration [s]."""
        return limits_of(self.duration)[0]

    @property
    def longest(self) -> float:
        """Longest duration [s]."""
        return limits_of(self.duration)[1]

    @property
    def typical_duration(self) -> float:
        """Duration of the initial guess [s].

        It is the mean of the limits, or their geometric mean if they are a factor of ten apart.
        """
        shortest, longest = self.shortest, self.longest
        if longest <= 10 * shortest:
            return (shortest + longest) / 2
        return float(np.sqrt(shortest * longest))

    @property
    def free_start(self) -> bool:
        """Whether the initial state is a decision variable."""
        return isinstance(self.start, FreeStart)

    @property
    def initial_state(self) -> Array:
        """Initial state (nx,).

        If it is free, this is its initial guess.
        """
        return np.asarray(self.start.near if isinstance(self.start, FreeStart) else self.start)

    @property
    def initial_goals(self) -> tuple[Goal, ...]:
        """Goals for a free initial state; empty without one."""
        return tuple(self.start.goals) if isinstance(self.start, FreeStart) else ()

    @property
    def terminal_goals(self) -> tuple[Goal, ...]:
        """Goals for the final state, without periodic goals.

        Goals of waypoints at the end are included.
        """
        return tuple(
            part
            for share, parts in self._instants
            if share == 1.0
            for part in parts
            if part not in self.periodic_goals
        )

    @property
    def periodic_goals(self) -> tuple[Any, ...]:
        """Goals that the final state equals a free initial state."""
        return tuple(goal for goal in self.goals if goal.repeats_start)

    @property
    def waypoints(self) -> list[tuple[float, tuple[Goal, ...]]]:
        """Goals before the end, with their fractions of the duration.

        They are in the order of time. Goals of one instant form one entry.
        """
        found: list[tuple[float, tuple[Goal, ...]]] = []
        for share, goals in sorted(self._instants, key=lambda pair: pair[0]):
            if found and share - found[-1][0] <= NEGLIGIBLE:
                found[-1] = found[-1][0], (*found[-1][1], *goals)
            elif share < 1.0:
                found.append((share, goals))
        return found

    @property
    def _instants(self) -> list[tuple[float, tuple[Goal, ...]]]:
        """All goals with their instants, as fractions of the duration."""
        return [
            (fraction_of(goal, self.duration), tuple(getattr(goal, "goals", (goal,))))
            for goal in self.goals
        ]

    def limits(self, kind: type[StringLimits]) -> tuple[Array, Array]:
        """Combine the limits of all bounds of a class.

        Parameters
        ----------
        kind : type
            `ForceDensityLimits`, `TensionLimits` or `RestLengthLimits`.

        Returns
        -------
        lower : numpy.ndarray, shape (α,) or (nu,)
            Lower limits of strings, or of cables and strings in no cable; −inf if there are none.
        upper : numpy.ndarray, shape (α,) or (nu,)
            Upper limits; inf if there are none.
        """
        structure = self.model.scene.structure
        limits = keep(self, (kind,), lambda: string_limits(structure, self.bounds, kind))
        return limits[0].copy(), limits[1].copy()

    @property
    def force_density_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (α,) of force densities [N/m].

        Lower limits are at least 0, as strings carry no compression.
        """
        lower, upper = self.limits(ForceDensityLimits)
        return np.maximum(lower, 0.0), upper

    @property
    def control_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (nu,) of the control.

        They limit force densities [N/m], tensions [N], rest lengths [m], their rates [m/s], or motor
        torques [N m].
        """
        if controls_force_densities(self.model):
            return self.force_density_limits
        if controls_rest_lengths(self.model):
            return self.rest_length_limits
        control = self.model.scene.control
        if isinstance(control, Winch):
            largest = control.limits("torque", self.model.nu)
            return -largest, largest
        if has_elastic_strings(self.model):
            largest = combine_rates(self.model.scene.structure, self.bounds)
            return -largest, largest
        lower, upper = self.limits(TensionLimits)
        return np.maximum(lower, 0.0), upper

    @property
    def rest_length_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (nu,) of rest lengths [m].

        Lower limits are at least 10⁻³ of the string lengths.
        """
        lower, upper = self.limits(RestLengthLimits)
        s = self.model.scene.structure
        return np.maximum(lower, 1e-3 * np.bincount(s.cable_of, weights=s.string_lengths)), upper

"""The problem of a plan: a model, how long, from where, to where, within which limits, at the least of which costs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import ForceDensityLimits, RestLengthLimits
from ocp.problem.control import winds
from ocp.problem.costs import Cost
from ocp.problem.goals.goal import Goal
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import INSTANT, Waypoint
from ocp.problem.phase import Phase
from ocp.problem.resolved import resolve, share_of, string_limits
from ocp.problem.start import FreeStart
from tenscasadi.dynamics.model import Model
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array

WIDE = (
    10.0  # times the shortest duration: beyond, the mean of the limits tells nothing about motions
)
SHORTEST = 1e-3  # of a string's length: the least rest length


@dataclass(frozen=True, eq=False)
class Problem(Value, kind="Problem"):
    """A plan that is asked for: a model, how long, from where, to where, within which limits, at the least of which costs.

    Parameters
    ----------
    model : Model
        The model, of a scene with ``control=ForceDensity()``; or with ``control=RestLength()``:
        then the plan decides the rest lengths of elastic strings, which may go slack, and their
        force densities follow.
    duration : float or (float, float), optional
        Seconds, or (shortest, longest) to let the solver choose.
    start : array_like of shape (n, 3) or (nx,), or FreeStart, optional
        Nodes at rest, m, or a state; None for the model's initial state; ``FreeStart(...)`` for a
        start that is found with the plan. Rounded numbers are put right.
    goals : iterable of goals, optional
        `StringLengths`, `NodePositions`, `NodeVelocities`, `CentreOfMass`, `Shape`, `AtRest`,
        `Periodic`, `Waypoint`: all met, at the end unless they say when; those that are `Goal.soft`
        join the costs.
    bounds : iterable of bounds, optional
        `ForceDensityLimits`, `TensionLimits`, `BarClearance`, `Constraint`, ...: all hold along the
        way.
    costs : iterable of costs, optional
        `Effort`, `Tracking`, `Integral`, ...: their sum is least. Without any, every motion will
        do; where force densities have no upper limits, `Effort` takes their place.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `tenscasadi.ParameterLayout.values`; nominal if None.
        `Problem.model` is then the model with these as constants (`Model.fixed`), and
        `Problem.parameters` is None. `fixed` asks the same with other values.
    phases : sequence of Phase, optional
        Parts of the plan in which nodes stand on the scene's ground, one after another: jumps,
        landings, steps. They have the durations; the problem's goals are met at the end of the
        last.

    Raises
    ------
    TypeError, ValueError
        If something is no number, value or model as described, does not fit the structure, or
        contradicts another; the message names the field and the cure.

    See Also
    --------
    solve : the plan of a problem.

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
    given: Mapping[str, Any] = field(init=False, repr=False)  # the arguments

    def __post_init__(self) -> None:
        given = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
        resolved = {**resolve(**given)._asdict(), "parameters": None, "given": given}
        for name, value in resolved.items():
            object.__setattr__(self, name, value)

    def to_fields(self) -> dict[str, Any]:
        """Return the keywords, without parameters: the model has their values."""
        names = [field.name for field in fields(self) if field.init and field.name != "parameters"]
        return {name: getattr(self, name) for name in names}

    def fixed(self, parameters: Any) -> Problem:
        """Return the problem with other values of its model's parameters.

        Parameters
        ----------
        parameters : array_like, shape (np,), or mapping of str to array_like
            Values, see `tenscasadi.ParameterLayout.values`, in place of all that the problem was
            made with; those that are not named are nominal.

        Returns
        -------
        Problem
            The problem as it was asked, of the model with these values as constants.

        Raises
        ------
        TypeError, ValueError
            The model has no parameters, or a value is wrong.

        Examples
        --------
        >>> import ocp
        >>> import tenscasadi as tc
        >>> scene = tc.Scene(tc.shapes.d_bar(), control=tc.ForceDensity(), parameters=tc.Parameters("bar_mass"))
        >>> problem = ocp.Problem(tc.Model(scene), goals=[ocp.AtRest()])
        >>> problem.fixed({"bar_mass": 2.0}).model.structure.bar_mass.tolist()
        [2.0, 2.0, 2.0, 2.0]
        """
        if not self.given["model"].np:
            raise ValueError(
                "parameters are given, and Problem.model has none: give a problem that was made with a model of "
                "Scene(..., parameters=Parameters(...)); one from a file or of dataclasses.replace holds values alone"
            )
        return Problem(**{**self.given, "parameters": parameters})

    @property
    def shortest(self) -> float:
        """The least duration, s."""
        return self.duration[0] if isinstance(self.duration, tuple) else self.duration

    @property
    def longest(self) -> float:
        """The greatest duration, s."""
        return self.duration[1] if isinstance(self.duration, tuple) else self.duration

    @property
    def typical_duration(self) -> float:
        """A duration to begin with, s: the mean of the limits; the geometric one where they are more than a factor of ten apart."""
        shortest, longest = self.shortest, self.longest
        return (
            (shortest + longest) / 2
            if longest <= WIDE * shortest
            else float(np.sqrt(shortest * longest))
        )

    @property
    def free_start(self) -> bool:
        """Whether the start is to be found."""
        return isinstance(self.start, FreeStart)

    @property
    def first_state(self) -> Array:
        """The start (nx,), or the state near which it is looked for."""
        return np.asarray(self.start.near if isinstance(self.start, FreeStart) else self.start)

    @property
    def start_goals(self) -> tuple[Goal, ...]:
        """The goals that a free start has to meet."""
        return tuple(self.start.goals) if isinstance(self.start, FreeStart) else ()

    @property
    def final_goals(self) -> tuple[Goal, ...]:
        """The goals that are met at the end, wherever the motion starts; also those of waypoints there."""
        last = [
            inner for share, waypoint in self._timed if share == 1.0 for inner in waypoint.goals
        ]
        return tuple(
            goal
            for goal in (*self.goals, *last)
            if not isinstance(goal, Waypoint) and goal not in self.repeating
        )

    @property
    def repeating(self) -> tuple[Periodic, ...]:
        """The goals that ask the end to repeat a start that is not known."""
        return tuple(
            goal for goal in self.goals if isinstance(goal, Periodic) and goal.start is None
        )

    @property
    def _timed(self) -> list[tuple[float, Waypoint]]:
        return [
            (share_of(goal, self.duration), goal)
            for goal in self.goals
            if isinstance(goal, Waypoint)
        ]

    @property
    def waypoints(self) -> list[tuple[float, Problem]]:
        """The goals before the end in their order: each a share of the duration, and the problem that ends there; those of one time are one."""
        found: list[tuple[float, list[Goal]]] = []
        for share, goal in sorted(self._timed, key=lambda pair: pair[0]):
            if share == 1.0:
                continue
            if not found or share - found[-1][0] > INSTANT:
                found.append((share, []))
            found[-1][1].extend(goal.goals)
        return [
            (
                share,
                replace(
                    self,
                    goals=goals,
                    bounds=(),
                    costs=(),
                    duration=(share * self.shortest, share * self.longest),
                ),
            )
            for share, goals in found
        ]

    def limits(self, kind: type) -> tuple[Array, Array]:
        """Return the limits that all bounds of one kind leave.

        Parameters
        ----------
        kind : type
            `ForceDensityLimits`, `TensionLimits` or `RestLengthLimits`.

        Returns
        -------
        lower : numpy.ndarray, shape (α,)
            Lower limits; −inf where there is none.
        upper : numpy.ndarray, shape (α,)
            Upper limits; inf where there is none.
        """
        return string_limits(self.model.scene.structure, self.bounds, kind)

    @property
    def force_density_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of γ (α,), N/m: at least 0, as strings do not push."""
        lower, upper = self.limits(ForceDensityLimits)
        return np.maximum(lower, 0.0), upper

    @property
    def control_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (α,) of what is decided: γ, N/m, or rest lengths, m, which are greater than 0."""
        if not winds(self.model):
            return self.force_density_limits
        lower, upper = self.limits(RestLengthLimits)
        return np.maximum(lower, SHORTEST * self.model.scene.structure.string_lengths), upper

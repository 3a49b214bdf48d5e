"""The problem of a plan: a model, how long, from where, to where, within which limits, at the least of which costs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import Bound
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    RestLengthLimits,
    StringLimits,
    TensionLimits,
)
from ocp.problem.control import check_control, refuse_wound, winds
from ocp.problem.costs import Cost, CostAt, Effort
from ocp.problem.expressions import check_expressions
from ocp.problem.goals.goal import BAR_TOLERANCE, Goal, SoftGoal, check_bar_lengths
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import INSTANT, Waypoint
from ocp.problem.phase import Phase, check_phases, phases_between, read_duration, read_items
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import projection
from tenscasadi.io.structure_section import OfStructure
from tenscasadi.schema.forms import STATE
from tenscasadi.schema.value import Value
from tenscasadi.util.read_only import read_only
from tenscasadi.util.validate import Array, finite_array, instance, nesting, shown

WIDE = (
    10.0  # times the shortest duration: beyond, the mean of the limits tells nothing about motions
)
SHORTEST = 1e-3  # of a string's length: the least rest length


@dataclass(frozen=True, eq=False)
class FreeStart(Value, kind="FreeStart"):
    """A start that the solver chooses, as for a gait, which repeats a motion that is not known before.

    Bars have their lengths at the start by constraints of their own; a clock starts as it does near
    ``near``.

    Parameters
    ----------
    near : array_like of shape (n, 3) or (nx,), optional
        Nodes at rest, m, or a state, where the start is looked for; None for the model's initial
        state.
    goals : iterable of goals, optional
        What the start has to meet, such as `NodePositions` of a node where nothing else says where
        on the ground a motion begins.

    Raises
    ------
    TypeError
        If goals are no goals, or `Waypoint`, `Periodic` or soft ones, which are goals of the
        problem.

    Examples
    --------
    >>> import ocp
    >>> ocp.FreeStart(goals=[ocp.AtRest()]).goals
    (AtRest(),)
    """

    near: Annotated[ArrayLike | None, OfStructure("nodes", STATE)] = None
    goals: Iterable[Goal] = ()

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "goals", read_items("FreeStart.goals", self.goals, Goal, "[AtRest()]")
        )
        for k, goal in enumerate(self.goals):
            if isinstance(goal, (Waypoint, Periodic, SoftGoal)):
                raise TypeError(
                    f"FreeStart.goals[{k}] is a {type(goal).__name__}: give it to the problem, goals of the start are of that instant alone"
                )


@dataclass(frozen=True, eq=False)
class Problem:
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

    def __post_init__(self) -> None:
        instance("Problem.model", self.model, Model, "a tenscasadi.Model")
        self.__dict__["_given"] = {field.name: getattr(self, field.name) for field in fields(self)}
        self.__dict__.update(model=self.model.fixed(self.parameters), parameters=None)
        check_control(self.model)
        if self.model.nq == 0:
            raise ValueError("Problem.model has all nodes pinned: there is nothing to move")
        own = self.__dict__
        own["phases"] = read_items("Problem.phases", self.phases, Phase, "[Phase(0.5)]")
        own["duration"] = read_duration("Problem.duration", self._whole_duration())
        own["goals"] = read_items("Problem.goals", self.goals, Goal, "[AtRest()]")
        divided = not own["phases"] and self._divide()
        if isinstance(self.start, type):
            raise TypeError(
                f"Problem.start is the class {self.start.__name__}: give {self.start.__name__}()"
            )
        if isinstance(self.start, FreeStart):
            if self.model.mechanism.joints or self.model.scene.supports is not None:
                raise ValueError(
                    'Problem.start is free, where bars alone are kept: give Model(scene, coordinates="reduced") without moved supports'
                )
            own["start"] = replace(self.start, near=self._state("FreeStart.near", self.start.near))
        else:
            own["start"] = self._state("Problem.start", self.start)
        for field, kinds, example in _KINDS:
            own[field] = read_items(f"Problem.{field}", getattr(self, field), kinds, example)
        structure = self.model.scene.structure
        for item in (*own["goals"], *own["bounds"], *own["costs"], *self.start_goals):
            item.check(structure)
        begin = None if self.free_start else self.first_state
        own["goals"] = tuple(goal.complete(self.model, begin) for goal in own["goals"])
        own["costs"] = tuple(
            cost.complete(self.model, begin) if isinstance(cost, SoftGoal) else cost
            for cost in own["costs"]
        )
        if isinstance(self.start, FreeStart):
            own["start"] = replace(
                self.start,
                goals=tuple(goal.complete(self.model, None) for goal in self.start.goals),
            )
        _ = self._timed  # refuses times that are none of the plan's
        self._check_limits()
        if not own["costs"] and np.isposinf(self.force_density_limits[1]).any():
            own["costs"] = (
                Effort(),
            )  # with nothing to keep them small, barriers of the solver let force densities grow without bound
        own["goals"], wishes = self._without_wishes()
        own["costs"] += wishes
        check_expressions(self.model, own["bounds"], own["costs"], begin)
        if own["phases"]:
            try:
                self._check_phases()
            except (TypeError, ValueError) as error:
                if not divided:
                    raise
                raise ValueError(
                    f"{error}; a range as Waypoint.time makes phases: or give one time, or a share"
                ) from None

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
        given: dict[str, Any] = self.__dict__["_given"]
        if not given["model"].np:
            raise ValueError(
                "parameters are given, and Problem.model has none: give a problem that was made with a model of "
                "Scene(..., parameters=Parameters(...)); one from a file or of dataclasses.replace holds values alone"
            )
        return Problem(**given | {"parameters": parameters})

    def _divide(self) -> bool:
        """Make waypoints of free times the ends of phases; tell whether there are any."""
        ways = [goal for goal in self.goals if isinstance(goal, Waypoint)]
        if not any(isinstance(way.time, tuple) for way in ways):
            return False
        for way in ways:
            way.check(self.model.scene.structure)
        goals = tuple(goal for goal in self.goals if goal not in ways)
        self.__dict__.update(goals=goals, phases=phases_between(ways, self.shortest, self.longest))
        return True

    def _check_phases(self) -> None:
        refuse_wound(self.model, "Problem.phases")
        if self.free_start:
            raise ValueError(
                "Problem.start is free, and phases begin where nodes stand: give the start"
            )
        check_phases(
            self.model,
            self.first_state,
            self.phases,
            self.__dict__["goals"],
            self.__dict__["bounds"],
            self.__dict__["costs"],
        )

    def _whole_duration(self) -> Any:
        """Return the duration that is given, or that of all phases."""
        phases: tuple[Phase, ...] = self.__dict__["phases"]
        if not phases:
            return self.duration
        last = phases[-1].until
        whole = read_duration(
            "Problem.duration",
            last
            if last is not None
            else (sum(phase.shortest for phase in phases), sum(phase.longest for phase in phases)),
        )
        if read_duration("Problem.duration", self.duration) not in (1.0, whole):
            raise ValueError(
                f"Problem.duration is {shown(self.duration)}, and phases have durations of their own: leave it out"
            )
        return whole

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
            (goal.at(self.shortest, self.longest), goal)
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
        structure = self.model.scene.structure
        given = [
            bound.limits(structure)
            for bound in self.bounds
            if isinstance(bound, kind) and isinstance(bound, StringLimits)
        ]
        count = len(structure.strings)
        lower = np.max([np.full(count, -np.inf), *(low for low, _ in given)], axis=0)
        upper = np.min([np.full(count, np.inf), *(up for _, up in given)], axis=0)
        return lower, upper

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

    def _state(self, field: str, given: ArrayLike | None) -> Array:
        """Read the state (nx,) that is given as nodes or as a state, on the constraints."""
        if given is None:
            return self.model.initial_state
        if nesting(given) == 1:
            state = finite_array(field, given, (self.model.nx,))
        else:
            nodes = finite_array(field, given, (len(self.model.structure.nodes), 3))
            try:
                state = self.model.state(nodes)
            except ValueError as error:
                raise ValueError(f"{field}: {error}") from None
        s, nodes, velocities = (
            self.model.structure,
            self.model.nodes(state),
            self.model.velocities(state),
        )
        check_bar_lengths(f"{field} makes", nodes, s)
        bars, rates = (Z[s.bars[:, 1]] - Z[s.bars[:, 0]] for Z in (nodes, velocities))
        stretch = abs(np.sum(bars * rates, axis=1)) / s.bar_lengths
        bad = np.flatnonzero(stretch > BAR_TOLERANCE * np.linalg.norm(velocities, axis=1).max())
        if bad.size:
            i = int(bad[0])
            raise ValueError(
                f"{field} stretches bar {i} by {stretch[i]:g} m/s: give velocities that keep the bars' lengths"
            )
        return read_only(np.asarray(projection(self.model, 10)(state).full()).ravel())  # type: ignore[no-any-return]

    def _without_wishes(self) -> tuple[tuple[Goal, ...], tuple[Cost, ...]]:
        """Return the goals that are met, and the costs of those that are not."""
        met: list[Goal] = []
        wished: list[Cost] = []
        for goal in self.goals:
            parts = list(goal.goals) if isinstance(goal, Waypoint) else [goal]
            soft = [part for part in parts if isinstance(part, SoftGoal)]
            share = goal.at(self.shortest, self.longest) if isinstance(goal, Waypoint) else 1.0
            wished += soft if share == 1.0 else [CostAt(part, share) for part in soft]
            if isinstance(goal, Waypoint) and 0 < len(soft) < len(parts):
                met.append(replace(goal, goals=tuple(part for part in parts if part not in soft)))
            elif not soft:
                met.append(goal)
        goals = [wish.cost if isinstance(wish, CostAt) else wish for wish in (*self.costs, *wished)]
        if any(
            isinstance(wish.goal, Periodic) and wish.goal.start is None
            for wish in goals
            if isinstance(wish, SoftGoal)
        ):
            raise ValueError(
                "Problem.goals has Periodic().soft(), and the start is free: give Periodic(start=...), or Periodic()"
            )
        return tuple(met), tuple(wished)

    def _check_limits(self) -> None:
        for kind in (ForceDensityLimits, TensionLimits, RestLengthLimits):
            lower, upper = self.limits(kind)
            crossed = np.flatnonzero(lower > upper)
            if crossed.size:
                i = int(crossed[0])
                raise ValueError(
                    f"Problem.bounds: {kind.__name__} leave string {i} nothing, lower {lower[i]:g} and upper {upper[i]:g}: widen one"
                )


_KINDS: tuple[tuple[str, type, str], ...] = (
    ("goals", Goal, "[AtRest()]"),
    ("bounds", Bound, "[ForceDensityLimits(0, 200)]"),
    ("costs", Cost, "[Effort()]"),
)

"""Reports of plans: the limits that a plan meets, what they cost, and those that it or its replay breaks, and when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint, RateBound
from ocp.problem.control import control_name, controls_rest_lengths
from ocp.problem.goals.goal import soft_goals
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.problem.rows import goal_rows
from ocp.solvers.multipliers import Duals
from ocp.transcription.mesh import profile_at
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array

MARGIN = 1e-4  # of a limit's range or size: nearer counts as held by it, farther beyond as broken


class Finding(NamedTuple):
    """One limit of one string, bar or node, and how a plan meets it.

    Attributes
    ----------
    name : str
        What is limited.
    side : str
        "lower" or "upper".
    limit, worst : float
        The limit, and the worst value, in `unit`.
    time : float
        When that occurs, s.
    share : float
        In which share of the instants the limit holds or is broken.
    unit : str
        Unit of limit and value.
    dual : float
        By how much the objective would fall for each unit by which the limit gave way, over the
        whole plan and to first order. NaN where it is not known: of what the replay breaks, and of
        the single strings of a group.
    """

    name: str
    side: str
    limit: float
    worst: float
    time: float
    share: float
    unit: str
    dual: float = np.nan

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        cost = (
            f", costs {self.dual:.3g} per {self.unit or 'unit'}" if np.isfinite(self.dual) else ""
        )
        worst = f"{self.worst:.6g}{unit} at t = {self.time:.4g} s, {self.share:.0%} of the time"
        return f"{self.name}: {self.side} limit {self.limit:g}{unit}, {worst}{cost}"


class Missed(NamedTuple):
    """One row of a soft goal (`Goal.soft`), and by how much the replay of a plan misses it.

    Attributes
    ----------
    name : str
        The row of the goal.
    miss : float
        By how much it is missed, in `unit`.
    unit : str
        "m" or "m/s".
    cost : float
        What that costs.
    """

    name: str
    miss: float
    unit: str
    cost: float

    def __str__(self) -> str:
        return f"{self.name}: missed by {self.miss:.4g} {self.unit}, costs {self.cost:.4g}"


@dataclass(frozen=True)
class Report:
    """Limits that hold a plan back, and those that it breaks; see `Plan.report`. It prints as a text.

    Attributes
    ----------
    active : tuple of Finding
        The limits that hold the plan back, the most costly first.
    violated : tuple of Finding
        Those that the plan oversteps, or its replay between the nodes of the mesh. What several
        bounds limit is told apart by the place of the bound, such as "obstacle clear of bar 0
        (bounds[2])".
    missed : tuple of Missed
        The rows of soft goals, the most costly first.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> cross = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> plan = ocp.solve(ocp.Problem(cross, goals=goals, bounds=[ocp.ForceDensityLimits(1.0)]), ocp.MultipleShooting(10))
    >>> report = plan.report()
    >>> report.active[0].name, report.active[0].side
    ('force density of string 0', 'lower')
    >>> report.violated
    ()
    """

    active: tuple[Finding, ...]
    violated: tuple[Finding, ...]
    missed: tuple[Missed, ...] = ()

    def __str__(self) -> str:
        lines = []
        for title, findings in (("active", self.active), ("violated", self.violated)):
            lines.append(f"{title}: {len(findings) or 'none'}")
            lines += [f"  {finding}" for finding in findings]
        if self.missed:
            lines += [f"soft goals: {len(self.missed)} rows", *(f"  {row}" for row in self.missed)]
        return "\n".join(lines)


def report_of(
    problem: Problem,
    time: Array,
    states: Array,
    controls: Array,
    replay: Trajectory,
    duals: Duals | None,
) -> Report:
    """Report the limits that are active at mesh points, and those that a plan or its replay violates."""
    planned = _planned_limits(problem, time, states, controls)
    replayed = _limits_of_instants(problem, replay.time, replay.states, replay.control)
    broken = [finding for one in (*planned, *replayed) for finding in one.findings(broken=True)]
    active = [
        finding._replace(dual=_find_dual(finding, duals))
        for finding in _merge(
            [finding for one in planned for finding in one.findings(broken=False)],
            lambda one: one.share,
        )
    ]
    return Report(
        tuple(sorted(active, key=lambda one: (-np.nan_to_num(one.dual), -one.share))),
        _merge(broken, lambda one: abs(one.worst - one.limit)),
        _measure_soft_goals(problem, replay),
    )


def violated_limits(
    problem: Problem, time: Array, states: Array, controls: Array
) -> tuple[Finding, ...]:
    """Find the limits that a plan violates at mesh points."""
    planned = _planned_limits(problem, time, states, controls)
    broken = [finding for one in planned for finding in one.findings(broken=True)]
    return _merge(broken, lambda one: abs(one.worst - one.limit))


def _planned_limits(
    problem: Problem, time: Array, states: Array, controls: Array
) -> list[_LimitedValues]:
    """Evaluate limits at both ends of every interval, under the controls within."""
    ends, before = np.append(time[:-1], time[1:]), np.append(time[:-1], time[1:] - 1e-9 * time[-1])
    both = np.concatenate([states[:-1], states[1:]])
    found = _limits_of_instants(problem, ends, both, profile_at(controls, time, before))
    return found + _limits_of_rates(problem, time, states, controls)


def _measure_soft_goals(problem: Problem, replay: Trajectory) -> tuple[Missed, ...]:
    """Measure the rows of all soft goals at their instants of a replay."""
    found, model = [], problem.model
    for share, goal in soft_goals(problem.costs):
        state = [
            np.interp(share * replay.time[-1], replay.time, column) for column in replay.states.T
        ]
        x = ca.SX.sym("x", model.nx)
        rows = goal_rows([goal], model, x)
        misses = np.abs(
            np.asarray(ca.Function("rows", [x], [ca.densify(rows.value)])(state).full()).ravel()
        )
        label = "" if share == 1.0 else f"waypoint at {share:.3g} of the duration, "
        named = zip(rows.names, misses.tolist(), rows.units, strict=True)
        found += [
            Missed(label + name, miss, unit, goal.weight * miss**2) for name, miss, unit in named
        ]
    return tuple(sorted(found, key=lambda one: -np.nan_to_num(one.cost, nan=np.inf)))


def _find_dual(finding: Finding, duals: Duals | None) -> float:
    if duals is None:
        return np.nan
    try:
        held = duals[finding.name]
    except KeyError:
        return np.nan
    return float(np.maximum(held if finding.side == "upper" else -held, 0.0).sum())


class _LimitedValues(NamedTuple):
    """Values (n, m) of limited quantities at times (n,)."""

    limited: PathConstraint
    time: Array
    values: Array

    def findings(self, broken: bool) -> list[Finding]:
        """Find the limits that are violated, or those that are active."""
        found = []
        lower, upper = self.limited.lower, self.limited.upper
        width = np.where(np.isfinite(upper - lower), upper - lower, np.inf)
        typical = np.abs(self.values).max(initial=0.0)
        for k, name in enumerate(self.limited.names):
            for side, limit, sign in (("lower", lower[k], -1.0), ("upper", upper[k], 1.0)):
                if not np.isfinite(limit):
                    continue
                excess = sign * (self.values[:, k] - limit)
                size = MARGIN * (min(width[k], max(abs(limit), typical)) or 1.0)
                hit = excess > (size if broken else -size)
                worst = int(np.argmax(excess))
                if hit.any() and (broken or excess[worst] <= size):
                    value, when, share = (
                        float(self.values[worst, k]),
                        float(self.time[worst]),
                        float(hit.mean()),
                    )
                    found.append(
                        Finding(name, side, float(limit), value, when, share, self.limited.unit)
                    )
        return found


def _limits_of_instants(
    problem: Problem, time: Array, states: Array, controls: Array
) -> list[_LimitedValues]:
    """Return what is decided, and what bounds limit of instants."""
    lower, upper = problem.control_limits
    names = tuple(f"{control_name(problem.model)} of string {k}" for k in range(len(lower)))
    own = _LimitedValues(
        PathConstraint(
            None,
            lower,
            upper,
            names,
            "m" if controls_rest_lengths(problem.model) else "N/m",
            (),
            (),
        ),
        time,
        controls,
    )
    values = [own]
    for one in path_constraints(problem, PathBound):
        when = slice(-1, None) if one.ends == ("last",) else slice(None)
        values.append(
            _evaluate(one, time[when], states[when].T, controls[when].T, time[None, when])
        )
    return values


def _limits_of_rates(
    problem: Problem, time: Array, states: Array, force_density: Array
) -> list[_LimitedValues]:
    """Return what bounds limit from each time for which a profile has force densities to the next."""
    x, u, t = states[: len(force_density)].T, force_density.T, time[: len(force_density)]
    if len(t) < 2:
        return []
    return [
        _evaluate(one, t[1:], x[:, :-1], u[:, :-1], x[:, 1:], u[:, 1:], np.diff(t)[None])
        for one in path_constraints(problem, RateBound)
    ]


def _evaluate(limited: PathConstraint, time: Array, *arguments: Array) -> _LimitedValues:
    return _LimitedValues(
        limited, time, np.asarray(limited.function.map(len(time))(*arguments).full()).T
    )


def _merge(findings: list[Finding], most: Callable[[Finding], float]) -> tuple[Finding, ...]:
    """One for each limit, the one that has most of something; those that hold longest come first."""
    best: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        key = finding.name, finding.side
        if key not in best or most(finding) > most(best[key]):
            best[key] = finding
    return tuple(sorted(best.values(), key=lambda finding: -finding.share))

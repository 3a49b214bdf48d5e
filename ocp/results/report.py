"""Reports of plans: active limits, their duals, and violations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, PathConstraint, RateBound
from ocp.problem.control import control_name, control_unit
from ocp.problem.goals.goal import soft_goals
from ocp.problem.path_constraints import compute_margins, path_constraints
from ocp.problem.problem import Problem
from ocp.problem.rows import goal_rows
from ocp.solvers.multipliers import Duals
from ocp.transcription.mesh import profile_at
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.cables import name_inputs
from tenscasadi.structure.names import find_named
from tenscasadi.util.validate import Array


class Finding(NamedTuple):
    """Active or violated limit of one string, bar or node.

    Attributes
    ----------
    name : str
        Name of the limited quantity.
    side : str
        "lower" or "upper".
    limit, worst : float
        The limit, and the extreme value of the quantity, in `unit`.
    time : float
        Time of the extreme value [s].
    share : float
        Fraction of the instants at which the limit is active or violated.
    unit : str
        Unit of limit and value.
    dual : float
        Decrease of the objective per unit of relaxation of the limit over the whole plan, to first
        order. NaN if unknown, as for violations, and for single strings of a control group.
    member : str
        The user's name of the string, bar or node; "" if it has none.
    """

    name: str
    side: str
    limit: float
    worst: float
    time: float
    share: float
    unit: str
    dual: float = np.nan
    member: str = ""

    def __str__(self) -> str:
        member = f" ({self.member})" if self.member else ""
        unit = f" {self.unit}" if self.unit else ""
        cost = (
            f", costs {self.dual:.3g} per {self.unit or 'unit'}" if np.isfinite(self.dual) else ""
        )
        worst = f"{self.worst:.6g}{unit} at t = {self.time:.4g} s, {self.share:.0%} of the time"
        return f"{self.name}: {self.side} limit {self.limit:g}{unit}, {worst}{cost}{member}"


class Missed(NamedTuple):
    """Residual of one row of a soft goal (`Goal.soft`).

    The residual is that of the replay.

    Attributes
    ----------
    name : str
        Name of the row.
    miss : float
        Residual in `unit`.
    unit : str
        "m" or "m/s".
    cost : float
        Contribution to the objective.
    """

    name: str
    miss: float
    unit: str
    cost: float

    def __str__(self) -> str:
        return f"{self.name}: missed by {self.miss:.4g} {self.unit}, costs {self.cost:.4g}"


@dataclass(frozen=True)
class Report:
    """Active limits, violated limits and soft goals of a plan.

    `Plan.report` returns it. It prints as text.

    Attributes
    ----------
    active : tuple of Finding
        Active limits in decreasing order of their duals.
    violated : tuple of Finding
        Limits that the plan violates at mesh points, or its replay between them. If several bounds
        limit the same quantity, the name has the index of the bound, such as "obstacle clear of bar
        0 (bounds[2])".
    missed : tuple of Missed
        Residuals of soft goals in decreasing order of their costs.

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
    """Build the report of a plan.

    The plan has times (K + 1,) [s], states (K + 1, nx), and controls (K, nu) or (K + 1, nu).
    `duals` are None if unknown. Limits are active at mesh points. Violations are those of the plan
    at mesh points, and those of its replay.
    """
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
    structure = problem.model.scene.structure

    def name(findings: Sequence[Finding]) -> tuple[Finding, ...]:
        members = (", ".join(find_named(one.name, structure).values()) for one in findings)
        return tuple(
            one._replace(member=member) for one, member in zip(findings, members, strict=True)
        )

    return Report(
        name(sorted(active, key=lambda one: (-np.nan_to_num(one.dual), -one.share))),
        name(_merge(broken, lambda one: abs(one.worst - one.limit))),
        _measure_soft_goals(problem, replay),
    )


def violated_limits(
    problem: Problem, time: Array, states: Array, controls: Array
) -> tuple[Finding, ...]:
    """Find the limits that a plan violates at mesh points.

    The plan has times (K + 1,) [s], states (K + 1, nx), and controls (K, nu) or (K + 1, nu).
    """
    planned = _planned_limits(problem, time, states, controls)
    broken = [finding for one in planned for finding in one.findings(broken=True)]
    return _merge(broken, lambda one: abs(one.worst - one.limit))


def _planned_limits(
    problem: Problem, time: Array, states: Array, controls: Array
) -> list[_LimitedValues]:
    """Evaluate a plan's limits at both ends of every interval.

    Both ends have the controls of the interval.
    """
    ends, before = np.append(time[:-1], time[1:]), np.append(time[:-1], time[1:] - 1e-9 * time[-1])
    both = np.concatenate([states[:-1], states[1:]])
    found = _limits_of_instants(problem, ends, both, profile_at(controls, time, before))
    return found + _limits_of_rates(problem, time, states, controls)


def _measure_soft_goals(problem: Problem, replay: Trajectory) -> tuple[Missed, ...]:
    """Compute residuals and costs of soft goals in a replay.

    The most costly come first.
    """
    found, model = [], problem.model
    for share, goal in soft_goals(problem.costs):
        state = [
            np.interp(share * replay.time[-1], replay.time, column) for column in replay.states.T
        ]
        x = ca.SX.sym("x", model.nx)
        rows = goal_rows([goal], model, x)
        misses = np.abs(ca.Function("rows", [x], [ca.densify(rows.value)])(state).full().ravel())
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
    """Values of limited quantities along a trajectory.

    Attributes
    ----------
    limited : PathConstraint
        The m quantities and their limits.
    time : ndarray, shape (n,)
        Times [s].
    values : ndarray, shape (n, m)
        Values, in the units of the quantities.
    """

    limited: PathConstraint
    time: Array
    values: Array

    def findings(self, broken: bool) -> list[Finding]:
        """List the violated limits if `broken`, otherwise the active ones."""
        found = []
        lower, upper = self.limited.lower, self.limited.upper
        margins = compute_margins(self.values, lower, upper)
        for k, name in enumerate(self.limited.names):
            sides = ("lower", lower[k], -1.0), ("upper", upper[k], 1.0)
            for (side, limit, sign), size in zip(sides, margins[:, k].tolist(), strict=True):
                if not np.isfinite(limit):
                    continue
                excess = sign * (self.values[:, k] - limit)
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
    """Evaluate the controls and all path constraints at given times.

    Terminal limits are evaluated at the last time only.
    """
    lower, upper = problem.control_limits
    inputs = name_inputs(problem.model.scene.structure)
    names = tuple(f"{control_name(problem.model)} of {name}" for name in inputs)
    own = _LimitedValues(
        PathConstraint(
            None,
            lower,
            upper,
            names,
            control_unit(problem.model),
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
    """Evaluate limited rates between successive control values.

    These are those of force densities and rest lengths, at times (K + 1,) with states (K + 1, nx).
    """
    x, u, t = states[: len(force_density)].T, force_density.T, time[: len(force_density)]
    if len(t) < 2:
        return []
    return [
        _evaluate(one, t[1:], x[:, :-1], u[:, :-1], x[:, 1:], u[:, 1:], np.diff(t)[None])
        for one in path_constraints(problem, RateBound)
    ]


def _evaluate(limited: PathConstraint, time: Array, *arguments: Array) -> _LimitedValues:
    return _LimitedValues(limited, time, limited.function.map(len(time))(*arguments).full().T)


def _merge(findings: list[Finding], most: Callable[[Finding], float]) -> tuple[Finding, ...]:
    """Keep one finding for each limit.

    It is the one with the largest value of `most`. Findings that are active or violated longest
    come first.
    """
    best: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        key = finding.name, finding.side
        if key not in best or most(finding) > most(best[key]):
            best[key] = finding
    return tuple(sorted(best.values(), key=lambda finding: -finding.share))

"""Which limits a plan meets, what they cost, and which its replay breaks: by string, bar or node, and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.bounds import CornerBound, ForceDensityLimits, Limited, PathBound
from ocp.duals import Duals
from ocp.grid import at
from ocp.instant import symbolic
from ocp.problem import Problem
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array

TOUCHES = 1e-4  # of a limit's range or size: nearer counts as held by it
BREAKS = 1e-4  # of the same: beyond counts as broken


class Finding(NamedTuple):
    """One limit of one member: how much of the plan it holds (share of the instants), the worst value and when it occurs, s.

    price: by how much the objective would fall for each unit by which the limit gave way, over the whole plan and to first order; NaN
    where it is not known: of what the replay breaks, and of the single strings of a group.
    """

    name: str
    side: str  # "lower" or "upper"
    limit: float
    worst: float
    time: float
    share: float
    unit: str
    price: float = np.nan

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        cost = f", costs {self.price:.3g} per {self.unit or 'unit'}" if np.isfinite(self.price) else ""
        worst = f"{self.worst:.6g}{unit} at t = {self.time:.4g} s, {self.share:.0%} of the time"
        return f"{self.name}: {self.side} limit {self.limit:g}{unit}, {worst}{cost}"


@dataclass(frozen=True)
class Report:
    """active: the limits that hold the plan back, the most costly first; violated: those that its replay, on a finer grid, oversteps.

    Prints as a text.
    """

    active: tuple[Finding, ...]
    violated: tuple[Finding, ...]

    def __str__(self) -> str:
        lines = []
        for title, findings in (("active", self.active), ("violated by the replay", self.violated)):
            lines.append(f"{title}: {len(findings) or 'none'}")
            lines += [f"  {finding}" for finding in findings]
        return "\n".join(lines)


def report_of(problem: Problem, time: Array, states: Array, force_density: Array, replay: Trajectory, duals: Duals | None) -> Report:
    """The limits of `problem` that hold at the ends of a plan's intervals, and those that its replay breaks between them."""
    planned = _findings(problem, time[:-1], states[:-1], at(force_density, time, time[:-1]), TOUCHES, inside=True)
    # the ends of intervals are planned for too, under the force densities before them
    planned += _findings(problem, time[1:], states[1:], at(force_density, time, time[1:] - 1e-9 * time[-1]), TOUCHES, inside=True)
    broken = _findings(problem, replay.time, replay.states, replay.control, BREAKS, inside=False)
    active = [finding._replace(price=_price(finding, duals)) for finding in _merged(planned)]
    return Report(tuple(sorted(active, key=lambda one: (-np.nan_to_num(one.price), -one.share))), _merged(broken))


def _price(finding: Finding, duals: Duals | None) -> float:
    if duals is None:
        return np.nan
    try:
        held = duals[finding.name]
    except KeyError:
        return np.nan
    return float(np.maximum(held if finding.side == "upper" else -held, 0.0).sum())


def _findings(problem: Problem, time: Array, states: Array, controls: Array, margin: float, inside: bool) -> list[Finding]:
    found = []
    lower, upper = problem.force_density_limits
    names = tuple(f"force density of string {k}" for k in range(len(lower)))
    found += _compare(controls, lower, upper, names, "N/m", time, margin, inside)
    for bound in problem.bounds:
        if isinstance(bound, ForceDensityLimits):
            continue
        if isinstance(bound, PathBound):
            now = symbolic(problem.model)
            limited = bound.limited(now)
            if limited.names:
                function = ca.Function("value", [now.state, now.control, now.time], [ca.densify(limited.value)]).map(len(time))
                found += _of(limited, function(states.T, controls.T, time[None]), time, margin, inside)
        elif isinstance(bound, CornerBound) and inside and len(time) > 1:
            before, after = symbolic(problem.model), symbolic(problem.model)
            h = type(before.state).sym("h")
            limited = bound.limited_between(before, after, h)
            inputs = [before.state, before.control, after.state, after.control, h]
            function = ca.Function("value", inputs, [ca.densify(limited.value)]).map(len(time) - 1)
            values = function(states[:-1].T, controls[:-1].T, states[1:].T, controls[1:].T, np.diff(time)[None])
            found += _of(limited, values, time[1:], margin, inside)
    return found


def _of(limited: Limited, values: ca.DM, time: Array, margin: float, inside: bool) -> list[Finding]:
    return _compare(np.asarray(values.full()).T, limited.lower, limited.upper, limited.names, limited.unit, time, margin, inside)


def _compare(values: Array, lower: Array, upper: Array, names: tuple[str, ...], unit: str, time: Array, margin: float, inside: bool) -> list[Finding]:
    found = []
    spread = np.where(np.isfinite(upper - lower), upper - lower, np.inf)
    typical = np.abs(values).max(initial=0.0)
    for k, name in enumerate(names):
        for side, limit, sign in (("lower", lower[k], -1.0), ("upper", upper[k], 1.0)):
            if not np.isfinite(limit):
                continue
            excess = sign * (values[:, k] - limit)
            size = margin * (min(spread[k], max(abs(limit), typical)) or 1.0)
            hit = excess > -size if inside else excess > size
            if hit.any():
                worst = int(np.argmax(excess))
                found.append(Finding(name, side, float(limit), float(values[worst, k]), float(time[worst]), float(hit.mean()), unit))
    return found


def _merged(findings: list[Finding]) -> tuple[Finding, ...]:
    """One for each limit, the one that holds longest; longest first."""
    best: dict[tuple[str, str], Finding] = {}
    for finding in findings:
        key = finding.name, finding.side
        if key not in best or finding.share > best[key].share:
            best[key] = finding
    return tuple(sorted(best.values(), key=lambda finding: -finding.share))

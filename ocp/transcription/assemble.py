"""Limits and costs along a plan as blocks over the intervals of a grid, the same for every transcription."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ocp.boundary.target import Target
from ocp.problem.bounds import PathBound, RateBound
from ocp.problem.costs import ControlCost, Cost, FinalCost, RunningCost, Smoothness
from ocp.problem.instant import Instant, symbolic
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.transcription.mesh import Profile, cubic, within
from ocp.transcription.sparse_nlp import Block, Unknowns
from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices


class Layout(Protocol):
    """Where a program keeps its unknowns, in references of `Unknowns`: see `ocp.program.Assembly`."""

    problem: Problem
    model: Model
    scales: Scales
    strength: float
    profile: Profile
    spread: Array
    fractions: Array
    count: int
    unknowns: Unknowns
    states: Indices
    controls: Indices
    duration: Indices
    share: Indices
    time: Indices

    @property
    def interval_controls(self) -> Indices:
        """References to what `gamma` needs in each interval."""

    def gamma(self, local: Any, share: float) -> Any:
        """Force densities (α,) at a share of an interval, from its entries of `interval_controls`."""

    def repeated(self, reference: Indices, count: int | None = None) -> Indices:
        """The same references (n,) for every instance."""


def bound_blocks(a: Layout) -> list[Block]:
    """Limits of instants, at the ends of every interval, and from each time for which the profile has force densities to the next."""
    limits = scaled_rows(a.problem, PathBound, a.scales, a.strength)
    blocks = [_at_end(a, rows, end) for rows in limits for end in rows.ends]
    if a.problem.free_start:  # a given one has been checked
        blocks += [_at_start(_at_end(a, rows, "start"), len(rows.names)) for rows in limits if "start" not in rows.ends]
    if len(a.controls) > 1:
        blocks += [_between(a, rows) for rows in scaled_rows(a.problem, RateBound, a.scales, a.strength)]
    return blocks


def cost_blocks(a: Layout) -> list[Block]:
    """All costs: integrals interval by interval, differences of neighbours pair by pair, the end once."""
    return [_cost(a, cost) for cost in a.problem.costs if not (isinstance(cost, Smoothness) and len(a.controls) == 1)]


def waypoint_blocks(a: Layout, target: Target) -> list[Block]:
    """The rows of all waypoints, each of the ends of the interval that it lies in."""
    blocks, nx = [], a.model.nx
    for number, waypoint in enumerate(target.waypoints):
        if not waypoint.target.count:
            continue
        k, share = within(a.fractions, waypoint.share)
        x, y, T, part = (ca.MX.sym("z", size) for size in (nx, nx, 1, 1))
        state = y if share == 1.0 else cubic(a.model, x, y, T * part, share)
        function = ca.Function("waypoint", [ca.vertcat(x, y, T, part)], [waypoint.target.rows(state)])
        names = tuple(f"goal of waypoint {number}, combination {row}" for row in range(waypoint.target.count))
        blocks.append(Block(function, np.concatenate([a.states[k], a.states[k + 1], a.duration, a.share[k]])[None], names, kind="waypoint"))
    return blocks


def _at_end(a: Layout, rows: ScaledRows, end: str) -> Block:
    share, at_end = (0.0, slice(-1)) if end == "start" else (1.0, slice(1, None))
    x, c, T, part = symbols(rows.function, a.model.nx, a.interval_controls.shape[1], 1, 1)
    function = ca.Function("bound", [ca.vertcat(x, c, T, part)], [rows.function(x, a.gamma(c, share), T * part)])
    index = np.hstack([a.states[at_end], a.interval_controls, a.repeated(a.duration), a.time[at_end]])
    names = tuple(f"{name}, {end} of interval {k}" for k in range(a.count) for name in rows.names)
    return Block(function, index, names, rows.lower, rows.upper, rows.scale, kind="path")


def _at_start(block: Block, count: int) -> Block:
    return replace(block, index=block.index[:1], names=block.names[:count])


def _between(a: Layout, rows: ScaledRows) -> Block:
    nx, m, pairs = a.model.nx, a.controls.shape[1], len(a.controls) - 1
    E = sparse(a.spread)
    x, c, y, d, T, part = symbols(rows.function, nx, m, nx, m, 1, 1)
    value = rows.function(x, ca.mtimes(E, c), y, ca.mtimes(E, d), T * part)
    duration = a.repeated(a.duration, pairs)
    index = np.hstack([a.states[:pairs], a.controls[:-1], a.states[1 : pairs + 1], a.controls[1:], duration, a.share[:pairs]])
    names = tuple(f"{name}, end of interval {k}" for k in range(pairs) for name in rows.names)
    return Block(ca.Function("between", [ca.vertcat(x, c, y, d, T, part)], [value]), index, names, rows.lower, rows.upper, rows.scale, kind="path")


def _cost(a: Layout, cost: Cost) -> Block:
    if isinstance(cost, Smoothness):
        z, value, index = _differences(a, cost)
    elif isinstance(cost, ControlCost):
        z = ca.SX.sym("z", a.interval_controls.shape[1] + 2)
        value = _integral(a, cost, z[:-2], z[-2] * z[-1])
        index = np.hstack([a.interval_controls, a.repeated(a.duration), a.share])
    elif isinstance(cost, RunningCost):
        z, value, index = _simpson(a, cost)
    elif isinstance(cost, FinalCost):
        x, c, T = symbols(symbolic(a.model).state, a.model.nx, a.interval_controls.shape[1], 1)
        z, value = ca.vertcat(x, c, T), cost.final(Instant(a.model, x, a.gamma(c, 1.0), T))
        index = np.concatenate([a.states[-1], a.interval_controls[-1], a.duration])[None]
    else:
        raise TypeError(f"Problem.costs has {cost!r}: give a ControlCost, RunningCost or FinalCost")
    return Block(ca.Function("cost", [z], [value]), index, ("cost",) * len(index), kind="cost")


def _differences(a: Layout, cost: Smoothness) -> tuple[Any, Any, Indices]:
    """Between neighbours: from middle to middle of intervals, or from end to end of linear profiles."""
    width = a.controls.shape[1]
    z = ca.SX.sym("z", 2 * width + 2)
    pair = ca.mtimes(sparse(a.spread), ca.reshape(z[: 2 * width], width, 2))
    spacing = a.fractions if a.profile.linear else (a.fractions[1:] + a.fractions[:-1]) / 2
    constants = [a.repeated(a.duration, len(spacing)), a.unknowns.constant(spacing[:, None])]
    return z, cost.expression(pair, z[-2] * z[-1]), np.hstack([a.controls[:-1], a.controls[1:], *constants])


def _integral(a: Layout, cost: ControlCost, local: Any, interval: Any) -> Any:
    """Of one interval; of linear profiles by Gauss's rule of two points, exact for squares."""
    if not a.profile.linear:
        return cost.expression(a.gamma(local, 0.0), interval)
    points = ca.horzcat(*(a.gamma(local, 0.5 + offset / np.sqrt(12)) for offset in (-1, 1)))
    return cost.expression(points, interval / 2)


def _simpson(a: Layout, cost: RunningCost) -> tuple[Any, Any, Indices]:
    """By Simpson's rule, the middle on the cubic between the ends: what swings within intervals would be hidden from the ends alone."""
    now = symbolic(a.model)
    rate = ca.Function("rate", [now.state, now.control, now.time], [cost.rate(now)])
    nx = a.model.nx
    parts = symbols(rate, nx, nx, a.interval_controls.shape[1], 1, 1, 1, 1)
    x, y, c, T, part, start, end = parts
    ends = rate(x, a.gamma(c, 0.0), T * start) + rate(y, a.gamma(c, 1.0), T * end)
    middle = rate(cubic(a.model, x, y, T * part, 0.5), a.gamma(c, 0.5), T * (start + end) / 2)
    value = T * part / 6 * (ends + 4 * middle)
    index = [a.states[:-1], a.states[1:], a.interval_controls, a.repeated(a.duration), a.share, a.time[:-1], a.time[1:]]
    return ca.vertcat(*parts), value, np.hstack(index)


def symbols(like: Any, *sizes: int) -> tuple[Any, ...]:
    """Symbols of these sizes: SX where `like`, a Function or an expression, is scalar code, else MX."""
    scalar = like.is_a("SXFunction") if isinstance(like, ca.Function) else isinstance(like, ca.SX)
    return tuple((ca.SX if scalar else ca.MX).sym("z", size) for size in sizes)

"""The program of a plan: path constraints, goals and costs as blocks over the mesh, put together with the defects of a transcription."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.control import winds
from ocp.problem.costs import ControlCost, Cost, CostAt, FinalCost, RunningCost, Smoothness
from ocp.problem.instant import Instant, symbolic
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.transcription.mesh import hermite_state, locate_share
from ocp.transcription.sparse_nlp import (
    Block,
    Program,
    Separable,
    gathered,
    split_symbol,
    symbol_kind,
)
from ocp.transcription.variables import Variables
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Indices, shown


class ProblemBlocks(NamedTuple):
    """Blocks of path constraints and goals, and of costs."""

    rows: list[Block]
    costs: list[Block]


class Defects(NamedTuple):
    """Blocks of what makes a motion of the variables: rows that vanish where the discretised equations of motion hold.

    states: None, or, where not all states are unknowns, from the column of all entries (in the
    order of `Variables.entries`) to all states (nx, K + 1).
    """

    rows: list[Block]
    states: Callable[[Any], Any] | None = None


class Stage(NamedTuple):
    """The variables of a plan, or of one of its phases, and all blocks in them."""

    variables: Variables
    blocks: ProblemBlocks
    defects: Defects

    @property
    def rows(self) -> list[Block]:
        """All rows, named after the phase."""
        v = self.variables
        return [
            replace(block, names=tuple(name + v.suffix for name in block.names))
            for block in (*start_blocks(v), *self.defects.rows, *self.blocks.rows)
        ]

    def states(self, entries: Any) -> Any:
        """Return the states (nx, K + 1) from the column of all entries."""
        if self.defects.states is None:
            return gathered(entries, self.variables.states)
        return self.defects.states(entries)


def problem_blocks(v: Variables) -> ProblemBlocks:
    """Build the blocks of path constraints, goals and costs."""
    return ProblemBlocks([*path_blocks(v), *waypoint_blocks(v), *end_blocks(v)], cost_blocks(v))


def assemble(stages: Sequence[Stage], linkage: Sequence[Block] = ()) -> Program:
    """Build the program of a plan, or of its phases, which share their entries.

    linkage: rows in entries of several phases.
    """
    variables = [stage.variables for stage in stages]
    first = variables[0]
    unknowns, place = first.entries.ordered()
    rows = [block for stage in stages for block in stage.rows] + list(linkage)
    costs = [block for stage in stages for block in stage.blocks.costs]
    rows, costs = ([block.relabelled(place) for block in blocks] for blocks in (rows, costs))
    objective = sum(v.objective for v in variables)
    parts = Separable(unknowns, rows, costs, 1 / objective)
    entries = unknowns.entries(parts.w)[place.tolist()]
    states = ca.horzcat(*(stage.states(entries) for stage in stages))
    decided = np.concatenate([v.controls for v in variables])
    controls = ca.mtimes(sparse(first.group_matrix), gathered(entries, decided))
    durations = gathered(entries, np.concatenate([v.duration for v in variables])[:, None])
    noise = None
    if first.noise is not None:
        noise = np.zeros(unknowns.count)
        noise[place[decided]] = first.noise
        noise /= unknowns.scale
    lower, upper, scale = (
        np.concatenate(columns) for columns in zip(*(block.limits() for block in rows), strict=True)
    )
    return Program(
        parts,
        w_lower=unknowns.lower / unknowns.scale,
        w_upper=unknowns.upper / unknowns.scale,
        first=unknowns.first / unknowns.scale,
        lower=lower,
        upper=upper,
        scale=scale,
        objective=objective,
        unpack=ca.Function("unpack", [parts.w], [states, controls, durations]),
        states=place[np.concatenate([v.states for v in variables])],
        controls=place[decided]
        if not first.profile.linear and len(np.unique(decided)) == decided.size
        else None,
        together=first.group_matrix,
        contact=any(v.model.scene.ground is not None for v in variables),
        noise=noise,
    )


def path_blocks(v: Variables) -> list[Block]:
    """Return limits of instants, at the ends of every interval, and from each time for which the profile has force densities to the next."""
    limits = scaled_rows(v.problem, PathBound, v.scales, v.strength)
    blocks = [_at_end(v, rows, end) for rows in limits for end in rows.ends]
    if v.problem.free_start:  # a given one has been checked
        blocks += [
            _only(0, _at_end(v, rows, "start"), len(rows.names))
            for rows in limits
            if rows.ends == ("end",)
        ]
    if len(v.controls) > 1:
        blocks += [
            _between(v, rows) for rows in scaled_rows(v.problem, RateBound, v.scales, v.strength)
        ]
    return blocks


def cost_blocks(v: Variables) -> list[Block]:
    """Return all costs: integrals interval by interval, differences of neighbours pair by pair, the end once."""
    return [
        _cost(v, cost)
        for cost in v.problem.costs
        if not (isinstance(cost, Smoothness) and len(v.controls) == 1)
    ]


def start_blocks(v: Variables) -> list[Block]:
    """Return the rows that hold at a free start alone."""
    free = v.target.free_start
    count = 0 if free is None else free.start.size1_out(0)
    if free is None or not count:
        return []
    return [
        Block(
            free.start,
            v.states[:1],
            tuple(f"start, combination {k} of bars and goals" for k in range(count)),
            kind="start",
        )
    ]


def waypoint_blocks(v: Variables) -> list[Block]:
    """Return the rows of all waypoints, each of the ends of the interval that it lies in."""
    blocks, nx = [], v.model.nx
    for number, waypoint in enumerate(v.target.waypoints):
        if not waypoint.target.count:
            continue
        k, share = locate_share(v.fractions, waypoint.share)
        z, (x, y, T, part) = split_symbol(ca.MX, nx, nx, 1, 1)
        state = y if share == 1.0 else hermite_state(v.model, x, y, T * part, share)
        function = ca.Function("waypoint", [z], [waypoint.target.rows(state)])
        names = tuple(
            f"goal of waypoint {number}, combination {row}" for row in range(waypoint.target.count)
        )
        blocks.append(
            Block(
                function,
                np.concatenate([v.states[k], v.states[k + 1], v.duration, v.share[k]])[None],
                names,
                kind="waypoint",
            )
        )
    return blocks


def end_blocks(v: Variables) -> list[Block]:
    """Return the rows of goals at the end, and those of an end that repeats the start."""
    blocks, target, free = [], v.target, v.target.free_start
    if target.count:
        names = tuple(f"goal, combination {k}" for k in range(target.count))
        blocks.append(
            Block(target.single, v.states[-1:], names, combination=target.weights, kind="end")
        )
    if free is not None and free.reduction.names:
        names = tuple(
            f"goal of repeating, combination {k}" for k in range(free.repeats.size1_out(0))
        )
        z, ends = split_symbol(ca.SX, v.model.nx, v.model.nx)
        function = ca.Function("repeats", [z], [free.repeats(*ends)])
        blocks.append(
            Block(function, np.hstack([v.states[:1], v.states[-1:]]), names, kind="periodic")
        )
    return blocks


def _at_end(v: Variables, rows: ScaledRows, end: str) -> Block:
    share, at_end = (0.0, slice(-1)) if end == "start" else (1.0, slice(1, None))
    z, (x, c, T, part) = split_symbol(
        symbol_kind(rows.function), v.model.nx, v.interval_controls.shape[1], 1, 1
    )
    function = ca.Function("bound", [z], [rows.function(x, v.gamma(c, share), T * part)])
    index = np.hstack(
        [v.states[at_end], v.interval_controls, v.repeated(v.duration), v.time[at_end]]
    )
    side = "start" if end == "start" else "end"
    names = tuple(f"{name}, {side} of interval {k}" for k in range(v.count) for name in rows.names)
    block = Block(function, index, names, rows.lower, rows.upper, rows.scale, kind="path")
    return _only(v.count - 1, block, len(rows.names)) if end == "last" else block


def _only(k: int, block: Block, count: int) -> Block:
    """Return instance k of a block with `count` names for each."""
    return replace(
        block, index=block.index[k : k + 1], names=block.names[k * count : (k + 1) * count]
    )


def _between(v: Variables, rows: ScaledRows) -> Block:
    nx, m, pairs = v.model.nx, v.controls.shape[1], len(v.controls) - 1
    E = sparse(v.group_matrix)
    z, (x, c, y, d, T, part) = split_symbol(symbol_kind(rows.function), nx, m, nx, m, 1, 1)
    value = rows.function(x, ca.mtimes(E, c), y, ca.mtimes(E, d), T * part)
    duration = v.repeated(v.duration, pairs)
    index = np.hstack(
        [
            v.states[:pairs],
            v.controls[:-1],
            v.states[1 : pairs + 1],
            v.controls[1:],
            duration,
            v.share[:pairs],
        ]
    )
    names = tuple(f"{name}, end of interval {k}" for k in range(pairs) for name in rows.names)
    return Block(
        ca.Function("between", [z], [value]),
        index,
        names,
        rows.lower,
        rows.upper,
        rows.scale,
        kind="rate",
    )


def _cost(v: Variables, cost: Cost) -> Block:
    if isinstance(cost, Smoothness):
        z, value, index = _differences(v, cost)
    elif isinstance(cost, ControlCost) and winds(v.model):
        z, value, index = _simpson(v, lambda now: cost.expression(now.force_density, 1.0))
    elif isinstance(cost, ControlCost):
        z = ca.SX.sym("z", v.interval_controls.shape[1] + 2)
        value = _integral(v, cost, z[:-2], z[-2] * z[-1])
        index = np.hstack([v.interval_controls, v.repeated(v.duration), v.share])
    elif isinstance(cost, RunningCost):
        z, value, index = _simpson(v, cost.rate)
    elif isinstance(cost, CostAt):
        z, value, index = _passing(v, cost)
    elif isinstance(cost, FinalCost):
        z, (x, c, T) = split_symbol(
            type(symbolic(v.model).state), v.model.nx, v.interval_controls.shape[1], 1
        )
        value = cost.final(Instant(v.model, x, v.gamma(c, 1.0), T))
        index = np.concatenate([v.states[-1], v.interval_controls[-1], v.duration])[None]
    else:
        raise TypeError(
            f"Problem.costs has {shown(cost)}: give a ControlCost, RunningCost or FinalCost"
        )
    return Block(ca.Function("cost", [z], [value]), index, ("cost",) * len(index), kind="cost")


def _passing(v: Variables, cost: CostAt) -> tuple[Any, Any, Indices]:
    """At a share of the duration, on the cubic between the ends of the interval in which it lies."""
    k, share = locate_share(v.fractions, cost.share)
    final = ca.Function("final", (now := symbolic(v.model)).symbols, [cost.cost.final(now)])
    z, (x, y, c, T, part) = split_symbol(
        symbol_kind(final), v.model.nx, v.model.nx, v.interval_controls.shape[1], 1, 1
    )
    state = y if share == 1.0 else hermite_state(v.model, x, y, T * part, share)
    index = np.concatenate(
        [v.states[k], v.states[k + 1], v.interval_controls[k], v.duration, v.share[k]]
    )
    return z, final(state, v.gamma(c, share), T * cost.share), index[None]


def _differences(v: Variables, cost: Smoothness) -> tuple[Any, Any, Indices]:
    """Between neighbours: from middle to middle of intervals, or from end to end of linear profiles."""
    width = v.controls.shape[1]
    z = ca.SX.sym("z", 2 * width + 2)
    pair = ca.mtimes(sparse(v.group_matrix), ca.reshape(z[: 2 * width], width, 2))
    spacing = v.fractions if v.profile.linear else (v.fractions[1:] + v.fractions[:-1]) / 2
    constants = [v.repeated(v.duration, len(spacing)), v.entries.constants(spacing[:, None])]
    return (
        z,
        cost.expression(pair, z[-2] * z[-1]),
        np.hstack([v.controls[:-1], v.controls[1:], *constants]),
    )


def _integral(v: Variables, cost: ControlCost, local: Any, interval: Any) -> Any:
    """Of one interval; of linear profiles by Gauss's rule of two points, exact for squares."""
    if not v.profile.linear:
        return cost.expression(v.gamma(local, 0.0), interval)
    points = ca.horzcat(*(v.gamma(local, 0.5 + offset / np.sqrt(12)) for offset in (-1, 1)))
    return cost.expression(points, interval / 2)


def _simpson(v: Variables, expression: Callable[[Instant], Any]) -> tuple[Any, Any, Indices]:
    """By Simpson's rule, the middle on the cubic between the ends: what swings within intervals would be hidden from the ends alone."""
    now = symbolic(v.model)
    rate = ca.Function("rate", now.symbols, [expression(now)])
    nx = v.model.nx
    z, (x, y, c, T, part, start, end) = split_symbol(
        symbol_kind(rate), nx, nx, v.interval_controls.shape[1], 1, 1, 1, 1
    )
    ends = rate(x, v.gamma(c, 0.0), T * start) + rate(y, v.gamma(c, 1.0), T * end)
    middle = rate(
        hermite_state(v.model, x, y, T * part, 0.5), v.gamma(c, 0.5), T * (start + end) / 2
    )
    value = T * part / 6 * (ends + 4 * middle)
    index = [
        v.states[:-1],
        v.states[1:],
        v.interval_controls,
        v.repeated(v.duration),
        v.share,
        v.time[:-1],
        v.time[1:],
    ]
    return z, value, np.hstack(index)

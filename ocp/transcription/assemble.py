"""Assembly of nonlinear programs from constraints and costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.costs import ControlTerm, InstantTerm, cost_terms
from ocp.problem.instant import symbolic
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.targets.target import Target
from ocp.transcription.base import Defects, Transcription
from ocp.transcription.mesh import Guess, hermite_state, locate_share
from ocp.transcription.sparse_nlp import (
    Block,
    Kind,
    Program,
    Separable,
    gather,
    split_symbol,
)
from ocp.transcription.variables import Variables
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.validate import Indices

# term of the objective: symbol z, expression in z, entries (instances, size of z)
_Summand = tuple[Any, Any, Indices]


class ProblemBlocks(NamedTuple):
    """Constraints and costs of a problem, without its dynamics.

    Attributes
    ----------
    rows, costs : list of Block
        Blocks of constraints, and of cost terms.
    """

    rows: list[Block]
    costs: list[Block]


class Stage(NamedTuple):
    """Decision variables, constraints and costs of a phase.

    A plan without phases is one stage.

    Attributes
    ----------
    variables : Variables
        Decision variables on the mesh of the phase.
    blocks : ProblemBlocks
        Constraints and costs without the dynamics.
    defects : Defects
        Discretized equations of motion.
    """

    variables: Variables
    blocks: ProblemBlocks
    defects: Defects

    @property
    def rows(self) -> list[Block]:
        """All constraints, with the phase in their names."""
        v = self.variables
        return [
            replace(block, names=tuple(name + v.suffix for name in block.names))
            for block in (*build_start_blocks(v), *self.defects.rows, *self.blocks.rows)
        ]

    def states(self, entries: Any) -> Any:
        """Select the states (nx, K + 1) from all variables.

        `entries` are all decision variables and constants in physical units.
        """
        if self.defects.states is None:
            return gather(entries, self.variables.states)
        return self.defects.states(entries)


def build_program(
    transcription: Transcription, problem: Problem, target: Target, scales: Scales, guess: Guess
) -> Program:
    """Build the nonlinear program of a problem.

    `target` has the initial state and the goals. `scales` make variables and constraints order one;
    they are those of the initial guess. `guess` is the initial guess on equal intervals.
    """
    own = transcription.fractions, transcription.control
    return assemble([build_stage(transcription, Variables(problem, target, scales, guess, *own))])


def build_stage(transcription: Transcription, v: Variables, *contact: Any) -> Stage:
    """Build all constraints and costs of a plan or phase.

    `contact` is the argument of `Variational.defects`. `v` are the decision variables of the plan
    or phase.
    """
    rows = [*build_path_blocks(v), *build_waypoint_blocks(v), *build_end_blocks(v)]
    costs = build_cost_blocks(v)
    used = v.entries.find_used([*rows, *costs])
    return Stage(v, ProblemBlocks(rows, costs), transcription.defects(v, used, *contact))


def assemble(stages: Sequence[Stage], linkage: Sequence[Block] = ()) -> Program:
    """Build the nonlinear program of all phases of a plan.

    Each phase is one stage. `linkage` are constraints on variables of several phases.
    """
    variables = [stage.variables for stage in stages]
    first = variables[0]
    unknowns, place = first.entries.order()
    rows = [block for stage in stages for block in stage.rows] + list(linkage)
    costs = [block for stage in stages for block in stage.blocks.costs]
    rows, costs = ([block.relabel(place) for block in blocks] for blocks in (rows, costs))
    objective = sum(v.objective for v in variables)
    parts = Separable(unknowns, rows, costs, 1 / objective)
    entries = unknowns.entries(parts.w)[place.tolist()]
    states = ca.horzcat(*(stage.states(entries) for stage in stages))
    decided = np.concatenate([v.controls for v in variables])
    controls = ca.mtimes(sparse(first.group_matrix), gather(entries, decided))
    durations = gather(entries, np.concatenate([v.duration for v in variables])[:, None])
    noise = None
    if first.noise is not None:
        noise = np.zeros(unknowns.count)
        noise[place[decided]] = first.noise
        noise /= unknowns.scale
    free = place[
        np.concatenate([first.states[0], decided.ravel(), *(v.duration for v in variables)])
    ]
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
        contact=any(v.model.scene.ground is not None for v in variables),
        noise=noise,
        decided=np.unique(free[free < unknowns.count]),
    )


def build_path_blocks(v: Variables) -> list[Block]:
    """Build the path constraints and the rate limits.

    `v` are the decision variables of the plan or phase.
    """
    limits = scaled_rows(v.problem, PathBound, v.scales, v.strength)
    blocks = [_build_bound(v, rows, end) for rows in limits for end in rows.ends]
    if v.problem.free_start:  # a fixed start was checked before
        blocks += [
            _select(0, _build_bound(v, rows, "start"), len(rows.names))
            for rows in limits
            if rows.ends == ("end",)
        ]
    if len(v.controls) > 1:
        blocks += [
            _build_rate_bound(v, rows)
            for rows in scaled_rows(v.problem, RateBound, v.scales, v.strength)
        ]
    return blocks


def build_cost_blocks(v: Variables) -> list[Block]:
    """Build all cost terms.

    They are integrals, functions of neighboring controls, and functions of one instant. `v` are the
    decision variables of the plan or phase.
    """
    terms = cost_terms(v.problem.costs).express(v.model)
    found = [_build_integral(v, one) for one in terms.control]
    if len(v.controls) > 1:
        found += [_build_differences(v, one) for one in terms.changes]
    found += [_build_simpson(v, rate) for rate in terms.running]
    found += [_build_instant(v, share, value) for share, value in terms.instants]
    return [
        Block(ca.Function("cost", [z], [value]), index, ("cost",) * len(index), kind="cost")
        for z, value, index in found
    ]


def build_start_blocks(v: Variables) -> list[Block]:
    """Build the constraints on a free initial state.

    `v` are the decision variables. The list is empty for a given state.
    """
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


def build_waypoint_blocks(v: Variables) -> list[Block]:
    """Build the constraints of all waypoints.

    The state at a waypoint is interpolated between the ends of its interval. `v` are the decision
    variables of the plan or phase.
    """
    blocks: list[Block] = []
    nx = v.model.nx
    for number, (share, target) in enumerate(v.target.waypoints):
        k, part = locate_share(v.fractions, share)
        z, (x, y, T, length) = split_symbol(ca.MX, nx, nx, 1, 1)
        state = hermite_state(v.model, x, y, T * length, part)
        function = ca.Function("waypoint", [z], [target.single(state)])
        index = np.concatenate([v.states[k], v.states[k + 1], v.duration, v.share[k]])[None]
        blocks += _build_goal_blocks(
            target, function, index, f"goal of waypoint {number}", "waypoint"
        )
    return blocks


def build_end_blocks(v: Variables) -> list[Block]:
    """Build the constraints of terminal and periodic goals.

    `v` are the decision variables of the plan or phase.
    """
    target, free = v.target, v.target.free_start
    blocks = _build_goal_blocks(target, target.single, v.states[-1:], "goal", "end")
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


def _build_goal_blocks(
    target: Target, function: ca.Function, index: Indices, name: str, kind: Kind
) -> list[Block]:
    """Build the constraints of the goals at one instant.

    They are independent combinations of the goal rows. Dependent goal rows are inequalities. Where
    conserved quantities already satisfy them, they are inactive, so that the gradients of active
    constraints remain independent. `function` maps variables to goal rows; `index` are their
    indices in y. Constraints have `kind`, and names that begin with `name`.
    """
    blocks = []
    if target.count:
        names = tuple(f"{name}, combination {k}" for k in range(target.count))
        blocks.append(Block(function, index, names, combination=target.weights, kind=kind))
    if len(rows := target.dependent):
        z, most = symbol_kind(function).sym("z", function.size1_in(0)), target.residual
        own = ca.Function("dependent", [z], [function(z)[rows.tolist()]])
        names = tuple(f"{name}, {target.names[k]}" for k in rows)
        blocks.append(Block(own, index, names, -most, most, kind="dependent"))
    return blocks


def _build_bound(v: Variables, rows: ScaledRows, end: str) -> Block:
    begins = end in ("start", "first")
    share, at_end = (0.0, slice(-1)) if begins else (1.0, slice(1, None))
    z, (x, c, T, part) = split_symbol(
        symbol_kind(rows.function), v.model.nx, v.interval_controls.shape[1], 1, 1
    )
    function = ca.Function("bound", [z], [rows.function(x, v.gamma(c, share), T * part)])
    index = np.hstack([v.states[at_end], v.interval_controls, v.repeat(v.duration), v.time[at_end]])
    side = "start" if begins else "end"
    names = tuple(f"{name}, {side} of interval {k}" for k in range(v.count) for name in rows.names)
    block = Block(
        function,
        index,
        names,
        rows.lower,
        rows.upper,
        rows.scale,
        kind="path",
        unit=rows.unit,
    )
    instance = {"first": 0, "last": v.count - 1}.get(end)
    return block if instance is None else _select(instance, block, len(rows.names))


def _select(k: int, block: Block, count: int) -> Block:
    """Select instance k of a block with `count` constraints each."""
    return replace(
        block, index=block.index[k : k + 1], names=block.names[k * count : (k + 1) * count]
    )


def _build_rate_bound(v: Variables, rows: ScaledRows) -> Block:
    nx, m, pairs = v.model.nx, v.controls.shape[1], len(v.controls) - 1
    E = sparse(v.group_matrix)
    z, (x, c, y, d, T, part) = split_symbol(symbol_kind(rows.function), nx, m, nx, m, 1, 1)
    value = rows.function(x, ca.mtimes(E, c), y, ca.mtimes(E, d), T * part)
    duration = v.repeat(v.duration, pairs)
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
        unit=rows.unit,
    )


def _build_instant(v: Variables, share: float, expression: InstantTerm) -> _Summand:
    """Build a cost term at a fraction of the duration.

    The fraction is `share`. `expression` maps the instant there to the cost. Returns a symbol z,
    the cost as an expression of z, and the indices of z in y.
    """
    k, part = locate_share(v.fractions, share)
    value = ca.Function("value", (now := symbolic(v.model)).symbols, [expression(now)])
    z, (x, y, c, T, length) = split_symbol(
        symbol_kind(value), v.model.nx, v.model.nx, v.interval_controls.shape[1], 1, 1
    )
    state = hermite_state(v.model, x, y, T * length, part)
    index = np.concatenate(
        [v.states[k], v.states[k + 1], v.interval_controls[k], v.duration, v.share[k]]
    )
    return z, value(state, v.gamma(c, part), T * share), index[None]


def _build_differences(v: Variables, expression: ControlTerm) -> _Summand:
    """Build a cost term of neighboring control values.

    `expression` maps the two values (α, 2) and the time between them [s] to the cost. Returns a
    symbol z, the cost as an expression of z, and the indices of z in y.
    """
    width = v.controls.shape[1]
    z = ca.SX.sym("z", 2 * width + 2)
    pair = ca.mtimes(sparse(v.group_matrix), ca.reshape(z[: 2 * width], width, 2))
    spacing = v.fractions if v.profile.linear else (v.fractions[1:] + v.fractions[:-1]) / 2
    constants = [v.repeat(v.duration, len(spacing)), v.entries.constants(spacing[:, None])]
    index = np.hstack([v.controls[:-1], v.controls[1:], *constants])
    return z, expression(pair, z[-2] * z[-1]), index


def _build_integral(v: Variables, expression: ControlTerm) -> _Summand:
    """Build a cost integral of the controls over each interval.

    `expression` maps controls (α, n) at n Gauss points and the weight of each point [s] to the
    integral. Returns a symbol z, the cost as an expression of z, and the indices of z in y.
    """
    z = ca.SX.sym("z", v.interval_controls.shape[1] + 2)
    offsets = np.array([-1, 1]) / np.sqrt(12) if v.profile.linear else np.zeros(1)
    points = ca.horzcat(*(v.gamma(z[:-2], 0.5 + offset) for offset in offsets))
    value = expression(points, z[-2] * z[-1] / len(offsets))
    return z, value, np.hstack([v.interval_controls, v.repeat(v.duration), v.share])


def _build_simpson(v: Variables, expression: InstantTerm) -> _Summand:
    """Build a running cost by Simpson's rule.

    `expression` maps an instant to the cost rate. A rule with the ends of intervals only would miss
    vibrations within them. Returns a symbol z, the cost as an expression of z, and the indices of z
    in y.
    """
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
        v.repeat(v.duration),
        v.share,
        v.time[:-1],
        v.time[1:],
    ]
    return z, value, np.hstack(index)

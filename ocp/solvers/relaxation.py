"""Relaxation of infeasible rate limits."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from ocp.solvers.base import Solution
from ocp.solvers.ipopt import NOWHERE, Ipopt
from ocp.solvers.monitor import Monitor
from ocp.transcription.sparse_nlp import (
    Block,
    Program,
    Separable,
    Unknowns,
    split_symbol,
)
from tenscasadi.util.casadi_tools import symbol_kind
from tenscasadi.util.validate import Array, Indices

TOO_SLOW = "Rates_Too_Slow"  # status: only a motion with wider limits of rates was found
# Three digits of the relaxation suffice. A large first barrier keeps iterates beyond the limits,
# and long dual steps halve the iterations.
OPTIONS = {"alpha_for_y": "min-dual-infeas", "mu_init": 0.1}


def find_rate_relaxation(
    program: Program, solver: Ipopt, failed: Solution, monitor: Monitor | None
) -> Solution | None:
    """Find the motion with the least relaxation of rate limits.

    None if the solver did not fail for lack of a feasible point, or rate limits are not its cause.
    """
    stopped = (*NOWHERE, "Maximum_Iterations_Exceeded")
    if failed.success or failed.status not in stopped or not program.rows("rate"):
        return None
    own = replace(
        solver,
        tolerance=max(1e-4, solver.tolerance),
        max_iterations=min(120, solver.max_iterations),
        warm_start=False,
        callback=None,
        options={**OPTIONS, **solver.options},
    )
    found = own.solve(relax_rates(program), monitor)
    w = found.w[:-1]
    if not found.success or measure_relaxation(program, w) <= 1e-3:
        return None
    return Solution(w, False, TOO_SLOW, failed.iterations + found.iterations)


def measure_relaxation(program: Program, w: Array) -> float:
    """Measure the violation of rate limits, relative to the limits."""
    rates = find_rate_rows(program)
    g = np.asarray(ca.Function("g", [program.parts.w], [program.parts.g])(w).full()).ravel()[rates]
    lower, upper = program.lower[rates], program.upper[rates]
    return float(np.max([(g - upper) / np.abs(upper), (lower - g) / np.abs(lower)], initial=0.0))


def find_rate_rows(program: Program) -> Indices:
    """Find the rows of g that limit rates."""
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in program.rows("rate")])


def relax_rates(program: Program) -> Program:
    """Build the program that minimizes the relaxation of rate limits."""
    parts, first = program.parts, measure_relaxation(program, program.first)
    known = parts.unknowns
    n = known.count
    names = (*known.names, "relaxation of rate limits")
    numbers = (
        (known.first, first),
        (known.scale, 1.0),
        (known.lower, 0.0),
        (known.upper, np.inf),
        (known.interval, np.inf),
    )
    value, scale, least, most, interval = (np.append(all_of, one) for all_of, one in numbers)
    unknowns = Unknowns(names, value, scale, least, most, interval, known.constants)
    place = np.concatenate([np.arange(n), np.arange(n + 1, n + 1 + len(known.constants))])
    moved = [block.relabel(place) for block in parts.rows]
    rows = [_relax(block, n) if block.kind == "rate" else block for block in moved]
    share = ca.SX.sym("share")
    cost = Block(ca.Function("cost", [share], [share]), np.array([[n]]), ("cost",), kind="cost")
    separable = Separable(unknowns, rows, [cost], 1.0)
    lower, upper, scale = (
        np.concatenate(limits) for limits in zip(*(block.limits() for block in rows), strict=True)
    )
    return replace(
        program,
        parts=separable,
        w_lower=np.append(program.w_lower, 0.0),
        w_upper=np.append(program.w_upper, np.inf),
        first=np.append(program.first, first),
        lower=lower,
        upper=upper,
        scale=scale,
        objective=1.0,
        unpack=ca.Function("unpack", [separable.w], list(program.unpack(separable.w[:n]))),
        multipliers=None,
        noise=None,
    )


def _relax(block: Block, share: int) -> Block:
    """Relax lower ≤ f ≤ upper to f − s·upper ≤ upper and f − s·lower ≥ lower.

    `share` is the number of s among the entries.
    """
    lower, upper, scale = (limit.reshape(block.count, block.rows)[0] for limit in block.limits())
    z, (own, s) = split_symbol(symbol_kind(block.function), block.function.size1_in(0), 1)
    value = block.function(own)
    sides = [
        value - ca.DM(np.where(np.isfinite(limit), limit, 0.0)) * s for limit in (upper, lower)
    ]
    nothing = np.full(block.rows, np.inf)
    each = [block.names[k * block.rows : (k + 1) * block.rows] for k in range(block.count)]
    return replace(
        block,
        function=ca.Function("wider", [z], [ca.vertcat(*sides)]),
        index=np.hstack([block.index, np.full((block.count, 1), share)]),
        names=tuple(name for names in each for name in 2 * names),
        lower=np.concatenate([-nothing, lower]),
        upper=np.concatenate([upper, nothing]),
        scale=np.tile(scale, 2),
    )

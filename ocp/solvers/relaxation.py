"""Elastic relaxation of limits that are too narrow.

Each limit has a relaxation variable, by which it may be exceeded, relative to its size. The relaxed
program minimizes the sum of these variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.rows import RESOLUTION
from ocp.solvers.base import Solution
from ocp.solvers.ipopt import NOWHERE, Ipopt
from ocp.solvers.monitor import Monitor
from ocp.transcription.sparse_nlp import (
    Block,
    Kind,
    Program,
    Separable,
    Unknowns,
    split_symbol,
)
from tenscasadi.util.casadi_tools import symbol_kind
from tenscasadi.util.validate import Array, Indices

TOO_SLOW = "Rates_Too_Slow"  # status: only a motion with wider limits of rates was found
# A large first barrier keeps iterates beyond the limits,
# and long dual steps halve the iterations.
OPTIONS = {"alpha_for_y": "min-dual-infeas", "mu_init": 0.1}


class WiderLimit(NamedTuple):
    """Limit that must be wider for a solution to exist.

    Attributes
    ----------
    name : str
        Name of the quantity that exceeds it most, such as "tension of string 3".
    side : str
        "lower", "upper", or "both" for limits of equal size.
    limit, needed : float
        The limit, and the value that permits a solution, in the unit of the quantity.
    """

    name: str
    side: str
    limit: float
    needed: float


@dataclass(frozen=True, eq=False)
class Relaxation:
    """Nonlinear program with relaxed limits.

    Attributes
    ----------
    given, program : Program
        The given program, and the relaxed one. The relaxation variables are its last variables.
    blocks : list of Block
        Constraints with relaxed limits, in the variables of the given program.
    groups : list of ndarray of int, shape (2, count, rows)
        Index of the relaxation variable of each lower and upper limit of these blocks. The last
        variable is fixed at 0.
    sizes : ndarray, shape (m,)
        Sizes of the limits of each relaxation variable, scaled.
    """

    given: Program
    program: Program
    blocks: list[Block]
    groups: list[Indices]
    sizes: Array

    def list_wider(self, w: Array) -> list[WiderLimit]:
        """List the limits that a solution w of the relaxed program exceeds.

        Those with the largest relaxations come first.
        """
        found: dict[int, tuple[float, WiderLimit]] = {}
        excesses = _find_excess(self.given, self.blocks, w)
        for block, groups, (value, both) in zip(self.blocks, self.groups, excesses, strict=True):
            lower, upper, scale = (part.reshape(value.shape) for part in block.limits())
            for side, limit, group, excess in zip(
                ("lower", "upper"), (lower, upper), groups, both, strict=True
            ):
                last = len(self.sizes) - 1
                for k, r in np.argwhere((group < last) & (excess > 0)).tolist():
                    number = int(group[k, r])
                    relaxation = float(excess[k, r] / self.sizes[number])
                    name = block.names[k * block.rows + r].split(",")[0]
                    own = float(limit[k, r] * scale[k, r]), float(value[k, r] * scale[k, r])
                    wider = WiderLimit(name, side, *own)
                    if lower[k, r] == -upper[k, r]:
                        wider = WiderLimit(name, "both", *map(abs, own))
                    if relaxation > max(RESOLUTION, found[number][0] if number in found else 0.0):
                        found[number] = relaxation, wider
        return [wider for _, wider in sorted(found.values(), reverse=True)]


def find_rate_relaxation(
    program: Program, solver: Ipopt, failed: Solution, monitor: Monitor | None
) -> Solution | None:
    """Find a solution with minimum relaxation of the rate limits.

    `solver` solves the relaxed program. `failed` is its result for `program` itself. The solution
    that is found does not count as a success. Returns None if the solver failed for another reason,
    or if rate limits are not the cause.
    """
    stopped = (*NOWHERE, "Maximum_Iterations_Exceeded")
    if failed.success or failed.status not in stopped or not program.rows("rate"):
        return None
    relaxed = relax_limits(program, ("rate",))
    found = solve_relaxed(relaxed, solver, monitor)
    w = found.w[: len(program.first)]
    if not found.success or not relaxed.list_wider(w):
        return None
    return Solution(w, False, TOO_SLOW, failed.iterations + found.iterations)


def solve_relaxed(relaxed: Relaxation, solver: Ipopt, monitor: Monitor | None) -> Solution:
    """Find a solution with the minimum sum of relaxations.

    `relaxed` holds the program. Tolerance and iterations of `solver` are limited.
    """
    # Relaxed rates of rest lengths (test_relaxation.py) take 9 CPU s, else 13. Other limits take the
    # same time with the tolerance and the iterations of the solver.
    own = replace(
        solver,
        tolerance=max(RESOLUTION / 10, solver.tolerance),
        max_iterations=min(120, solver.max_iterations),
        warm_start=False,
        callback=None,
        options={**OPTIONS, **solver.options},
    )
    return own.solve(relaxed.program, monitor)


def measure_relaxation(program: Program, w: Array) -> float:
    """Compute the largest relative violation of rate limits.

    `w` are the scaled decision variables. The violation is 0 if all limits hold.
    """
    rates = find_rate_rows(program)
    g = ca.Function("g", [program.parts.w], [program.parts.g])(w).full().ravel()[rates]
    lower, upper = program.lower[rates], program.upper[rates]
    return float(np.max([(g - upper) / np.abs(upper), (lower - g) / np.abs(lower)], initial=0.0))


def find_rate_rows(program: Program) -> Indices:
    """Find the rows of the constraints g that limit rates."""
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in program.rows("rate")])


def relax_limits(program: Program, kinds: Sequence[Kind], controls: bool = False) -> Relaxation:
    """Relax the limits of constraints of the given kinds.

    With `controls`, limits of the controls are relaxed, too. Equal limits of one quantity share one
    relaxation variable, as do lower and upper limits of equal size. A limit 0 is not relaxed, as it
    defines a sign.
    """
    n, known = len(program.first), program.parts.unknowns
    given = [block for block in program.parts.rows if block.kind in kinds]
    kept = [block for block in program.parts.rows if block.kind not in kinds]
    w_lower, w_upper = program.w_lower.copy(), program.w_upper.copy()
    if controls and (own := _find_control_limits(program)) is not None:
        w_lower[own.index], w_upper[own.index] = -np.inf, np.inf
        given.append(own)
    relaxations, groups = _find_relaxations(program, given)
    m = len(relaxations.size)
    place = np.append(np.arange(n), n + m + np.arange(len(known.constants)))
    rows = [block.relabel(place) for block in kept]
    rows += [
        _relax(block.relabel(place), n + group) for block, group in zip(given, groups, strict=True)
    ]
    parts = Separable(
        _add_relaxations(known, relaxations), rows, [_build_cost(n, relaxations.size)], 1.0
    )
    lower, upper, scale = (
        np.concatenate(limits) for limits in zip(*(block.limits() for block in rows), strict=True)
    )
    relaxed = replace(
        program,
        parts=parts,
        w_lower=np.append(w_lower, np.zeros(m)),
        w_upper=np.append(w_upper, relaxations.most),
        first=np.append(program.first, relaxations.first),
        lower=lower,
        upper=upper,
        scale=scale,
        objective=1.0,
        unpack=ca.Function("unpack", [parts.w], list(program.unpack(parts.w[:n]))),
        multipliers=None,
        noise=None,
    )
    return Relaxation(program, relaxed, given, groups, relaxations.size)


def _find_control_limits(program: Program) -> Block | None:
    """Convert the bounds on controls to constraints.

    Returns one block of constraints; None if no control has bounds.
    """
    known = program.parts.unknowns
    limited = np.isfinite(program.w_lower) | np.isfinite(program.w_upper)
    which = np.flatnonzero(limited & np.isfinite(known.interval))
    if not which.size:
        return None
    own = known.scale[which, None]
    size, c = float(own.max()), ca.SX.sym("c")
    lower, upper = (limit[which, None] * own / size for limit in (program.w_lower, program.w_upper))
    names = tuple(known.names[k] for k in which)
    function = ca.Function("control", [c], [c / size])
    return Block(function, which[:, None], names, lower, upper, size, kind="path")


class _Relaxations(NamedTuple):
    """Relaxation variables, one for each different limit.

    Attributes
    ----------
    names : tuple of str
        Their names.
    size : ndarray, shape (m,)
        Absolute values of the limits, scaled.
    most, first : ndarray, shape (m,)
        Upper bounds and initial values, relative to `size`.
    """

    names: tuple[str, ...]
    size: Array
    most: Array
    first: Array


def _find_relaxations(
    program: Program, blocks: Sequence[Block]
) -> tuple[_Relaxations, list[Indices]]:
    """Assign relaxation variables to the limits of blocks.

    The last variable is fixed at 0, for limits that are not relaxed. A relaxed limit does not
    change its sign. Also returns the index of the variable of each lower and upper limit (2, count,
    rows), for each block.
    """
    keys: dict[tuple[str, str, float], int] = {}
    groups = [_group_limits(block, keys) for block in blocks]
    size = np.array([*(abs(limit) for *_, limit in keys), 1.0])
    falls = [limit > 0 if side == "lower" else limit < 0 for _, side, limit in keys]
    most = np.array([*(1.0 if one else np.inf for one in falls), 0.0])
    groups = [np.where(group < 0, len(keys), group) for group in groups]
    first = np.zeros(len(size))
    for group, (_, excess) in zip(
        groups, _find_excess(program, blocks, program.first), strict=True
    ):
        np.maximum.at(first, group, np.maximum(excess, 0.0) / size[group])
    names = tuple(f"relaxation of {name}" for name in (*(name for name, *_ in keys), "nothing"))
    return _Relaxations(names, size, most, np.minimum(first, most)), groups


def _group_limits(block: Block, keys: dict[tuple[str, str, float], int]) -> Indices:
    """Assign relaxation variables to the limits of one block.

    `keys` are the quantity, side and limit of each variable, and are extended.
    """
    lower, upper, _ = (limit.reshape(block.count, block.rows) for limit in block.limits())
    groups = np.full((2, block.count, block.rows), -1)
    for k, r in np.ndindex(block.count, block.rows):
        name = block.names[k * block.rows + r].split(",")[0].split(" of ")[0]
        low, high = float(lower[k, r]), float(upper[k, r])
        for number, side, limit in ((0, "lower", low), (1, "upper", high)):
            if np.isfinite(limit) and limit:
                key = (name, "both", high) if low == -high else (name, side, limit)
                groups[number, k, r] = keys.setdefault(key, len(keys))
    return groups


def _find_excess(program: Program, blocks: Sequence[Block], w: Array) -> list[tuple[Array, Array]]:
    """Evaluate the constraints of blocks, and their violations.

    `w` are the scaled decision variables. For each block, returns the values (count, rows), and
    lower limits minus values, values minus upper limits (2, count, rows). Positive differences are
    violations.
    """
    known = program.parts.unknowns
    y = np.append(known.scale * w, known.constants)
    found = []
    for block in blocks:
        value = ca.DM(block.value(y[block.index].T)).full().T
        lower, upper, _ = (limit.reshape(value.shape) for limit in block.limits())
        found.append((value, np.array([lower - value, value - upper])))
    return found


def _add_relaxations(known: Unknowns, relaxations: _Relaxations) -> Unknowns:
    """Append the relaxation variables to the decision variables.

    `known` are the decision variables of the program. Relaxation variables are in units of their
    limits.
    """
    none = np.full(len(relaxations.size), np.inf)
    return Unknowns(
        (*known.names, *relaxations.names),
        np.append(known.first, relaxations.first * relaxations.size),
        np.append(known.scale, relaxations.size),
        np.append(known.lower, np.zeros(len(none))),
        np.append(known.upper, none),
        np.append(known.interval, none),
        known.constants,
    )


def _build_cost(n: int, sizes: Array) -> Block:
    """Build the cost function, the sum of all relaxations.

    The relaxation variables follow the n decision variables. Each is divided by the size of its
    limit.
    """
    relaxation = ca.SX.sym("relaxation", len(sizes))
    function = ca.Function("cost", [relaxation], [ca.dot(relaxation, ca.DM(1 / sizes))])
    return Block(function, np.arange(n, n + len(sizes))[None], ("cost",), kind="cost")


def _relax(block: Block, relaxations: Indices) -> Block:
    """Add relaxation variables to the constraints of a block.

    lower ≤ f ≤ upper becomes f − s ≤ upper and f + s' ≥ lower. The indices of s' and s are
    `relaxations`.
    """
    lower, upper, scale = (limit.reshape(block.count, block.rows) for limit in block.limits())
    size, rows = block.function.size1_in(0), block.rows
    z, (own, below, above) = split_symbol(symbol_kind(block.function), size, rows, rows)
    value, nothing = block.function(own), np.full(lower.shape, np.inf)
    each = [block.names[k * rows : (k + 1) * rows] for k in range(block.count)]
    return replace(
        block,
        function=ca.Function("wider", [z], [ca.vertcat(value - above, value + below)]),
        index=np.hstack([block.index, *relaxations]),
        names=tuple(name for names in each for name in 2 * names),
        lower=np.hstack([-nothing, lower]),
        upper=np.hstack([upper, nothing]),
        scale=np.hstack([scale, scale]),
    )

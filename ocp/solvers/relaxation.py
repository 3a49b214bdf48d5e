"""Elastic relaxation of limits that are too narrow.

Each limit has a relaxation variable, by which it may be exceeded, relative to its size. The relaxed
program minimizes the sum of these variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.rows import RESOLUTION
from ocp.solvers.base import Solution
from ocp.solvers.ipopt import Ipopt
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
    unit : str
        This unit; "" if it is unknown.
    """

    name: str
    side: str
    limit: float
    needed: float
    unit: str


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

    def measure(self, w: Array) -> Array:
        """Compute the relaxations (m,) that variables w of the given program need."""
        needed = np.zeros(len(self.sizes))
        for group, (_, excess) in zip(
            self.groups, _find_excess(self.given, self.blocks, w), strict=True
        ):
            np.maximum.at(needed, group, np.maximum(excess, 0.0) / self.sizes[group])
        return np.minimum(needed, self.program.w_upper[len(w) :])

    def widen(self, amounts: Any = np.inf) -> Program:
        """Build the given program with wider limits.

        `amounts` (m,) are relaxations. By default, limits are as wide as relaxation permits.
        """
        given, n = self.given, len(self.given.first)
        most = np.minimum(self.program.w_upper[n:], amounts) * self.sizes
        rows = [block for block in given.parts.rows if block not in self.blocks]
        for block, (below, above) in zip(self.blocks, self.groups, strict=True):
            lower, upper, _ = (limit.reshape(below.shape) for limit in block.limits())
            rows.append(replace(block, lower=lower - most[below], upper=upper + most[above]))
        parts = Separable(given.parts.unknowns, rows, given.parts.costs, 1 / given.objective)
        bounds = self.program.w_lower[:n], self.program.w_upper[:n]
        return _replace_parts(given, parts, *bounds)

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
                    wider = WiderLimit(name, side, *own, block.unit or "")
                    if lower[k, r] == -upper[k, r]:
                        sizes = abs(own[0]), abs(own[1])
                        wider = WiderLimit(name, "both", *sizes, block.unit or "")
                    if relaxation > max(RESOLUTION, found[number][0] if number in found else 0.0):
                        found[number] = relaxation, wider
        return [wider for _, wider in sorted(found.values(), reverse=True)]


def solve_relaxed(relaxed: Relaxation, solver: Ipopt, monitor: Monitor | None) -> Solution:
    """Find a solution of the given program with a small sum of relaxations.

    `relaxed` holds both programs. The search starts from a solution without limits: from the guess
    of the program, a relaxed jump with limited bar forces takes 241 iterations, in place of 40 and
    55. The relaxed program is solved with a larger tolerance, which can hide that limits have to be
    still wider. Therefore, the given program is then solved with these wider limits. An iterate
    that satisfies the constraints is a success, as its limits suffice, even if they are not the
    narrowest.
    """
    own = replace(
        solver,
        tolerance=max(RESOLUTION / 10, solver.tolerance),
        warm_start=False,
        callback=None,
    )
    wide, margin = relaxed.widen(), 0.03  # relative to the relaxations
    free = own.solve(wide, monitor)
    if not _is_feasible(wide, free.w, own.tolerance):
        return free._replace(success=False)
    first = np.append(free.w, relaxed.measure(free.w))
    found = own.solve(replace(relaxed.program, first=first), monitor)
    if not _is_feasible(relaxed.program, found.w, own.tolerance):
        return found._replace(success=False)
    w = found.w[: len(free.w)]
    enough = replace(relaxed.widen((1 + margin) * relaxed.measure(w)), first=w)
    checked = replace(own, tolerance=solver.tolerance).solve(enough, monitor)
    success = checked.success or _is_feasible(enough, checked.w, solver.tolerance)
    iterations = free.iterations + found.iterations + checked.iterations
    return checked._replace(success=success, iterations=iterations)


def _is_feasible(program: Program, w: Array, tolerance: float) -> bool:
    """Return whether variables w satisfy the scaled constraints within a tolerance."""
    g = ca.Function("g", [program.parts.w], [program.parts.g])(w).full().ravel()
    violation = np.maximum(program.lower - g, g - program.upper)
    return bool(np.isfinite(g).all() and violation.max(initial=0.0) <= tolerance)


def relax_limits(
    program: Program, kinds: Sequence[Kind], control_unit: str | None = None
) -> Relaxation:
    """Relax the limits of constraints of the given kinds.

    Contact constraints have no unit, and are not relaxed. With `control_unit`, the unit of the
    controls, their limits are relaxed, too. Equal limits of one quantity share one relaxation
    variable, as do lower and upper limits of equal size. Equations are not relaxed. Strings stay
    in tension, and rest lengths positive.
    """
    n, known = len(program.first), program.parts.unknowns
    every = program.parts.rows
    given = [block for block in every if block.kind in kinds and block.unit is not None]
    kept = [block for block in every if block not in given]
    w_lower, w_upper = program.w_lower.copy(), program.w_upper.copy()
    own = None if control_unit is None else _find_control_limits(program)
    if own is not None:
        w_lower[own.index], w_upper[own.index] = -np.inf, np.inf
        given.append(replace(own, unit=control_unit))
    relaxations, groups = _find_relaxations(given)
    m = len(relaxations.size)
    place = np.append(np.arange(n), n + m + np.arange(len(known.constants)))
    rows = [block.relabel(place) for block in kept]
    rows += [
        _relax(block.relabel(place), n + group) for block, group in zip(given, groups, strict=True)
    ]
    parts = Separable(
        _add_relaxations(known, relaxations), rows, [_build_cost(n, relaxations.size)], 1.0
    )
    bounds = np.append(w_lower, np.zeros(m)), np.append(w_upper, relaxations.most)
    relaxed = replace(
        _replace_parts(program, parts, *bounds),
        first=np.append(program.first, np.zeros(m)),
        objective=1.0,
        unpack=ca.Function("unpack", [parts.w], list(program.unpack(parts.w[:n]))),
        noise=None,
    )
    found = Relaxation(program, relaxed, given, groups, relaxations.size)
    first = np.append(program.first, found.measure(program.first))
    return replace(found, program=replace(relaxed, first=first))


def _replace_parts(program: Program, parts: Separable, lower: Array, upper: Array) -> Program:
    """Build a program with other constraints, cost and bounds on variables."""
    low, high, scale = (
        np.concatenate(limits)
        for limits in zip(*(block.limits() for block in parts.rows), strict=True)
    )
    return replace(
        program,
        parts=parts,
        w_lower=lower,
        w_upper=upper,
        lower=low,
        upper=high,
        scale=scale,
        multipliers=None,
    )


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
    most : ndarray, shape (m,)
        Upper bounds, relative to `size`.
    """

    names: tuple[str, ...]
    size: Array
    most: Array


def _find_relaxations(blocks: Sequence[Block]) -> tuple[_Relaxations, list[Indices]]:
    """Assign relaxation variables to the limits of blocks.

    The last variable is fixed at 0, for limits that are not relaxed. Also returns, for each block,
    the index of the variable of each lower and upper limit (2, count, rows).
    """
    keys: dict[tuple[str, str, float], int] = {}
    groups = [_group_limits(block, keys) for block in blocks]
    size = np.array([*(abs(limit) or 1.0 for *_, limit in keys), 1.0])
    most = np.array([*(_find_largest(*key) for key in keys), 0.0])
    groups = [np.where(group < 0, len(keys), group) for group in groups]
    names = tuple(f"relaxation of {name}" for name in (*(name for name, *_ in keys), "nothing"))
    return _Relaxations(names, size, most), groups


def _find_largest(name: str, side: str, limit: float) -> float:
    """Find the largest relaxation of a limit, relative to its size.

    Tensions, force densities and rest lengths of strings are not negative.
    """
    signed = side == "lower" and name in (
        "tension",
        "force density",
        "elastic force density",
        "rest length",
    )
    return np.sign(limit) if signed else np.inf


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
            if np.isfinite(limit) and low < high:
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
        np.append(known.first, np.zeros(len(relaxations.size))),
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

"""By how much limits of rates have to be wider for a program to have a solution: what is asked where a solver does not get within them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.solvers.base import Solution
from ocp.solvers.ipopt import Ipopt, Progress
from ocp.transcription.sparse_nlp import (
    Block,
    Program,
    Separable,
    Unknowns,
    split_symbol,
    symbol_kind,
)
from tenscasadi.util.validate import Array, Indices

TOO_SLOW = (
    "Rates_Too_Slow"  # status: no way within limits of rates was found, and one beyond them was
)
ENOUGH = 1e-3  # of the limits: less is not worth telling
BARRIER = 0.1  # to start with: one that is small keeps the first way beyond the limits
TOLERANCE = 1e-4  # tells the width to three digits
STRIDES = {
    "alpha_for_y": "min-dual-infeas"
}  # halves the iterations where all that counts is a width
MOST = 120  # iterations
SOON, WAITED = (
    40,
    12,
)  # after so many iterations, and no halving of the violation in the last so many, a solver hardly gets there
SMALL = 1e-4  # scaled violation: below, a solver gets there


class Wider(NamedTuple):
    """w that needs limits of rates widened by `share` of them, after some iterations; and whether that is the least."""

    w: Array
    share: float
    iterations: int
    least: bool


class Patience:
    """Watches a solver, and where that does not get within the constraints, finds by how much limits of rates have to be wider.

    wider: what was found, None while nobody asked; too_slow: whether they have to be, and the
    solver was stopped for it.
    """

    def __init__(self, program: Program, solver: Ipopt, deadline: float | None) -> None:
        self._program, self._solver, self._deadline = program, solver, deadline
        self._seen = deque[float](maxlen=WAITED + 1)
        self.wider: Wider | None = None
        self.too_slow = False

    def __call__(self, now: Progress) -> bool:
        """Tell whether to go on."""
        watch = self._solver.watch
        if watch is not None and watch(now) is False:
            return False
        self._seen.append(now.infeasibility)
        if (
            self.wider is None
            and now.iteration >= SOON
            and now.infeasibility > max(SMALL, 0.5 * self._seen[0])
        ):
            self.ask()
        return not self.too_slow

    def ask(self) -> Wider:
        """Find by how much limits of rates have to be wider."""
        self.wider = least_wider(self._program, self._solver, self._deadline)
        self.too_slow = self.wider.least and self.wider.share > ENOUGH
        return self.wider


def least_wider(program: Program, solver: Ipopt, deadline: float | None) -> Wider:
    """Return the motion that needs limits of rates widened least, whatever it costs. deadline: of `time.perf_counter`, s; None: no limit."""
    own = _roughly(
        replace(
            solver,
            max_iterations=min(MOST, solver.max_iterations),
            watch=None,
            options={**STRIDES, **solver.options},
        )
    )
    found = own.solve(
        widened(program.disturbed()), deadline
    )  # saddles take more iterations here than anywhere
    w = found.w[:-1]
    return Wider(w, widening(program, w), found.iterations, found.success)


def from_wider(program: Program, wider: Wider, solver: Ipopt, deadline: float | None) -> Solution:
    """Return a rough solution of the program, from the motion that needs limits of rates widened least."""
    return _roughly(solver).solve(
        replace(program, first=wider.w, multipliers=None, noise=None), deadline
    )


def _roughly(solver: Ipopt) -> Ipopt:
    return replace(
        solver,
        tolerance=max(TOLERANCE, solver.tolerance),
        warm=False,
        options={"mu_init": BARRIER, **solver.options},
    )


def widening(program: Program, w: Array) -> float:
    """Return by how much of their limits rates are beyond them."""
    rates = rate_rows(program)
    g = np.asarray(ca.Function("g", [program.parts.w], [program.parts.g])(w).full()).ravel()[rates]
    lower, upper = program.lower[rates], program.upper[rates]
    return float(np.max([(g - upper) / np.abs(upper), (lower - g) / np.abs(lower)], initial=0.0))


def rate_rows(program: Program) -> Indices:
    """Return the rows of g that limit rates."""
    return np.concatenate([np.arange(rows.start, rows.stop) for rows in program.rows("rate")])


def widened(program: Program) -> Program:
    """Return the program whose last unknown is the share by which all limits of rates are wider, which is what is minimised."""
    parts, first = program.parts, widening(program, program.first)
    known = parts.unknowns
    n = known.count
    names = (*known.names, "share by which limits of rates are wider")
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
    moved = [block.relabelled(place) for block in parts.rows]
    rows = [_open(block, n) if block.kind == "rate" else block for block in moved]
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
        controls=None,
        multipliers=None,
        noise=None,
    )


def _open(block: Block, share: int) -> Block:
    """Return lower (1 + s) ≤ f ≤ upper (1 + s) as rows f − s·upper ≤ upper and f − s·lower ≥ lower; share: the number of s among the entries."""
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

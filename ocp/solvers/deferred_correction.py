"""Deferred correction: a coarse program is solved again until its solution moves as exactly as fine steps do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.solvers.base import Solution, Solver
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.base import Transcription
from ocp.transcription.multiple_shooting import ramped_step, shooting_step
from ocp.transcription.sparse_nlp import Program
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.util.validate import Array

FINE_STEPS = 1  # steps of DormandPrince853 in an interval: more exact than ten of RungeKutta4, at a third of the cost
MOST_ROUNDS = 6  # of corrections
ROUGH_TOLERANCE = 1e-5  # tolerance of the first solution, which the next one moves by more
MOST_LEFT = 0.5  # a round that leaves more than this share of the gap leads nowhere


class Corrected(NamedTuple):
    """A corrected solution.

    states (intervals + 1, nx): where fine steps lead, None where they diverge; gap: how far its own states are from them, m (speeds: m per
    duration).
    """

    solution: Solution
    states: Array | None
    gap: float


def check_correctable(transcription: Transcription, solver: Solver) -> None:
    """Raise ValueError where an accuracy is asked for, and the solver does not start from a solution and its multipliers."""
    if transcription.accuracy is not None and not isinstance(solver, Ipopt):
        name = f"{type(transcription).__name__}.accuracy is {transcription.accuracy:g}"
        text = f"{name}, and solver is {type(solver).__name__}, which cannot start again from its own solution"
        raise ValueError(f"{text}: give ocp.Ipopt(), or accuracy=None and more intervals")


def solve_corrected(program: Program, solver: Ipopt, model: Model, fractions: Array, accuracy: float, deadline: float | None = None) -> Corrected:
    """Solve, and again with rows g(w) = τ of the motion in place of g(w) = 0, until states are as near to fine ones as `accuracy`.

    τ is what the rows leave at the states of fine steps under the planned force densities (Stetter, Numer. Math. 1978, 29, 425): where that is
    settled, the coarse rows hold exactly at the fine motion. Each round gains what the coarse scheme is worth: a factor of about its relative error.
    Only limits change, so nothing is built again. Optimal is the plan for the costs of the coarse rows, which are wrong by its order.
    """
    solution = replace(solver, tolerance=max(solver.tolerance, ROUGH_TOLERANCE)).solve(program, deadline)
    best, before, iterations = Corrected(solution, None, np.inf), np.inf, solution.iterations
    if not solution.success:
        return best
    rows = ca.Function("rows", [program.problem["x"]], [program.problem["g"]])
    again: Callable[..., Solution] | None = None
    count, moving = len(fractions), program.rows("start", "defect")[-1].stop
    linear = program.unpack.size2_out(1) > count
    chain = (ramped_step if linear else shooting_step)(model, DormandPrince853(), FINE_STEPS).mapaccum(count)
    for done in range(MOST_ROUNDS + 1):
        states, gamma, duration = (np.asarray(value.full()).T for value in program.unpack(solution.w))
        T = float(duration.squeeze())
        held = (gamma[:-1].T, gamma[1:].T) if linear else (gamma.T,)
        fine = np.column_stack([states[0], np.asarray(chain(states[0], *held, T * fractions[None]).full())]).T
        gap = np.abs(fine - states) * program.known
        places, speeds, _ = model.split(gap)
        size = float(max(places.max(initial=0.0), T * speeds.max(initial=0.0)))
        if done and size < best.gap:  # the first solution is a rough one
            best = Corrected(solution._replace(iterations=iterations), fine, size)
        if (done and size <= accuracy) or not size < MOST_LEFT * before or done == MOST_ROUNDS:
            break
        before = size
        shift = np.asarray(rows(program.with_states(solution.w, fine)).full()).ravel()[:moving]
        lower, upper = (np.concatenate([shift, limit[moving:]]) for limit in (program.lower, program.upper))
        moved = replace(program, lower=lower, upper=upper, first=solution.w, multipliers=solution.multipliers)
        again = again or replace(solver, warm=True).prepared(moved)
        solution = again(moved, deadline)
        iterations += solution.iterations
        if not solution.success:
            return best if done else Corrected(solution, None, np.inf)
    return best

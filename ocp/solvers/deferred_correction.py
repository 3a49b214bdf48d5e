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
from tenscasadi.dynamics.regulator import plan_gains
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.util.validate import Array

# steps of DormandPrince853 in an interval: more exact than ten of RungeKutta4, at a third of the
# cost
FINE_STEPS = 1
MOST_ROUNDS = 6  # of corrections
ROUGH_TOLERANCE = 1e-5  # tolerance of the first solution, which the next one moves by more
FAR = 0.03  # of the structure's size: fine steps that leave a plan by more have left it
TOO_COARSE = (
    "too coarse: corrections end {:.2g} m from fine steps, not {:.2g} m: give more intervals"
)
MOST_LEFT = 0.5  # a round that leaves more than this share of the gap leads nowhere


class Corrected(NamedTuple):
    """A corrected solution.

    states (intervals + 1, nx): where fine steps lead, None where they diverge; gap: how far its own
    states are from them, m (speeds: m per duration).
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


def solve_corrected(
    program: Program,
    solver: Ipopt,
    model: Model,
    fractions: Array,
    accuracy: float,
    deadline: float | None = None,
) -> Corrected:
    """Solve, and again with rows g(w) = τ of the motion in place of g(w) = 0, until states are as near to fine ones as `accuracy`.

    τ is what the rows leave at the states of fine steps under the planned force densities (Stetter,
    Numer. Math. 1978, 29, 425): where that is settled, the coarse rows hold exactly at the fine
    motion. Each round gains what the coarse scheme is worth: a factor of about its relative error.
    Only limits change, so nothing is built again. Optimal is the plan for the costs of the coarse
    rows, which are wrong by its order.

    Where errors grow, fine steps leave the plan and tell nothing about it: then τ is taken along a
    fine motion that feedback keeps to the plan, under the force densities of that, until those of
    the plan alone lead there.
    """
    solution = replace(solver, tolerance=max(solver.tolerance, ROUGH_TOLERANCE)).solve(
        program, deadline
    )
    best, before, iterations = Corrected(solution, None, np.inf), np.inf, solution.iterations
    if not solution.success:
        return best
    rows = ca.Function("rows", [program.problem["x"]], [program.problem["g"]])
    again: Callable[..., Solution] | None = None
    moving, motion, kept = (
        program.rows("start", "defect")[-1].stop,
        _Motion(program, model, fractions),
        False,
    )
    for done in range(MOST_ROUNDS + 1):
        states, gamma, T = _planned(program, solution.w)
        fine = motion.free(states, gamma, T)
        alone = size = motion.gap(fine, states, T)
        true = program.with_states(solution.w, fine)
        kept = kept or not size < min(MOST_LEFT * before, motion.far)
        if kept and not alone <= accuracy and (steadied := motion.kept(solution.w)) is not None:
            fine, true = steadied
            size = motion.gap(fine, states, T)
        settled = bool(done) and alone <= accuracy  # the first solution is a rough one
        if done and (settled or size < best.gap):
            best = Corrected(solution._replace(iterations=iterations), fine, size)
        if settled or not size < MOST_LEFT * before or done == MOST_ROUNDS:
            break
        before = size if done or not kept else np.inf
        shift = np.asarray(rows(true).full()).ravel()[:moving]
        lower, upper = (
            np.concatenate([shift, limit[moving:]]) for limit in (program.lower, program.upper)
        )
        moved = replace(
            program, lower=lower, upper=upper, first=solution.w, multipliers=solution.multipliers
        )
        again = again or replace(solver, warm=True).prepared(moved)
        solution = again(moved, deadline)
        iterations += solution.iterations
        if not solution.success:
            return best if done else Corrected(solution, None, np.inf)
    return best


class _Motion:
    """Fine steps under what is planned: alone, or kept to the plan by feedback. far: m, what a motion that has left the plan is away from it."""

    def __init__(self, program: Program, model: Model, fractions: Array) -> None:
        self._program, self._model, self._fractions = program, model, fractions
        self._linear = program.unpack.size2_out(1) > len(fractions)
        self._step = (ramped_step if self._linear else shooting_step)(
            model, DormandPrince853(), FINE_STEPS
        )
        self._chain = self._step.mapaccum(len(fractions))
        self._offset = np.zeros(
            program.states.shape
        )  # of fine states from those that follow from the unknowns
        self.far = FAR * float(np.linalg.norm(np.ptp(model.structure.nodes, axis=0)))

    def free(self, states: Array, gamma: Array, T: float) -> Array:
        """Return the states of fine steps."""
        held = (gamma[:-1].T, gamma[1:].T) if self._linear else (gamma.T,)
        return np.column_stack(
            [states[0], np.asarray(self._chain(states[0], *held, T * self._fractions[None]).full())]
        ).T

    def gap(self, fine: Array, states: Array, T: float) -> float:
        """Return how far states are from fine ones, m (speeds: m per duration), where they are unknowns."""
        places, speeds, _ = self._model.split(np.abs(fine - states) * self._program.known)
        return float(max(places.max(initial=0.0), T * speeds.max(initial=0.0)))

    def kept(self, w: Array) -> tuple[Array, Array] | None:
        """Return the states of fine steps that feedback keeps to the plan, and w of that motion; None where there are no gains."""
        program = self._program
        if program.controls is None or program.together is None:
            return None
        states, gamma, T = _planned(program, w)
        wanted, lengths = states + self._offset, T * self._fractions
        try:
            with np.errstate(all="ignore"):
                gains = plan_gains(self._model, wanted, gamma, lengths, program.together)
        except (np.linalg.LinAlgError, ValueError):
            return None
        fine, change = wanted.copy(), np.zeros(gains.shape[:2])
        for k, h in enumerate(lengths):
            change[k] = gains[k] @ (wanted[k] - fine[k])
            fine[k + 1] = np.asarray(
                self._step(fine[k], gamma[k] + program.together @ change[k], h).full()
            ).ravel()
        if not np.all(np.isfinite(fine)):
            return None
        true = program.with_controls(program.with_states(w, fine), change)
        self._offset = (fine - _planned(program, true)[0]) * np.logical_not(program.known)
        return fine, true


def _planned(program: Program, w: Array) -> tuple[Array, Array, float]:
    """Return states (K + 1, nx), force densities and duration."""
    states, gamma, duration = (np.asarray(value.full()).T for value in program.unpack(w))
    return states, gamma, float(duration.squeeze())

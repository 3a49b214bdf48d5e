"""Plans in phases: one program of all, solved by IPOPT, and solved again for what contact on the true ground leaves."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.phases.correction import correct
from ocp.phases.first_guess import guess_phases, split_plan
from ocp.phases.motion import PhaseMotion
from ocp.phases.program import PhasedProgram, link_phases
from ocp.phases.targets import find_targets, phase_problems, whole_target
from ocp.plan.diagnosis import explain_failure, measure_misses
from ocp.plan.plan import Plan
from ocp.presolve import check_groups
from ocp.problem.costs import Duration, FinalCost
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.solvers.base import Outcome, Solution, Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.multipliers import named_duals
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess, InitialGuess
from ocp.transcription.variables import Variables
from ocp.transcription.variational import Variational
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, shown

MET = 3e-4  # of the structure's size: goals missed by more are missed


class PhasedTask(NamedTuple):
    """A problem with phases as a program: the problem, and the target, of each phase, and all of them linked."""

    parts: list[Problem]
    targets: list[Target]
    scales: Scales
    transcription: Transcription
    linked: PhasedProgram

    def joined(self, w: Array) -> tuple[Array, Array, Array]:
        """Return time (K + 1,), states (K + 1, nx) and force densities of all phases, where nodes land those after the impact."""
        values, shares = self.linked.values(w), self.transcription.fractions
        durations = [
            float(np.clip(one.duration, part.shortest, part.longest))
            for one, part in zip(values, self.parts, strict=True)
        ]
        states = np.concatenate([*(one.states[:-1] for one in values), values[-1].states[-1:]])
        gamma = [
            np.clip(one.force_density, *part.force_density_limits)
            for one, part in zip(values, self.parts, strict=True)
        ]
        return (
            np.append(
                0.0, np.cumsum(np.concatenate([duration * shares for duration in durations]))
            ),
            states,
            np.concatenate(gamma),
        )


def solve_phased(
    problem: Problem,
    transcription: Transcription,
    solver: Solver | CondensedNewton,
    guess: InitialGuess | None,
    deadline: float | None,
    tolerance: float,
) -> tuple[Outcome, Target]:
    """Return what was found for a problem with phases, and the target that its replay is measured by.

    transcription: a `Variational`, whose intervals are those of each phase. deadline: of
    `time.perf_counter`, s; None: no limit. tolerance: how far the replay may end from the goals, m.
    Raises TypeError, ValueError, InfeasibleGoalError.
    """
    if not isinstance(solver, Ipopt):
        raise ValueError(f"solver is {type(solver).__name__}: phases take ocp.Ipopt()")
    task = link_problem(problem, transcription, guess)
    solution = solver.solve(task.linked.program, deadline)
    planned, target = _outcome(task, solution)
    if not planned.success:
        return planned, target
    corrected = correct(
        task.linked, problem.model, solver, solution, task.joined, task.targets, tolerance, deadline
    )
    outcome, target = _outcome(task, corrected)
    return outcome._replace(
        success=True, why=""
    ), target  # goals were moved: the replay is what counts


def link_problem(
    problem: Problem, transcription: Transcription, guess: InitialGuess | None = None
) -> PhasedTask:
    """Return a problem with phases as a program. Raises TypeError, ValueError, InfeasibleGoalError."""
    if (
        not isinstance(transcription, Variational)
        or transcription.accuracy is not None
        or transcription.control.linear
    ):
        raise ValueError(
            f"transcription is {transcription}: phases take ocp.Variational(intervals), with PiecewiseConstant() and without accuracy"
        )
    if guess is not None and not isinstance(guess, Plan):
        raise TypeError(
            f"guess is {shown(guess)}: phases start from a plan of the same phases, or None"
        )
    check_groups(problem, transcription.control)
    scene, count = problem.model.scene, transcription.count
    air = replace(
        problem,
        model=Model(replace(scene, ground=None)),
        duration=problem.duration,
        goals=(),
        phases=(),
    )
    scales = Scales.of(replace(air, duration=max(phase.longest for phase in problem.phases)))
    parts = phase_problems(problem, air)
    targets = find_targets(problem, parts, scales)
    weight = (
        np.zeros(3)
        if scene.gravity is None
        else scales.mass * np.asarray(scene.gravity.acceleration, dtype=float)
    )
    first = (
        guess_phases(parts, targets, count, scales, float(np.linalg.norm(weight)))
        if guess is None
        else split_plan(guess, parts, count)
    )
    motions = []
    for k, (part, target, own) in enumerate(zip(parts, targets, first, strict=True)):
        stands = tuple(problem.phases[k].stands)
        lands = k > 0 and bool(set(stands) - set(problem.phases[k - 1].stands))
        v = Variables(
            _without_end(part, problem) if k + 1 < len(parts) else part,
            target,
            scales,
            own,
            transcription.fractions,
            transcription.control,
        )
        reactions = np.tile(-weight / max(len(stands), 1), len(stands))
        motions.append(PhaseMotion(v, stands, lands, -float(np.mean(own.force_density)), reactions))
    return PhasedTask(
        parts,
        targets,
        scales,
        transcription,
        link_phases(motions, scene.grounds, [phase.until for phase in problem.phases]),
    )


def _without_end(part: Problem, problem: Problem) -> Problem:
    """Return a phase before the last without the problem's own costs and limits of the end; but its duration is a part of the whole."""
    costs = [
        cost for cost in part.costs if isinstance(cost, Duration) or not isinstance(cost, FinalCost)
    ]
    return replace(
        part,
        costs=costs,
        bounds=[
            bound
            for bound in part.bounds
            if bound not in problem.bounds or not getattr(bound, "at_end", False)
        ],
    )


def _outcome(task: PhasedTask, solution: Solution) -> tuple[Outcome, Target]:
    values, program = task.linked.values(solution.w), task.linked.program
    time, states, gamma = task.joined(solution.w)
    count = task.transcription.count
    ends = time[count::count] / time[-1]
    target = whole_target(task.targets, ends)
    missed = measure_misses(
        target, lambda share: values[int(np.argmin(np.abs(ends - share)))].states[-1]
    )
    why = ""
    if not solution.success:
        why = explain_failure(
            missed, target, None, program, solution, Guess(states, gamma, float(time[-1])), "", {}
        )
    elif max((amount for amount, _ in missed.places), default=0.0) > MET * task.scales.length:
        why = f"no plan: {missed.worst()}: nodes that stand keep it from there, leave it out or let them step"
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    outcome = Outcome(
        states=states,
        force_density=gamma,
        duration=float(time[-1]),
        objective=float(cost) * program.objective,
        success=not why,
        status=solution.status,
        iterations=solution.iterations,
        duals=named_duals(program, target, solution.w, *solution.multipliers)
        if solution.success and solution.multipliers
        else None,
        why=why,
        imposed=f"{len(values)} phases; {target.describe()}",
        time=time,
    )
    return outcome, target

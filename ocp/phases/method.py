"""Planning with contact phases by one nonlinear program.

Deferred correction adapts its goals to the compliant ground.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.guess.initial_guess import InitialGuess
from ocp.phases.contact import PRESSED, cone_blocks, height_blocks
from ocp.phases.correction import Replay, correct
from ocp.phases.first_guess import guess_phases, split_plan
from ocp.phases.targets import find_targets, join_targets, phase_problems
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.diagnosis import explain_failure
from ocp.results.result import PlanResult
from ocp.solvers.base import Outcome, Solution, Solver, find_best_iterate
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.early_stop import stop_early
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Monitor
from ocp.solvers.multipliers import name_duals
from ocp.targets.target import Target
from ocp.transcription.assemble import Stage, assemble, build_stage
from ocp.transcription.base import Transcription
from ocp.transcription.contact_set import ContactSet, add_contacts
from ocp.transcription.mesh import Guess
from ocp.transcription.sparse_nlp import Block, Program
from ocp.transcription.variables import Entries, Variables
from ocp.transcription.variational import Variational
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, format_value


class PhaseValues(NamedTuple):
    """Solution of a phase with s contact nodes.

    If the phase begins with an impact, the state before it is the final state of the preceding
    phase.

    Attributes
    ----------
    states : ndarray, shape (K + 1, nx)
        States at the mesh points.
    force_density : ndarray, shape (K, α)
        Force densities [N/m].
    duration : float
        Duration [s].
    reactions : ndarray, shape (K + 1, s, 3)
        Ground reactions [N].
    impulses : ndarray, shape (0, s, 3) or (1, s, 3)
        Impulses of the impact [N·s].
    """

    states: Array
    force_density: Array
    duration: float
    reactions: Array
    impulses: Array


class PhasedTask(NamedTuple):
    """Problem with phases as a nonlinear program.

    Attributes
    ----------
    problem : Problem
        The problem.
    parts, targets, stages, contacts : list
        Problem, final state, constraints and contact nodes of each phase.
    harder : float
        Minimum normal reaction of a contact node, relative to a typical reaction.
    program : Program
        The nonlinear program.
    """

    problem: Problem
    parts: list[Problem]
    targets: list[Target]
    stages: list[Stage]
    contacts: list[ContactSet]
    harder: float
    program: Program

    @property
    def intervals(self) -> int:
        """Number of mesh intervals of each phase."""
        return self.stages[0].variables.count

    def values(self, w: Array) -> list[PhaseValues]:
        """Convert scaled decision variables w to the trajectory of each phase."""
        phases, count = len(self.parts), self.intervals
        states, gamma, durations = (one.full().T for one in self.program.unpack(w))
        y = self.stages[0].variables.entries.values(w)
        return [
            PhaseValues(
                own_states,
                own_gamma,
                float(duration),
                y[contact.reactions].reshape(count + 1, len(contact.stands), 3),
                y[contact.impulses].reshape(int(contact.lands), len(contact.stands), 3),
            )
            for own_states, own_gamma, duration, contact in zip(
                np.split(states, phases),
                np.split(gamma, phases),
                durations[:, 0],
                self.contacts,
                strict=True,
            )
        ]

    def joined(self, w: Array) -> tuple[Array, Array, Array]:
        """Join time, states and force densities of all phases.

        `w` are the scaled decision variables. Shapes are (K + 1,), (K + 1, nx) and (K, α) for K
        intervals of all phases. At an impact, the state is that after it.
        """
        values, nodes = self.values(w), self.stages[0].variables.fractions
        durations = [
            float(np.clip(one.duration, part.shortest, part.longest))
            for one, part in zip(values, self.parts, strict=True)
        ]
        states = np.concatenate([*(one.states[:-1] for one in values), values[-1].states[-1:]])
        gamma = [
            np.clip(one.force_density, *part.force_density_limits)
            for one, part in zip(values, self.parts, strict=True)
        ]
        intervals = np.concatenate([duration * nodes for duration in durations])
        return np.append(0.0, np.cumsum(intervals)), states, np.concatenate(gamma)


def solve_phased(
    problem: Problem,
    transcription: Transcription,
    solver: Solver | CondensedNewton,
    guess: InitialGuess | None,
    monitor: Monitor,
    tolerance: float,
    replay: Replay,
) -> tuple[Outcome, Target | None]:
    """Solve a problem with phases.

    The transcription must be a `Variational`, whose intervals are those of each phase. `tolerance`
    is the permitted distance of the `replay` from the goals [m]. Returns the result, and the target
    of its acceptance test; the target is None if the search stopped before. Without a guess,
    `guess_phases` builds one. Raises TypeError, ValueError or InfeasibleGoalError.
    """
    if not isinstance(solver, Ipopt):
        raise ValueError(f"solver is {type(solver).__name__}: phases take ocp.Ipopt()")
    task = monitor.run(lambda: link_problem(problem, transcription, tolerance, guess), lambda: None)
    if task is None:
        return stop_early(problem, transcription, monitor.status()), None

    def run() -> Solution:
        solution = solver.solve(task.program, monitor)
        if not solution.success:
            return solution
        corrected = correct(
            task.program,
            task.harder,
            replay,
            solver,
            solution,
            task.joined,
            task.targets,
            tolerance,
            monitor,
        )
        # The goals of the program were shifted, so that only the replay decides on success.
        return corrected._replace(success=True)

    solution = monitor.run(run, lambda: find_best_iterate(task.program, monitor))
    return _read_outcome(task, solution)


def link_problem(
    problem: Problem,
    transcription: Transcription,
    tolerance: float,
    guess: InitialGuess | None = None,
) -> PhasedTask:
    """Build the nonlinear program of a problem with phases.

    Linkage constraints connect the phases. Raises TypeError, ValueError or InfeasibleGoalError.
    Without a guess, `guess_phases` builds one. `tolerance` is that of the goals [m].
    """
    _check_options(transcription, guess)
    scene, count = problem.model.scene, transcription.count
    air = replace(
        problem,
        model=Model(replace(scene, ground=None), "reduced"),
        duration=problem.duration,
        goals=(),
        phases=(),
    )
    scales = Scales.of(replace(air, duration=max(phase.longest for phase in problem.phases)))
    parts = phase_problems(problem, air)
    targets = find_targets(problem, parts, scales, tolerance)
    weight = (
        np.zeros(3)
        if scene.gravity is None
        else scales.mass * np.asarray(scene.gravity.acceleration, dtype=float)
    )
    first = (
        split_plan(guess, parts, count)
        if isinstance(guess, PlanResult)
        else guess_phases(parts, targets, count, scales, float(np.linalg.norm(weight)))
    )
    stages: list[Stage] = []
    contacts: list[ContactSet] = []
    entries, least = Entries(), 0.0
    for k, (phase, part, target, own) in enumerate(
        zip(problem.phases, parts, targets, first, strict=True)
    ):
        entries.begin_phase()
        last = k + 1 == len(parts)
        v = Variables(
            part if last else _without_end(part, problem),
            target,
            scales,
            own,
            transcription.fractions,
            transcription.control,
            entries,
            stages[-1].variables.states[-1] if stages else None,
        )
        lands = k > 0 and bool(set(phase.contact_nodes) - set(problem.phases[k - 1].contact_nodes))
        share = -weight / max(len(phase.contact_nodes), 1)
        contact = add_contacts(
            v, phase.contact_nodes, lands, np.tile(share, len(phase.contact_nodes))
        )
        stage = build_stage(transcription, v, contact)
        if phase.contact_nodes:
            pressed = PRESSED * float(np.linalg.norm(share))
            least = max(least, pressed / contact.force)
            stage.blocks.rows.extend(cone_blocks(v, contact, scene.grounds[0], pressed))
        landing = () if last else problem.phases[k + 1].contact_nodes
        stage.blocks.rows.extend(height_blocks(v, contact, scene.grounds, landing))
        stages.append(stage)
        contacts.append(contact)
    program = assemble(stages, _end_times(problem, stages))
    return PhasedTask(problem, parts, targets, stages, contacts, least, program)


def _check_options(transcription: Transcription, guess: InitialGuess | None) -> None:
    if (
        not isinstance(transcription, Variational)
        or transcription.accuracy is not None
        or transcription.control.linear
    ):
        raise ValueError(
            f"transcription is {transcription}: phases take ocp.Variational(intervals), with PiecewiseConstant() and without accuracy"
        )
    if guess is not None and not isinstance(guess, PlanResult):
        raise TypeError(
            f"guess is {format_value(guess)}: phases start from a plan of the same phases, or None"
        )


def _end_times(problem: Problem, stages: list[Stage]) -> list[Block]:
    """Build the limits of the phases' end times.

    `stages` are the phases. An end time is the sum of the durations up to it. That of the first
    phase is limited by its duration.
    """
    durations = np.concatenate([stage.variables.duration for stage in stages])
    blocks = []
    for k, phase in enumerate(problem.phases):
        if phase.end_time is not None and k:
            z, size = ca.SX.sym("z", k + 1), sum(stage.variables.scales.time for stage in stages)
            earliest, latest = (time / size for time in phase.end_time)
            function = ca.Function("end", [z], [ca.sum1(z) / size])
            names = (f"end of phase {k}",)
            blocks.append(
                Block(
                    function,
                    durations[None, : k + 1],
                    names,
                    earliest,
                    latest,
                    size,
                    kind="path",
                    unit="s",
                )
            )
    return blocks


def _without_end(part: Problem, problem: Problem) -> Problem:
    """Remove terminal costs and limits from an intermediate phase.

    Additive costs remain, such as that of the duration, which is a part of the whole. Terminal
    limits remain if they belong to the phase and not to the problem.
    """
    costs = [cost for cost in part.costs if cost.additive]
    return replace(
        part,
        costs=costs,
        bounds=[
            bound
            for bound in part.bounds
            if bound not in problem.bounds or not getattr(bound, "at_end", False)
        ],
    )


def _read_outcome(task: PhasedTask, solution: Solution) -> tuple[Outcome, Target]:
    """Convert the solution of the nonlinear program to a result.

    Also returns the goals and states that its acceptance test uses.
    """
    values, program = task.values(solution.w), task.program
    time, states, gamma = task.joined(solution.w)
    ends = time[task.intervals :: task.intervals] / time[-1]
    target = join_targets(task.targets, ends)

    def state_at(share: float) -> Array:
        return np.asarray(values[int(np.argmin(np.abs(ends - share)))].states[-1])

    why = ""
    if not solution.success:
        found = Guess(states, gamma, float(time[-1]))
        why = explain_failure(task.problem, target, state_at, program, solution, found)
    cost = ca.Function("cost", [program.problem["x"]], [program.problem["f"]])(solution.w)
    outcome = Outcome(
        states=states,
        force_density=gamma,
        duration=float(time[-1]),
        objective=float(cost) * program.objective,
        success=not why,
        status=solution.status,
        iterations=solution.iterations,
        duals=name_duals(program, target, solution.w, *solution.multipliers)
        if solution.success and solution.multipliers
        else None,
        why=why,
        imposed=f"{len(values)} phases; {target.describe()}",
        time=time,
    )
    return outcome, target

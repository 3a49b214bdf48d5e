"""Method selection: the default sequence of attempts.

Comments give the measurement that justifies each attempt.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.guess.initial_guess import (
    NOISE,
    InitialGuess,
    InverseDynamics,
    TrajectoryGuess,
    evaluate_guess,
)
from ocp.problem.control import controls_force_densities, has_elastic_strings
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.result import PlanResult
from ocp.sampling.method import default_intervals
from ocp.sampling.solver import Sampling
from ocp.search.rest_lengths import (
    build_force_density_problem,
    convert_guess,
    is_converted,
    is_limited_at_instants,
    limit_instants,
    restore_forces,
)
from ocp.search.task import Method, PlanningTask
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.condensed_newton.method import NOT_SETTLED
from ocp.solvers.ipopt import Ipopt
from ocp.targets.find_target import find_target
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.direct_collocation import DirectCollocation
from ocp.transcription.mesh import Guess, PiecewiseLinear
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.variational import Variational
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.schema.definitions import resolve_names

FIRST, INEXACT, FAILED = "first", "inexact", "failed"
PHASE_INTERVALS = 20  # number of intervals of each phase
MIN_INTERVALS, MAX_INTERVALS = 30, 400
INTERVALS_PER_RADIAN = 3.0  # intervals per radian of the fastest vibration
# × √bars: forces accumulate along chains of bars, so that γ exceeds the guess with more bars
INTERVALS_PER_BAR = 6.0
CONDENSED_BARS = 6  # number of bars from which the condensed method is faster


class PlannedGuess(NamedTuple):
    """Initial guess from a plan with force densities as control.

    `plan` has the trajectory, converted to the control of the problem.
    """

    plan: TrajectoryGuess

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on a number of equal intervals."""
        return self.plan.guess(problem, target, intervals)


class Attempt(NamedTuple):
    """Transcription, solver and initial guess that a search tries.

    Attributes
    ----------
    transcription, solver, guess
        Method of solution. The guess may be another attempt, whose plan is used, see `plan_guess`.
    why : str
        Reason for the attempt.
    after : str
        Condition: the first attempt (FIRST), after an optimum with an inaccurate replay (INEXACT),
        or after a failure of the solver (FAILED).
    twin : PlanningTask, optional
        The same problem with force densities as control. Its plan is converted to rest lengths.
    """

    transcription: Transcription
    solver: Method
    guess: InitialGuess | PlannedGuess | Attempt | None
    why: str
    after: str = FIRST
    twin: PlanningTask | None = None

    def describe(self) -> str:
        """Describe the transcription and the solver.

        An example is "Variational of 30 intervals by Ipopt".
        """
        name, count = type(self.transcription).__name__, self.transcription.count
        text = f"{name} of {count} intervals by {type(self.solver).__name__}"
        if isinstance(self.guess, Attempt | PlannedGuess):
            return f"{text}, from a plan in force densities"
        return text if self.twin is None else f"{text}, in force densities"

    def follows(self, last: PlanResult | None) -> bool:
        """Return whether to run the attempt after the last plan.

        The plan has failed. None means that no attempt was made.
        """
        if last is None:
            return self.after == FIRST
        return self.after == (INEXACT if is_inexact(last) else FAILED)

    def refine(self, problem: Problem, plan: PlanResult) -> Attempt:
        """Build the attempt that repeats a plan on a finer mesh.

        It has at least twice as many intervals, and enough to resolve the vibration of the plan.
        """
        known = Guess(plan.trajectory.states, plan.control, float(plan.time[-1]))
        count = max(2 * (len(plan.time) - 1), choose_intervals(problem, known))
        finer = replace(self.transcription, intervals=count)
        return self._replace(transcription=finer, guess=plan)


class _EvaluatedGuess(NamedTuple):
    """Initial guess with a stored value for one number of intervals.

    Attributes
    ----------
    origin : InitialGuess
        Guess that is evaluated for other numbers of intervals.
    known : Guess
        The stored value.
    """

    origin: InitialGuess
    known: Guess

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Compute the guess on a number of equal intervals."""
        if intervals == len(self.known.force_density):
            return self.known
        return self.origin.guess(problem, target, intervals)


# No second start from another seed where limits are active: no plan of 25 gets better by more than
# 0.01 %, in twice the time (docs/benchmarks.md); `n_starts` asks for one.
def attempts(task: PlanningTask, guess: InitialGuess | None) -> Iterator[Attempt]:
    """Yield the attempts at a problem in order.

    `find_plan` runs those that apply after the last failure, and stops at the first success.
    `guess` is that of the user; None for the default one.
    """
    problem, model = task.problem, task.problem.model
    if task.target is None:  # phases have a method of their own
        yield Attempt(Variational(PHASE_INTERVALS), Ipopt(), guess, "phases")
        return
    # Without noise a symmetric guess is next to a saddle: with it IPOPT alone solves 137 of 138
    # problems without contact.
    default = InverseDynamics(noise=NOISE)
    first = evaluate_guess(default if guess is None else guess, problem, task.target, MIN_INTERVALS)
    start = _EvaluatedGuess(default, first) if guess is None else guess
    sampled = model.scene.grounds and not problem.free_start and controls_force_densities(model)
    near = sampled and is_near_ground(problem, first)
    after = FIRST
    # Another goal or parameter: 5 to 10 iterations, in place of 14 to 17 with another method
    if again := repeat_method(task, guess):
        yield again
        after = FAILED
    if near:  # IPOPT finds 0 of 8 jumps through a penalty ground, sampling 12 of 12
        yield Attempt(_for_sampling(problem), Sampling(), guess, "contact", after)
        after = FAILED
    count = choose_intervals(problem, first)
    # corrections within 0.3 of the tolerance, and within 1e-4 of the structure's size
    accuracy = min(0.3 * task.tolerance, 1e-4 * Scales.of(problem).length)
    shooting = MultipleShooting(count)
    variational = Variational(count, accuracy=accuracy)
    # Mean CPU time of CondensedNewton and of IPOPT [s]: up to 4 bars 0.36 and 0.21, 6 to 8 bars
    # 1.36 and 1.48 (the ball 0.89 and 1.27; towers that stand under their weight, where IPOPT has
    # to follow, 0.6 more), 9 to 12 bars 1.9 and 3.0, above 2.7 and 19.7.
    few = model.mechanism.bars < CONDENSED_BARS
    solver = Ipopt() if few else CondensedNewton()
    # CPU time with strings of 1e3 to 1e6 N/m: 1 to 2 s; the attempts below take over 18 s from 2e4 on
    force_attempt = build_force_density_attempt(task, first, solver, accuracy, after)
    if force_attempt is not None and model.has_coupled_rates:
        # CPU time of a prism of nine strings: 10 s, 30 s by shooting on all intervals; without
        # the plan none is found in 60 s
        collocation = DirectCollocation(max(MIN_INTERVALS, count // 3))
        yield Attempt(collocation, Ipopt(), force_attempt, "motors of winches", after)
        after = FAILED
    elif force_attempt is not None:
        strict = limit_attempt_instants(problem, force_attempt)
        # strings that go slack violate a least force density: the strict attempt comes first
        names_least = bool((problem.force_density_limits[0] > 0).any())
        both = [strict, force_attempt] if names_least else [force_attempt, strict]
        for attempt in both:
            if attempt is not None:
                yield attempt._replace(after=after)
                after = FAILED
    if model.has_coupled_rates:  # which Variational does not take
        yield Attempt(shooting, Ipopt(), start, "motors of winches", after)
        yield Attempt(shooting, Ipopt(), start, "mesh too coarse", INEXACT)
        return
    yield Attempt(variational, solver, start, "the fastest that converges", after)
    yield Attempt(variational, solver, start, "mesh too coarse", INEXACT)
    if not few:
        yield Attempt(variational, Ipopt(), start, "states kept as unknowns", FAILED)
        # a tower of 6 bars that stands unstably for 3 s: 13 s, and none by shooting in 40 s
        yield Attempt(variational, Ipopt(), start, "mesh too coarse", INEXACT)
    yield Attempt(shooting, Ipopt(), start, "other equations", FAILED)
    yield Attempt(shooting, Ipopt(), start, "mesh too coarse", INEXACT)
    if sampled and not near:
        yield Attempt(_for_sampling(problem), Sampling(), guess, "contact after all", FAILED)


def build_force_density_attempt(
    task: PlanningTask, guess: Guess, solver: Method, accuracy: float, after: str
) -> Attempt | None:
    """Build the attempt with force densities as control.

    Returns None if they cannot be the control, or if no final state was found. `guess` is a guess
    for the control of the problem. `accuracy` is that of the transcription [m]. `after` is the kind
    of failure after which the attempt runs.
    """
    twin = build_force_density_task(task)
    if twin is None or twin.target is None:
        return None
    known = convert_guess(task.problem, guess)
    forces = evaluate_guess(known, twin.problem, twin.target, MIN_INTERVALS)
    count = choose_intervals(twin.problem, forces, elastic=True)
    coarse = Variational(count, control=PiecewiseLinear(), accuracy=accuracy)
    return Attempt(coarse, solver, known, "stiff strings", after, twin)


def limit_attempt_instants(problem: Problem, attempt: Attempt) -> Attempt | None:
    """Build the attempt in force densities with limits of rest lengths at single instants.

    Mean rates over intervals permit rates that alternate within them. Of rest lengths at 1e5 N/m
    with an active limit, mean rates find none, and this attempt finds a plan in 1.2 s of CPU time.
    At 1e4 N/m near the least feasible limit, it is the slower one: 23 s in place of 1.2 s. Returns
    None without limits of rates and damping.
    """
    twin = attempt.twin
    limited = None if twin is None else limit_instants(problem, twin.problem)
    if twin is None or limited is None:
        return None
    why = "limits at single instants"
    return attempt._replace(twin=twin._replace(problem=limited), why=why, after=FAILED)


def build_force_density_task(task: PlanningTask) -> PlanningTask | None:
    """Build the same problem with force densities as control.

    Returns None if there is no such problem, see `build_force_density_problem`.
    """
    twin = build_force_density_problem(task.problem)
    if twin is None or not task.problem.model.na:
        return None if twin is None else task._replace(problem=twin)
    scales = Scales.of(twin)
    target = find_target(twin, scales, tolerance=task.tolerance / scales.length)
    return task._replace(problem=twin, target=target, scales=scales)


def repeat_method(task: PlanningTask, guess: InitialGuess | None) -> Attempt | None:
    """Build the attempt that repeats a plan's method with a warm start.

    Returns None unless `guess` is a successful plan by a nonlinear program for the same control.
    Plans that were converted from force densities are solved in these, with the same limits.
    """
    if not isinstance(guess, PlanResult) or not guess.success or guess.duals is None:
        return None
    transcription, solver = guess.transcription, guess.solver
    if transcription is None or guess.trajectory.states.shape[1] != task.problem.model.nx:
        return None
    if isinstance(solver, Ipopt):
        solver = replace(solver, warm_start=True)
    elif not isinstance(solver, CondensedNewton):
        return None
    again = Attempt(transcription, solver, guess, "solved before")
    if not is_converted(guess):
        return again
    twin = build_force_density_task(task)
    if twin is None or twin.target is None:
        return None
    again = again._replace(guess=restore_forces(guess), twin=twin)
    strict = limit_attempt_instants(task.problem, again)
    found = strict is not None and is_limited_at_instants(guess)
    return strict._replace(after=FIRST) if strict is not None and found else again


def _for_sampling(problem: Problem) -> Transcription:
    """Choose the mesh of a plan that random sampling finds."""
    return MultipleShooting(default_intervals(problem))


def complete(
    transcription: Transcription | None,
    solver: Method | None,
    guess: InitialGuess | None,
    problem: Problem,
) -> Attempt:
    """Build the attempt with the user's transcription and solver.

    Defaults replace those that are None. `guess` is None for the default guess.
    """
    solver = Ipopt() if solver is None else solver
    if transcription is None:
        if problem.phases:
            transcription = Variational(PHASE_INTERVALS)
        elif isinstance(solver, Sampling):
            transcription = _for_sampling(problem)
        else:
            condenses = isinstance(solver, CondensedNewton)
            transcription = Variational() if condenses else MultipleShooting()
    names = problem.model.scene.structure.names
    return Attempt(
        resolve_names(transcription, names), resolve_names(solver, names), guess, "asked for"
    )


def is_inexact(plan: PlanResult) -> bool:
    """Return whether a failed plan is an optimum of its program.

    Then the replay caused the failure.
    """
    return plan.duals is not None and plan.status != NOT_SETTLED


def is_near_ground(problem: Problem, guess: Guess) -> bool:
    """Return whether nodes of a guess come near a ground.

    Only nodes that can move count. It is also True if no node is pinned, as the structure can fall.
    """
    model, structure = problem.model, problem.model.scene.structure
    held = np.flatnonzero(structure.fixed.all(axis=1))
    if not len(held):
        return True
    margin = 0.02 * Scales.of(problem).length  # nearer nodes may touch it
    for ground in model.scene.grounds:
        depths, ends = ground.find_depths(model.structure, model.nodes(guess.states))
        moving = ~np.isin(ends, held).all(axis=1)
        if (depths[:, moving] > -margin).any():
            return True
    return False


def choose_intervals(problem: Problem, guess: Guess, elastic: bool = False) -> int:
    """Choose a number of intervals that resolves the fastest vibration.

    The vibration is that at the middle of the guess. It is `elastic` if the plan becomes one of
    rest lengths.
    """
    middle = len(guess.force_density) // 2
    rate = fastest_rate(problem.model, guess.states[middle], guess.force_density[middle])
    # Plans under rest-length control hardly excite vibrations; corrections remove the rest.
    each = 1.0 if elastic or has_elastic_strings(problem.model) else INTERVALS_PER_RADIAN
    wanted = np.ceil(each * rate * guess.duration) if np.isfinite(rate) else MIN_INTERVALS
    least = np.ceil(INTERVALS_PER_BAR * np.sqrt(problem.model.mechanism.bars))
    return int(np.clip(max(wanted, least), MIN_INTERVALS, MAX_INTERVALS))

"""From a problem to the result of a search: attempts in their order, each judged by its replay."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.control.lqr import replay_tracked
from ocp.problem.control import winds
from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.replay import replay_open
from ocp.results.result import PlanResult
from ocp.results.verdict import assess_plan
from ocp.search.coordinates import ReducedCoordinates, reduce_coordinates
from ocp.search.methods import run_method
from ocp.search.policy import INEXACT, Attempt, attempts, complete, is_inexact
from ocp.search.task import Method, Task, prepare
from ocp.solvers.base import Outcome
from ocp.solvers.monitor import Monitor
from ocp.solvers.relaxation import TOO_SLOW
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import InitialGuess
from ocp.transcription.mesh import PiecewiseConstant
from ocp.transcription.multiple_shooting import MultipleShooting
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.processes import one_blas_thread
from tenscasadi.util.validate import Array

# of the structure's size (and of it per duration): what a replay may miss by, unless a tolerance is
# stated
RELIABLE = 1e-2


class _Search(NamedTuple):
    """Arguments of a search. reduced: None where the model is planned as it is."""

    task: Task
    tracked: bool
    automatic: bool
    reduced: ReducedCoordinates | None


@one_blas_thread()
def find_plan(
    problem: Problem,
    transcription: Transcription | None = None,
    solver: Method | None = None,
    guess: InitialGuess | None = None,
    tolerance: float | None = None,
    *,
    seconds: float | None = None,
    tracked: bool = False,
) -> PlanResult:
    """Find a plan; arguments and errors as of `ocp.solve`."""
    monitor = Monitor(seconds)
    given = (
        None
        if transcription is None and solver is None
        else complete(transcription, solver, guess, problem)
    )
    reduced = None
    shoots = given is not None and isinstance(given.transcription, MultipleShooting)
    if not problem.phases and not shoots:
        reduced = reduce_coordinates(problem, guess)
    if reduced is not None:
        problem, guess = reduced.problem, reduced.guess(guess)
    limit = RELIABLE * Scales.of(problem).length if tolerance is None else tolerance
    control = PiecewiseConstant() if given is None else given.transcription.control
    task = prepare(problem, control, limit, monitor)
    rows = attempts(task, guess) if given is None else [given._replace(guess=guess)]
    with monitor.catching_interrupts():
        result = _walk(_Search(task, tracked, given is None, reduced), rows)
    if reduced is None:
        return result
    if result.success:
        result = replace(result, message=f"{result.message}; found in reduced coordinates")
    return reduced.restore(result)


def _walk(search: _Search, rows: Iterable[Attempt]) -> PlanResult:
    """Make the attempts that fit the failures before them; stop at the first success."""
    tried: dict[str, PlanResult] = {}
    best: PlanResult | None = None
    plan: PlanResult | None = None
    for attempt in rows:
        if not attempt.follows(plan):
            continue
        if plan is not None and attempt.after == INEXACT:
            attempt = attempt.refine(search.task.problem, plan)
        plan = _try(search, attempt)
        tried[attempt.describe()] = plan
        best = plan if best is None else max(best, plan, key=_worth)
        if plan.success or plan.status == TOO_SLOW or search.task.monitor.status():
            break
    if best is None:
        raise ValueError("no method takes the problem: give a transcription and a solver")
    if not search.automatic:
        return best
    names = [name for name in tried if tried[name] is not best]
    if best.success:
        told = f"chosen: {next(name for name in tried if tried[name] is best)}"
        told += f", after {', '.join(names)}" if names else ""
    else:
        told = f"tried: {', '.join(tried)}"
    return replace(
        best,
        message=f"{best.message}; {told}",
        iterations=sum(plan.iterations for plan in tried.values()),
        seconds=search.task.monitor.elapsed,
    )


def _worth(plan: PlanResult) -> tuple[bool, bool, float]:
    """Return what makes a plan better than another: success, an optimum, the smaller error."""
    return plan.success, is_inexact(plan), -plan.worst_error


def _try(search: _Search, attempt: Attempt) -> PlanResult:
    """Return what one attempt finds, judged by its replay."""
    outcome, target = run_method(search.task, attempt.transcription, attempt.solver, attempt.guess)
    plan = _record(search, attempt, outcome)

    def replay(plan: PlanResult) -> Trajectory:
        given = plan if search.reduced is None else search.reduced.restore(plan)
        if plan.tracked:
            motion = replay_tracked(given)
        else:
            motion = replay_open(given, given.known_model("replay"), RungeKutta4(), None)
        return motion if search.reduced is None else search.reduced.lower(motion)

    return assess_plan(plan, target, outcome, search.task.tolerance, replay, search.automatic)


def _record(search: _Search, attempt: Attempt, found: Outcome) -> PlanResult:
    """Return what was found as a plan that is not yet replayed."""
    problem, transcription = search.task.problem, attempt.transcription
    mesh = (
        found.duration * np.append(0.0, np.cumsum(transcription.fractions))
        if found.time is None
        else found.time.copy()
    )
    mesh[-1] = found.duration
    motion = _trajectory(problem, mesh, found)
    wound = found.force_density if winds(problem.model) else None
    forces = (
        found.force_density
        if wound is None
        else forces_of(problem.model, motion.states[: len(wound)], wound)
    )
    return PlanResult(
        success=False,
        status=found.status,
        message="",
        objective=found.objective,
        iterations=found.iterations,
        seconds=search.task.monitor.elapsed,
        time=mesh,
        force_density=forces,
        trajectory=motion,
        replay_error=np.nan,
        replay_speed_error=np.nan,
        structure=problem.model.scene.structure,
        model=problem.model,
        duals=found.duals,
        problem=problem,
        transcription=transcription,
        solver=attempt.solver,
        unknown="",
        rest_length=wound,
        tracked=search.tracked,
    )


def _trajectory(problem: Problem, mesh: Array, found: Outcome) -> Trajectory:
    """Return the planned motion at the nodes of the mesh."""
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(mesh)]
    with np.errstate(all="ignore"):
        return record_trajectory(
            problem.model,
            mesh,
            found.states,
            controls,
            step=float(mesh[1]),
            message="planned motion at the ends of the intervals",
            success=found.success or found.coarse,
        )

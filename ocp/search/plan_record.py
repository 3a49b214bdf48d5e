"""Conversion of attempts' results to plans."""

from __future__ import annotations

import numpy as np

from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.results.result import PlanResult
from ocp.search.task import Method, PlanningTask
from ocp.solvers.base import Outcome
from ocp.transcription.base import Transcription
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array


def record_plan(
    task: PlanningTask, transcription: Transcription, solver: Method, found: Outcome
) -> PlanResult:
    """Convert the result of an attempt to a plan.

    `found` is the result. The plan has no replay errors yet.
    """
    problem = task.problem
    mesh = (
        found.duration * np.append(0.0, np.cumsum(transcription.fractions))
        if found.time is None
        else found.time.copy()
    )
    mesh[-1] = found.duration
    motion = _record_motion(problem, mesh, found)
    control, model = found.force_density, problem.model
    forces = forces_of(model, motion.states[: len(control)], control)
    attribute = "force_density" if model.scene.control is None else model.scene.control.attribute
    return PlanResult(
        success=False,
        status=found.status,
        message="",
        objective=found.objective,
        iterations=found.iterations,
        seconds=task.monitor.elapsed,
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
        solver=solver,
        not_restored="",
        inputs=None if attribute == "force_density" else control,
        input_attribute=attribute,
    )


def _record_motion(problem: Problem, mesh: Array, found: Outcome) -> Trajectory:
    """Build the planned trajectory at the mesh points.

    `mesh` (K + 1,) are these times [s], `found` has the states and controls.
    """
    controls = np.concatenate([found.force_density, found.force_density[-1:]])[: len(mesh)]
    with np.errstate(all="ignore"):
        return record_trajectory(
            problem.model,
            mesh,
            found.states,
            controls,
            step=float(mesh[1]),
            message="planned motion at mesh points",
            success=found.success or found.coarse,
        )

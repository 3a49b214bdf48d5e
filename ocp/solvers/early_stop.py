"""Results of attempts that stop before the solver begins."""

from __future__ import annotations

import numpy as np

from ocp.problem.problem import Problem
from ocp.solvers.base import Outcome
from ocp.solvers.monitor import TIME_UP
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Guess, on_mesh


def stop_early(
    problem: Problem, transcription: Transcription, status: str, guess: Guess | None = None
) -> Outcome:
    """Build the result of an attempt without solution.

    It is the initial guess. Without one, it is the initial state under the nominal control.
    `status` is the reason of the stop.
    """
    name = "guess" if guess is not None else "start"
    if guess is None:
        controls = np.clip(problem.model.initial_control, *problem.control_limits)
        states = np.tile(problem.initial_state, (transcription.count + 1, 1))
        rows = np.tile(controls, (transcription.count, 1))
        guess = Guess(states, rows, problem.typical_duration)
    own = on_mesh(problem.model, guess, transcription.fractions, transcription.control)
    cure = ": increase time_limit" if status == TIME_UP else ""
    why = f"stopped before the solver began, with the {name}{cure}"
    return Outcome(own.states, own.force_density, own.duration, np.nan, False, status, 0, why=why)

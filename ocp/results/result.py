"""The result of a search for a plan, as data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from ocp.guess.initial_guess import resample_guess
from ocp.problem.problem import Problem
from ocp.results.error_growth import grown_errors
from ocp.results.planned_forces import PlannedForces
from ocp.sampling.solver import Sampling
from ocp.solvers.base import Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.multipliers import Duals
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Guess
from tenscasadi.dynamics.model import Model
from tenscasadi.schema.stored import Stored
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult(PlannedForces, Stored):
    """Control over time and the motion that it causes; `ocp.Plan` says what the fields are."""

    success: bool
    status: str
    message: str
    objective: float
    iterations: int
    seconds: float
    time: Annotated[Array, "t", "f"]
    force_density: Annotated[Array, "ku", "f"]
    trajectory: Trajectory
    replay_error: float
    replay_speed_error: float
    structure: Structure
    model: Model | None
    duals: Duals | None = None
    problem: Problem | None = None
    transcription: Transcription | None = None
    solver: Solver | CondensedNewton | Sampling | None = None
    not_restored: str = "it was made by hand"
    tracked: bool = False
    rest_length: Annotated[Array | None, "ku", "f"] = None
    start_objectives: Annotated[Array | None, "n", "f"] = None
    open_loop_error: float = np.nan

    def __repr__(self) -> str:
        count, strings = len(self.time) - 1, self.force_density.shape[1]
        return (
            f"{type(self).__name__}({count} intervals, {strings} strings, {self.time[-1]:g} s, "
            f"success={self.success}, replay_error={self.replay_error:.2g} m)"
        )

    @property
    def worst_error(self) -> float:
        """The larger of the replay's errors in place, and in speed times the duration, m; infinite where it diverges."""
        return float(
            np.nan_to_num(
                max(self.replay_error, self.replay_speed_error * float(self.time[-1])), nan=np.inf
            )
        )

    @cached_property
    def error_growth(self) -> float:
        """How many times larger small errors of the start can be at the end of the open-loop motion, in m, and m per duration of speed.

        The largest singular value of the motion's state transition: a few for calm motions,
        thousands where it is unstable. inf where it overflows; NaN where it is not known, as of
        plans with phases, whose impacts have no derivative.
        """
        if self.problem is not None and self.problem.phases:
            return np.nan
        return grown_errors(
            self.require_model("error_growth"), self.time, self.trajectory.states, self.control
        )

    def require_model(self, user: str) -> Model:
        """Return the model.

        Parameters
        ----------
        user : str
            What needs it, for the message.

        Returns
        -------
        Model
            The plan's model.

        Raises
        ------
        ValueError
            The plan was loaded from a file that does not hold it.
        """
        if self.model is None:
            missing = "which its file does not hold: it is of an older version, or the scene has functions of time"
            raise ValueError(
                f"{user} needs the model, {missing}; give Plan.load(path, problem=...)"
            )
        return self.model

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Return the plan as initial guess of a problem.

        Parameters
        ----------
        problem : Problem
            What is asked.
        target : Target
            Where its goals lead.
        intervals : int
            Number of equal ones, K.

        Returns
        -------
        Guess
            States (K + 1, nx), force densities (K, α), N/m, and duration, s.

        Raises
        ------
        ValueError
            The plan is of another structure.
        """
        if (
            self.trajectory.states.shape[1] != problem.model.nx
            or self.force_density.shape[1] != problem.model.nu
        ):
            raise ValueError(
                "guess is a plan for another structure: give one whose model has the same nodes and strings"
            )
        shares = self.time / self.time[-1]
        return resample_guess(
            problem,
            target,
            self.trajectory.states,
            shares,
            self.control,
            shares,
            intervals,
            float(self.time[-1]),
        )

"""Solution of an optimal control problem, as data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from ocp.guess.initial_guess import resample_guess
from ocp.problem.problem import Problem
from ocp.results.error_growth import measure_error_growth
from ocp.results.motion_spans import split_motion
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
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array

STEPS = 10  # integration steps and rest-length updates in each interval of a plan


@dataclass(frozen=True, eq=False, repr=False)
class PlanResult(PlannedForces, Stored):
    """Solution of an optimal control problem, as data.

    `ocp.Plan` documents the fields and adds methods.
    """

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
    inputs: Annotated[Array | None, "ki", "f"] = None
    input_attribute: str = "force_density"
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
        """Larger of both replay errors [m].

        They are the position error, and velocity error × duration. Infinite if the replay diverges.
        """
        return float(
            np.nan_to_num(
                max(self.replay_error, self.replay_speed_error * float(self.time[-1])), nan=np.inf
            )
        )

    @cached_property
    def error_growth(self) -> float:
        """Worst-case growth of small initial errors in open loop.

        It is the largest singular value of the state-transition matrix, with positions in m and
        velocities in m per duration. Values of a few are common; thousands indicate an unstable
        motion. It is inf if it overflows, and NaN if it is unknown. In plans with phases it is the
        largest growth within a phase, in which contact nodes are pinned, as impacts have no
        derivative.
        """
        model, states = self.require_model("error_growth"), self.trajectory.states
        phases = () if self.problem is None else self.problem.phases
        growths = [
            measure_error_growth(
                span.model,
                self.time[span.first : span.last + 1],
                states[span.first : span.last + 1, span.entries],
                self.control[span.first : span.last + int(self.linear)],
            )
            for span in split_motion(model, states, phases)
        ]
        return float(np.max(growths))

    def require_model(self, user: str) -> Model:
        """Return the model; raise ValueError if it is unknown.

        Parameters
        ----------
        user : str
            Name of the function that needs it, for the message.

        Returns
        -------
        Model
            The plan's model.

        Raises
        ------
        ValueError
            If the plan was loaded from a file without the model.
        """
        if self.model is None:
            missing = "which its file does not hold: it is of an older version, or the scene has functions of time"
            raise add_address(
                ValueError(f"{user} needs the model, {missing}; give Plan.load(path, problem=...)")
            )
        return self.model

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """Convert the plan to an initial guess of a problem.

        Parameters
        ----------
        problem : Problem
            Optimal control problem.
        target : Target
            Target of its goals.
        intervals : int
            Number K of equal intervals of the guess.

        Returns
        -------
        Guess
            States (K + 1, nx), force densities (K, α) [N/m], and duration [s].

        Raises
        ------
        ValueError
            If the plan has another structure.
        """
        if (
            self.trajectory.states.shape[1] != problem.model.nx
            or self.control.shape[1] != problem.model.nu
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


class Replayed(NamedTuple):
    """Replays by which a plan is accepted or rejected.

    The plan succeeds if every replay is valid and meets the goals.

    Attributes
    ----------
    motions : tuple of Trajectory
        The replay. If it fails the check of its step size: one in steps of its mean step size, and
        one in steps of half of it.
        Empty if the feedback of a tracked replay cannot be computed.
    failure : str
        Reason why the replay is not valid; "" if it is.
    """

    motions: tuple[Trajectory, ...]
    failure: str = ""

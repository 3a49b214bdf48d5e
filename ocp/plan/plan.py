"""What a solver found: force densities over time, the motion they cause, and how far its replay ends from the goal."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ocp.boundary.target import Target
from ocp.plan.mesh_refinement import finer
from ocp.plan.replay import run_profile
from ocp.plan.report import Report, report_of
from ocp.problem.problem import Problem
from ocp.solvers.multipliers import Duals
from ocp.transcription.initial_guess import Guess, resampled
from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.serialize import find_differences, model_from_arrays, model_to_arrays, structure_from_arrays, structure_to_arrays
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme
from tenscasadi.scene.strings import rest_length
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util import archive
from tenscasadi.util.validate import Array, instance, nonnegative, per_item, positive_number, whole_number

_FORMAT = "tenscasadi plan 1"
REPLAY_STEPS = 10  # steps of a replay for one interval of the plan
LOST = 1e6  # tolerances that a replay which diverges counts as its error


@dataclass(frozen=True, eq=False)
class Plan:
    """Force densities of α strings over K intervals, and the motion that they cause; also what is left when no plan was found.

    success: an optimum was found, and its replay meets the tolerance; status: the solver's word; message: what was imposed, what came of it,
    and after a failure why and what to try.
    objective: the costs' sum; iterations; seconds: wall time of the solver, building included. time (K + 1,) s;
    force_density (K, α) N/m, each row held from its time to the next, or (K + 1, α), linear between the times; trajectory: the planned
    motion at `time`.
    replay_error: m, and replay_speed_error: m/s: how far the motion that `replay` computes ends from the goals (NaN where it diverges).
    structure, model: what was planned for; `model` is None for a loaded plan whose scene has functions of time (moved supports, nodal forces).
    duals: what constraints cost; None where the solver found no optimum. problem: what was asked, and again: how it was solved, on intervals
    of these relative lengths, from a plan, to a tolerance; both None for a saved plan, unless `load` is given the problem.
    """

    success: bool
    status: str
    message: str
    objective: float
    iterations: int
    seconds: float
    time: Array
    force_density: Array
    trajectory: Trajectory
    replay_error: float
    replay_speed_error: float
    structure: Structure
    model: Model | None
    duals: Duals | None = None
    problem: Problem | None = None
    again: Callable[[Array, Plan, float], Plan] | None = None

    def __post_init__(self) -> None:
        for name in ("time", "force_density"):
            view = getattr(self, name).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    def __repr__(self) -> str:
        count, strings = len(self.time) - 1, self.force_density.shape[1]
        return f"Plan({count} intervals, {strings} strings, {self.time[-1]:g} s, success={self.success}, replay_error={self.replay_error:.2g} m)"

    def summary(self) -> str:
        """What was found and how, as a few lines of text."""
        tension = self.tension()
        return "\n".join(
            [
                self.message,
                f"solver        {self.status}, {self.iterations} iterations, {self.seconds:.3g} s",
                f"plan          {self.time[-1]:g} s in {len(self.time) - 1} intervals, objective {self.objective:.6g}",
                f"force density {self.force_density.min():.4g} … {self.force_density.max():.4g} N/m",
                f"tension       {tension.min():.4g} … {tension.max():.4g} N",
                f"replay        ends {self.replay_error:.2g} m and {self.replay_speed_error:.2g} m/s from the goal",
            ]
        )

    @property
    def linear(self) -> bool:
        """Whether force densities are given at the ends of intervals, and linear within."""
        return len(self.force_density) == len(self.time)

    def lengths(self) -> Array:
        """Distances (K + 1, α) between the ends of each string at `time`, m."""
        ends = self.trajectory.nodes[:, self.structure.strings]
        return np.asarray(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2))

    def tension(self, end: bool = False) -> Array:
        """Tensions γ s (K, α), N, at the start of each interval, or at its end."""
        lengths, gamma = self.lengths(), self.force_density
        if self.linear:
            return np.asarray(gamma[1:] * lengths[1:] if end else gamma[:-1] * lengths[:-1])
        return np.asarray(gamma * (lengths[1:] if end else lengths[:-1]))

    def bar_forces(self) -> Array:
        """Forces of the bars (K, β), N, at the start of each interval, positive in compression: λ ‖b‖ (Eqs. 46, 87).

        Raises ValueError where the model is not known.
        """
        model, count = self.known_model("bar_forces"), len(self.time) - 1
        lam = model.multiplier_function.map(count)(self.trajectory.states[:-1].T, self.force_density[:count].T)[0]
        ends = self.trajectory.nodes[:-1, self.structure.bars]
        return np.asarray(np.asarray(lam.full()).T * np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2))

    def rest_lengths(self, stiffness: ArrayLike | None = None) -> Array:
        """Rest lengths ρ = s (1 − γ/k) (K, α), m, that give γ at the start of each interval (Eq. 99, without damping); (K + 1, α) where γ is linear.

        stiffness: k, N/m, one number or one per string; None: the structure's. Raises ValueError naming the string where γ ≥ k.
        """
        given = self.structure.stiffness if stiffness is None else stiffness
        k = nonnegative("stiffness", per_item("stiffness", given, self.force_density.shape[1]), "string")
        largest = self.force_density.max(axis=0)
        bad = np.flatnonzero((largest > 0) & (largest >= k))
        if bad.size:
            i = int(bad[0])
            raise ValueError(f"stiffness of string {i} is {k[i]:g} N/m: it must exceed its force density, up to {largest[i]:g} N/m in this plan")
        return rest_length(self.force_density, self.lengths()[: len(self.force_density)], k)

    def replay(self, scheme: Scheme | None = None, step: float | None = None) -> Trajectory:
        """The motion under the planned force densities, integrated by `scheme` (None: RungeKutta4) in steps of `step` s (None: a tenth of
        an interval) from the plan's start, the clock of a scene with functions of time included, without corrections.

        Raises TypeError, ValueError; also where the model is not known: a loaded plan whose scene has functions of time.
        """
        model, scheme = self.known_model("replay"), RungeKutta4() if scheme is None else scheme
        check_scheme(scheme)
        size = None if step is None else positive_number("step", step)
        start, intervals = self.trajectory.states[0], np.diff(self.time)
        if self.linear or np.ptp(intervals) > 1e-9 * self.time[-1]:
            return run_profile(model, scheme, start, self.time, self.force_density, REPLAY_STEPS, size)
        size = intervals[0] / REPLAY_STEPS if size is None else size
        return simulate(model, float(self.time[-1]), size, scheme, start, self.force_density, compiled=False)

    def known_model(self, user: str) -> Model:
        """The model. Raises ValueError, naming what needs it, for a loaded plan whose file does not hold it."""
        if self.model is None:
            missing = "which its file does not hold: it is of an older version, or the scene has functions of time"
            raise ValueError(f"{user} needs the model, {missing}; give Plan.load(path, problem=...)")
        return self.model

    def guess(self, problem: Problem, target: Target, intervals: int) -> Guess:
        """The plan as initial guess on equal intervals. Raises ValueError for a plan of another structure."""
        if self.trajectory.states.shape[1] != problem.model.nx or self.force_density.shape[1] != problem.model.nu:
            raise ValueError("guess is a plan for another structure: give one whose model has the same nodes and strings")
        shares = self.time / self.time[-1]
        return resampled(problem, target, self.trajectory.states, shares, self.force_density, shares, intervals, float(self.time[-1]))

    def report(self) -> Report:
        """The limits that hold the plan back, with what they cost, and those that it breaks, or its replay between the ends of its intervals.

        Raises ValueError where the problem is not known: for a loaded plan.
        """
        if self.problem is None:
            raise ValueError("report needs the problem, which a file does not hold: give Plan.load(path, problem=...)")
        return report_of(self.problem, self.time, self.trajectory.states, self.force_density, self.replay(), self.duals)

    def refine(self, tolerance: float, attempts: int = 5) -> Plan:
        """The plan whose replay ends within `tolerance`, m, of the goals (and as many m per duration in speed).

        Cuts the intervals whose steps go wrong, in proportion, and solves again from what was found, at most `attempts` times, and no more
        where that does not halve the error. A plan that was not found is returned as it is; one that still misses the tolerance says so.
        Raises TypeError, ValueError; also for a loaded plan: solve with it as guess.
        """
        limit = positive_number("tolerance", tolerance)
        whole_number("attempts", attempts, 1)
        if self.again is None or self.model is None:
            raise ValueError("refine needs to know how the plan was solved, which a file does not hold: refine solve(problem, ..., guess=plan)")
        found, again, model = self, self.again, self.model
        why = f"in {attempts} attempts: give more, or substeps"
        for _ in range(attempts):
            error = found.worst_error
            if found.duals is None or error <= limit:
                return found
            times_too_large = error / limit if np.isfinite(error) else LOST
            finest = again(finer(model, found.time, found.trajectory.states, found.force_density, times_too_large), found, limit)
            if finest.duals is not None and not finest.worst_error <= max(limit, error / 2):
                why = f"and {len(finest.time) - 1} intervals in place of {len(found.time) - 1} do not halve the error: give a larger tolerance"
                found = min(found, finest, key=lambda plan: plan.worst_error)
                break
            found = finest
        if found.duals is None or found.worst_error <= limit:
            return found
        return replace(found, success=False, message=f"{found.message}; the tolerance of {limit:g} m was not met {why}")

    @property
    def worst_error(self) -> float:
        """The larger of the replay's errors in place, and in speed times the duration, m; infinite where it diverges."""
        return float(np.nan_to_num(max(self.replay_error, self.replay_speed_error * float(self.time[-1])), nan=np.inf))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a compressed .npz file (NumPy arrays only) to exactly `path` and returns it: the plan and its model, without functions of time.

        Raises OSError when it cannot be written.
        """
        content = {name: np.asarray(getattr(self, name)) for name in (*_VALUES, "time", "force_density")}
        content |= {f"trajectory.{field.name}": np.asarray(getattr(self.trajectory, field.name)) for field in fields(Trajectory)}
        if self.model is None:
            content |= structure_to_arrays(self.structure)
        else:
            content |= model_to_arrays(self.model, self.trajectory.states[:, -1])
        if self.duals is not None:
            content |= {f"duals.{field.name}": np.asarray(getattr(self.duals, field.name)) for field in fields(Duals)}
        return archive.save(path, _FORMAT, content)

    @staticmethod
    def load(path: str | os.PathLike[str], problem: Problem | None = None) -> Plan:
        """The plan saved in `path`; its model is rebuilt from the file, or is that of `problem`. No code in the file is ever run.

        Raises FileNotFoundError, ValueError naming the file for one that cannot be read or is no plan, and ValueError naming what differs
        for a problem with another model.
        """
        if problem is not None:
            instance("problem", problem, Problem, "an ocp.Problem or None")
        plan, content = archive.load(path, _FORMAT, "plan", lambda content: (_from_arrays(content), content))
        if problem is None:
            return plan
        wrong = find_differences(content, problem.model)
        if not wrong and plan.trajectory.states.shape[1] != problem.model.nx:
            wrong.append("Model.nx")  # older files hold less
        if wrong:
            raise ValueError(f"problem.model is not the plan's, other in {', '.join(wrong[:4])}: give the problem that the plan was made for")
        return replace(plan, model=problem.model, problem=problem)


_VALUES = {  # in NumPy's letters what they are
    "success": "b",
    "status": "U",
    "message": "U",
    "objective": "f",
    "iterations": "i",
    "seconds": "f",
    "replay_error": "f",
    "replay_speed_error": "f",
}


def _from_arrays(content: archive.Fields) -> Plan:
    model = model_from_arrays(content)
    structure = structure_from_arrays(content) if model is None else model.scene.structure
    values = {name: content.array(name, kind, 0).item() for name, kind in _VALUES.items()}
    trajectory = Trajectory.from_arrays(content.within("trajectory."))
    if model is not None and trajectory.states.shape[1] != model.nx:
        raise ValueError(f"field 'trajectory.states' has {trajectory.states.shape[1]} columns, not {model.nx}")
    intervals, strings = len(trajectory.time) - 1, len(structure.strings)
    time, gamma = content.array("time", "f", 1), content.array("force_density", "f", 2)
    rows = intervals + (len(gamma) == intervals + 1)
    for name, value, shape in (("time", time, (intervals + 1,)), ("force_density", gamma, (rows, strings))):
        if value.shape != shape:
            raise ValueError(f"field {name!r} has shape {value.shape}, not {shape}")
    duals = None
    if "duals.names" in content:
        duals = Duals(tuple(content.array("duals.names", "U", 1).tolist()), content["duals.values"], content["duals.point"])
    return Plan(**values, time=time, force_density=gamma, trajectory=trajectory, structure=structure, model=model, duals=duals)

"""What a solver found: force densities over time, the motion they cause, and how far its replay ends from the goal."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.duals import Duals
from ocp.problem import Problem
from ocp.refine import finer
from ocp.report import Report, report_of
from ocp.rerun import run_profile
from tenscasadi import archive
from tenscasadi.loads import Gravity
from tenscasadi.model import Model
from tenscasadi.scene import Scene
from tenscasadi.schemes import RungeKutta4, Scheme
from tenscasadi.simulate import simulate
from tenscasadi.strings import ForceDensity, rest_length
from tenscasadi.structure import PARAMETERS, Structure
from tenscasadi.trajectory import Trajectory
from tenscasadi.validate import Array, at_least, instance, per_item, positive_number, whole_number

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
    structure, model: what was planned for; `model` is None for a saved plan whose scene has moving supports, or loads other than gravity.
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
        if self.model is None:
            raise ValueError("bar_forces needs the model, whose loads a file does not hold: give Plan.load(path, problem=...)")
        count = len(self.time) - 1
        lam = self.model.multiplier_function.map(count)(self.trajectory.states[:-1].T, self.force_density[:count].T)[0]
        ends = self.trajectory.nodes[:-1, self.structure.bars]
        return np.asarray(np.asarray(lam.full()).T * np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2))

    def rest_lengths(self, stiffness: ArrayLike | None = None) -> Array:
        """Rest lengths ρ = s (1 − γ/k) (K, α), m, that give γ at the start of each interval (Eq. 99, without damping); (K + 1, α) where γ is linear.

        stiffness: k, N/m, one number or one per string; None: the structure's. Raises ValueError naming the string where γ ≥ k.
        """
        given = self.structure.stiffness if stiffness is None else stiffness
        k = at_least("stiffness", per_item("stiffness", given, self.force_density.shape[1], "string"), 0.0, "string")
        largest = self.force_density.max(axis=0)
        bad = np.flatnonzero((largest > 0) & (largest >= k))
        if bad.size:
            i = int(bad[0])
            raise ValueError(f"stiffness of string {i} is {k[i]:g} N/m: it must exceed its force density, up to {largest[i]:g} N/m in this plan")
        return rest_length(self.force_density, self.lengths()[: len(self.force_density)], k)

    def replay(self, scheme: Scheme | None = None, step: float | None = None) -> Trajectory:
        """The motion under the planned force densities, integrated by `scheme` (None: RungeKutta4) in steps of `step` s (None: a tenth of
        an interval) from the plan's start, without corrections.

        Raises ValueError where the model is not known: a loaded plan whose scene had loads other than gravity.
        """
        if self.model is None:
            raise ValueError("replay needs the model, whose loads a file does not hold: give Plan.load(path, problem=...)")
        size = None if step is None else positive_number("step", step)
        start = self.model.state(self.trajectory.nodes[0], self.trajectory.velocities[0])
        intervals = np.diff(self.time)
        if self.linear or np.ptp(intervals) > 1e-9 * self.time[-1]:
            return run_profile(self.model, scheme or RungeKutta4(), start, self.time, self.force_density, REPLAY_STEPS, size)
        size = intervals[0] / REPLAY_STEPS if size is None else size
        return simulate(self.model, float(self.time[-1]), size, scheme or RungeKutta4(), start, self.force_density, compiled=False)

    def report(self) -> Report:
        """The limits that hold the plan back, with what they cost, and those that its replay breaks between the ends of its intervals.

        Raises ValueError where the problem is not known: for a loaded plan.
        """
        if self.problem is None:
            raise ValueError("report needs the problem, which a file does not hold: give Plan.load(path, problem=...)")
        return report_of(self.problem, self.time, self.trajectory.states, self.force_density, self.replay(), self.duals)

    def refine(self, tolerance: float, attempts: int = 5) -> Plan:
        """The plan whose replay ends within `tolerance`, m, of the goals (and as many m per duration in speed).

        Cuts the intervals whose steps go wrong, in proportion, and solves again from what was found, at most `attempts` times. A plan that
        was not found is returned as it is; one that still misses the tolerance says so. Raises TypeError, ValueError; also for a
        loaded plan: solve with it as guess.
        """
        limit = positive_number("tolerance", tolerance)
        whole_number("attempts", attempts, 1)
        if self.again is None or self.model is None:
            raise ValueError("refine needs to know how the plan was solved, which a file does not hold: refine solve(problem, ..., guess=plan)")
        found, again, model = self, self.again, self.model
        for _ in range(attempts):
            error = found.worst_error
            if found.duals is None or error <= limit:
                return found
            times_too_large = error / limit if np.isfinite(error) else LOST
            found = again(finer(model, found.time, found.trajectory.states, found.force_density, times_too_large), found, limit)
        if found.duals is None or found.worst_error <= limit:
            return found
        return replace(found, message=f"{found.message}; the tolerance of {limit:g} m was not met in {attempts} attempts: give more, or substeps")

    @property
    def worst_error(self) -> float:
        """The larger of the replay's errors in place, and in speed times the duration, m."""
        return max(self.replay_error, self.replay_speed_error * float(self.time[-1]))

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Writes a compressed .npz file (NumPy arrays only) to exactly `path` and returns it. Raises OSError when it cannot be written."""
        content = {name: np.asarray(getattr(self, name)) for name in _VALUES}
        content |= {f"trajectory.{field.name}": np.asarray(getattr(self.trajectory, field.name)) for field in fields(Trajectory)}
        content |= {f"structure.{name}": np.asarray(getattr(self.structure, name)) for name in PARAMETERS if name != "pinned"}
        content["structure.fixed"] = np.asarray(self.structure.fixed)
        content |= _scene_arrays(self.model)
        if self.duals is not None:
            content |= {f"duals.{field.name}": np.asarray(getattr(self.duals, field.name)) for field in fields(Duals)}
        return archive.save(path, _FORMAT, content)

    @staticmethod
    def load(path: str | os.PathLike[str], problem: Problem | None = None) -> Plan:
        """The plan saved in `path`; its model is rebuilt from the file, or is that of `problem`. No code in the file is ever run.

        Raises FileNotFoundError, and ValueError naming the file for one that cannot be read or is no plan.
        """
        if problem is not None:
            instance("problem", problem, Problem, "an ocp.Problem or None")
        plan = archive.load(path, _FORMAT, "plan", _from_arrays)
        if problem is not None and (plan.trajectory.states.shape[1], plan.force_density.shape[1]) != (problem.model.nx, problem.model.nu):
            raise ValueError("problem is of another structure than the plan: give one whose model has the same nodes and strings")
        return plan if problem is None else replace(plan, model=problem.model, problem=problem)


_VALUES = ("success", "status", "message", "objective", "iterations", "seconds", "time", "force_density", "replay_error", "replay_speed_error")


def _scene_arrays(model: Model | None) -> dict[str, Any]:
    """What a file holds of the scene: enough to replay it, unless there are loads other than gravity."""
    if model is None or any(getattr(model.scene, load) is not None for load in ("ground", "pressure", "forces", "supports")):
        return {}
    scene = model.scene
    acceleration = np.zeros(0) if scene.gravity is None else np.asarray(scene.gravity.acceleration)
    return {"scene.gravity": acceleration, "scene.segments": np.asarray(scene.segments), "scene.ends": np.asarray(scene.ends)}


def _from_arrays(content: dict[str, Any]) -> Plan:
    pinned = {int(node): "".join(np.array(list("xyz"))[axes]) for node, axes in enumerate(content["structure.fixed"]) if axes.any()}
    given = {name: content[f"structure.{name}"] for name in PARAMETERS if name != "pinned"}
    structure = Structure(**given, pinned=pinned)
    model = None
    if "scene.gravity" in content:
        gravity = content["scene.gravity"]
        segments: Any = content["scene.segments"].tolist()
        model = Model(
            Scene(
                structure,
                control=ForceDensity(),
                segments=segments,
                ends=str(content["scene.ends"]),  # type: ignore[arg-type]  # Scene checks it
                gravity=Gravity(tuple(gravity.tolist())) if gravity.size else None,
            )
        )
    values = {name: value.item() if value.ndim == 0 else value for name, value in ((name, content[name]) for name in _VALUES)}
    prefix = "trajectory."
    trajectory = Trajectory.from_arrays({name.removeprefix(prefix): value for name, value in content.items() if name.startswith(prefix)})
    intervals, strings = len(trajectory.time) - 1, len(structure.strings)
    rows = intervals + (len(values["force_density"]) == intervals + 1)
    for name, shape in (("time", (intervals + 1,)), ("force_density", (rows, strings))):
        if values[name].shape != shape or values[name].dtype.kind != "f":
            raise ValueError(f"field {name!r} has shape {values[name].shape}, not {shape}")
    duals = None
    if "duals.names" in content:
        duals = Duals(tuple(content["duals.names"].tolist()), content["duals.values"], content["duals.point"])
    return Plan(**values, trajectory=trajectory, structure=structure, model=model, duals=duals)

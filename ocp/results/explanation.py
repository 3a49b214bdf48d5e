"""How far a motion is from the goals, and why no plan was found: what is violated, what holds it back, what to try."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.path_constraints import path_constraints
from ocp.problem.problem import Problem
from ocp.solvers.base import Solution
from ocp.solvers.ipopt import SADDLE
from ocp.solvers.monitor import STOPPED, TIME_UP
from ocp.solvers.relaxation import TOO_SLOW, find_rate_rows, measure_relaxation
from ocp.targets.control_sensitivities import ControlSensitivities
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, hermite_state, locate_share
from ocp.transcription.sparse_nlp import Program
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.util.validate import Array

MET = 3e-4  # of the structure's size (and of it per duration): goals missed by more are missed
VIOLATED = 1e-6  # in scaled rows: below it a constraint counts as met
AT_LIMIT = 1e-3  # of a limit: nearer counts as held by it
LONG = 2.0  # radians of the fastest vibration in a step: beyond, steps are unstable, or nearly
NOTHING = 1e-6  # m: smaller distances do not count beside speeds
PATIENT = 50  # iterations after which limits of rates that hold are to blame, not their number
RUNAWAY = 1e2  # in scaled unknowns: what nothing holds grows beyond

_ROOM = "give a longer duration, wider limits, or a nearer goal"
_CAUSES = {
    "iterations": "stopped at the iteration limit: raise max_iterations of the solver",
    "undetermined": "the equations of motion do not determine the states here: give solver=ocp.Ipopt()",
    "unstable": "errors grow too much along the guess to eliminate the states: give solver=ocp.Ipopt(), or another guess",
    "Maximum_Iterations_Exceeded": "stopped at the iteration limit: raise max_iterations of the solver",
    "Infeasible_Problem_Detected": f"no plan near this one meets all constraints: {_ROOM}, or more intervals",
    "Restoration_Failed": f"the solver found no way back to the constraints: {_ROOM}",
    "Invalid_Number_Detected": "something became infinite on the way: give more intervals or substeps",
    "Diverging_Iterates": f"the motion grew without bound: {_ROOM}",
    "Not_Enough_Degrees_Of_Freedom": "there are more constraints than unknowns: give more intervals, or leave constraints out",
}
_STOPS = {
    "Maximum_WallTime_Exceeded": "stopped at the time limit: raise Ipopt(seconds=...)",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit: raise max_cpu_time in Ipopt(options=...)",
    TIME_UP: "stopped at the time limit, with the best so far: raise seconds",
    SADDLE: "stopped at a saddle: leave out restart=False, or give another guess",
    STOPPED: "stopped on request, by Ipopt(watch=...) or from the keyboard, with the best so far",
}
_CONTACT = "through contact with a ground derivatives mislead the solver: try solver=ocp.Sampling(), or phases"
_STEPS = f"the solver could not go on: {_ROOM}, or more intervals"


StateAt = Callable[[float], Array]  # the state (nx,) at a share of the duration


class Misses(NamedTuple):
    """Distances from goals, m, and differences of speed, m/s, each with the name of the goal's row."""

    places: list[tuple[float, str]]
    speeds: list[tuple[float, str]]

    def worst(self) -> str:
        """Return the row that is missed most, and by how much; places come first. There has to be one."""
        place, speed = (max(rows, default=(0.0, "")) for rows in (self.places, self.speeds))
        (amount, name), unit = (
            (place, "m") if place[0] > NOTHING or not self.speeds else (speed, "m/s")
        )
        return f"{name} misses its goal by {amount:.2g} {unit}"


def measure_misses(target: Target, state_at: StateAt) -> Misses:
    """Return what the motion misses whose state (nx,) at a share of the duration is state_at(share)."""
    found = Misses([], [])
    for share, part, label in target.instants:
        metres, speeds = (
            np.abs(np.asarray(value.full()).ravel()).tolist()
            for value in part.misfit(state_at(share))
        )
        names = [label + name for name in part.names]
        found.places.extend(zip(metres, names, strict=False))
        found.speeds.extend(zip(speeds, names[len(metres) :], strict=True))
    return found


def state_function(model: Model, states: Array, duration: float, fractions: Array) -> StateAt:
    """Return the state (nx,) as a function of the share of the duration, as waypoints see it, of states (K + 1, nx) at the nodes of the mesh."""

    def state_at(share: float) -> Array:
        k, part = locate_share(fractions, share)
        before, after = states[k : k + 2]
        return (
            after
            if part == 1.0
            else np.asarray(
                hermite_state(
                    model, ca.DM(before), ca.DM(after), duration * fractions[k], part
                ).full()
            ).ravel()
        )

    return state_at


def goals_met(target: Target, state_at: StateAt) -> bool:
    """Tell whether the rows of all goals vanish, also those that were not imposed; how well bars and momenta are kept is not asked."""
    for share, part, _ in target.instants:
        residual = np.asarray(part.rows(state_at(share)).full()).ravel()
        if (
            len(residual)
            and np.abs(np.linalg.lstsq(part.reduction.combinations, residual)[0]).max() > MET
        ):
            return False
    return True


def explain_failure(
    missed: Misses,
    imposed: Target,
    reach: ControlSensitivities | None,
    program: Program,
    solution: Solution,
    found: Guess,
    too_long: str,
    units: Mapping[str, str],
) -> str:
    """Tell the cause and its cure, the largest violation by name, the limits that hold, and how many rows of the goals the strings move.

    too_long: what `long_steps` says. reach: None where it is not known. units: of what is limited,
    by its name.
    """
    values = ca.Function(
        "values", [program.problem["x"]], [program.problem["f"], program.problem["g"]]
    )(solution.w)
    f, g = (np.asarray(value.full()).ravel() for value in values)
    violation = np.maximum(np.maximum(program.lower - g, g - program.upper), 0.0)
    held = _held(program.w_names, solution.w, program.w_lower, program.w_upper) + _held(
        program.names, g, program.lower, program.upper
    )
    slow = [name for name in held if " rate " in name]
    cause = _STOPS.get(solution.status) or _not_finite(program, solution, f, g)
    if solution.status == TOO_SLOW:
        rates = find_rate_rows(program)
        beyond, times = (
            program.names[rates[np.argmax(violation[rates])]],
            1 + measure_relaxation(program, solution.w),
        )
        cause = f"{_slow(beyond)}; with limits of rates {times:.3g} times as wide this mesh has a way, which is this plan"
        cause += f", but {too_long}" if too_long else ""
    cause = cause or _runaway(program, solution) or too_long
    if not cause:
        cause = _CAUSES.get(solution.status, _STEPS)
        if held and solution.status == "Maximum_Iterations_Exceeded":
            cause += f", or {_ROOM}"
        if (
            slow
            and violation.max(initial=0.0) > VIOLATED
            and solution.status in _CAUSES
            and solution.iterations >= PATIENT
        ):
            cause = _slow(slow[0])
    parts = [f"no plan: {cause}"]
    if not np.all(np.isfinite(g)):
        return parts[0]
    worst = int(np.argmax(violation))
    if violation[worst] > VIOLATED:
        name, scale = program.names[worst], program.scale[worst]
        unit = units.get(name.split(",")[0])
        amount = (
            f"{violation[worst]:.2g} of its scale"
            if unit is None
            else f"{violation[worst] * scale:.2g} {unit}".rstrip()
        )
        parts.append(
            "largest violation: "
            + (missed.worst() if name.startswith("goal") else f"{name}, by {amount}")
        )
    else:
        parts.append(
            "all constraints are met, but the cost is not settled: a plan of another transcription may be a better guess"
        )
    if program.contact:
        parts.append(_CONTACT)
    if held:
        often, _ = Counter(name.split(",")[0] for name in held).most_common(1)[0]
        parts.append(f"upper limits hold {len(held)} times, most often the {often}")
    if reach is not None and imposed.count:
        states = reach.rollout(imposed.start, found.force_density, found.duration)
        if np.all(np.isfinite(states)):
            rank = len(
                reach.controllable_rows(
                    imposed.single,
                    imposed.weights,
                    imposed.start,
                    found.force_density,
                    found.duration,
                )
            )
            parts.append(f"the strings move {rank} of {imposed.count} rows of the goals")
    return "; ".join(parts)


def _slow(rate: str) -> str:
    return f"limits of rates leave no way that was found: allow a faster {rate.split(',')[0]}, or a longer duration"


def units_of(problem: Problem) -> dict[str, str]:
    """Return the units of all that bounds limit, by name; "" of own constraints."""
    kinds = (PathBound, RateBound)
    return {
        name: one.unit
        for kind in kinds
        for one in path_constraints(problem, kind)
        for name in one.names
    }


def long_steps(model: Model, states: Array, gamma: Array, step: float, duration: float) -> str:
    """Tell whether steps, s, are too long for the fastest vibration at some of the states (K + 1, nx) under γ (K, α), and how many are needed.

    The text is empty where they are not.
    """
    chosen = [
        k
        for k in sorted({0, len(gamma) // 2, len(gamma) - 1})
        if np.all(np.isfinite(states[k])) and np.all(np.isfinite(gamma[k]))
    ]
    rate = max((fastest_rate(model, states[k], gamma[k]) for k in chosen), default=0.0)
    if not rate * step > LONG:
        return ""
    return (
        f"steps of {step:.2g} s are too long for the fastest vibration, which takes {2 * np.pi / rate:.2g} s: "
        f"give at least {int(np.ceil(duration * rate))} of them, as intervals or substeps, or smaller force densities"
    )


def _not_finite(program: Program, solution: Solution, f: Array, g: Array) -> str:
    """Tell which row, cost, or derivative is not a number, and what to do."""
    if not np.all(np.isfinite(g)):
        return _cure(program.names[int(np.argmax(~np.isfinite(g)))])
    if not np.all(np.isfinite(f)):
        return _cure("the sum of Problem.costs")
    if solution.status != "Invalid_Number_Detected":
        return ""
    derivatives = program.derivatives()
    slope = np.asarray(derivatives["nlp_grad_f"](solution.w, [])[1].full()).ravel()
    if not np.all(np.isfinite(slope)):
        return _cure(
            f"the derivative of Problem.costs by {program.w_names[int(np.argmax(~np.isfinite(slope)))]}"
        )
    J = derivatives["nlp_jac_g"](solution.w, [])[1]
    bad = np.flatnonzero(~np.isfinite(np.asarray(J.nonzeros())))
    return (
        _cure(f"the derivative of {program.names[J.sparsity().get_triplet()[0][int(bad[0])]]}")
        if bad.size
        else ""
    )


def _cure(name: str) -> str:
    cure = (
        "give more intervals or substeps"
        if "dynamics" in name
        else "keep roots, logarithms and quotients away from their limits"
    )
    return f"{name} is not a number: {cure}"


def _runaway(program: Program, solution: Solution) -> str:
    """Tell which unknown grows and grows without limit."""
    if solution.last is None or not np.all(np.isfinite(solution.last)):
        return ""
    limits = np.where(solution.last > 0, program.w_upper, program.w_lower)
    size = np.where(np.isfinite(limits), 0.0, np.abs(solution.last))
    pulls = (
        np.array(
            [
                name.startswith(("force density of string", "rest length of string"))
                for name in program.w_names
            ]
        )
        * size
    )
    worst = int(
        np.argmax(pulls if pulls.max(initial=0.0) >= RUNAWAY else size)
    )  # what pulls makes the rest grow
    if size[worst] < RUNAWAY:
        return ""
    grown = solution.last[worst] * program.w_scale[worst]
    return f"{program.w_names[worst]} grows to {grown:.2g} with nothing to hold it: give it a limit, or a cost"


def _held(names: tuple[str, ...], value: Array, lower: Array, upper: Array) -> list[str]:
    """Return the entries at (or beyond) their upper limit."""
    limited = np.isfinite(upper) & (lower < upper)
    return [
        names[k] for k in np.flatnonzero(limited) if value[k] > upper[k] - AT_LIMIT * abs(upper[k])
    ]

"""Diagnosis of failures: violated constraint, cause, and cure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import casadi as ca
import numpy as np

from ocp.problem.limit_conflict import LimitCheck
from ocp.problem.problem import Problem
from ocp.problem.scaling import UNBOUNDED
from ocp.results.result import PlanResult
from ocp.solvers.base import Solution
from ocp.solvers.ipopt import SADDLE
from ocp.solvers.monitor import STOPPED, TIME_UP
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, hermite_state, locate_share
from ocp.transcription.sparse_nlp import Program
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stability import fastest_rate
from tenscasadi.util.validate import TOLERANCE, Array

_ROOM = "increase the duration, widen the limits, or move the goal closer"
_CAUSES = {
    "iterations": "stopped at the iteration limit: increase max_iterations of the solver",
    "undetermined": "the equations of motion do not determine the states here: give solver=ocp.Ipopt()",
    "unstable": "errors grow too much along the guess to eliminate the states: give solver=ocp.Ipopt(), or another guess",
    "Maximum_Iterations_Exceeded": "stopped at the iteration limit: increase max_iterations of the solver",
    "Infeasible_Problem_Detected": f"the constraint violation does not decrease near this motion: {_ROOM}, or give more intervals",
    "Restoration_Failed": f"IPOPT's restoration phase failed: {_ROOM}",
    "Invalid_Number_Detected": "a function became infinite: give more intervals or substeps",
    "Diverging_Iterates": f"the motion grew without bound: {_ROOM}",
    "Not_Enough_Degrees_Of_Freedom": "there are more constraints than unknowns: give more intervals, or leave constraints out",
}
_STOPS = {
    "Maximum_WallTime_Exceeded": "stopped at the time limit of the solver: increase it",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit: increase max_cpu_time in Ipopt(options=...)",
    TIME_UP: "stopped at the time limit, with the best so far: increase time_limit",
    SADDLE: "stopped at a saddle: leave out restart_at_saddle=False, or give another guess",
    STOPPED: "stopped on request, by a callback or from the keyboard, with the best so far",
}

StateAt = Callable[[float], Array]  # fraction of the duration → state (nx,)


def build_interpolant(model: Model, states: Array, duration: float, fractions: Array) -> StateAt:
    """Build the interpolant of the planned states.

    It is a function of the fraction of the duration: the cubic Hermite interpolant of the states (K
    + 1, nx) at the mesh points. The constraints of waypoints use the same interpolant. `fractions`
    (K,) are the interval lengths relative to the duration.
    """

    def state_at(share: float) -> Array:
        k, part = locate_share(fractions, share)
        ends = states[k], states[k + 1]
        return np.array(hermite_state(model, *ends, duration * fractions[k], part))

    return state_at


def interpolate_plan(plan: PlanResult) -> StateAt:
    """Build the interpolant of the states of a plan; see `build_interpolant`."""
    duration = float(plan.time[-1])
    model, fractions = plan.require_model("solve"), np.diff(plan.time) / duration
    return build_interpolant(model, plan.trajectory.states, duration, fractions)


def explain_failure(
    problem: Problem,
    target: Target,
    state_at: StateAt,
    program: Program,
    solution: Solution,
    found: Guess,
    step: float = 0.0,
) -> str:
    """Explain why a solver failed.

    `program` is the nonlinear program, `target` has its goals. The message gives the cause, its
    cure, and the name of the largest violation. `state_at` returns the planned states at a fraction
    of the duration. `step` is the longest step of its discretization [s]; 0 omits the check of its
    length. `solution` is the last iterate of the solver, `found` the same as states and controls.
    """
    functions = [program.problem["f"], program.problem["g"]]
    values = ca.Function("values", [program.problem["x"]], functions)(solution.w)
    f, g = (value.full().ravel() for value in values)
    violation = np.maximum(np.maximum(program.lower - g, g - program.upper), 0.0)
    too_long = ""
    if step:
        too_long = find_long_steps(
            problem.model, found.states, found.force_density, step, found.duration
        )
    cause = (
        _STOPS.get(solution.status)
        or _find_undefined(program, solution, f, g)
        or _find_overdetermined(target, program)
        or _find_runaway(program, solution)
        or too_long
        or _CAUSES.get(solution.status)
        or f"the solver could not go on: {_ROOM}, or give more intervals"
    )
    parts = [cause]
    if not np.all(np.isfinite(g)):
        return parts[0]
    worst = int(np.argmax(violation))
    if violation[worst] > TOLERANCE:
        name, amount = program.names[worst], violation[worst]
        unit = [block.unit for block in program.parts.rows for _ in block.names][worst]
        scaled = f"{amount:.2g} of its scale"
        text = f"{name}, by " + (
            scaled if unit is None else f"{amount * program.scale[worst]:.2g} {unit}".rstrip()
        )
        if name.startswith("goal"):
            row, size, unit = target.measure(state_at).find_worst(found.duration)
            text = f"{row} misses its goal by {size:.2g} {unit}"
        parts.append(f"largest violation: {text}")
    else:
        parts.append("all constraints are met, but the cost is not settled")
    if program.contact:
        parts.append(
            "through contact with a ground derivatives mislead the solver: try solver=ocp.Sampling(), or phases"
        )
    parts += _describe_limits(problem, target, program, solution, g)
    return "; ".join(parts)


def _describe_limits(
    problem: Problem, target: Target, program: Program, solution: Solution, g: Array
) -> list[str]:
    """Describe active upper limits and conflicting limits.

    Limits conflict if no control satisfies all of them at the target state. `g` are the values of
    the constraints.
    """
    names = _list_active(program.w_names, solution.w, program.w_lower, program.w_upper)
    rows = _list_active(program.names, g, program.lower, program.upper)
    names += [name for name in rows if not name.startswith("goal")]
    parts = []
    if names:
        often, _ = Counter(name.split(",")[0] for name in names).most_common(1)[0]
        parts.append(f"upper limits are active {len(names)} times, most often the {often}")
    if target.state is not None and not problem.phases:
        conflict = LimitCheck(problem).find_conflict(target.state, "end")
        if conflict is not None:
            parts.append(f"where the goals are met, {conflict.message}")
    return parts


def _find_overdetermined(target: Target, program: Program) -> str:
    """Find waypoints with more residuals than earlier controls can satisfy.

    `target` has the waypoints. Returns a message, or "" if there are no such waypoints.
    """
    unknowns, count = program.parts.unknowns, len(program.states) - 1
    controls = np.array(["of string" in name for name in unknowns.names])
    for share, part, label in target.instants:
        before = int(np.sum(controls & (unknowns.interval < max(share * count, 1e-9))))
        if before < part.count:
            return f"{label}{part.count} rows of goals need more than {before} controls before them: give more intervals"
    return ""


def find_long_steps(model: Model, states: Array, gamma: Array, step: float, duration: float) -> str:
    """Explain that steps are too long for the fastest vibration.

    States are (K + 1, nx), force densities `gamma` (K, α) [N/m], step and duration in seconds.
    Returns "" if the steps are short enough.
    """
    chosen = [
        k
        for k in sorted({0, len(gamma) // 2, len(gamma) - 1})
        if np.all(np.isfinite(states[k])) and np.all(np.isfinite(gamma[k]))
    ]
    rate = max((fastest_rate(model, states[k], gamma[k]) for k in chosen), default=0.0)
    if not rate * step > 2.0:  # the stability limit of the leapfrog method
        return ""
    return (
        f"steps of {step:.2g} s are too long for the fastest vibration, which takes {2 * np.pi / rate:.2g} s: "
        f"give at least {int(np.ceil(duration * rate))} of them, as intervals or substeps, or smaller force densities"
    )


def _find_undefined(program: Program, solution: Solution, f: Array, g: Array) -> str:
    """Find the constraint, cost or derivative that is not finite.

    `f` is the cost and `g` are the constraints at the solution. Returns its name with a cure, or ""
    if all are finite.
    """
    if not np.all(np.isfinite(g)):
        return explain_undefined(program.names[int(np.argmax(~np.isfinite(g)))])
    if not np.all(np.isfinite(f)):
        return explain_undefined("the sum of Problem.costs")
    if solution.status != "Invalid_Number_Detected":
        return ""
    derivatives = program.derivatives()
    slope = derivatives["nlp_grad_f"](solution.w, [])[1].full().ravel()
    if not np.all(np.isfinite(slope)):
        name = program.w_names[int(np.argmax(~np.isfinite(slope)))]
        return explain_undefined(f"the derivative of Problem.costs by {name}")
    J = derivatives["nlp_jac_g"](solution.w, [])[1]
    bad = np.flatnonzero(~np.isfinite(np.asarray(J.nonzeros())))
    if not bad.size:
        return ""
    return explain_undefined(
        f"the derivative of {program.names[J.sparsity().get_triplet()[0][int(bad[0])]]}"
    )


def explain_undefined(name: str) -> str:
    """Explain that a quantity is not a number, with a cure."""
    cure = (
        "give more intervals or substeps"
        if "dynamics" in name
        else "keep roots, logarithms and quotients away from their limits"
    )
    return f"{name} is not a number: {cure}"


def _find_runaway(program: Program, solution: Solution) -> str:
    """Find the state, control or duration that diverges and has no bound.

    Controls come first, as they make states grow. The value is that of the last iterate. Returns a
    message, or "" if none is large.
    """
    if solution.last is None or not np.all(np.isfinite(solution.last)):
        return ""
    limits = np.where(solution.last > 0, program.w_upper, program.w_lower)
    free = np.where(np.isfinite(limits), 0.0, np.abs(solution.last))
    # Users cannot limit other variables, such as multipliers and stages of integration.
    every = np.arange(len(free))
    controls, states = (
        free * np.isin(every, index) for index in (program.decided, program.states.ravel())
    )
    # A large control makes other unknowns large.
    worst = int(np.argmax(controls if controls.max(initial=0.0) >= UNBOUNDED else states))
    if states[worst] < UNBOUNDED and controls[worst] < UNBOUNDED:
        return ""
    grown = solution.last[worst] * program.w_scale[worst]
    return f"{program.w_names[worst]} grows to {grown:.2g} without a limit: give it one, or a cost"


def _list_active(names: tuple[str, ...], value: Array, lower: Array, upper: Array) -> list[str]:
    """List the names of entries at or above upper limits.

    Values, names and limits have the shape (n,). Entries with equal lower and upper limits do not
    count.
    """
    limited = np.isfinite(upper) & (lower < upper)
    return [names[k] for k in np.flatnonzero(limited) if value[k] > upper[k] - 1e-3 * abs(upper[k])]

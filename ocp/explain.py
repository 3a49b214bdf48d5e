"""Why no plan was found: which constraint is left violated, which goals the strings do not reach, and what to try."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.guess import Guess
from ocp.reach import Reach, controlled
from ocp.solver import Solution
from ocp.target import Target
from ocp.transcription import Program

VIOLATED = 1e-6  # in scaled rows: below it a constraint counts as met

_CAUSES = {
    "Maximum_Iterations_Exceeded": "stopped at the iteration limit: raise Ipopt(max_iterations=...), or give a longer duration or wider limits",
    "Infeasible_Problem_Detected": "no plan near this one meets all constraints: give a longer duration or wider limits",
    "Restoration_Failed": "the solver found no way back to the constraints: give a longer duration, wider limits, or more intervals",
    "Maximum_WallTime_Exceeded": "stopped at the time limit: raise it",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit: raise it",
    "Invalid_Number_Detected": "the motion became infinite on the way: give more intervals or substeps",
    "Error_In_Step_Computation": "the solver's steps became too small: give other goals, wider limits, or more intervals",
    "Search_Direction_Becomes_Too_Small": "the solver's steps became too small: give other goals, wider limits, or more intervals",
    "Not_Enough_Degrees_Of_Freedom": "there are more goals than force densities to meet them: give more intervals",
}


def explain_failure(target: Target, imposed: Target, reach: Reach, program: Program, solution: Solution, found: Guess) -> str:
    """One sentence with the cause, the largest violation by name, and the rank of the goals' rows."""
    if solution.success:
        return f"no plan: {_worst_goal(target, found)}, and no string moves it there to first order: give a goal that the motion passes"
    parts = [f"no plan: {_CAUSES.get(solution.status, f'the solver ended with {solution.status}')}"]
    g = np.asarray(ca.Function("rows", [program.problem["x"]], [program.problem["g"]])(solution.w).full()).ravel()
    violation = np.maximum(np.maximum(program.lower - g, g - program.upper), 0.0)
    if not np.all(np.isfinite(violation)):
        return parts[0] + f" ({program.names[int(np.argmax(~np.isfinite(violation)))]} is not a number)"
    worst = int(np.argmax(violation))
    if violation[worst] > VIOLATED:
        name = program.names[worst]
        parts.append(
            "largest violation: " + (_worst_goal(target, found) if name.startswith("goal") else f"{name}, {violation[worst]:.2g} of its scale")
        )
    if imposed.count:
        states = reach.rollout(target.start, found.force_density, found.duration)
        if np.all(np.isfinite(states)):
            rank = len(controlled(reach.of_rows(imposed.rows, states, found.force_density, found.duration)))
            parts.append(f"the strings move {rank} of {imposed.count} rows of the goals")
    return "; ".join(parts)


def _worst_goal(target: Target, found: Guess) -> str:
    metres, speeds = (np.abs(np.asarray(value.full()).ravel()) for value in target.misfit(found.states[-1]))
    if metres.max(initial=0.0) > VIOLATED or not speeds.size:
        return f"{target.names[int(np.argmax(metres))]} misses its goal by {metres.max(initial=0.0):.2g} m"
    return f"{target.names[len(metres) + int(np.argmax(speeds))]} misses its goal by {speeds.max():.2g} m/s"

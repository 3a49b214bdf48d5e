"""Why no plan was found: which constraint is left violated, which limits hold it back, which goals the strings move, what to try."""

from __future__ import annotations

from collections import Counter

import casadi as ca
import numpy as np

from ocp.guess import Guess
from ocp.misses import Misses
from ocp.program import Program
from ocp.reach import Reach, controlled
from ocp.solver import Solution
from ocp.target import Target
from tenscasadi.validate import Array

VIOLATED = 1e-6  # in scaled rows: below it a constraint counts as met
AT_LIMIT = 1e-3  # of a limit: nearer counts as held by it

_ROOM = "give a longer duration, wider limits, or a nearer goal"
_CAUSES = {
    "Maximum_Iterations_Exceeded": "stopped at the iteration limit: raise Ipopt(max_iterations=...)",
    "Infeasible_Problem_Detected": f"no plan near this one meets all constraints: {_ROOM}",
    "Restoration_Failed": f"the solver found no way back to the constraints: {_ROOM}",
    "Maximum_WallTime_Exceeded": "stopped at the time limit: raise max_wall_time",
    "Maximum_CpuTime_Exceeded": "stopped at the time limit: raise max_cpu_time",
    "Invalid_Number_Detected": "the motion became infinite on the way: give more intervals or substeps",
    "Diverging_Iterates": f"the motion grew without bound: {_ROOM}",
}
_STEPS = f"the solver could not go on: {_ROOM}, or more intervals"


def explain_failure(missed: Misses, imposed: Target, reach: Reach, program: Program, solution: Solution, found: Guess) -> str:
    """The cause and its cure, the largest violation by name, the limits that hold, and how many rows of the goals the strings move."""
    parts = [f"no plan: {_CAUSES.get(solution.status, _STEPS)}"]
    g = np.asarray(ca.Function("rows", [program.problem["x"]], [program.problem["g"]])(solution.w).full()).ravel()
    if not np.all(np.isfinite(g)):
        return f"{parts[0]} ({program.names[int(np.argmax(~np.isfinite(g)))]} is not a number)"
    violation = np.maximum(np.maximum(program.lower - g, g - program.upper), 0.0)
    worst = int(np.argmax(violation))
    if violation[worst] > VIOLATED:
        name = program.names[worst]
        parts.append("largest violation: " + (missed.worst() if name.startswith("goal") else f"{name}, {violation[worst]:.2g} of its scale"))
    held = _held(program.w_names, solution.w, program.w_lower, program.w_upper) + _held(program.names, g, program.lower, program.upper)
    if held:
        often, _ = Counter(name.split(",")[0] for name in held).most_common(1)[0]
        parts.append(f"upper limits hold {len(held)} times, most often the {often}")
    if imposed.count:
        states = reach.rollout(imposed.start, found.force_density, found.duration)
        if np.all(np.isfinite(states)):
            rank = len(controlled(reach.of_rows(imposed.rows, imposed.start, found.force_density, found.duration)))
            parts.append(f"the strings move {rank} of {imposed.count} rows of the goals")
    return "; ".join(parts)


def _held(names: tuple[str, ...], value: Array, lower: Array, upper: Array) -> list[str]:
    """The entries at (or beyond) their upper limit."""
    limited = np.isfinite(upper) & (lower < upper)
    return [names[k] for k in np.flatnonzero(limited) if value[k] > upper[k] - AT_LIMIT * abs(upper[k])]

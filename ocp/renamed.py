"""Public names of earlier versions."""

from __future__ import annotations

from ocp.targets.infeasible_goal import InfeasibleGoalError
from tenscasadi.util.renamed import find_renamed

__getattr__ = find_renamed("ocp", {"UnreachableGoal": ("InfeasibleGoalError", InfeasibleGoalError)})

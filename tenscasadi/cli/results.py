"""Loading of trajectories, rollouts and plans from files."""

from __future__ import annotations

from typing import Any

from tenscasadi.cli.loading import load_ocp
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.archive import read_format


def load_result(path: str) -> Any:
    """Load a trajectory, rollouts or a plan from a path.

    Raises ValueError, OSError.
    """
    kind = " ".join(read_format(path).split()[:2])
    if kind == "tenscasadi plan":
        return load_ocp().Plan.load(path)
    loaders = {"tenscasadi trajectory": Trajectory.load, "tenscasadi rollouts": Rollouts.load}
    if kind not in loaders:
        reason = (
            f"it holds a {kind.split()[-1]}"
            if kind.startswith("tenscasadi ")
            else "tenscasadi did not save it, or it is damaged"
        )
        raise ValueError(f"{path} is no trajectory, rollouts or plan: {reason}")
    return loaders[kind](path)

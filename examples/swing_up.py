"""A chain of two bars, hinged to the ceiling, swings up between strings and comes to rest upright.

The strings are too weak to lift it directly: it first swings to both sides. Run it with a folder
for the picture: python examples/swing_up.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

LENGTH, MASS = 1.0, 1.0  # m, kg, of each bar
SPAN = 1.5  # m, from the hinge to each anchor
WEAK = 4.0  # N/m, largest force density
DURATION = 2.0  # s


def chain() -> tc.Structure:
    """Build the chain: node 0 is the hinge, 1 the joint, 2 the tip, 3 and 4 anchors."""
    lean = 1e-3 * LENGTH  # hanging straight, no string could move it to one side first
    deep = np.sqrt(LENGTH**2 - lean**2)
    nodes = [(0, 0, 0), (lean, 0, -deep), (0, 0, -2 * deep), (-SPAN, 0, 0), (SPAN, 0, 0)]
    pinned = {0: "xyz", 1: "y", 2: "y", 3: "xyz", 4: "xyz"}  # it stays in its plane
    strings = [(1, 3), (1, 4), (2, 3), (2, 4)]
    return tc.Structure(nodes, bars=[(0, 1), (1, 2)], strings=strings, pinned=pinned, bar_mass=MASS)


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its swings, save a picture, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    model = tc.Model(tc.Scene(chain(), control=tc.ForceDensity(), gravity=tc.Gravity()))
    upright = {1: (0, None, LENGTH), 2: (0, None, 2 * LENGTH)}
    problem = ocp.Problem(
        model,
        duration=DURATION,
        goals=[ocp.NodePositions(upright), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(0.0, WEAK)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    print(plan.summary())

    replay = plan.replay()
    side = replay.nodes[:, 1, 0]
    print(f"swings        {count_swings(side)}, of the joint, up to {np.abs(side).max():.2f} m")
    print(f"tip           at {replay.nodes[-1, 2].round(4)} m in the end")
    plots.time_lapse(replay, instants=8, title="chain: swings up", path=folder / "swing_up.png")
    return plan


def count_swings(side: np.ndarray) -> int:
    """Count the reversals of a horizontal motion (T,) of more than 1 cm."""
    turns = side[1:-1][np.diff(np.sign(np.diff(side))) != 0]
    return int(np.sum(np.abs(np.diff(turns, prepend=0.0)) > 0.01))


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

"""A D-bar, pinned at one node, folds and unfolds: a class-2 structure with a waypoint and a periodic motion.

Run it with a folder for the pictures: python examples/dbar_folds.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

OPEN, FOLDED = np.pi / 4, 0.25  # rad, of the bars off the x axis


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its replay, save pictures, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    structure = tc.shapes.d_bar(angle=OPEN, pinned=[0], bar_mass=1.0)
    folded = tc.shapes.d_bar(angle=FOLDED).string_lengths
    problem = ocp.Problem(
        tc.Model(tc.Scene(structure, control=tc.ForceDensity())),
        duration=2.0,
        goals=[
            ocp.Waypoint([ocp.StringLengths(folded), ocp.AtRest()], time=1.0),
            ocp.StringLengths(structure.string_lengths),
            ocp.AtRest(),
        ],
        bounds=[ocp.ForceDensityLimits(1.0, 100.0)],
        costs=[ocp.Effort(), ocp.Smoothness(1e-3)],
    )
    plan = ocp.solve(problem, ocp.MultipleShooting(40, substeps=2))
    print(plan.summary())
    print(plan.report())
    replay = plan.replay()
    strings = np.linalg.norm(np.diff(replay.nodes[:, structure.strings], axis=2)[:, :, 0], axis=2)
    middle = strings[np.argmin(abs(replay.time - 1.0))]
    print(
        f"strings       {strings[0].round(4)} → {middle.round(4)} (wanted {folded.round(4)}) → {strings[-1].round(4)} m"
    )
    first = plan.trajectory.nodes[: len(plan.time) // 2 + 1]
    print(f"node 0 moves by {np.abs(first[:, 0] - structure.nodes[0]).max():.1g} m")
    half = tc.simulate(problem.model, 1.0, 5e-3, control=plan.force_density[:20], compiled=False)
    plots.time_lapse(
        half, instants=5, title="D-bar: folds, pinned at one node", path=folder / "dbar_folds.png"
    )
    plots.force_densities(
        plan,
        lower=1.0,
        upper=100.0,
        title="D-bar: planned force densities",
        path=folder / "dbar_folds_forces.png",
    )
    return plan


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

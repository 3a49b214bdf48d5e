"""A hinged arm with four strings reaches a point and avoids a ball in its path.

Run it with a folder for the pictures: python examples/arm_reaches.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

REACH = (0.6, 0.1, None)  # m; the height follows from the arm's length
BALL, RADIUS = (0.0, -0.05, 0.9), 0.25  # m


def arm() -> tc.Structure:
    """Build the arm: node 0 is its hinge, 1 its tip, 2-5 the string anchors."""
    nodes = [
        (0, 0, 0),
        (-0.6, 0.1, np.sqrt(1 - 0.37)),
        (-1, 0, 0),
        (1, 0, 0),
        (0, -1, 0),
        (0, 1, 0),
    ]
    return tc.Structure(
        nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5]
    )


def main(folder: Path = Path()) -> dict[str, ocp.Plan]:
    """Print both plans, with and without the ball, save pictures, and return the plans."""
    folder.mkdir(parents=True, exist_ok=True)
    structure = arm()
    model = tc.Model(tc.Scene(structure, control=tc.ForceDensity(), gravity=tc.Gravity()))
    plans = {}
    for name, obstacles in (("straight", []), ("round the ball", [ocp.Obstacle(BALL, RADIUS)])):
        problem = ocp.Problem(
            model,
            duration=1.0,
            goals=[ocp.NodePositions({1: REACH}), ocp.AtRest()],
            bounds=[ocp.ForceDensityLimits(1.0, 100.0), *obstacles],
            costs=[ocp.Effort(), ocp.Smoothness(1e-2)],
        )
        plan = plans[name] = ocp.solve(problem, ocp.MultipleShooting(30, substeps=2))
        replay = plan.replay()
        print(f"--- {name}\n{plan.summary()}")
        print(plan.report())
        print(f"hand          at {replay.nodes[-1, 1].round(5)} m, wanted {REACH}")
        print(
            f"ball          bars come as near as {nearest(replay):.4f} m to its center, its radius is {RADIUS} m"
        )
    figure = plots.time_lapse(
        plans["round the ball"].replay(), instants=6, title="arm: reaches round a ball"
    )
    figure.axes[0].view_init(elev=20, azim=-8)  # type: ignore[attr-defined]  # along the way: it goes round the side
    draw_ball(figure.axes[0])
    figure.savefig(folder / "arm_reaches.png", dpi=150)
    return plans


def draw_ball(axes: Any) -> None:
    """Draw the ball as a transparent net."""
    around, down = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)
    axes.plot_wireframe(
        *(center + RADIUS * side for center, side in zip(BALL, (x, y, z), strict=True)),
        color="tab:red",
        linewidth=0.4,
        zorder=1,
    )


def nearest(motion: tc.Trajectory) -> float:
    """Compute the smallest distance of the bars from the ball's center [m]."""
    least = np.inf
    for a, b in motion.bars:
        start, along = motion.nodes[:, a], motion.nodes[:, b] - motion.nodes[:, a]
        share = np.clip(
            np.sum((np.array(BALL) - start) * along, axis=1) / np.sum(along**2, axis=1), 0, 1
        )
        least = min(
            least,
            float(np.linalg.norm(start + share[:, None] * along - np.array(BALL), axis=1).min()),
        )
    return least


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

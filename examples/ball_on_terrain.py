"""A ball of six bars rolls down a hilly slope, hits a wall, and comes to rest in a hollow.

There are two grounds: a height field, bilinear between the points of a grid, with friction; and a
wall.

Run it with a folder for the picture: python examples/ball_on_terrain.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

import tenscasadi as tc
from tenscasadi import plots

LENGTH, WIDTH = 8.0, 4.0  # of the height field, m
LAW: dict[str, Any] = {
    "stiffness": 3000.0,
    "damping": 30.0,
    "friction": 0.5,
    "slip_speed": 0.1,
}  # N/m, N s/m, 1, m/s
WALL = 0.6  # m, where it stands


def main(folder: Path = Path(), quick: bool = False) -> tuple[tc.Terrain, tc.Trajectory]:
    """Print the motion of the ball, save a picture, and return height field and trajectory."""
    folder.mkdir(parents=True, exist_ok=True)
    field = hills(41 if quick else 161)
    ball = tc.shapes.six_bar_ball(stiffness=2000.0, damping=10.0, prestress=200.0)
    ball = ball.replace(nodes=ball.nodes - ball.nodes.mean(axis=0) + [-3.0, 0.2, 2.0])
    wall = tc.Ground(normal=(-1, 0, 0), height=-WALL, stiffness=3000.0)
    model = tc.Model(tc.Scene(ball, gravity=tc.Gravity(), ground=[field, wall]))
    start = model.state(ball.nodes, np.tile([2.5, 0.0, 0.0], (len(ball.nodes), 1)))
    run = tc.simulate(
        model, 5.0, 5e-4, state=start, save_every=20, correction=tc.Projection(every=10)
    )
    print(run.summary())
    way = run.nodes.mean(axis=1)
    reached = float(run.nodes[..., 0].max())
    depth = np.asarray(field.depth(run.nodes[-1].T)).ravel()
    print(
        f"its center goes {way[-1, 0] - way[0, 0]:.2f} m ahead and {way[0, 2] - way[-1, 2]:.2f} m down, {reached - WALL:.3f} m into the wall"
    )
    print(
        f"at the end it stands on nodes {np.flatnonzero(depth > 0).tolist()}, at {np.abs(run.velocities[-1]).max():.1g} m/s at most"
    )
    plots.time_lapse(
        run,
        7,
        ground=model.scene.ground,
        title="a ball rolls over a height field against a wall",
        path=folder / "ball_on_terrain.png",
    )
    return field, run


def hills(points: int) -> tc.Terrain:
    """Build a height field of 22 % slope with waves."""
    x, y = (
        np.linspace(-LENGTH / 2, LENGTH / 2, points)[:, None],
        np.linspace(-WIDTH / 2, WIDTH / 2, points // 2 + 1),
    )
    heights = 0.1 * np.sin(2.2 * x) + 0.1 * y**2 - 0.22 * x
    return tc.Terrain(heights, (-LENGTH / 2, -WIDTH / 2), (LENGTH / 2, WIDTH / 2), **LAW)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

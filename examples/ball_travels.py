"""A ball of six bars travels over flat ground, uphill and downhill by 10°, controlled by `ocp.Mppi` at 20 Hz.

There is no plan and no derivative: the controller simulates contact and friction. The goal is a
speed of 0.7 m/s straight ahead with constant height and shape. The controller's model has errors:
the ball is a tenth heavier, the ground three times stiffer and more slippery than in the model. The
slope is known. Constant force densities do not stabilize the ball: it would collapse within half a
second.

Run it with a folder for the picture: python examples/ball_travels.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc

BEHIND, EDGE = 11, (3, 7)  # nodes of the face that it stands on; it rolls over EDGE
SPEED = 0.7  # m/s
PERIOD, DURATION = 0.05, 4.0  # s
LEAST, MOST, USUAL = 50.0, 1000.0, 300.0  # N/m, force densities
BELIEVED = {
    "mass": 1.0,
    "stiffness": 1000.0,
    "friction": 0.8,
}  # kg of a bar, N/m and μ of the ground
ACTUAL = {"mass": 1.1, "stiffness": 3000.0, "friction": 0.6}


class Row(NamedTuple):
    """Result of a run: slope [°], distances ahead and aside [m], and computation times."""

    slope: float
    ahead: float
    aside: float
    seconds: np.ndarray
    motion: tc.Trajectory


def main(folder: Path = Path(), quick: bool = False) -> list[Row]:
    """Print distances and computation times, save a picture, and return a row per slope."""
    folder.mkdir(parents=True, exist_ok=True)
    start = standing_still()
    rows = []
    print("slope   ahead   aside   a decision takes: median, 95 of 100, most")
    for slope in (0.0,) if quick else (0.0, 10.0, -10.0):
        row = travel(slope, start, 1.5 if quick else DURATION)
        times = "  ".join(
            f"{1e3 * np.quantile(row.seconds, share):.2f} ms" for share in (0.5, 0.95, 1.0)
        )
        print(f"{slope:4.0f}° {row.ahead:6.2f} m {row.aside:5.2f} m  {times}")
        rows.append(row)
    draw(rows, folder / "ball_travels.png")
    return rows


def world(
    slope: float, mass: float, stiffness: float, friction: float, control: Any = None
) -> tc.Model:
    """Build a model of the ball on a slope along x; gravity is tilted instead."""
    ball = tc.shapes.six_bar_ball(stiffness=3000.0, damping=5.0, prestress=USUAL, bar_mass=mass)
    edge, behind = ball.nodes[list(EDGE)], ball.nodes[BEHIND]
    down, ahead = edge.sum(axis=0) + behind, edge.mean(axis=0) - behind
    x, z = ahead / np.linalg.norm(ahead), -down / np.linalg.norm(down)
    nodes = (
        ball.nodes @ np.array([x, np.cross(z, x), z]).T
    )  # it stands on a face, and x points over an edge
    angle = np.radians(slope)
    gravity = tc.Gravity((-9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)))
    ground = tc.Ground(stiffness=stiffness, damping=20.0, friction=friction, slip_speed=0.3)
    return tc.Model(
        tc.Scene(
            ball.replace(nodes=nodes - [0, 0, nodes[:, 2].min()]),
            control=control,
            gravity=gravity,
            ground=ground,
        )
    )


def standing_still() -> np.ndarray:
    """Compute the nodes of the elastic ball at rest on flat ground."""
    elastic = world(0.0, **BELIEVED)
    return np.asarray(tc.simulate(elastic, 3.0, 5e-4, correction=tc.Projection(every=10)).nodes[-1])


def travel(slope: float, nodes: np.ndarray, duration: float) -> Row:
    """Simulate one run of the ball from rest."""
    believed, actual = (
        world(slope, **given, control=tc.ForceDensity()) for given in (BELIEVED, ACTUAL)
    )
    height, length = float(nodes[:, 2].mean()), float(believed.structure.string_lengths.mean())

    def wrong(now: ocp.Instant) -> Any:
        forward, sideways, up = ca.vertsplit(ca.sum2(now.velocities) / len(nodes))
        center = ca.sum2(now.nodes)[2] / len(nodes)
        moving = (forward - SPEED) ** 2 + sideways**2 + 0.3 * up**2
        return moving + 10.0 * (center - height) ** 2 + 0.3 * ca.sumsqr(now.lengths - length)

    problem = ocp.Problem(
        believed,
        start=nodes,
        bounds=[ocp.ForceDensityLimits(LEAST, MOST)],
        costs=[ocp.Integral("wrong", wrong), ocp.Prestress(USUAL, 1e-7)],
    )
    controller = ocp.Mppi(problem, PERIOD, horizon=0.5, samples=64, noise=100.0)
    loop = ocp.run(controller, duration, actual, believed.state(nodes), steps=50)
    went = loop.trajectory.nodes[-1].mean(axis=0) - loop.trajectory.nodes[0].mean(axis=0)
    return Row(slope, float(went[0]), float(abs(went[1])), loop.seconds, loop.trajectory)


def draw(rows: list[Row], path: Path, instants: int = 5) -> None:
    """Draw side views of each run at equal intervals, and the path of the center."""
    figure = Figure(figsize=(9.6, 3.9 * len(rows) + 0.6), layout="constrained")
    for ax, row in zip(np.ravel(figure.subplots(len(rows), 1, sharex=True)), rows, strict=True):
        angle, motion = np.radians(row.slope), row.motion
        turn = np.array(
            [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        )  # from the ground's axes to the level
        ground = turn @ [[-0.8, 3.6], [0.0, 0.0]]
        ax.fill_between(ground[0], ground[1], ground[1] - 0.15, color="0.9")
        shots = np.linspace(0, len(motion.time) - 1, instants).astype(int)
        for shade, shot in zip(np.linspace(0.25, 1.0, instants), shots, strict=True):
            side = motion.nodes[shot][:, [0, 2]] @ turn.T
            ax.add_collection(
                LineCollection(side[motion.strings], colors="tab:blue", linewidths=0.7, alpha=shade)
            )
            ax.add_collection(
                LineCollection(
                    side[motion.bars], colors="0.25", linewidths=3.0, capstyle="round", alpha=shade
                )
            )
        center = motion.nodes.mean(axis=1)[:, [0, 2]] @ turn.T
        ax.plot(*center.T, color="tab:red", lw=1.2, label="way of the center")
        ax.set(
            aspect="equal",
            ylabel="z (m)",
            title=f"{row.slope:g}°: {row.ahead:.2f} m in {motion.time[-1]:g} s",
        )
        ax.set_xlim(-0.7, 3.5)
        ax.set_ylim(np.array([-0.3, 1.45]) + min(0.0, 3.0 * np.tan(angle)))  # the same scale in all
    ax.set_xlabel("x (m)")
    figure.axes[0].legend(loc="upper left", fontsize=9, frameon=False)
    figure.suptitle(
        "six-bar ball, steered by sampled motions; shown at equal intervals of time, later is darker"
    )
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

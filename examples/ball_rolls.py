"""A ball of six bars rolls over an edge onto the next face, where it comes to rest in its initial shape.

The plan consists of force densities. Gravity acts, and the ground is compliant with friction: the
ball stands 2 cm deep in it, and friction is viscous below 0.3 m/s. The initial guess is a
simulation, in which two strings shorten to a half and a third of their lengths and back, so that an
elastic ball falls over. The plan is feasible, without a cost.

Run it with a folder for the pictures: python examples/ball_rolls.py pictures
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc
from tenscasadi import plots

BEHIND, EDGE, AHEAD = (
    11,
    (3, 7),
    1,
)  # the ball stands on EDGE and BEHIND, and rolls onto EDGE and AHEAD
DURATION = 0.9  # s
TIPPING = {
    12: 0.5,
    23: 0.3,
}  # strings and the share of their rest lengths to which they are wound: found by trying pairs of strings
WOUND = (
    0.2,
    0.25,
    0.55,
)  # s, when they are wound, when they begin to be let out again, and when they have been
LEAST, MOST = 10.0, 500.0  # N/m, force densities
STIFFNESS = 1000.0  # N/m, of the ground


def main(folder: Path = Path(), quick: bool = False) -> tuple[ocp.Plan, tc.Trajectory]:
    """Print the plan and the final position of its replay, save pictures, and return both.

    The returned trajectory continues for two seconds after the plan.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ball = standing(tc.shapes.six_bar_ball(stiffness=1000.0, damping=5.0, prestress=100.0))
    scene = tc.Scene(
        ball,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=STIFFNESS, damping=20.0, friction=0.8, slip_speed=0.3),
    )
    elastic, wound, planned = (
        tc.Model(replace(scene, control=control))
        for control in (None, tc.RestLength(), tc.ForceDensity())
    )

    still = tc.simulate(elastic, 3.0, 1e-3, correction=tc.Projection(every=10))
    start, lengths = planned.state(still.nodes[-1]), string_lengths(still)
    tipped = tc.simulate(wound, DURATION, 1e-3, state=start, control=winding(ball), save_every=5)
    depth = -ball.mass_matrix().sum() * 9.81 / 3 / STIFFNESS  # where three nodes carry the ball
    problem = ocp.Problem(
        planned,
        DURATION,
        start=start,
        goals=[
            ocp.NodePositions(dict.fromkeys((*EDGE, AHEAD), (None, None, depth))),
            ocp.StringLengths(lengths),
            ocp.AtRest(),
        ],
        bounds=[ocp.ForceDensityLimits(LEAST, MOST)],
    )
    grid = ocp.Variational(120 if quick else 240, control=ocp.PiecewiseLinear())
    guess = ocp.TrajectoryGuess(tipped.states, tipped.force_density)
    plan = ocp.solve(
        problem, grid, ocp.Ipopt(tolerance=1e-3), guess, tolerance=0.3 if quick else 0.05
    )
    print(plan.summary())

    replay = plan.replay()
    after = tc.simulate(
        wound, 2.0, 1e-3, state=replay.states[-1], control=ball.rest_length, save_every=10
    )
    watched = [BEHIND, *EDGE, AHEAD]
    for name, motion in (
        ("at the start", still),
        ("tipped", tipped),
        ("replayed", replay),
        ("2 s later", after),
    ):
        heights, speed = motion.nodes[-1][watched, 2].round(3), np.abs(motion.velocities[-1]).max()
        print(f"{name:13s} nodes {watched} at z = {heights} m, speed {speed:.2g} m/s")
    apart, deformed = (
        np.abs(change).max()
        for change in (
            replay.nodes[-1] - plan.trajectory.nodes[-1],
            string_lengths(replay) - lengths,
        )
    )
    print(
        f"replay        ends {apart:.2g} m from the planned nodes, and {deformed:.2g} m from the ball's lengths"
    )
    film(replay, folder / "ball_rolls.png")
    plots.force_densities(
        plan,
        lower=LEAST,
        upper=MOST,
        title="ball: planned force densities",
        path=folder / "ball_rolls_forces.png",
    )
    return plan, after


def standing(ball: tc.Structure) -> tc.Structure:
    """Rotate the ball so that it stands on the ground z = 0.

    Its center is at x = y = 0. The x axis points from node BEHIND over EDGE.
    """
    edge, behind = ball.nodes[list(EDGE)], ball.nodes[BEHIND]
    down, ahead = edge.sum(axis=0) + behind, edge.mean(axis=0) - behind
    x, z = ahead / np.linalg.norm(ahead), -down / np.linalg.norm(down)
    nodes = ball.nodes @ np.array([x, np.cross(z, x), z]).T
    return ball.replace(nodes=nodes - [0, 0, nodes[:, 2].min()])


def winding(ball: tc.Structure) -> np.ndarray:
    """Compute the rest lengths (100, α) [m] over DURATION for the initial guess."""
    wound = np.interp(np.linspace(0, DURATION, 100), (0.0, *WOUND), (0.0, 1.0, 1.0, 0.0))
    change = np.zeros(len(ball.strings))
    change[list(TIPPING)] = np.array(list(TIPPING.values())) - 1
    return np.asarray(ball.rest_length * (1 + wound[:, None] * change))


def string_lengths(motion: tc.Trajectory) -> np.ndarray:
    """Compute the final string lengths (α,) [m]."""
    ends = motion.nodes[-1][motion.strings]
    return np.asarray(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))


def film(motion: tc.Trajectory, path: Path, instants: int = 6) -> None:
    """Draw side views at equal time intervals."""
    figure = Figure(figsize=(9.6, 6.0), layout="constrained")
    panels = figure.subplots(2, instants // 2, sharex=True, sharey=True)
    face = [*EDGE, AHEAD]
    for ax, time in zip(panels.ravel(), np.linspace(0, motion.time[-1], instants), strict=True):
        side = motion.nodes[np.argmin(abs(motion.time - time))][:, [0, 2]]
        ax.axhspan(-0.1, 0.0, color="0.9")
        ax.add_collection(LineCollection(side[motion.strings], colors="tab:blue", linewidths=0.8))
        ax.add_collection(
            LineCollection(side[motion.bars], colors="0.25", linewidths=3.5, capstyle="round")
        )
        ax.plot(*side[face].T, "o", color="tab:red", label="the face that it rolls onto")
        ax.plot(*side[[BEHIND]].T, "s", color="tab:orange", label="the node that it leaves")
        ax.set_title(f"t = {time:.2g} s", fontsize=10)
        ax.set_aspect("equal")
        ax.set_ylim(-0.1, 1.0)
    for ax in panels[-1]:
        ax.set_xlabel("x (m)")
    for ax in panels[:, 0]:
        ax.set_ylabel("z (m)")
    figure.legend(
        *panels[0, 0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2,
        fontsize=9,
        frameon=False,
    )
    figure.suptitle("six-bar ball: rolls one face over, seen from the side")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

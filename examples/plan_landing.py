"""A prism jumps 0.3 m and lands at rest: a plan of four phases, replayed on a compliant ground.

In the stance phases the reactions of the ground are decision variables within the friction cone.
The landing is an inelastic impact. The replay has no phases: its ground is a spring with damping
and friction.

Run it with a folder for the picture: python examples/plan_landing.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc

BAR, HEIGHT, RISE = 1.0, 0.6, 0.3  # m
FEET = [0, 1, 2]
LEAST, MOST = 5.0, 500.0  # N/m


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its replay, save a picture, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    prism = tc.shapes.prism(
        3, np.sqrt(BAR**2 - HEIGHT**2) / (2 * np.sin(np.radians(75))), HEIGHT, bar_mass=0.3
    )
    ground = tc.Ground(stiffness=1e4, damping=60.0, friction=0.6, slip_speed=1e-2)
    top = ocp.CenterOfMass((None, None, HEIGHT / 2 + RISE))
    problem = ocp.Problem(
        tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground)),
        phases=[
            ocp.Phase((0.1, 0.5), contact_nodes=FEET),
            ocp.Phase((0.02, 0.5), goals=[top]),
            ocp.Phase((0.02, 0.5)),
            ocp.Phase((0.1, 0.6), contact_nodes=FEET, goals=[ocp.AtRest()]),
        ],
        bounds=[ocp.ForceDensityLimits(LEAST, MOST)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem, tolerance=0.05)
    print(plan.summary())

    replay = plan.replay()
    rise = replay.nodes[:, :, 2].mean(axis=1) - HEIGHT / 2
    apart, speed = (
        np.abs(replay.nodes[-1] - plan.trajectory.nodes[-1]).max(),
        np.abs(replay.velocities[-1]).max(),
    )
    print(f"rises         {rise.max():.4f} m, wanted {RISE} m")
    print(
        f"comes to rest {apart:.2g} m from the planned nodes, at {speed:.2g} m/s, feet {replay.nodes[-1, FEET, 2].min():.2g} m deep in the ground"
    )
    draw(plan, replay, folder / "plan_landing.png")
    return plan


def draw(plan: ocp.Plan, replay: tc.Trajectory, path: Path) -> None:
    """Draw shapes of the prism, the height of its center of mass, and force densities."""
    figure = Figure(figsize=(9, 6), layout="constrained")
    shapes, heights, forces = figure.subplots(3, 1, height_ratios=(1, 1, 1))
    ends = plan.time[:: (len(plan.time) - 1) // 4]
    instants = np.concatenate([ends[:-1], (ends[1:] + ends[:-1]) / 2, ends[-1:]])
    for column, time in enumerate(sorted(instants)):
        nodes = replay.nodes[np.argmin(np.abs(replay.time - time))]
        for pairs, style in (
            (replay.strings, {"color": "tab:red", "lw": 0.8}),
            (replay.bars, {"color": "0.25", "lw": 2.5}),
        ):
            shapes.plot(
                *(nodes[pairs][:, :, axis].T + 1.1 * column * (axis == 0) for axis in (0, 2)),
                **style,
            )
        shapes.annotate(f"{time:.2f} s", (1.1 * column, -0.25), ha="center")
    shapes.axhline(0.0, color="tab:green", lw=1)
    shapes.set(
        aspect="equal",
        ylim=(-0.32, None),
        xticks=[],
        ylabel="z (m)",
        title="a prism jumps 0.3 m and lands at rest: its replay",
    )
    heights.plot(replay.time, replay.nodes[:, :, 2].mean(axis=1), label="replayed")
    heights.plot(
        plan.time, plan.trajectory.nodes[:, :, 2].mean(axis=1), "k.", ms=3, label="planned"
    )
    heights.set(ylabel="center of mass (m)", xticklabels=[])
    heights.legend(frameon=False)
    forces.step(plan.time[:-1], plan.force_density, where="post", lw=0.8)
    forces.set(ylabel="force density (N/m)", xlabel="time (s)")
    for axes in (heights, forces):
        for end in ends:
            axes.axvline(end, color="0.8", lw=0.8, zorder=0)
        axes.set_xlim(0, plan.time[-1])
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

"""A tumbling prism flies into a frame, whose strings catch it smoothly and bring it to rest.

Run it with a folder for the picture: python examples/catch_prism.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import ocp
import tenscasadi as tc

FROM, TO = np.array([-0.8, 0.0, 1.2]), (0.2, 0.0, 1.2)  # m, its center of mass
SPEED, SPIN = np.array([1.5, 0.0, 1.0]), np.array([0.0, 2.0, 1.0])  # m/s, rad/s
FRAME, HEIGHT = 1.5, 2.5  # m, half of the frame's width, and its height
DURATION = 1.0  # s
WEIGHT = 3 * 0.5 * 9.81  # N


def prism_in_frame() -> tc.Structure:
    """Build prism and frame: nodes 0-5 are the prism, 6-9 and 10-13 the frame's corners."""
    prism = tc.shapes.prism(radius=0.3, height=0.5)
    square = FRAME * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    corners = [np.column_stack([square, np.full(4, z)]) for z in (HEIGHT, 0.0)]
    above = [(node, corner) for node in (3, 4, 5) for corner in range(6, 10)]
    below = [(node, corner) for node in (0, 1, 2) for corner in range(10, 14)]
    return tc.Structure(
        np.vstack([prism.nodes - prism.nodes.mean(axis=0) + FROM, *corners]),
        bars=prism.bars,
        strings=[*prism.strings.tolist(), *above, *below],
        pinned=range(6, 14),
        bar_mass=0.5,
    )


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and the motion, save a picture, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    structure = prism_in_frame()
    model = tc.Model(tc.Scene(structure, control=tc.ForceDensity(), gravity=tc.Gravity()))
    velocities = np.zeros_like(structure.nodes)
    velocities[:6] = SPEED + np.cross(SPIN, structure.nodes[:6] - FROM)
    own, long = 9, len(structure.strings) - 9  # its strings, and those to the frame
    limits = ocp.ForceDensityLimits(
        np.append(np.full(own, 5.0), np.zeros(long)),
        np.append(np.full(own, 300.0), np.full(long, 60.0)),
    )
    problem = ocp.Problem(
        model,
        duration=DURATION,
        start=model.state(structure.nodes, velocities),
        goals=[ocp.CenterOfMass(TO), ocp.AtRest()],
        bounds=[limits],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    print(plan.summary())

    replay = plan.replay()
    most = plan.tension()[:, own:].max()
    print(
        f"frame         its {long} strings pull with up to {most:.1f} N, the prism weighs {WEIGHT:.1f} N"
    )
    draw(plan, replay, folder / "catch_prism.png")
    return plan


def draw(plan: ocp.Plan, replay: tc.Trajectory, path: Path) -> None:
    """Draw side views at several times, and the tensions of the catching strings."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    center = replay.nodes[:, :6].mean(axis=1)
    left.plot(center[:, 0], center[:, 2], "k:", linewidth=1)
    for share in (0.0, 0.3, 0.65, 1.0):
        row = round(share * (len(replay.time) - 1))
        color, frame = plt.colormaps["viridis"](0.9 * share), replay.nodes[row][:, [0, 2]]
        for a, b in replay.bars:
            left.plot(*frame[[a, b]].T, color=color, linewidth=3)
        for string, (a, b) in enumerate(replay.strings):
            if string < 9 or (share == 1.0 and replay.tension[row, string] > 0.1):
                left.plot(*frame[[a, b]].T, color=color, linewidth=0.6)
        left.plot([], [], color=color, linewidth=3, label=f"{replay.time[row]:.2g} s")
    left.plot(*replay.nodes[0, 6:][:, [0, 2]].T, "k^")
    left.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title="thrown and caught")
    left.legend(loc="upper center", fontsize="small")
    right.plot(replay.time, replay.tension[:, 9:], color="tab:blue", linewidth=0.8)
    right.set(xlabel="time [s]", ylabel="tension [N]", title="strings to the frame")
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

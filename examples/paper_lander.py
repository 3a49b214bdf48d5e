"""Sect. 7.4 of the paper: a tensegrity ball of six bars and 24 strings falls from 3.5 m and bounces.

Run it with a folder for the pictures: python examples/paper_lander.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import tenscasadi as tc
from tenscasadi import plots

HEIGHT = 3.5
T_END = 6.0
STEP = 1e-4
EXPECTED = (2.304, 1.551, 1.101, 0.827, 0.675)  # m, face down


def ball(down: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> tc.Structure:
    """Bars of 1 m and 1 kg; strings of 5000 N/m, 10 N·s/m and 0.1 kg at 1000 N/m; its center at 3.5 m, its direction `down` down.

    (1, 1, 1) puts one of the eight triangles of strings flat on the ground, (0, 0, 1) a pair of
    nodes.
    """
    upright = tc.shapes.six_bar_ball(
        1.0, prestress=1000.0, stiffness=5000.0, damping=10.0, string_mass=0.1
    )
    turn = Rotation.align_vectors([(0.0, 0.0, -1.0)], [np.array(down) / np.linalg.norm(down)])[0]
    return upright.replace(nodes=upright.nodes @ turn.as_matrix().T + (0.0, 0.0, HEIGHT))


def drop(structure: tc.Structure, t_end: float = T_END) -> tuple[tc.Trajectory, np.ndarray]:
    """The fall of a ball without friction, and the height of its center of mass (T,), m."""
    # Two segments a string: its mass is one point mass in its middle.
    scene = tc.Scene(
        structure, segments=2, gravity=tc.Gravity(), ground=tc.Ground(stiffness=1e4, damping=10.0)
    )
    model = tc.Model(scene)
    trajectory = tc.simulate(model, t_end, STEP, correction=tc.Projection(), save_every=10)
    weight = np.asarray(model.structure.mass_matrix().sum(axis=0)).ravel()
    return trajectory, np.asarray(trajectory.nodes[:, :, 2] @ weight / weight.sum())


def rebounds(height: np.ndarray) -> np.ndarray:
    """The rows of the tops of bounces, those above 0.6 m (at rest the center is at about 0.4 m)."""
    local = np.flatnonzero((height[1:-1] > height[:-2]) & (height[1:-1] >= height[2:])) + 1
    return local[height[local] > 0.6]


def main(folder: Path = Path()) -> list[float]:
    """Prints the table, saves the pictures and returns the rebound heights face down, m."""
    folder.mkdir(parents=True, exist_ok=True)
    trajectory, height = drop(ball(), T_END)
    tops = rebounds(height)[: len(EXPECTED)]
    heights = [float(height[k]) for k in tops]
    print(
        f"{ball()!r}, center of mass from {HEIGHT:g} m, one triangle down\n{trajectory.summary()}\n"
    )
    print("rebound  expected m   here m   at s   energy J")
    for i, (k, expected) in enumerate(zip(tops, EXPECTED, strict=False)):
        print(
            f"{i + 1:7} {expected:11.3f} {height[k]:8.3f} {trajectory.time[k]:6.2f} {trajectory.energy[k]:10.2f}"
        )
    gained = float(np.diff(trajectory.energy).max())
    print(
        "\npaper: heights fall from bounce to bounce, as strings and ground are damped; bar lengths exact to about 1e-16"
    )
    print(
        f"here:  energy never grows by more than {max(gained, 0.0):.0e} J from row to row; bar lengths within {trajectory.bar_length_error.max():.0e}"
    )
    edge, edge_height = drop(ball((0.0, 0.0, 1.0)), T_END)
    print(
        f"on a pair of nodes it rebounds to {edge_height[rebounds(edge_height)[0]]:.3f} m first: how it lands decides"
    )

    plots.time_lapse(
        drop(ball(), 1.2)[0],
        instants=4,
        title="lander: first fall and rebound",
        path=folder / "paper_lander.png",
    )
    figure_11(trajectory, height, tops, (edge, edge_height)).savefig(
        folder / "paper_lander_height.png", dpi=150
    )
    plots.errors(
        trajectory,
        title="lander: errors with projection after every step",
        path=folder / "paper_lander_errors.png",
    )
    return heights


def figure_11(
    trajectory: tc.Trajectory,
    height: np.ndarray,
    tops: np.ndarray,
    edge: tuple[tc.Trajectory, np.ndarray],
) -> Figure:
    """Height of the center of mass, and energy, over time."""
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(trajectory.time, height, label="a triangle down")
    upper.plot(edge[0].time, edge[1], lw=0.9, color="0.6", label="a pair of nodes down", zorder=1)
    upper.plot(
        trajectory.time[tops],
        EXPECTED[: len(tops)],
        "o",
        mfc="none",
        color="black",
        label="expected rebounds",
    )
    upper.set(ylabel="center of mass (m)", ylim=(0, 1.05 * HEIGHT), xlim=(0, trajectory.time[-1]))
    lower.plot(trajectory.time, trajectory.energy - trajectory.energy[-1])
    lower.set(ylabel="energy above the last (J)", xlabel="time (s)")
    for ax in (upper, lower):
        ax.grid(visible=True, color="0.9")
    upper.legend(frameon=False)
    figure.suptitle("lander: height and energy from bounce to bounce")
    return figure


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

"""A prism walks: a gait whose start is not given but found, such that after a period all nodes move as before, 14 cm further on.

The ground is soft and has friction (slip is damped, rather than rubbed, below 0.3 m/s). The first
guess is a simulation: five strings of an elastic prism are wound in and out like sines, with
strengths and phases found by trying some hundreds at random, until it moves nearly periodically.
The plan closes the gait: simulated in finer steps, a period ends within 2 cm of where it should.
There are many such gaits, and which one is found depends on rounding. It is then carried out three
times in a row, by the same force densities wherever the nodes are: errors grow several times in
each period (after two, nodes are within 8 cm of the gait, and more than 25 cm further on), so that
a longer walk needs a controller.

Run it with a folder for the pictures: python examples/prism_gait.py pictures
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc
from tenscasadi import plots

PERIOD, STEP = 0.4, 0.14  # s, m
SWINGS = {
    1: (0.25, 0.77),
    3: (0.045, 0.15),
    5: (0.13, 0.37),
    6: (0.175, 0.975),
    7: (0.08, 0.90),
}  # string: share of its length, phase
PERIODS = 3
LEAST, MOST = 5.0, 400.0  # N/m, force densities


def main(folder: Path = Path()) -> tuple[ocp.Plan, np.ndarray]:
    """Prints the plan and how periodic it is, saves the pictures, and returns the plan and the `strides` of its repetition."""
    folder.mkdir(parents=True, exist_ok=True)
    radius = np.sqrt(1.0 - 0.55**2) / (2 * np.sin(np.radians(75)))  # bars of 1 m
    prism = tc.shapes.prism(
        3, radius, 0.55, bar_mass=1.0, stiffness=1000.0, damping=5.0, prestress=100.0
    )
    scene = tc.Scene(
        prism,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=1000.0, damping=20.0, friction=0.8, slip_speed=0.3),
    )
    model = tc.Model(replace(scene, control=tc.ForceDensity()))
    still = tc.simulate(tc.Model(scene), 3.0, 1e-3, correction=tc.Projection(every=10))
    states, pull = guess(model, still)
    x, y, _ = model.nodes(states[0])[0]
    problem = ocp.Problem(
        model,
        PERIOD,
        start=ocp.FreeStart(
            states[0], goals=[ocp.NodePositions({0: (x, y, None)})]
        ),  # else it could be anywhere on the ground
        goals=[ocp.Periodic(shift=(STEP, 0.0, 0.0))],
        bounds=[ocp.ForceDensityLimits(LEAST, MOST), ocp.AboveGround(0.2, nodes=[3, 4, 5])],
        costs=[ocp.Prestress(still.force_density[-1])],
    )
    grid = ocp.Variational(100, control=ocp.PiecewiseLinear())
    plan = ocp.solve(
        problem, grid, ocp.Ipopt(tolerance=1e-3), ocp.TrajectoryGuess(states, pull), tolerance=0.04
    )
    print(plan.summary())

    walk = carried_out(plan)
    print("forward, sideways and departure of the nodes from the gait, m, after each period")
    print(strides(plan, walk).round(4))
    film(plan, walk, folder / "prism_gait.png")
    plots.force_densities(
        plan,
        lower=LEAST,
        upper=MOST,
        title="prism: force densities of one period",
        path=folder / "prism_gait_forces.png",
    )
    return plan, strides(plan, walk)


def guess(model: tc.Model, still: tc.Trajectory, periods: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """States and force densities in the last of some periods in which strings are wound like sines, turned such that it leads along x."""
    prism = model.scene.structure
    time = (np.arange(40 * periods) + 0.5) / 40
    swing = np.zeros((len(time), len(prism.strings)))
    for string, (strength, phase) in SWINGS.items():
        swing[:, string] = strength * np.minimum(time, 1.0) * np.sin(2 * np.pi * (time - phase))
    wound = tc.Model(replace(model.scene, control=tc.RestLength()))
    motion = tc.simulate(
        wound,
        periods * PERIOD,
        1e-3,
        state=still.states[-1],
        control=prism.rest_length * (1 + swing),
        save_every=5,
    )
    last = motion.time >= motion.time[-1] - PERIOD - 1e-9
    nodes, velocities = motion.nodes[last], motion.velocities[last]
    way = (nodes[-1] - nodes[0]).mean(axis=0)[:2]
    x, y = way / np.linalg.norm(way)
    turn = np.array([[x, -y, 0], [y, x, 0], [0, 0, 1]])
    states = [model.state(N @ turn, V @ turn) for N, V in zip(nodes, velocities, strict=True)]
    return np.array(states), motion.force_density[last]


def carried_out(plan: ocp.Plan) -> tc.Trajectory:
    """PERIODS of the plan's force densities, one after the other, from its start."""
    assert plan.model is not None
    start = plan.model.state(plan.trajectory.nodes[0], plan.trajectory.velocities[0])
    control = np.tile(fine(plan.force_density), (PERIODS, 1))
    return tc.simulate(
        plan.model, PERIODS * PERIOD, 5e-4, state=start, control=control, save_every=4
    )


def fine(values: np.ndarray, parts: int = 400) -> np.ndarray:
    """Values (K + 1, α), linear between equal times, held in `parts` short intervals."""
    nodes = np.linspace(0, 1, len(values))
    return np.column_stack(
        [np.interp((np.arange(parts) + 0.5) / parts, nodes, column) for column in values.T]
    )


def strides(plan: ocp.Plan, motion: tc.Trajectory) -> np.ndarray:
    """After each period: how far the nodes' mean went forward and sideways, and the largest distance of a node from where the gait has it, m."""
    first = plan.trajectory.nodes[0]
    rows = []
    for k in range(1, round(motion.time[-1] / PERIOD) + 1):
        nodes = motion.nodes[np.argmin(abs(motion.time - k * PERIOD))]
        way = (nodes - first).mean(axis=0)
        rows.append(
            [way[0], way[1], np.linalg.norm(nodes - first - [k * STEP, 0, 0], axis=1).max()]
        )
    return np.array(rows)


def film(plan: ocp.Plan, walk: tc.Trajectory, path: Path) -> None:
    """One period from the side, and the way that the nodes' mean takes in all PERIODS."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    side, way = figure.subplots(2, 1, height_ratios=(2, 1))
    scale = ScalarMappable(Normalize(0, PERIOD), "viridis_r")
    side.axhspan(-0.1, 0.0, color="0.93")
    for row in np.linspace(0, len(plan.time) - 1, 4).astype(int):
        places = plan.trajectory.nodes[row][:, [0, 2]]
        color = scale.to_rgba(plan.time[row])
        side.add_collection(
            LineCollection(
                places[plan.structure.strings], colors=[color], linewidths=0.7, alpha=0.6
            )
        )
        side.add_collection(
            LineCollection(
                places[plan.structure.bars], colors=[color], linewidths=3.0, capstyle="round"
            )
        )
    side.autoscale_view()
    side.set_aspect("equal")
    side.set(
        xlabel="x (m)",
        ylabel="z (m)",
        xlim=(0.3, 1.9),
        ylim=(-0.1, 1.2),
        title="prism: one period of its gait, seen from the side",
    )
    figure.colorbar(scale, ax=side, label="time (s)")
    mean = walk.nodes.mean(axis=1)
    way.plot(walk.time, mean[:, 0] - mean[0, 0], label="forward")
    way.plot(walk.time, mean[:, 1] - mean[0, 1], label="sideways")
    way.plot(
        [0, walk.time[-1]], [0, STEP / PERIOD * walk.time[-1]], "k:", label=f"{STEP} m a period"
    )
    way.set(
        xlabel="time (s)",
        ylabel="way of the nodes' mean (m)",
        title=f"its way in {PERIODS} periods of the same force densities",
    )
    way.grid(visible=True, color="0.9")
    way.legend(fontsize=9)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

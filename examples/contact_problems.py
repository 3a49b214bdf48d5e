"""Plans of motions through contact with defaults: jumps, landings, a crawl, a ball that tips over.

The lower limits of the force densities are above 0, because a structure without forces collapses,
and `Effort` alone leads to it. Goals fix the shape where it matters.

Run it with a folder for the pictures: python examples/contact_problems.py pictures
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc

EDGE, BEHIND = (3, 7), 11  # the face on which the ball stands: it tips over EDGE


class Asked(NamedTuple):
    """Problem with its permitted replay error [m].

    None is 1 % of the structure's size.
    """

    build: Callable[[], ocp.Problem]
    tolerance: float | None = None


def main(folder: Path = Path(), quick: bool = False) -> dict[str, ocp.Plan]:
    """Prints what is found for each problem, saves the picture, and returns the plans. quick: of the first few."""
    folder.mkdir(parents=True, exist_ok=True)
    plans = {}
    for name in list(PROBLEMS)[: 2 if quick else None]:
        asked, began = PROBLEMS[name], time.perf_counter()
        plans[name] = ocp.solve(asked.build(), tolerance=asked.tolerance)
        print(
            f"{name:24} {'found' if plans[name].success else 'not found':9} {time.perf_counter() - began:6.2f} s  {plans[name].message}"
        )
    draw(plans, folder / "contact_problems.png")
    return plans


def low_prism(stiffness: float = 1e4, damping: float = 20.0) -> tc.Model:
    """Model of a prism of three bars of 1 m and 0.3 kg on a ground with friction.

    It is 0.6 m high.
    """
    height = 0.6
    prism = tc.shapes.prism(
        3, np.sqrt(1.0 - height**2) / (2 * np.sin(np.radians(75))), height, bar_mass=0.3
    )
    ground = tc.Ground(stiffness=stiffness, damping=damping, friction=0.6, slip_speed=1e-2)
    return tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground))


def heavy_prism() -> tc.Model:
    """Model of a prism of three bars of 1 m and 1 kg on a compliant ground."""
    height = 0.55
    prism = tc.shapes.prism(
        3, np.sqrt(1.0 - height**2) / (2 * np.sin(np.radians(75))), height, bar_mass=1.0
    )
    ground = tc.Ground(stiffness=1e3, damping=20.0, friction=0.8, slip_speed=0.3)
    return tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground))


def ball_on_face(slope: float = 0.0) -> tc.Model:
    """Model of a ball of six bars of 1 m and 1 kg that stands on a face.

    The x axis points over the edge of the face, uphill on a slope [°]: gravity is tilted instead of
    the ground.
    """
    ball = tc.shapes.six_bar_ball()
    edge, behind = ball.nodes[list(EDGE)], ball.nodes[BEHIND]
    down, ahead = edge.sum(axis=0) + behind, edge.mean(axis=0) - behind
    x, z = ahead / np.linalg.norm(ahead), -down / np.linalg.norm(down)
    nodes = ball.nodes @ np.array([x, np.cross(z, x), z]).T
    angle = np.radians(slope)
    gravity = tc.Gravity((-9.81 * np.sin(angle), 0.0, -9.81 * np.cos(angle)))
    ground = tc.Ground(stiffness=1e4, damping=60.0, friction=0.8, slip_speed=0.05)
    return tc.Model(
        tc.Scene(
            ball.replace(nodes=nodes - [0, 0, nodes[:, 2].min()]),
            control=tc.ForceDensity(),
            gravity=gravity,
            ground=ground,
        )
    )


def top_of_a_jump(nodes: int) -> list[ocp.Constraint]:
    """Constraints at the highest point of a jump, for nodes of equal mass.

    The vertical velocity of the center of mass is zero, and no node touches the ground.
    """
    return [
        ocp.Constraint(
            "rise", lambda end: ca.sum2(end.velocities)[2] / nodes, -0.1, 0.1, at_end=True
        ),
        ocp.Constraint("height of nodes", lambda end: end.nodes[2, :].T, 0.02, at_end=True),
    ]


def prism_jumps(
    rise: float, stiffness: float = 1e4, damping: float = 20.0, duration: float = 0.5
) -> ocp.Problem:
    """Jump of a prism by which its center of mass rises by `rise` [m]."""
    model = low_prism(stiffness, damping)
    goal = ocp.CenterOfMass((None, None, model.structure.nodes[:, 2].mean() + rise))
    return ocp.Problem(
        model,
        duration,
        goals=[goal],
        bounds=[ocp.ForceDensityLimits(5.0, 500.0), *top_of_a_jump(6)],
    )


def ball_jumps(rise: float = 0.2) -> ocp.Problem:
    """Jump of a ball from a face."""
    model = ball_on_face()
    goal = ocp.CenterOfMass((None, None, model.structure.nodes[:, 2].mean() + rise))
    return ocp.Problem(
        model, 0.6, goals=[goal], bounds=[ocp.ForceDensityLimits(50.0, 2000.0), *top_of_a_jump(12)]
    )


def prism_lands(rise: float = 0.15) -> ocp.Problem:
    """Jump of a prism with a landing at rest at its initial position."""
    model = low_prism(damping=60.0)
    x, y, z = model.structure.nodes.mean(axis=0).tolist()
    goals = [
        ocp.Waypoint([ocp.CenterOfMass((None, None, z + rise))], share=0.45),
        ocp.CenterOfMass((x, y, z)),
        ocp.AtRest(),
    ]
    return ocp.Problem(model, 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(5.0, 500.0)])


def prism_crawls(step: float = 0.1, period: float = 0.4, cycles: int = 3) -> ocp.Problem:
    """Locomotion of a prism along x, by `step` [m] in each period.

    The center of mass is at its initial height after each period.
    """
    model = heavy_prism()
    start = model.structure.nodes - [0, 0, 9.81 / 1e3]  # three nodes carry 3 kg
    x, _, z = start.mean(axis=0).tolist()
    steps = [ocp.CenterOfMass((x + k * step, None, z)) for k in range(1, cycles + 1)]
    goals = [ocp.Waypoint([goal], share=k / cycles) for k, goal in enumerate(steps[:-1], 1)]
    bounds = [ocp.ForceDensityLimits(20.0, 400.0)]
    return ocp.Problem(
        model,
        cycles * period,
        start,
        goals=[*goals, steps[-1]],
        bounds=bounds,
        costs=[ocp.Prestress(100.0)],
    )


def ball_tips(slope: float = 0.0) -> ocp.Problem:
    """Rotation of a ball onto its next face, where it stands at rest."""
    model = ball_on_face(slope)
    nodes = model.structure.nodes
    ahead, up = nodes[:, 0] - nodes[EDGE[0], 0], nodes[:, 2]
    angle = np.where(np.isin(np.arange(12), (*EDGE, BEHIND)), np.pi, np.arctan2(up, ahead))
    first = int(np.argmin(angle))  # the node that comes down
    turn = angle[first]
    x, z = (
        ahead * np.cos(turn) + up * np.sin(turn) + nodes[EDGE[0], 0],
        up * np.cos(turn) - ahead * np.sin(turn),
    )
    turned = np.column_stack([x, nodes[:, 1], z])
    places = {node: tuple(turned[node].tolist()) for node in (*EDGE, first)}
    goals = [ocp.NodePositions(places), ocp.CenterOfMass((None, None, z.mean())), ocp.AtRest()]
    return ocp.Problem(
        model,
        0.8,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(50.0, 1000.0)],
        costs=[ocp.Prestress(200.0)],
    )


PROBLEMS: dict[str, Asked] = {
    **{
        f"prism jumps {rise} m": Asked(lambda rise=rise: prism_jumps(rise))  # type: ignore[misc]
        for rise in (0.1, 0.2, 0.3, 0.4)
    },
    "ball jumps 0.2 m": Asked(ball_jumps),
    "prism jumps and lands": Asked(prism_lands, 0.05),
    "prism crawls 3 cycles": Asked(prism_crawls),
    "ball tips": Asked(ball_tips),
    "ball tips uphill, 10°": Asked(lambda: ball_tips(10.0)),
}


def draw(plans: dict[str, ocp.Plan], path: Path, instants: int = 6) -> None:
    """Draw side views of each motion at equal intervals, and the path of the center."""
    rows = -(-len(plans) // 2)
    figure = Figure(figsize=(12.0, 1.6 * rows + 0.5), layout="constrained")
    for ax, (name, plan) in zip(
        np.ravel(figure.subplots(rows, 2, squeeze=False)), plans.items(), strict=False
    ):
        motion = plan.replay()
        center = motion.nodes.mean(axis=1)
        size, apart = np.ptp(motion.nodes[0], axis=0).max(), np.ptp(center[:, 0]) > 0.05
        ax.axhspan(-1.0, 0.0, color="0.9")
        shots = np.linspace(0, len(motion.time) - 1, instants).astype(int)
        for k, shot in enumerate(shots):
            side = motion.nodes[shot][:, [0, 2]] + [1.15 * size * k, 0.0]
            ax.add_collection(
                LineCollection(side[motion.strings], colors="tab:blue", linewidths=0.6, alpha=0.8)
            )
            ax.add_collection(
                LineCollection(side[motion.bars], colors="0.25", linewidths=2.0, capstyle="round")
            )
            ax.plot(center[shot, 0] + 1.15 * size * k, center[shot, 2], "o", color="tab:red", ms=3)
        ax.set(aspect="equal", ylabel="z (m)", title=f"{name}, {motion.time[-1]:g} s", xticks=[])
        ax.set_xlim(
            -0.8 * size, 1.15 * size * (instants - 0.4) + (np.ptp(center[:, 0]) if apart else 0.0)
        )
        ax.set_ylim(-0.1, motion.nodes[:, :, 2].max() + 0.1)
    for ax in figure.axes[len(plans) :]:
        ax.set_axis_off()
    figure.suptitle(
        "side views at equal intervals of time, next to each other; the center of mass in red"
    )
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

"""A prism that rises in a gust: force densities from a plan alone, with a regulator about it, and planned anew 20 times a second; a ball at 10 Hz.

Run it: python examples/mpc_prism.py
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

import ocp
import tenscasadi as tc

BAR = 1.4  # m
LIMITS = ocp.ForceDensityLimits(1.0, 100.0)


class Row(NamedTuple):
    """How far, m, distances between nodes are from those of the goal at the end, and the time of a decision, ms."""

    name: str
    error: float
    median: float
    longest: float
    allowed: float


def prism(height: float, mass: float = 1.0) -> tc.Structure:
    """The prism of three bars that stands `height` m tall in equilibrium."""
    return tc.shapes.prism(
        bars=3,
        radius=np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))),
        height=height,
        bar_mass=mass,
    )


def main(quick: bool = False) -> list[Row]:
    """Prints a row for each controller, and returns the rows. quick: shorter runs."""
    low, high = prism(1.0), prism(1.15)
    model = driven(low)
    problem = ocp.Problem(
        model,
        1.0,
        goals=[ocp.Shape(high.nodes), ocp.AtRest()],
        bounds=[LIMITS],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem, ocp.MultipleShooting(20))
    wind = np.zeros((6, 3))
    wind[4, 0], wind[0, 0] = 0.3, -0.3  # N
    plant = driven(prism(1.0, mass=1.1), wind)  # heavier than the controllers believe, and pulled
    alone = tc.simulate(plant, 1.0, 5e-3, control=plan.force_density, compiled=False)
    rows = [Row("plan alone, 1 s", misfit(alone.nodes[-1], high.nodes), 0.0, 0.0, np.inf)]
    held = ocp.run(ocp.track(plan, lower=1.0, upper=100.0), 1.0, plant)
    rows.append(row("plan and regulator, 1 s", held, high.nodes, 50.0))
    for name, reference in (
        ("predictive, along the plan", plan),
        ("predictive, to the goal", None),
    ):
        t_end = 1.0 if quick else 3.0
        rows.append(
            row(
                f"{name}, {t_end:g} s",
                ocp.run(ocp.Mpc(problem, 0.05, 10, plan=reference), t_end, plant),
                high.nodes,
                50.0,
            )
        )
    rows.append(ball(1.0 if quick else 3.0))
    print(f"{'controller':40}  error (m)  median (ms)  longest (ms)  allowed (ms)")
    for r in rows:
        print(f"{r.name:40}  {r.error:9.1e}  {r.median:11.2f}  {r.longest:12.2f}  {r.allowed:12g}")
    return rows


def ball(t_end: float) -> Row:
    """The six-bar ball, shaken out of shape, finds back to it at 10 Hz."""
    structure = tc.shapes.six_bar_ball()
    model = driven(structure)
    shaken = model.state(structure.nodes + 0.03 * np.random.default_rng(0).normal(size=(12, 3)))
    start = model.nodes(np.asarray(tc.Projection(iterations=10).step(model)(shaken).full()).ravel())  # type: ignore[misc]
    problem = ocp.Problem(
        model, 1.0, start, goals=[ocp.Shape(structure.nodes), ocp.AtRest()], bounds=[LIMITS]
    )
    held = ocp.run(ocp.Mpc(problem, 0.1, 8, substeps=2), t_end, state=np.asarray(problem.start))
    return row(f"ball, predictive, {t_end:g} s", held, structure.nodes, 100.0)


def driven(structure: tc.Structure, wind: np.ndarray | None = None) -> tc.Model:
    """The structure under given force densities, and a constant pull on its nodes."""
    return tc.Model(
        tc.Scene(
            structure,
            control=tc.ForceDensity(),
            forces=None if wind is None else tc.NodalForce(wind),
        )
    )


def row(name: str, held: ocp.ClosedLoop, goal: np.ndarray, allowed: float) -> Row:
    """The figures of a run."""
    ms = 1e3 * held.seconds
    return Row(
        name,
        misfit(held.trajectory.nodes[-1], goal),
        float(np.median(ms)),
        float(ms.max()),
        allowed,
    )


def misfit(nodes: np.ndarray, goal: np.ndarray) -> float:
    """The largest difference of a distance between nodes."""
    pairs = combinations(range(len(nodes)), 2)
    return max(
        float(abs(np.linalg.norm(nodes[a] - nodes[b]) - np.linalg.norm(goal[a] - goal[b])))
        for a, b in pairs
    )


if __name__ == "__main__":
    main()

"""A prism that rises in a gust: force densities from a plan alone, with a regulator about it, and planned anew 20 times a second; a ball at 10 Hz.

Run it: python examples/mpc_prism.py
"""

from __future__ import annotations

from itertools import combinations
from time import perf_counter
from typing import NamedTuple

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.compile import compile_function

BAR = 1.4  # m
LIMITS = ocp.ForceDensityLimits(1.0, 100.0)


class Row(NamedTuple):
    """Largest error of a distance between nodes at the end [m], and times of decisions [ms]."""

    name: str
    error: float
    times: np.ndarray
    allowed: float
    generated: np.ndarray = np.zeros(1)  # by the C code of `ocp.export_mpc`


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
    rows = [Row("plan alone, 1 s", misfit(alone.nodes[-1], high.nodes), np.zeros(1), np.inf)]
    held = ocp.run(ocp.track(plan, lower=1.0, upper=100.0), 1.0, plant)
    rows.append(row("plan and regulator, 1 s", held, high.nodes, 50.0))
    for name, reference in (
        ("predictive, along the plan", plan),
        ("predictive, to the goal", None),
    ):
        t_end = 1.0 if quick else 3.0
        mpc = ocp.Mpc(problem, 0.05, 10, plan=reference)
        held = ocp.run(mpc, t_end, plant)
        rows.append(row(f"{name}, {t_end:g} s", held, high.nodes, 50.0, mpc))
    rows.append(ball(1.0 if quick else 3.0))
    print(f"{'ms of a decision':32} error (m)  median  longest  C median  C longest  allowed")
    for r in rows:
        times = [
            f"{value:8.2f}" for t in (r.times, r.generated) for value in (np.median(t), t.max())
        ]
        print(f"{r.name:32} {r.error:9.1e} {'  '.join(times)} {r.allowed:8g}")
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
    mpc = ocp.Mpc(problem, 0.1, 8, substeps=2)
    held = ocp.run(mpc, t_end, state=np.asarray(problem.start))
    return row(f"ball, predictive, {t_end:g} s", held, structure.nodes, 100.0, mpc)


def driven(structure: tc.Structure, wind: np.ndarray | None = None) -> tc.Model:
    """The structure under given force densities, and a constant pull on its nodes."""
    return tc.Model(
        tc.Scene(
            structure,
            control=tc.ForceDensity(),
            forces=None if wind is None else tc.NodalForce(wind),
        )
    )


def row(
    name: str, held: ocp.ClosedLoop, goal: np.ndarray, allowed: float, mpc: ocp.Mpc | None = None
) -> Row:
    """The figures of a run."""
    error = misfit(held.trajectory.nodes[-1], goal)
    generated = np.zeros(1) if mpc is None else generated_times(mpc, held)
    return Row(name, error, 1e3 * held.seconds, allowed, generated)


def generated_times(mpc: ocp.Mpc, held: ocp.ClosedLoop) -> np.ndarray:
    """Times [ms] of the decisions of a run by generated C, the shortest of five."""
    solver = mpc.quadratic_program.generated()
    decide = ArrayFunction(compile_function(mpc.function(solver)))
    count, before = len(held.seconds), mpc.first.T
    stride = (len(held.trajectory.time) - 1) // count
    times = np.full((count, 5), np.inf)
    for k in range(count):
        inputs = (held.trajectory.time[[k * stride]], held.trajectory.states[k * stride], before)
        for repetition in range(5):
            start = perf_counter()
            after, _ = decide(*inputs)
            times[k, repetition] = 1e3 * (perf_counter() - start)
        before = after
    return np.asarray(times.min(axis=1))


def misfit(nodes: np.ndarray, goal: np.ndarray) -> float:
    """The largest difference of a distance between nodes."""
    pairs = combinations(range(len(nodes)), 2)
    return max(
        float(abs(np.linalg.norm(nodes[a] - nodes[b]) - np.linalg.norm(goal[a] - goal[b])))
        for a, b in pairs
    )


if __name__ == "__main__":
    main()

"""A prism rises from flat to tall in one second, from rest to rest, by force densities from a plan.

A replay checks the plan.

Run it with a folder for the pictures: python examples/plan_prism.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

BAR = 1.4  # m
TWIST = np.radians(150)  # of a prism in equilibrium, from a bar's lower to its upper end
LOW, HIGH = 0.3, 1.2  # m


def prism(height: float) -> tc.Structure:
    """Build the prism of three bars with a height [m] in equilibrium."""
    return tc.shapes.prism(
        bars=3,
        radius=np.sqrt(BAR**2 - height**2) / (2 * np.sin(TWIST / 2)),
        height=height,
        bar_mass=1.0,
    )


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its replay, save pictures, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    flat, tall = prism(LOW), prism(HIGH)
    least, most = 5.0, 60.0
    problem = ocp.Problem(
        tc.Model(tc.Scene(flat, control=tc.ForceDensity())),
        duration=1.0,
        goals=[ocp.StringLengths(tall.string_lengths), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(least, most), ocp.TensionLimits(upper=12.0)],
        costs=[ocp.Effort(), ocp.Smoothness(1e-3)],
    )
    plan = ocp.solve(problem, ocp.MultipleShooting(intervals=30), ocp.Ipopt())
    print(plan.summary())

    replay = plan.replay()
    height = np.ptp(replay.nodes[-1] @ axis(replay.nodes[-1]))
    print(
        f"height        {LOW} → {height:.6f} m, wanted {HIGH} m; bars off by {replay.bar_length_error.max():.1e} of their length"
    )
    rest_lengths = plan.rest_lengths(stiffness=1000.0)
    print(
        f"rest lengths  {rest_lengths.min():.4f} … {rest_lengths.max():.4f} m for strings of 1000 N/m"
    )
    plots.time_lapse(
        replay, instants=5, title="prism: from flat to tall", path=folder / "plan_prism.png"
    )
    plots.force_densities(
        plan,
        lower=least,
        upper=most,
        title="prism: planned force densities",
        path=folder / "plan_prism_forces.png",
    )
    return plan


def axis(nodes: np.ndarray) -> np.ndarray:
    """Compute the unit vector from the center of the bottom to that of the top.

    An unsupported prism may rotate during the motion.
    """
    along = nodes[3:].mean(axis=0) - nodes[:3].mean(axis=0)
    return np.asarray(along / np.linalg.norm(along))


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

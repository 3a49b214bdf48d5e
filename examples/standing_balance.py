"""A chain of three bars on a pin is raised to the upright position, and stabilized by an LQR against pushes.

The motion is unstable: within the two seconds of the plan, errors grow by more than ten orders of
magnitude. Its acceptance test is therefore the replay under feedback. Run it with a folder for the
picture: python examples/standing_balance.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

import ocp
import tenscasadi as tc

BARS, LENGTH, MASS = 3, 2 / 3, 2 / 3  # number, m, kg
SPAN = 1.5  # m, from the pin to each anchor
LEAN = 0.1  # rad, of each bar at the start, to alternate sides
DURATION, AFTER, PERIOD = (
    2.0,
    4.0,
    0.02,
)  # s, of the plan, afterwards, and from decision to decision
PUSHES, PUSH = (1.0, 3.0), 0.3  # s, m/s
STRONG = 20.0  # N/m, largest force density


class Balance(NamedTuple):
    """Plan, and trajectory under feedback with pushes."""

    plan: ocp.Plan
    motion: tc.Trajectory


def chain(lean: float) -> tc.Structure:
    """Build the chain: node 0 is the pin, 1-3 are bar ends, the last two are anchors."""
    turned = lean * (-1.0) ** np.arange(BARS)
    steps = LENGTH * np.column_stack([np.sin(turned), 0 * turned, np.cos(turned)])
    nodes = np.vstack([np.zeros(3), np.cumsum(steps, axis=0), (-SPAN, 0, 0), (SPAN, 0, 0)])
    own, anchors = range(1, BARS + 1), (BARS + 1, BARS + 2)
    return tc.Structure(
        nodes,
        bars=[(k, k + 1) for k in range(BARS)],
        strings=[(k, anchor) for k in own for anchor in anchors],
        pinned={0: "xyz", **dict.fromkeys(anchors, "xyz"), **dict.fromkeys(own, "y")},
        bar_mass=MASS,
    )


def main(folder: Path = Path()) -> Balance:
    """Print plan and trajectory under feedback, save a picture, and return both."""
    folder.mkdir(parents=True, exist_ok=True)
    upright = chain(0.0).nodes
    model = tc.Model(tc.Scene(chain(LEAN), control=tc.ForceDensity(), gravity=tc.Gravity()))
    problem = ocp.Problem(
        model,
        duration=DURATION,
        goals=[
            ocp.NodePositions({k: (0, None, upright[k, 2]) for k in range(1, BARS + 1)}),
            ocp.AtRest(),
        ],
        bounds=[ocp.ForceDensityLimits(0.0, STRONG)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    print(plan.summary())
    print(f"open loop     errors grow {plan.error_growth:.1e}-fold")

    # The strings are almost slack in the plan: the default scale, a tenth of the planned forces,
    # would make the regulator sluggish.
    tracker = ocp.track(plan, decisions=round(DURATION / PERIOD), control_scale=STRONG / 20)
    loop = ocp.run(tracker, DURATION + AFTER, disturbance=push)
    tip = loop.trajectory.nodes[:, BARS, 0]
    print(f"feedback      keeps the tip within {np.abs(tip).max():.3f} m of the vertical")
    print(f"end           {abs(tip[-1]):.1e} m beside it, {AFTER:g} s after the plan")
    draw(loop.trajectory, folder / "standing_balance.png")
    return Balance(plan, loop.trajectory)


def push(time: float, state: np.ndarray) -> np.ndarray:
    """Change the velocities at the first decisions after the times of the pushes."""
    pushed = any(at <= time < at + PERIOD for at in PUSHES)
    half = len(state) // 2
    return np.concatenate([state[:half], state[half:] + PUSH * pushed])


def draw(motion: tc.Trajectory, path: Path) -> None:
    """Draw the chain at several times, and the tip's distance from the vertical."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for time in (0.0, 0.1, 0.3, 2.0):
        frame = motion.nodes[int(np.searchsorted(motion.time, time))]
        left.plot(1e3 * frame[: BARS + 1, 0], frame[: BARS + 1, 2], "o-", label=f"{time:g} s")
    left.set(xlabel="x [mm]", ylabel="z [m]", xlim=(-100, 100), title="standing up")
    left.legend()
    for node in range(1, BARS + 1):
        right.plot(motion.time, 1e3 * motion.nodes[:, node, 0], label=f"node {node}")
    for at in PUSHES:
        right.axvline(at, color="0.7", linestyle=":", zorder=0)
    right.set(xlabel="time [s]", ylabel="x [mm]", title="under feedback; dotted: pushes")
    right.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

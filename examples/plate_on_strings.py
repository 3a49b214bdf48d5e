"""A plate on six strings rises, turns and tilts in one second, from rest to rest, with limited angular velocity.

Run it with a folder for the picture: python examples/plate_on_strings.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

MASS, WIDTH, THICKNESS = 3.0, 0.5, 0.02  # kg, m, m
TURN, TILT = np.radians([40.0, 8.0])
SPIN = 1.2  # rad/s, at most


def platform() -> tc.Structure:
    """Build the square plate with its load, and strings to three points of the frame."""
    half = WIDTH / 2
    corners = half * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    angle = np.radians([90, 210, 330])
    frame = np.column_stack([np.cos(angle), np.sin(angle), np.full(3, 1.0)])
    across = MASS / 12 * (WIDTH**2 + THICKNESS**2)
    plate = tc.RigidBody(range(4), MASS, (0, 0, 0), (across, across, MASS / 6 * WIDTH**2))
    return tc.Structure(
        np.vstack([corners, frame]),
        strings=[(0, 5), (1, 6), (2, 4), (3, 4), (2, 6), (3, 5)],
        pinned=(4, 5, 6),
        bodies=[plate],
    )


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its replay, save a picture, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    about_z, about_x = (
        ocp.BodyOrientation(0, turn).matrix for turn in [(0, 0, TURN), (TILT, 0, 0)]
    )
    model = tc.Model(tc.Scene(platform(), control=tc.ForceDensity(), gravity=tc.Gravity()))
    problem = ocp.Problem(
        model,
        duration=1.0,
        goals=[
            ocp.BodyOrientation(0, about_z @ about_x),
            ocp.CenterOfMass((None, None, 0.15)),
            ocp.AtRest(),
        ],
        bounds=[
            ocp.ForceDensityLimits(0.5, 120.0),
            ocp.AboveGround(-0.02, nodes=range(4)),
            ocp.Constraint("spin", lambda now: now.angular_velocity(0)[2], upper=SPIN),
        ],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem)
    print(plan.summary())

    replay = plan.replay()
    R, spin = replay.orientation(0), replay.angular_velocity(0)
    turned = np.degrees(np.arctan2(R[-1, 1, 0], R[-1, 0, 0]))
    tilted = np.degrees(np.arccos(R[-1, 2, 2]))
    print(
        f"plate         turned by {turned:.3f}°, tilted by {tilted:.3f}°, spin up to {spin[:, 2].max():.3f} rad/s"
    )
    plots.time_lapse(
        replay, instants=3, title="plate on six strings", path=folder / "plate_on_strings.png"
    )
    return plan


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

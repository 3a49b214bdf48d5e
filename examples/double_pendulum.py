"""A double pendulum of two rods (class 2), compared with the Lagrange equations of its angles.

The force in its pin is compared, too.

Run it with a folder for the picture: python examples/double_pendulum.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

import tenscasadi as tc
from tenscasadi import plots

GRAVITY = 9.81
ANGLES = (np.pi / 2, 2 * np.pi / 3)
T_END = 3.0


def main(folder: Path = Path()) -> dict[str, float]:
    """Print the comparison, save a picture, and return the largest errors by name [m, N]."""
    folder.mkdir(parents=True, exist_ok=True)
    rods = tc.shapes.double_pendulum(angles=ANGLES)
    scene = tc.Scene(rods, gravity=tc.Gravity((0.0, 0.0, -GRAVITY)))
    models = {
        coordinates: tc.Model(scene, coordinates=coordinates) for coordinates in ("reduced", "full")
    }
    runs = {
        coordinates: tc.simulate(model, T_END, step=2e-4, correction=tc.Projection())
        for coordinates, model in models.items()
    }
    errors = {}
    for coordinates, run in runs.items():
        print(f"{coordinates} coordinates\n{run.summary()}\n")
        errors[coordinates] = float(np.abs(run.nodes - textbook(run.time)).max())
        print(f"largest distance from the textbook's solution: {errors[coordinates]:.1e} m\n")

    # The last column of P holds the pin: Ω is what it exerts, which must be what Newton's second
    # law asks for.
    model, run = models["full"], runs["full"]
    pin = np.array(
        [model.multipliers(x).joint_force[:, pin_column(rods)] for x in run.states[::100]]
    )
    errors["pin force"] = float(np.abs(pin - newton(model, run.states[::100])).max())
    print(
        f"force in the pin: up to {np.linalg.norm(pin, axis=1).max():.1f} N, within {errors['pin force']:.1e} N of Newton's second law"
    )
    plots.time_lapse(
        runs["reduced"],
        instants=9,
        title=f"double pendulum: {T_END:g} seconds from rest",
        path=folder / "double_pendulum.png",
    )
    plots.errors(
        run,
        title="double pendulum: errors in full coordinates",
        path=folder / "double_pendulum_errors.png",
    )
    return errors


def textbook(times: np.ndarray) -> np.ndarray:
    """Compute nodes (T, 3, 3) from Lagrange's equations for the angles.

    The two uniform rods have length 1 and equal mass.
    """

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        (a, b), (da, db) = y[:2], y[2:]
        c, s = np.cos(a - b), np.sin(a - b)
        inertia = np.array([[4 / 3, c / 2], [c / 2, 1 / 3]])
        moments = np.array(
            [-s / 2 * db**2 - 1.5 * GRAVITY * np.sin(a), s / 2 * da**2 - 0.5 * GRAVITY * np.sin(b)]
        )
        return np.concatenate([y[2:], np.linalg.solve(inertia, moments)])

    angles = solve_ivp(
        slope, (0.0, times[-1]), [*ANGLES, 0.0, 0.0], "DOP853", times, rtol=1e-12, atol=1e-12
    ).y[:2]
    rods = np.stack([np.sin(angles), np.zeros_like(angles), -np.cos(angles)], axis=-1)  # 2×T×3
    return np.stack([np.zeros_like(rods[0]), rods[0], rods[0] + rods[1]], axis=1)


def pin_column(structure: tc.Structure) -> int:
    """Find the column of P that belongs to the pinned node."""
    return int(np.flatnonzero(np.abs(structure.class_one().P).sum(axis=0) == 1)[0])


def newton(model: tc.Model, states: np.ndarray) -> np.ndarray:
    """Compute the pin force (T, 3) [N] from the acceleration of the center of mass."""
    accelerations = np.array(
        [
            model.nodes(
                np.concatenate([model.ode(x, []).full().ravel()[model.nq :], x[model.nq :]])
            )
            for x in states
        ]
    )
    rods = model.structure.bar_mass[:, None] * accelerations[:, model.structure.bars].mean(axis=2)
    return np.asarray(
        rods.sum(axis=1) + model.structure.bar_mass.sum() * np.array([0.0, 0.0, GRAVITY])
    )


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

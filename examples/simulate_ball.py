"""A thrown six-bar ball: what step and projection do to its errors, and a picture of the flight.

Run it with a folder for the pictures: python examples/simulate_ball.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

import tenscasadi as tc
from tenscasadi import plots

T_END = 1.0
GRAVITY = (0.0, 0.0, -9.81)
VELOCITY = (3.0, 0.0, 5.0)


class Row(NamedTuple):
    """One run: its step, s, what corrects it, and its errors: of nodes, m, bar lengths, relative, and energy, J."""

    step: float
    correction: tc.Projection | None
    position: float
    bar_length: float
    energy: float


def main(folder: Path = Path()) -> list[Row]:
    """Prints the table, saves the pictures and returns the table's rows."""
    folder.mkdir(parents=True, exist_ok=True)
    ball = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0)
    model = tc.Model(tc.Scene(ball, gravity=tc.Gravity(GRAVITY)))
    print(
        f"{ball!r}: {model.nx} states; instructions of the right-hand side:\n{model.describe()}\n"
    )
    # Turning as a rigid body changes no bar's length: the start needs no correction.
    start = model.state(ball.nodes, np.cross((1.0, 3.0, 0.5), ball.nodes) + VELOCITY)

    finest = tc.simulate(model, T_END, step=1e-4, state=start)
    rows = []
    print(
        f"{'step s':>8} {'projection':>11} {'position m':>11} {'bar length':>11} {'energy J':>10}"
    )
    for step in (1e-2, 5e-3, 2e-3, 1e-3):
        for correction in (None, tc.Projection()):
            run = tc.simulate(model, T_END, step, state=start, correction=correction)
            row = Row(
                step,
                correction,
                position=float(np.abs(run.nodes[-1] - finest.nodes[-1]).max()),
                bar_length=float(run.bar_length_error.max()),
                energy=float(np.abs(run.energy_error).max()),
            )
            rows.append(row)
            shown = "no" if correction is None else "every step"
            print(
                f"{step:8g} {shown:>11} {row.position:11.1e} {row.bar_length:11.1e} {row.energy:10.1e}"
            )

    parabola = np.array(VELOCITY) * T_END + np.array(GRAVITY) * T_END**2 / 2
    drift = np.abs(finest.nodes[-1].mean(axis=0) - parabola).max()
    print(f"\ncenter of mass: {drift:.1e} m from the parabola of its throw")
    plots.time_lapse(
        finest, instants=5, title="a thrown six-bar ball", path=folder / "simulate_ball.png"
    )
    plots.errors(
        finest,
        title="a thrown six-bar ball: errors at a step of 0.1 ms",
        path=folder / "simulate_ball_errors.png",
    )
    return rows


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

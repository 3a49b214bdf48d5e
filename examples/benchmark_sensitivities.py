"""Cost of exact derivatives of a run: forward, adjoint, and by central differences.

Costs are in units of the time of a run. All derivatives are of the same steps, so that differences
show the error of finite differences, which is large for unstable motions, such as a ball on an
edge.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import casadi as ca
import numpy as np

import tenscasadi as tc


class Row(NamedTuple):
    """Seconds of a run, costs of its derivatives in runs, and their relative difference.

    Derivatives are those of the whole final state, and of one number, with respect to the initial
    state.
    """

    name: str
    inputs: int
    run: float
    forward: float
    adjoint: float
    differ: float


def main(quick: bool = False) -> list[Row]:
    """Print the table and return its rows. With `quick`, one model and a short run."""
    prism = tc.shapes.prism(stiffness=1000.0, prestress=50.0)
    ball = tc.shapes.six_bar_ball(stiffness=1000.0, prestress=100.0, damping=1.0)
    scenes = {
        "prism, force densities": tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity()),
        "ball, elastic strings": tc.Scene(ball, gravity=tc.Gravity()),
        "ball on the ground": tc.Scene(
            ball, gravity=tc.Gravity(), ground=tc.Ground(stiffness=1e4, damping=10.0, height=-0.55)
        ),
    }
    rows = []
    for name, scene in list(scenes.items())[: 1 if quick else 3]:
        for scheme in (tc.RungeKutta4(),) if quick else (tc.RungeKutta4(), tc.Rattle()):
            rows.append(
                measure(
                    f"{name}, {type(scheme).__name__}",
                    tc.Model(scene),
                    scheme,
                    0.1 if quick else 2.0,
                    False if quick else None,
                )
            )
    print(
        f"{'':40s}{'inputs':>7s}{'run':>9s}   in runs: forward  a tangent  adjoint of 1  differences   they differ by"
    )
    for row in rows:
        costs = f"{row.forward:19.1f}{row.forward / row.inputs:11.2f}{row.adjoint:14.1f}{2 * row.inputs:13d}{row.differ:17.1e}"
        print(f"{row.name:40s}{row.inputs:7d}{1e3 * row.run:7.2f} ms{costs}")
    return rows


def measure(
    name: str,
    model: tc.Model,
    scheme: tc.RungeKutta4 | tc.Rattle,
    t_end: float,
    compiled: bool | None,
) -> Row:
    """Measure one row of the table, as medians of nine."""
    start = model.initial_state

    def run(state: np.ndarray) -> tc.Trajectory:
        return tc.simulate(
            model,
            t_end,
            1e-3,
            scheme,
            state,
            save_every=10**6,
            energy_balance=False,
            compiled=compiled,
        )

    def derivatives(**options: object) -> tc.Sensitivities:
        return tc.sensitivities(model, start, t_end, 1e-3, scheme, compiled=compiled, **options)  # type: ignore[arg-type]

    exact = derivatives(mode="forward").jacobian
    moves = 1e-6 * np.eye(model.nx)
    central = np.stack(
        [(run(start + move).states[-1] - run(start - move).states[-1]) / 2e-6 for move in moves],
        axis=1,
    )
    times = []
    for _ in range(9):  # one after the other, so that what else the machine does slows all three
        one = run(start).seconds
        forward = derivatives(mode="forward").seconds / one
        times.append((one, forward, derivatives(output=squares, mode="adjoint").seconds / one))
    differ = float(np.abs(central - exact).max() / np.abs(exact).max())
    seconds, tangents, gradient = np.median(times, axis=0).tolist()
    return Row(name, model.nx, seconds, tangents, gradient, differ)


def squares(x: ca.MX, u: ca.MX) -> ca.MX:
    """Build a scalar output of the final state."""
    return ca.sumsqr(x)


if __name__ == "__main__":
    began = time.perf_counter()
    main()
    print(f"{time.perf_counter() - began:.0f} s in all")

"""Motions through contact as planning problems: each is solved by `ocp.solve(problem)` as it is.

Run it for what is found: python examples/contact_problems.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import casadi as ca
import numpy as np

import ocp
import tenscasadi as tc


def main() -> list[ocp.Plan]:
    """Prints what is found for each problem, and returns the plans."""
    plans = []
    for name, build in PROBLEMS.items():
        began = time.perf_counter()
        plans.append(ocp.solve(build()))
        print(f"{name:32} {'found' if plans[-1].success else 'not found':10} {time.perf_counter() - began:6.2f} s  {plans[-1].message}")
    return plans


def low_prism(stiffness: float = 1e4, damping: float = 20.0) -> tc.Model:
    """A prism of three bars of 1 m and 0.3 kg, 0.6 m high, on a ground with friction."""
    height = 0.6
    prism = tc.shapes.prism(3, np.sqrt(1.0 - height**2) / (2 * np.sin(np.radians(75))), height, bar_mass=0.3)
    ground = tc.Ground(stiffness=stiffness, damping=damping, friction=0.6, slip_speed=1e-2)
    return tc.Model(tc.Scene(prism, control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground))


def prism_jumps(rise: float, stiffness: float = 1e4, damping: float = 20.0, duration: float = 0.5) -> ocp.Problem:
    """The prism jumps: at the end its centre of mass is `rise` m higher, at the top of its way, and no node touches the ground."""
    model = low_prism(stiffness, damping)
    z = float(model.structure.nodes[:, 2].mean())  # all bars weigh the same
    return ocp.Problem(
        model,
        duration,
        goals=[ocp.CentreOfMass((None, None, z + rise))],
        bounds=[
            ocp.ForceDensityLimits(5.0, 500.0),
            ocp.Constraint("rise", lambda end: ca.sum2(end.velocities)[2] / 6, -0.1, 0.1, at_end=True),
            ocp.Constraint("height of nodes", lambda end: end.nodes[2, :].T, 0.02, at_end=True),
        ],
    )


PROBLEMS: dict[str, Callable[[], ocp.Problem]] = {
    **{f"prism jumps {rise} m": lambda rise=rise: prism_jumps(rise) for rise in (0.1, 0.2, 0.3, 0.4)},  # type: ignore[misc]
}

if __name__ == "__main__":
    main()

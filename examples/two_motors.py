"""Two motors tilt a prism by three cables, from rest to rest; the controls are rest lengths.

The cables run from its upper nodes through eyelets at its supports.

Run it with a folder for the picture: python examples/two_motors.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import ocp
import tenscasadi as tc
from tenscasadi import plots

CABLES = [[0, 3], [1, 4], [2, 5]]  # strings from the top to a foot, and on to the drums
MOTORS = ((1, 2),)  # one motor winds cable 0, the other one winds cables 1 and 2


def robot() -> tc.Structure:
    """A prism with three pinned feet; three springs connect its upper nodes."""
    prism = tc.shapes.prism(radius=0.5, height=1.0)
    s = tc.Structure(
        nodes=[*prism.nodes, (0, 0, 0)],  # the drums are in the middle of the feet
        bars=prism.bars,
        strings=[(0, 3), (1, 4), (2, 5), (0, 6), (1, 6), (2, 6), (3, 4), (4, 5), (5, 3)],
        pinned=[0, 1, 2, 6],
        node_mass=[0, 0, 0, 0, 0, 0, 1],
        stiffness=200.0,
        damping=3.0,
        cables=CABLES,
    )
    return s.prestressed(tc.equilibrium_force_density(s, minimum=5.0))


def main(folder: Path = Path()) -> ocp.Plan:
    """Print the plan and its replay, save a picture, and return the plan."""
    folder.mkdir(parents=True, exist_ok=True)
    s = robot()
    scene = tc.Scene(s, control=tc.RestLength())
    model = tc.Model(scene)
    start = model.initial_control  # rest lengths of three cables, then of three springs
    end = start + [-0.1, 0.04, 0.04, 0, 0, 0]
    tilted = tc.find_equilibrium(scene, control=end)
    reach = np.array([0.25, 0.25, 0.25, 0, 0, 0])  # m; the springs have no motor
    problem = ocp.Problem(
        model,
        duration=1.0,
        goals=[
            ocp.NodePositions({node: tuple(tilted.nodes[node]) for node in (3, 4, 5)}),
            ocp.AtRest(),
        ],
        bounds=[
            ocp.RestLengthLimits(start - reach, start + reach),
            ocp.ForceDensityLimits(0.5),  # all cables and springs stay taut
        ],
        costs=[ocp.Smoothness()],
    )
    profile = ocp.PiecewiseConstant(groups=MOTORS)
    plan = ocp.solve(problem, ocp.Variational(40, control=profile))
    print(plan.summary())
    moved = plan.control[-1] - start
    print(f"rest lengths of the cables change by {moved[:3].round(3)} m")
    plots.time_lapse(
        plan.replay(),
        instants=5,
        title="prism: two motors, three cables",
        path=folder / "two_motors.png",
    )
    return plan


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

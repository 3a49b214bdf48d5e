"""Scenes that several test files use."""

from __future__ import annotations

import numpy as np

from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength, Smooth, StringLaw
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.structure.structure import Structure

PRISM = {
    "nodes": [(-0.5, 0, 0), (0.5, 0, 0), (0, 0.866, 0), (0, 0.866, 1), (-0.5, 0, 1), (0.5, 0, 1)],
    "bars": [(0, 3), (1, 4), (2, 5)],
    "strings": [(1, 2), (2, 0), (0, 1), (5, 3), (3, 4), (4, 5), (1, 5), (2, 3), (0, 4)],
    "rest_length": 0.7,
}


def every_term(slack: StringLaw = Smooth(0.01), moved: bool = True) -> Scene:
    """Every term that there is: time, moved supports (unless `moved` is False), pressure, friction, massive strings, rollers."""
    rng = np.random.default_rng(3)
    tower = Structure(rng.normal(size=(7, 3)), [(0, 1), (1, 2), (2, 3), (4, 5)], [(0, 4), (3, 5), (2, 6), (4, 6)], node_mass=[0] * 6 + [1],
                      pinned={0: "xyz", 3: "z"}, damping=0.3, rest_length=0.2, string_mass=0.1)  # fmt: skip
    start = tower.nodes[0]
    return Scene(
        tower,
        control=RestLength(),
        segments=2,
        gravity=Gravity(),
        ground=Ground(100.0, 1.0, friction=0.4, height=0.3),
        pressure=Pressure([(0, 1, 2)], 5.0),
        forces=NodalForce(rng.normal(size=(3, 7, 3)), times=[0.0, 1.0, 2.0]),
        slack=slack,
        supports=SupportMotion({0: lambda t: [start[0] + np.sin(t), start[1] + t**2, start[2] - t]})
        if moved
        else None,
    )

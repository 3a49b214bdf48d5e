"""Structures of every kind, and those of the peers' files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure

DATA = Path(__file__).parents[1] / "data"
PEERS = [p for p in sorted((DATA / "motes").glob("*.npz")) if "analytical" not in p.stem]


def peer(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of a peer's file."""
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def from_peer(d: dict[str, np.ndarray]) -> Structure:
    """Return the structure of a peer's matrices."""
    columns = d["N0"].shape[1]
    mass = np.zeros(columns)
    mass[columns - len(d["m_string_node"]) :] = d["m_string_node"]
    return Structure.from_matrices(
        d["N0"],
        d["C_b"],
        d["C_s"],
        d["P"],
        d["D"],
        node_mass=mass,
        bar_mass=d["m_bar"],
        stiffness=d["k"],
        damping=d["c"],
        rest_length=d["s0"],
    )


def chain(**options: Any) -> Structure:
    """Return three bars meeting in node 1, a string node 4, pins at 0 and (one axis) 2; every number different."""
    nodes = [(0, 0, 0), (1, 0.2, 0.1), (2, 0, 0.3), (1, 1, 0), (0.5, 0.5, 1.0)]
    found: dict[str, Any] = {
        "bars": [(1, 0), (2, 1), (1, 3)],
        "strings": [(0, 3), (3, 4), (4, 1)],
        "bar_mass": [1.0, 2.0, 3.0],
        "bar_radius": [0.0, 0.1, 0.2],
        "node_mass": [0.0, 0.5, 0.0, 0.0, 0.25],
        "pinned": {0: "zyx", 2: "z"},
        "stiffness": [10.0, 20.0, 30.0],
        "damping": [0.1, 0.2, 0.3],
    }
    return Structure(nodes, **{**found, **options})


STRUCTURES = {
    "chain": chain(),
    "prism": shapes.prism(5),
    "d_bar": shapes.d_bar(pinned=[0]),
    "t_bar": shapes.t_bar(),
    "membrane": shapes.membrane(4, 3),
    "ball": shapes.six_bar_ball(bar_radius=0.05),
}

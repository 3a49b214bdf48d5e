"""A prism shortens its triangle strings until its bars, 8 cm thick, touch; without contact they intersect.

Run it with a folder for the picture: python examples/bars_touch.py pictures
"""

from __future__ import annotations

import sys
from itertools import combinations
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tenscasadi as tc
from tenscasadi.scene.closest_points import Segments, find_contact

RADIUS = 0.04  # m
WOUND = 0.1  # of the rest length of the triangles' strings, after RAMP seconds
RAMP, T_END = 1.5, 2.0  # s


def measure_distance(nodes: np.ndarray, bars: np.ndarray) -> np.ndarray:
    """Compute the smallest distance [m] between the axes of bars for nodes (T, n, 3)."""
    found = []
    for pair in combinations(range(len(bars)), 2):
        ends = Segments(*(nodes[:, node].T for node in bars[list(pair)].ravel()))
        depth = find_contact(ends, np.full((1, len(nodes)), 2 * RADIUS))[0].depth
        found.append(2 * RADIUS - np.asarray(depth).ravel())
    return np.asarray(np.min(found, axis=0))


def main(folder: Path = Path()) -> dict[str, np.ndarray]:
    """Print and draw the distance of the bars with and without contact, and return both."""
    folder.mkdir(parents=True, exist_ok=True)
    s = tc.shapes.prism(stiffness=300.0, prestress=30.0, damping=2.0, bar_radius=RADIUS)
    found, figure = {}, plt.figure(figsize=(7, 3), layout="constrained")
    axes = figure.add_subplot()
    laws = {"no contact": None, "contact": tc.BarContact(stiffness=2e4, damping=20.0)}
    for name, contact in laws.items():
        model = tc.Model(tc.Scene(s, control=tc.RestLength(), bar_contact=contact))
        start = model.initial_control
        end = np.where(np.arange(9) < 6, WOUND, 1.0) * start
        ramp = np.minimum(np.arange(200) / 200 * T_END / RAMP, 1.0)[:, None]
        run = tc.simulate(
            model,
            T_END,
            5e-4,
            control=start + ramp * (end - start),
            correction=tc.Projection(),
            save_every=20,
        )
        found[name] = measure_distance(run.nodes, s.bars)
        print(f"{name:<11} {run.message}: least distance of axes {found[name].min():.4f} m")
        axes.plot(run.time, found[name], label=name)
    axes.axhline(2 * RADIUS, color="gray", linestyle=":", label="sum of the radii")
    axes.set(xlabel="time (s)", ylabel="distance of axes (m)", ylim=(0, None))
    axes.legend()
    figure.savefig(folder / "bars_touch.png", dpi=150)
    plt.close(figure)
    return found


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

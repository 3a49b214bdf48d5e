"""How stiff should the strings of a ball be that falls? Each stiffness and damping is a ball of its own, dropped from a meter: a sweep on all cores.

What has finished is kept in a folder, so that a second run is done at once:

    python examples/sweep_stiffness.py pictures results

On a cluster the same sweep takes an executor, such as Dask's: tc.sweep(drop, cases,
client.get_executor(), "results").
"""

from __future__ import annotations

import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

import tenscasadi as tc

HEIGHT = 1.0  # m, of the lowest node
DAMPINGS = (1.0, 5.0, 25.0)  # N·s/m
FACE_DOWN = Rotation.align_vectors([(0.0, 0.0, 1.0)], [(1.0, 1.0, 1.0)])[
    0
].as_matrix()  # the ball lands on three nodes
SLACK = 0.02  # of a string's length, that its prestress stretches it by


def drop(case: dict[str, Any]) -> dict[str, Any]:
    """Drop one ball: how hard its strings pull, how far it is crushed, and how high it rises again."""
    stiffness = case["stiffness"]
    ball = tc.shapes.six_bar_ball(
        stiffness=stiffness, damping=case["damping"], prestress=SLACK * stiffness
    )
    nodes = ball.nodes @ FACE_DOWN.T
    ball = ball.replace(nodes=nodes + (0.0, 0.0, HEIGHT - nodes[:, 2].min()))
    scene = tc.Scene(
        ball,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=2e4, damping=5.0, friction=0.8, slip_speed=0.05),
    )
    run = tc.simulate(
        tc.Model(scene),
        case["seconds"],
        2e-4,
        correction=tc.Projection(every=10),
        compiled=case["compiled"],
    )
    center = run.nodes[:, :, 2].mean(axis=1)
    landed = int(np.argmax(np.diff(center) > 0))  # where it first rises
    size = np.ptp(run.nodes[[0, landed], :, 2], axis=1)
    return {
        "tension": run.tension.max(),  # N
        "crushed": 1 - size[1] / size[0],  # share of its height
        "rebound": (center[landed:].max() - center[landed])
        / (center[0] - center[landed]),  # share of the fall
        "success": run.success,
    }


def main(folder: Path = Path(), results: Path | None = None, *, quick: bool = False) -> tc.Sweep:
    """Prints the table, saves the picture and returns the table. `quick`: four cases, a short fall, nothing compiled, one thread."""
    folder.mkdir(parents=True, exist_ok=True)
    stiffnesses = np.geomspace(300.0, 30_000.0, 2 if quick else 9)
    common = {"seconds": 0.9, "compiled": False} if quick else {"seconds": 1.5, "compiled": None}
    cases = [
        {"stiffness": k, "damping": c, **common}
        for c in DAMPINGS[: 2 if quick else 3]
        for k in stiffnesses
    ]

    began = time.perf_counter()
    if quick:
        with ThreadPoolExecutor(1) as executor:
            table = tc.sweep(drop, cases, executor, results)
    else:
        table = tc.sweep(drop, cases, folder=results, progress=True)
    print(
        f"{table.message}: {time.perf_counter() - began:.1f} s, {table.seconds.sum():.1f} s of work"
    )
    print(table.to_csv())
    draw(table, folder / "sweep_stiffness.png")
    return table


def draw(table: tc.Sweep, path: Path) -> None:
    """Three outcomes over the stiffness, a curve for each damping."""
    figure = Figure(figsize=(11, 3.6), layout="constrained")
    labels = {
        "tension": "largest tension / N",
        "crushed": "lost of its height",
        "rebound": "rebound / fall",
    }
    for axes, (name, label) in zip(figure.subplots(1, 3), labels.items(), strict=True):
        for damping in np.unique(table["damping"]):
            rows = table["damping"] == damping
            axes.plot(
                table["stiffness"][rows], table[name][rows], "o-", ms=4, label=f"{damping:g} N·s/m"
            )
        axes.set(xscale="log", xlabel="stiffness of each string / N/m", ylabel=label)
        axes.grid(alpha=0.3)
    figure.axes[0].set_yscale("log")
    figure.axes[1].legend(title="damping", frameon=False)
    figure.suptitle(f"a ball of six bars, dropped from {HEIGHT:g} m")
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))

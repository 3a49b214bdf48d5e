"""Computation times of plans for towers of 3 to 96 bars, whose height increases by a tenth.

The towers of three-bar prisms are unsupported and move from rest to rest in a second. Each is
planned by default, and up to 24 bars also by `Variational` with IPOPT on as many intervals. Times
are processor times from `ocp.solve` to the plan, including the replay.

Run it with a folder for the picture: python examples/plan_growth.py pictures
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: so that the processor's seconds are those of one thread

import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from ocp_problems.shape_changes import free_tower

import ocp

STAGES = (1, 2, 4, 8, 16, 32)
PROGRAM_STAGES = 8  # up to which a whole program is factored
DEFAULT, PROGRAM = "default", "Variational by Ipopt"


class Row(NamedTuple):
    """Result of one plan, with the error of its replay [m] and its error growth."""

    bars: int
    method: str
    success: bool
    intervals: int
    seconds: float
    iterations: int
    error: float
    growth: float
    objective: float


def solved(stages: int, method: str, intervals: int = 0) -> Row:
    """Solve the problem of one tower."""
    problem = free_tower(stages)
    given = (
        (ocp.Variational(intervals, accuracy=1e-4 * stages), ocp.Ipopt())
        if method == PROGRAM
        else ()
    )
    began = time.process_time()
    plan = ocp.solve(problem, *given)
    seconds = time.process_time() - began
    count = len(plan.time) - 1
    return Row(
        3 * stages,
        method,
        plan.success,
        count,
        seconds,
        plan.iterations,
        plan.replay_error,
        plan.error_growth,
        plan.objective,
    )


def main(folder: Path = Path(), quick: bool = False) -> list[Row]:
    """Print the table, draw it, and return its rows. With `quick`, up to 12 bars."""
    folder.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    print(
        f"{'bars':>5}  {'method':21}{'success':>8}{'intervals':>10}{'seconds':>9}{'iterations':>11}{'replay m':>10}{'growth':>9}{'objective':>11}"
    )
    for stages in STAGES[: 3 if quick else None]:
        rows.append(solved(stages, DEFAULT))
        if stages <= PROGRAM_STAGES:
            rows.append(solved(stages, PROGRAM, rows[-1].intervals))
        for row in rows[-1 - (stages <= PROGRAM_STAGES) :]:
            found = f"{row.bars:5}  {row.method:21}{row.success!s:>8}{row.intervals:10}{row.seconds:9.2f}{row.iterations:11}"
            print(f"{found}{row.error:10.1e}{row.growth:9.1e}{row.objective:11.1f}", flush=True)
    draw(rows, folder / "plan_growth.png")
    return rows


def draw(rows: list[Row], path: Path) -> None:
    """Draw times over numbers of bars, a line for each method, and a quadratic line."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    axes = figure.subplots()
    for method, marker, above in ((DEFAULT, "o", -13), (PROGRAM, "s", 7)):
        own = [row for row in rows if row.method == method and row.success]
        axes.plot(
            [row.bars for row in own], [row.seconds for row in own], marker=marker, label=method
        )
        for row in own:
            axes.annotate(
                f"{row.seconds:.2g}",
                (row.bars, row.seconds),
                xytext=(3, above),
                textcoords="offset points",
                fontsize=8,
            )
    bars = np.array([6.0, max(row.bars for row in rows)])
    axes.plot(
        bars,
        0.3 * rows[0].seconds * (bars / 3) ** 2,
        ":",
        color="gray",
        label="second power of the bars",
    )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="bars of the tower",
        ylabel="seconds of the processor, from problem to plan",
    )
    ticks = sorted({row.bars for row in rows})
    axes.set_xticks(ticks, [str(tick) for tick in ticks])
    axes.minorticks_off()
    axes.set_title("Towers of three-bar prisms rise by a tenth in a second: what a plan takes")
    axes.grid(which="major", alpha=0.3)
    axes.legend(fontsize=9)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

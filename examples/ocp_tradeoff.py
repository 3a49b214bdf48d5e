"""What a plan costs and what it is worth: all transcriptions on several grids, seconds against replay error, and plain multiple shooting.

Plain: RK4 with two substeps in one graph, CasADi's own derivatives, IPOPT with its default options,
same guess, same rows. The replay error is how far a simulation with steps ten times finer than the
intervals ends from the goal. Corrected: solved again with what fine steps show the coarse rows to
miss.

Run it with a folder for the picture: python examples/ocp_tradeoff.py pictures
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np
from matplotlib.figure import Figure

import ocp
import tenscasadi as tc
from ocp.solvers.base import Solution
from ocp.solvers.monitor import Monitor
from ocp.transcription.base import Transcription
from ocp.transcription.sparse_nlp import Program

BAR = 1.4  # m
SAME = 60  # intervals at which the fast path and plain multiple shooting are compared
CORRECTED, LEAST = (
    "Variational, corrected",
    20,
)  # the fast path; with fewer intervals corrections need many rounds


class Row(NamedTuple):
    """One plan: seconds are wall time of `ocp.solve`, building included."""

    method: str
    intervals: int
    seconds: float
    iterations: int
    replay_error: float
    objective: float


@dataclass(frozen=True)
class Plain(ocp.Ipopt):
    """IPOPT as it comes, with the derivatives that CasADi makes of the whole program."""

    def solve(self, program: Program, monitor: Monitor | None = None) -> Solution:
        """The solution."""
        solver = ca.nlpsol(
            "solver",
            "ipopt",
            program.problem,
            {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False},
        )
        result = solver(
            x0=program.first,
            lbx=program.w_lower,
            ubx=program.w_upper,
            lbg=program.lower,
            ubg=program.upper,
        )
        stats = solver.stats()
        w = np.asarray(result["x"].full()).ravel()
        return Solution(
            w, bool(stats["success"]), str(stats["return_status"]), int(stats["iter_count"])
        )


def problem() -> ocp.Problem:
    """A prism is raised from 1 m to 1.1 m in a second, from rest to rest, at the least effort."""

    def prism(height: float) -> tc.Structure:
        return tc.shapes.prism(
            bars=3, radius=np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height=height
        )

    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    model = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
    return ocp.Problem(
        model, goals=goals, bounds=[ocp.ForceDensityLimits(5.0, 100.0)], costs=[ocp.Effort()]
    )


def methods(intervals: int) -> dict[str, Transcription]:
    """All transcriptions on a grid."""
    corrected = {CORRECTED: ocp.Variational(intervals, accuracy=1e-9)} if intervals >= LEAST else {}
    return {
        "Variational": ocp.Variational(intervals),
        **corrected,
        "ImplicitMidpoint": ocp.ImplicitMidpoint(intervals),
        "MultipleShooting": ocp.MultipleShooting(intervals),
        "MultipleShooting, 2 substeps": ocp.MultipleShooting(intervals, substeps=2),
        "Collocation, degree 2": ocp.DirectCollocation(intervals, degree=2),
        "Collocation, degree 3": ocp.DirectCollocation(intervals, degree=3),
    }


def measured(name: str, transcription: Transcription, solver: ocp.Ipopt, repeats: int) -> Row:
    """The median of `repeats` runs."""
    plans = [ocp.solve(problem(), transcription, solver) for _ in range(repeats)]
    plan = plans[0]
    if not plan.success:
        print(f"{name}, {transcription.count} intervals: {plan.message}")
    seconds = float(np.median([one.seconds for one in plans]))
    return Row(
        name, transcription.count, seconds, plan.iterations, plan.replay_error, plan.objective
    )


def main(folder: Path = Path(), quick: bool = False) -> list[Row]:
    """Prints the table, draws it, and returns its rows; the last is plain multiple shooting."""
    folder.mkdir(parents=True, exist_ok=True)
    grids, repeats = ((5, LEAST), 1) if quick else ((10, 20, 40, SAME), 5)
    measured("warm-up", ocp.Variational(5), ocp.Ipopt(), 1)
    rows = [
        measured(name, method, ocp.Ipopt(), repeats)
        for n in grids
        for name, method in methods(n).items()
    ]
    plain = measured(
        "plain multiple shooting", ocp.MultipleShooting(grids[-1], substeps=2), Plain(), repeats
    )
    rows.append(plain)
    print(
        f"{'method':<30}{'intervals':>10}{'seconds':>10}{'iterations':>12}{'replay error (m)':>18}{'objective':>12}"
    )
    for row in rows:
        print(
            f"{row.method:<30}{row.intervals:>10}{row.seconds:>10.3f}{row.iterations:>12}{row.replay_error:>18.1e}{row.objective:>12.4f}"
        )
    same = next(row for row in rows if row.method == CORRECTED and row.intervals == grids[-1])
    faster = plain.seconds / same.seconds
    print(
        f"\n{same.intervals} intervals: {CORRECTED}, {same.replay_error:.1e} m, is {faster:.1f} times as fast as plain multiple shooting"
    )
    better = [row for row in rows[:-1] if row.replay_error <= plain.replay_error]
    if better:
        best = min(better, key=lambda row: row.seconds)
        name = f"{best.method}, {best.intervals} intervals"
        print(
            f"as exact as plain or more: {name}, {best.replay_error:.1e} m, {plain.seconds / best.seconds:.1f} times as fast"
        )
    draw(rows, folder / "ocp_tradeoff.png")
    return rows


def draw(rows: list[Row], path: Path) -> None:
    """Seconds against replay error, a line for each method."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    axes = figure.subplots()
    for name, marker in zip(dict.fromkeys(row.method for row in rows), "oPsD^v<*", strict=False):
        own = [row for row in rows if row.method == name]
        axes.plot(
            [row.replay_error for row in own],
            [row.seconds for row in own],
            marker=marker,
            label=name,
            markersize=10 if marker == "*" else 6,
        )
        if name in ("Variational", CORRECTED, "plain multiple shooting"):
            for row in own:
                axes.annotate(
                    str(row.intervals),
                    (row.replay_error, row.seconds),
                    xytext=(4, 6),
                    textcoords="offset points",
                    fontsize=8,
                )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="replay error at the goal (m)",
        ylabel="seconds, building included",
    )
    axes.set_title("A prism rises: what a plan costs and what it is worth")
    axes.grid(which="major", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=120)


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

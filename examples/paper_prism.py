"""Sect. 7.1 of the paper: a prism whose strings have mass, modeled by 1 to 10 segments each. How many segments are enough?

Run it with a folder for the pictures: python examples/paper_prism.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure

import tenscasadi as tc
from tenscasadi import plots

T_END = 5.0
STEP = 1e-3
ROWS = 5  # steps from one kept row to the next
MOST = 10
Ends = Literal["interior", "lumped"]
ENDS: tuple[Ends, ...] = ("interior", "lumped")
DRAWN = (1, 2, 3, 5, 10)


def prism() -> tc.Structure:
    """The paper's prism: bars of √2 m and 1 kg; nine strings of 1 m, 100 N/m and 0.04 kg that all start at 30 N/m, out of balance."""
    triangle = np.array([(0.5, 0.0, 0.0), (0.0, np.sqrt(0.75), 0.0), (-0.5, 0.0, 0.0)])
    sides = [(0, 1), (1, 2), (2, 0), (3, 4), (4, 5), (5, 3)]
    uprights = [(0, 3), (1, 4), (2, 5)]
    nodes = np.concatenate([triangle, triangle + (0.0, 0.0, 1.0)])
    return tc.Structure(
        nodes, [(2, 4), (0, 5), (1, 3)], sides + uprights, stiffness=100.0, string_mass=0.04
    ).prestressed(30.0)


def run(
    segments: int, ends: Ends, correction: tc.Projection | None = tc.Projection()
) -> tc.Trajectory:
    """Five seconds from rest with each string in `segments`."""
    model = tc.Model(tc.Scene(prism(), segments=segments, ends=ends))
    # Each model runs once: to compile it would take longer.
    return tc.simulate(model, T_END, STEP, correction=correction, save_every=ROWS, compiled=False)


def distance(trajectory: tc.Trajectory, reference: tc.Trajectory) -> float:
    """√(∫‖n − n_ref‖² dt / ∫‖n_ref‖² dt) of node 1 (index 0 here): the L2 norm of its distance over that of its position."""
    theirs = reference.nodes[:, 0]
    return float(np.linalg.norm(trajectory.nodes[:, 0] - theirs) / np.linalg.norm(theirs))


def main(folder: Path = Path()) -> dict[tuple[Ends, int], float]:
    """Prints the table, saves the pictures, and returns the relative error of node 1 by (ends, segments)."""
    folder.mkdir(parents=True, exist_ok=True)
    divisions = range(1, MOST)
    runs = {(ends, n): run(n, ends) for ends in ENDS for n in (*divisions, MOST)}
    errors = {
        (ends, n): distance(runs[ends, n], runs[ends, MOST]) for ends in ENDS for n in divisions
    }

    print(
        f"{prism()!r}, {T_END:g} s from rest; L2 distance of node 1 from its run with {MOST} segments, relative to its position\n"
    )
    print(f"{'segments':>8}" + "".join(f"{ends:>12}" for ends in ENDS))
    for n in divisions:
        print(f"{n:8}" + "".join(f"{errors[ends, n]:12.3%}" for ends in ENDS))
    last = [errors[ends, MOST - 1] for ends in ENDS]
    print(
        "\npaper: less than 0.5 % from the 9th to the 10th division, string mass on inner nodes only"
    )
    print(
        f"here:  {last[0]:.2%} with string mass on inner nodes only, {last[1]:.2%} with its share on the strings' ends too (ends='lumped')"
    )
    plain = run(1, "interior", correction=None).bar_length_error.max()
    kept = max(trajectory.bar_length_error.max() for trajectory in runs.values())
    print(
        f"\nbar lengths, paper: errors of about 1e-16 without correction\nhere:  {plain:.1e} without, {kept:.1e} with projection, RK4 at {STEP:g} s"
    )

    five = runs["interior", 5]
    early = tc.simulate(
        tc.Model(tc.Scene(prism(), segments=5)),
        1.0,
        STEP,
        correction=tc.Projection(),
        compiled=False,
    )
    plots.time_lapse(
        early,
        instants=4,
        title="prism: its first second, five segments a string",
        path=folder / "paper_prism.png",
    )
    for n in (1, 5, MOST):
        title = f"prism: {n} segment{'s' * (n > 1)} a string, t = 2 s"
        plots.structure(
            runs["lumped", n], time=2.0, title=title, path=folder / f"paper_prism_{n}.png"
        )
    figure_5(runs, five.time).savefig(folder / "paper_prism_node_1.png", dpi=150)
    convergence(errors).savefig(folder / "paper_prism_convergence.png", dpi=150)
    return errors


def figure_5(runs: dict[tuple[Ends, int], tc.Trajectory], time: np.ndarray) -> Figure:
    """The y coordinate of node 1 over time, for both distributions of mass."""
    figure = Figure(figsize=(7.2, 5.2), layout="constrained")
    shown = [n for n in DRAWN if (ENDS[0], n) in runs]
    for ax, ends in zip(figure.subplots(2, 1, sharex=True, sharey=True), ENDS, strict=True):
        for k, n in enumerate(shown):
            last = n == MOST
            ax.plot(
                time,
                runs[ends, n].nodes[:, 0, 1],
                color="black" if last else f"C{k}",
                ls="--" if last else "-",
                lw=1.3,
                label=f"{n}",
            )
        ax.set(
            ylabel="y of node 1 (m)",
            title=f'prism: string mass with ends="{ends}"',
            xlim=(0, T_END),
        )
        ax.grid(visible=True, color="0.9")
    ax.set_xlabel("time (s)")
    figure.legend(
        *ax.get_legend_handles_labels(), loc="outside right upper", title="segments", frameon=False
    )
    return figure


def convergence(errors: dict[tuple[Ends, int], float]) -> Figure:
    """Error of node 1 against the number of segments, with the paper's claim."""
    figure = Figure(figsize=(6.0, 3.8), layout="constrained")
    ax = figure.subplots()
    for ends, marker in zip(ENDS, "os", strict=True):
        points = [(n, 100 * error) for (kind, n), error in errors.items() if kind == ends]
        ax.semilogy(*zip(*points, strict=True), marker=marker, label=f'ends="{ends}"')
    ax.plot(MOST - 1, 0.5, "v", color="black", ms=8, label="paper: less than")
    ax.set(
        xlabel="segments a string",
        ylabel=f"error of node 1 against {MOST} segments (%)",
        xticks=range(1, MOST),
    )
    ax.set_title("prism: how many segments are enough")
    ax.grid(visible=True, which="both", color="0.92")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.legend(frameon=False)
    return figure


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

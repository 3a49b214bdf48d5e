"""Sect. 7.2 of the paper: a D-bar with one node held, a class-2 structure, driven through its fold by unequal prestress.

Run it with a folder for the pictures: python examples/paper_dbar.py pictures
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

import tenscasadi as tc
from tenscasadi import plots

T_END = 5.0
STEP = 1e-3
STIFFNESS = 100.0
REST = (0.5, 1.0)  # of the string from the held node to the one opposite, and of the other, m
CORRECTIONS: dict[str, tc.Projection | tc.BarLengthCorrection | None] = {
    "none": None,
    "Appendix C": tc.BarLengthCorrection(),
    "projection": tc.Projection(),
}


class Row(NamedTuple):
    """One run: where it ended, s, and its largest errors: bar lengths, relative, joints, m, energy, J, and nodes, m, against one angle's equation."""

    end: float
    bar_length: float
    joint: float
    energy: float
    position: float


def d_bar() -> tc.Structure:
    """A square of four bars of 1 m and 1 kg with node 0 held. It is unstable out of its plane, in which z = 0 exactly keeps it."""
    square = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (0.0, 1.0, 0.0)]
    bars = [(0, 1), (1, 2), (2, 3), (3, 0)]
    return tc.Structure(
        square, bars, [(0, 2), (1, 3)], pinned=[0], stiffness=STIFFNESS, rest_length=REST
    )


def one_angle(times: np.ndarray) -> np.ndarray:
    """Nodes (T, 4, 3) from Lagrange's equation of the half angle a at the held node.

    Symmetric forces keep the diagonal where it is, so a is the whole motion: kinetic energy (2/3 +
    2 sin²a) ȧ², strings 2 |cos a| and 2 |sin a| long. It folds at a = π/2, where nodes 0 and 2
    meet.
    """

    def slope(_: float, y: np.ndarray) -> list[float]:
        a, da = y
        lengths = 2 * np.abs([np.cos(a), np.sin(a)])
        pull = STIFFNESS * np.maximum(0.0, lengths - REST)
        force = 2 * pull[0] * np.sin(a) * np.sign(np.cos(a)) - 2 * pull[1] * np.cos(a) * np.sign(
            np.sin(a)
        )
        return [da, (force - 2 * np.sin(2 * a) * da**2) / (4 / 3 + 4 * np.sin(a) ** 2)]

    a = solve_ivp(
        slope,
        (0.0, times[-1]),
        [np.pi / 4, 0.0],
        "DOP853",
        times,
        rtol=1e-12,
        atol=1e-12,
        max_step=1e-3,
    ).y[0]
    ends = [
        np.stack([np.cos(np.pi / 4 + turn), np.sin(np.pi / 4 + turn), np.zeros_like(a)], axis=-1)
        for turn in (-a, a)
    ]
    return np.stack([np.zeros_like(ends[0]), ends[0], ends[0] + ends[1], ends[1]], axis=1)


def main(folder: Path = Path()) -> dict[str, Row]:
    """Prints the table, saves the pictures, and returns the table's rows by correction."""
    folder.mkdir(parents=True, exist_ok=True)
    # "full": the paper's nodes of each bar and Ω that joins them, so that joints could open.
    model = tc.Model(tc.Scene(d_bar()), coordinates="full")
    rows, runs = {}, {}
    print(
        f"{d_bar()!r} of class 2, {model.structure.class_one().P.shape[1]} joints and pins, {T_END:g} s, RK4 at {STEP:g} s\n"
    )
    print(
        f"{'correction':>11} {'ran until s':>11} {'bar length':>11} {'joint m':>9} {'energy J':>9} {'position m':>11}"
    )
    for name, correction in CORRECTIONS.items():
        run = tc.simulate(model, T_END, STEP, correction=correction, compiled=False)
        runs[name] = run
        position = np.abs(run.nodes - one_angle(run.time)).max()
        largest = (
            float(np.abs(values).max())
            for values in (run.bar_length_error, run.joint_error, run.energy_error, position)
        )
        rows[name] = Row(float(run.time[-1]), *largest)
        print(
            f"{name:>11} {run.time[-1]:11.3g} {rows[name].bar_length:11.1e} {rows[name].joint:9.1e} {rows[name].energy:9.1e} {position:11.1e}"
        )
    kept, other = runs["projection"], runs["Appendix C"]
    opposite = kept.nodes[:, 2] @ (1.0, 1.0, 0.0)  # along the diagonal that node 2 moves on
    folds = kept.time[1:][np.diff(np.sign(opposite)) != 0]
    print(
        f"\nthe D-bar folds at t = {', '.join(f'{t:.2f}' for t in folds)} s: its bars lie on one line, and the constraints are dependent there"
    )
    print(
        "paper: bars, joints and the held node exact to machine precision, with the correction of Appendix C"
    )
    ours, theirs = rows["projection"], rows["Appendix C"]
    print(
        f"here:  bars {ours.bar_length:.0e}, joints {ours.joint:.0e} m through all folds with projection;"
    )
    print(
        f"       Appendix C opens joints by {theirs.joint:.0e} m"
        + ("" if other.success else f" and {other.message.split(':')[0]}")
    )

    before = tc.simulate(model, 1.3, STEP, correction=tc.Projection(), compiled=False)
    plots.time_lapse(
        before,
        instants=6,
        title="D-bar, node 0 held: through its fold",
        path=folder / "paper_dbar.png",
    )
    plots.node_histories(
        kept,
        nodes=[1, 2, 3],
        title="D-bar, node 0 held: places of its other nodes",
        path=folder / "paper_dbar_nodes.png",
    )
    plots.errors(
        kept,
        title="D-bar: errors with projection after every step",
        path=folder / "paper_dbar_errors.png",
    )
    figure_7(runs).savefig(folder / "paper_dbar_figure_7.png", dpi=150)
    return rows


def figure_7(runs: dict[str, tc.Trajectory]) -> Figure:
    """Errors of the bars' lengths and of the joints over time, one curve for each correction, on a logarithmic scale."""
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    floor = 1e-17
    quantities = {
        "bar length (relative)": "bar_length_error",
        "joints and held node (m)": "joint_error",
    }
    for ax, (label, field) in zip(
        figure.subplots(2, 1, sharex=True, sharey=True), quantities.items(), strict=True
    ):
        for name, run in runs.items():
            ax.semilogy(run.time, np.maximum(getattr(run, field), floor), label=name, lw=1.3)
        ax.set(ylabel=f"error: {label}", xlim=(0, T_END), ylim=(floor / 3, 1.0))
        ax.grid(visible=True, color="0.9")
    ax.set_xlabel(f"time (s)   [errors below {floor:g} lie at {floor:g}]")
    figure.suptitle("D-bar: what corrections do to its errors")
    figure.legend(
        *ax.get_legend_handles_labels(),
        loc="outside right upper",
        title="correction",
        frameon=False,
    )
    return figure


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

"""Sect. 7.3 of the paper: a cylinder of strings under an inner pressure of 1 atm that rises by 5 % at once. No bars: class 0.

Run it with a folder for the pictures: python examples/paper_membrane.py pictures

What the paper leaves open is read as follows. Both ends are closed by caps, whose load acts on the
end rings along the axis. Strings are of UHMWPE (970 kg/m³, 2.7 GPa), as thick as their tension at 1
atm asks for, with half of their mass on each of their ends, and damped by c = 2 η √(k m), η = 0.1.
Pressure follows the membrane, the caps' load does not.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.structure.shapes import membrane_faces

RADIUS, LENGTH = 20.0, 40.0
ATMOSPHERE = 101325.0
RISE = 1.05
DENSITY, STRENGTH = 970.0, 2.7e9
LENGTH_RATIO = 0.975  # of a string without tension to the same string at 1 atm
DAMPING_RATIO = 0.1
T_END = 0.15
STEP = 2e-5
EXPECTED = {(8, 5): 0.0477, (16, 9): 0.0495, (24, 13): 0.0501}


class Row(NamedTuple):
    """One membrane: the first peak of its middle ring's radial motion, m, its time, s, the ring's axial motion, m, and the strings' mass, kg."""

    peak: float
    time: float
    axial: float
    mass: float


def caps(p: int, q: int) -> np.ndarray:
    """Forces (n, 3) of 1 atm on both caps, regular polygons of p corners, N."""
    forces = np.zeros((p * q, 3))
    share = ATMOSPHERE * RADIUS**2 / 2 * np.sin(2 * np.pi / p)
    forces[:p, 2], forces[-p:, 2] = -share, share
    return forces


@cache
def membrane(p: int, q: int) -> tc.Structure:
    """`q` rings of `p` nodes in equilibrium with 1 atm. The load decides all tensions, and these all masses and stiffnesses."""
    bare = tc.shapes.membrane(p, q, RADIUS, LENGTH, node_mass=1.0)
    corners = bare.nodes[np.array(membrane_faces(p, q))]
    thirds = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * ATMOSPHERE / 6
    loads = caps(p, q)
    np.add.at(loads, membrane_faces(p, q), thirds[:, None])
    gamma = tc.equilibrium_force_density(bare, loads, minimum=0.0)
    stiffness = gamma / (1 - LENGTH_RATIO)  # Eq. 99
    mass = DENSITY / STRENGTH * gamma * bare.string_lengths**2  # area t/σ times length and density
    return bare.replace(
        node_mass=0.0,
        stiffness=stiffness,
        damping=2 * DAMPING_RATIO * np.sqrt(stiffness * mass),
        rest_length=LENGTH_RATIO * bare.string_lengths,
        string_mass=mass,
    )


def run(p: int, q: int, rise: float = RISE) -> tc.Trajectory:
    """The motion after the pressure has become `rise` atm at t = 0."""
    pressure = tc.Pressure(membrane_faces(p, q).tolist(), rise * ATMOSPHERE)
    scene = tc.Scene(
        membrane(p, q), ends="lumped", pressure=pressure, forces=tc.NodalForce(rise * caps(p, q))
    )
    return tc.simulate(
        tc.Model(scene), T_END, STEP, save_every=5, compiled=False
    )  # runs once: to compile it would take longer


def radial(trajectory: tc.Trajectory, p: int, q: int) -> np.ndarray:
    """Radial motion (T, p) of the middle ring, m."""
    ring = trajectory.nodes[:, p * (q // 2) : p * (q // 2 + 1), :2]
    return np.asarray(np.linalg.norm(ring, axis=2)) - RADIUS


def first_peak(values: np.ndarray) -> int:
    """The row of the first local maximum."""
    return int(np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:]))[0]) + 1


def main(folder: Path = Path()) -> dict[tuple[int, int], Row]:
    """Prints the table, saves the pictures and returns the table's rows by (p, q)."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, runs = {}, {}
    print(
        f"pressure {ATMOSPHERE:g} Pa → {RISE:g} times that; R = {RADIUS:g} m, L = {LENGTH:g} m; middle ring\n"
    )
    print(
        f"{'(p, q)':>9} {'first peak m':>13} {'expected m':>11} {'at ms':>6} {'axial m':>9} {'strings':>8} {'mass kg':>8}"
    )
    for p, q in EXPECTED:
        runs[p, q] = trajectory = run(p, q)
        middle = radial(trajectory, p, q)[:, 0]
        k = first_peak(middle)
        axial = np.abs(trajectory.nodes[:, p * (q // 2) : p * (q // 2 + 1), 2]).max()
        structure = membrane(p, q)
        row = rows[p, q] = Row(
            float(middle[k]),
            float(trajectory.time[k]),
            float(axial),
            float(structure.string_mass.sum()),
        )
        print(
            f"({p:2},{q:3}) {row.peak:15.4f} {EXPECTED[p, q]:11.4f} {1e3 * row.time:6.1f} {axial:9.1e} {len(structure.strings):8} {row.mass:8.0f}"
        )
    print("\npaper: no vertical motion of the center nodes, radial vibration that is damped")
    coarse = next(iter(runs))
    rest = radial(runs[coarse], *coarse)[len(runs[coarse].time) // 2 :, 0].mean()
    print(
        f"here:  vertical motion below {max(row.axial for row in rows.values()):.0e} m; radial vibration about its new rest near {rest:.3f} m is"
    )
    print(
        "       damped, least in the finest membrane (c falls with a string's mass); it beats with the axial vibration that the caps drive"
    )

    sizes = list(runs)
    for p, q in (sizes[0], sizes[-1]):
        plots.structure(
            membrane(p, q),
            title=f"membrane: p = {p}, q = {q}, at 1 atm",
            path=folder / f"paper_membrane_{p}_{q}.png",
        )
    figure_9(runs).savefig(folder / "paper_membrane.png", dpi=150)
    return rows


def figure_9(runs: dict[tuple[int, int], tc.Trajectory]) -> Figure:
    """Radial and axial motion of a node of the middle ring."""
    figure = Figure(figsize=(7.2, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    for (p, q), trajectory in runs.items():
        upper.plot(
            1e3 * trajectory.time,
            1e3 * radial(trajectory, p, q)[:, 0],
            lw=1.2,
            label=f"p = {p}, q = {q}",
        )
        end = trajectory.nodes[:, -1, 2] - trajectory.nodes[0, -1, 2]
        lower.plot(1e3 * trajectory.time, 1e3 * trajectory.nodes[:, p * (q // 2), 2], lw=1.2)
        lower.plot(
            1e3 * trajectory.time, 1e3 * end, lw=0.9, ls="--", color=lower.lines[-1].get_color()
        )
    upper.set(ylabel="radial motion (mm)", xlim=(0, 1e3 * T_END))
    upper.set_title(f"membrane after a rise of pressure to {RISE:g} atm: center", fontsize=10)
    lower.set(ylabel="axial motion (mm)", xlabel="time (ms)")
    lower.set_title("center: full lines, at 0; end ring: dashed", fontsize=10)
    for ax in (upper, lower):
        ax.grid(visible=True, color="0.9")
    figure.legend(
        *upper.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=len(runs),
        frameon=False,
    )
    return figure


if __name__ == "__main__":
    main(Path(*sys.argv[1:2]))

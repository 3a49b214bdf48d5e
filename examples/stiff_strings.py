"""Stiff strings (1e7 N/m, five segments each): what a motion to 1e-6 m costs by explicit and implicit schemes. Prints the table.

Explicit steps are bound by the fastest wave along a string, 85 000 rad/s (damped: decay at 720 000
/s), while what moves visibly, the prism and its strings to and fro, has 10 to 200 rad/s. Implicit
steps follow the visible motion alone. That works because the start, a prism that turns, hardly
excites the waves along the strings: in a start that does, by more than the tolerance and without
damping, these waves are part of the answer and every scheme has to follow them.

python examples/stiff_strings.py
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

import tenscasadi as tc

T_END = 0.1


class Row(NamedTuple):
    """One scheme: steps taken, largest error of a node, m, and the least time of some runs, s."""

    scheme: str
    steps: int
    error: float
    seconds: float


def stiff_prism(damping: float) -> tuple[tc.Model, Any]:
    """A turning prism with strings of 1e7 N/m and 0.1 kg in five segments, and its start; damping in N s/m."""
    structure = tc.shapes.prism(stiffness=1e7, prestress=30.0, damping=damping, string_mass=0.1)
    model = tc.Model(tc.Scene(structure, segments=5, gravity=tc.Gravity()))
    nodes = model.structure.nodes
    return model, model.state(nodes, np.cross([0.5, 0.3, 1.0], nodes - nodes.mean(axis=0)))


def rows(damping: float, quick: bool = False) -> list[Row]:
    """All schemes (`quick`: two, in the virtual machine), each as cheap as it meets 1e-6 m; the runs of one alternate with those of the others."""
    model, start = stiff_prism(damping)
    options: dict[str, Any] = {
        "state": start,
        "save_every": 10**9,
        "energy_balance": False,
        "compiled": False if quick else None,
    }
    explicit = [
        (scheme, tc.stable_step(model, start, scheme=scheme))
        for scheme in (tc.RungeKutta4(), tc.DormandPrince853())
    ]
    exact = tc.simulate(model, T_END, explicit[0][1] / 2, tc.RungeKutta4(), **options).nodes[-1]
    schemes: list[tuple[Any, float | None]] = [
        *explicit,
        (tc.DormandPrince54(1e-6), None),
        (tc.DormandPrince853(1e-6), None),
    ]
    schemes += [
        (tc.Collocation(2, tolerance=1e-8), T_END / 10),
        (tc.Collocation(3, tolerance=1e-8), T_END / 5),
        (tc.Cvodes(1e-8), T_END / 50),
    ]
    if quick:
        schemes = [schemes[0], schemes[4]]
    results: list[list[tc.Trajectory]] = [[] for _ in schemes]
    for _ in range(1 if quick else 5):
        for (scheme, step), done in zip(schemes, results, strict=True):
            done.append(tc.simulate(model, T_END, step, scheme, **options))
    table = []
    for (scheme, _), done in zip(schemes, results, strict=True):
        error = float(abs(done[0].nodes[-1] - exact).max())
        table.append(
            Row(str(scheme), round(T_END / done[0].step), error, min(run.seconds for run in done))
        )
    return table


def main(quick: bool = False) -> list[list[Row]]:
    """Prints both tables, without and with damping, and returns them; `quick`: two schemes, one run each."""
    tables = []
    for damping in (0.0, 1e3):
        print(
            f"strings of 1e7 N/m in five segments, damping {damping:g} N s/m: {T_END} s to 1e-6 m"
        )
        tables.append(rows(damping, quick))
        for row in tables[-1]:
            print(
                f"  {row.scheme:<70}{row.steps:>7} steps{row.error:>10.1e} m{1e3 * row.seconds:>9.2f} ms"
            )
    return tables


if __name__ == "__main__":
    main()

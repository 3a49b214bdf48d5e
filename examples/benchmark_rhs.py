"""Steps per second of RK4: compiled, in CasADi's virtual machine, and in NumPy."""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: small matrices gain nothing from threads

import time
from collections.abc import Callable
from statistics import median
from typing import Any, NamedTuple

import numpy as np

import tenscasadi as tc

STEP = 1e-4
STEPS = {"compiled": 200_000, "virtual machine": 20_000, "NumPy": 2_000}


class Row(NamedTuple):
    """Steps per second of one scene; None without a C compiler."""

    scene: str
    compiled: float | None
    virtual_machine: float
    numpy: float


def main(quick: bool = False) -> list[Row]:
    """Measure, print the table, and return its rows.

    With `quick`, it takes a tenth of the steps once instead of five times.
    """
    shapes = {
        "prism": tc.shapes.prism(stiffness=1000.0, prestress=30.0),
        "six-bar ball": tc.shapes.six_bar_ball(stiffness=1000.0, prestress=30.0),
    }
    drives: dict[str, Any] = {"force densities": tc.ForceDensity(), "elastic strings": None}
    rows = []
    print(
        f"{'RK4 steps per second':32}{'compiled':>12}{'virtual m.':>12}{'NumPy':>12}{'comp./NumPy':>13}{'v.m./NumPy':>12}"
    )
    for shape, structure in shapes.items():
        for drive, control in drives.items():
            row = measure(
                f"{shape}, {drive}", tc.Model(tc.Scene(structure, control=control)), quick
            )
            rows.append(row)
            ratio = "–" if row.compiled is None else f"{row.compiled / row.numpy:.0f}"
            speed = "no compiler" if row.compiled is None else f"{row.compiled:,.0f}"
            print(
                f"{row.scene:32}{speed:>12}{row.virtual_machine:>12,.0f}{row.numpy:>12,.0f}{ratio:>13}{row.virtual_machine / row.numpy:>12.0f}"
            )
    return rows


def measure(scene: str, model: tc.Model, quick: bool) -> Row:
    """Measure the median times of alternating runs of all variants."""
    start = model.state(
        model.structure.nodes,
        0.1 * np.random.default_rng(0).normal(size=model.structure.nodes.shape),
    )
    start = tc.simulate(
        model, STEP, STEP, state=start, correction=tc.Projection(), compiled=False
    ).states[-1]  # no bar is stretched
    rhs = numpy_rhs(model)
    theirs, ours = rhs(start), model.ode(start, model.initial_control).full().ravel()
    if not np.allclose(theirs, ours, rtol=1e-10, atol=1e-10 * np.abs(ours).max()):
        raise RuntimeError(f"{scene}: the NumPy port is off by {np.abs(theirs - ours).max():g}")

    def ours_seconds(compiled: bool | None, steps: int) -> float:
        run = tc.simulate(
            model,
            steps * STEP,
            STEP,
            state=start,
            compiled=compiled,
            energy_balance=False,
            save_every=1000,
        )
        return run.seconds if compiled is False or run.compiled else np.nan

    def numpy_seconds(steps: int) -> float:
        began = time.perf_counter()
        numpy_rk4(rhs, start, STEP, steps)
        return time.perf_counter() - began

    count = {name: steps // 10 if quick else steps for name, steps in STEPS.items()}
    speeds: dict[str, list[float]] = {name: [] for name in count}
    for _ in range(1 if quick else 5):
        speeds["compiled"].append(count["compiled"] / ours_seconds(None, count["compiled"]))
        speeds["virtual machine"].append(
            count["virtual machine"] / ours_seconds(False, count["virtual machine"])
        )
        speeds["NumPy"].append(count["NumPy"] / numpy_seconds(count["NumPy"]))
    compiled, virtual, plain = (median(values) for values in speeds.values())
    return Row(scene, None if np.isnan(compiled) else compiled, virtual, plain)


def numpy_rhs(model: tc.Model) -> Callable[[np.ndarray], np.ndarray]:
    """Build ẋ of an unsupported class-1 structure in NumPy (Eqs. 46, 94-99)."""
    s = model.structure
    n = len(s.nodes)
    C_b, C_s = s.C_b, s.C_s
    inverse_mass = np.linalg.inv(s.mass_matrix().toarray())
    bars_to_nodes = inverse_mass @ C_b.T
    strings_to_nodes = -inverse_mass @ C_s.T
    G = np.diag(C_b @ bars_to_nodes)
    gamma = model.initial_control[:, None]
    k, rest = s.stiffness, s.rest_length
    elastic = model.nu == 0

    def rhs(x: np.ndarray) -> np.ndarray:
        N, V = x[: 3 * n].reshape(n, 3), x[3 * n :].reshape(n, 3)
        S, B, Bd = C_s @ N, C_b @ N, C_b @ V
        density = (
            np.maximum(k * (1 - rest / np.sqrt((S * S).sum(1))), 0)[:, None] if elastic else gamma
        )
        A = strings_to_nodes @ (density * S)
        lam = -((Bd * Bd).sum(1) + (B * (C_b @ A)).sum(1)) / (G * (B * B).sum(1))
        return np.concatenate([x[3 * n :], (A + bars_to_nodes @ (lam[:, None] * B)).ravel()])

    return rhs


def numpy_rk4(
    rhs: Callable[[np.ndarray], np.ndarray], x: np.ndarray, h: float, steps: int
) -> np.ndarray:
    """Take `steps` steps of the classical Runge-Kutta method."""
    for _ in range(steps):
        k1 = rhs(x)
        k2 = rhs(x + 0.5 * h * k1)
        k3 = rhs(x + 0.5 * h * k2)
        k4 = rhs(x + h * k3)
        x = x + h / 6 * (k1 + 2 * (k2 + k3) + k4)
    return x


if __name__ == "__main__":
    main()

"""Thousands of motions at once: steps per second of rollouts, against one motion at a time, MuJoCo's rollouts, and one model for each stiffness.

The six-bar ball with elastic strings, classical Runge-Kutta steps of 1 ms, each motion from a start
of its own. Each line is a median of ratios measured by turns in one process; whole calls are
clocked, with the checks of every motion that they make. One thread is clocked in seconds of the
processor, which other work on the machine does not lengthen; several threads in seconds of the
wall.

MuJoCo reads what `tenscasadi.export_mjcf` writes: each bar a free body and each string a tendon
that pulls beyond its rest length; `mujoco.rollout` returns the state after each step, which it
cannot leave out. On the ground two things differ: here nodes are points that a penalty with Coulomb
friction holds (no equations to solve), there small spheres on which a solver of soft constraints
acts with the same stiffness.

MuJoCo is optional: pip install 'tenscasadi[peers]'
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: small matrices gain nothing from threads

import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import tenscasadi as tc
from tenscasadi.simulation.engine.build import build_kernel

STEP, STEPS = 1e-3, 1000
HEIGHT = 0.01  # m, of the lowest node above the ground


class Row(NamedTuple):
    """Name of a comparison, steps per second of both, and the median of their ratio."""

    name: str
    ours: float
    other: float
    ratio: float


def main(quick: bool = False) -> list[Row]:
    """Measure, print the table, and return its rows. With `quick`, few runs."""
    n, repeats = (64, 1) if quick else (4096, 3)
    structure = tc.shapes.six_bar_ball(stiffness=1000.0, prestress=50.0)
    structure = structure.replace(
        nodes=structure.nodes + [0.0, 0.0, HEIGHT - structure.nodes[:, 2].min()]
    )
    flying = tc.Model(tc.Scene(structure))
    starts = throw(flying, n)
    print(f"{'':<62} {'steps/s':>11}  {'the other':>10}  ratio")
    rows = []
    for correction in (None,) if quick else (None, tc.Projection()):
        rows += against_simulate(flying, starts, correction, repeats, quick)
    rows.append(against_double(flying, starts, "in flight", repeats))
    if (os.cpu_count() or 1) > 1:
        name = "two threads, against one"
        rows.append(
            compare(
                name,
                roll(flying, starts, threads=2),
                n * STEPS,
                roll(flying, starts, threads=1),
                n * STEPS,
                repeats,
                time.perf_counter,
            )
        )
    rows += against_mujoco(structure, n, repeats, quick)
    rows.append(stiffnesses(structure, 20 if quick else 1000, 1 if quick else 3))
    return rows


def throw(model: tc.Model, n: int) -> np.ndarray:
    """Draw states (n, nx) with random velocities that satisfy the bars."""
    rng = np.random.default_rng(0)
    nodes = model.structure.nodes
    rough = np.array([model.state(nodes, rng.normal(0.0, 0.1, nodes.shape)) for _ in range(n)])
    return np.ascontiguousarray(tc.build_projection(model).map(n)(rough.T).full().T)


def roll(model: tc.Model, starts: np.ndarray, **options: Any) -> Callable[[], Any]:
    """Build a call of `rollouts` that checks the success of all runs."""

    def run() -> None:
        assert tc.rollouts(model, STEPS * STEP, STEP, starts, **options).success.all()

    return run


def compare(
    name: str,
    ours: Any,
    steps: int,
    other: Any,
    other_steps: int,
    repeats: int,
    clock: Callable[[], float] = time.process_time,
) -> Row:
    """Measure two programs alternately, after a first call that compiles."""
    ours(), other()
    rates = []
    for _ in range(repeats):
        times = [clock()]
        for run in (ours, other):
            run()
            times.append(clock())
        rates.append((steps / (times[1] - times[0]), other_steps / (times[2] - times[1])))
    row = Row(
        name,
        median(a for a, _ in rates),
        median(b for _, b in rates),
        median(a / b for a, b in rates),
    )
    print(f"{row.name:<62} {row.ours:>11,.0f}  {row.other:>10,.0f}  {row.ratio:.1f}", flush=True)
    return row


def against_simulate(
    model: tc.Model, starts: np.ndarray, correction: tc.Projection | None, repeats: int, quick: bool
) -> list[Row]:
    """Compare `rollouts` in one thread with `simulate`, for several lane numbers."""
    n, count = len(starts), 2_000 if quick else 50_000
    with_it = ", with Projection" if correction else ""

    def one() -> None:
        tc.simulate(model, count * STEP, STEP, state=starts[0], correction=correction)

    once = tc.rollouts(model, STEPS * STEP, STEP, starts, correction=correction)
    name = f"rollouts, {once.lanes} lanes{with_it}, against simulate"
    rows = [
        compare(
            name,
            roll(model, starts, correction=correction, threads=1),
            n * STEPS,
            one,
            count,
            repeats,
        )
    ]
    for lanes in () if quick else (4,) if correction else (4, 2):
        if lanes < once.lanes:
            kernel, held = (
                build_kernel(model, tc.RungeKutta4(), correction, measured=True, lanes=lanes),
                np.zeros((1, 1, model.nw)),
            )
            run = partial(kernel, starts, held, STEP, STEPS)
            rows.append(
                compare(f"its kernel, {lanes} lanes{with_it}", run, n * STEPS, one, count, repeats)
            )
    return rows


def against_double(model: tc.Model, starts: np.ndarray, place: str, repeats: int) -> Row:
    """Compare single with double precision in one thread."""
    steps = len(starts) * STEPS
    single, double = (roll(model, starts, threads=1, compiled=how) for how in (tc.Single(), None))
    name = f"rollouts in single precision {place}, against double"
    return compare(name, single, steps, double, steps, repeats)


def against_mujoco(s: tc.Structure, n: int, repeats: int, quick: bool) -> list[Row]:
    """Compare one thread with `mujoco.rollout`, in flight and on the ground."""
    try:
        mujoco, rollout = import_module("mujoco"), import_module("mujoco.rollout")
    except ImportError:
        print("MuJoCo is not installed and left out: pip install 'tenscasadi[peers]'\n")
        return []
    count, steps = (8, 10) if quick else (64, 200)
    ground = tc.Scene(
        s,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=1e4, damping=30.0, friction=0.6, slip_speed=0.05),
    )
    rows = []
    for scene, place in ((tc.Scene(s), "in flight"), (ground, "on the ground")):
        model = tc.Model(scene)
        starts = throw(model, n)
        ours = roll(model, starts, threads=1)
        if scene.ground is not None:
            rows.append(against_double(model, starts, place, repeats))
        for integrator in ("RK4",) if quick else ("RK4", "Euler"):
            theirs = mujoco_model(mujoco, scene, integrator)
            data = mujoco.MjData(theirs)
            kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
            state = np.zeros(mujoco.mj_stateSize(theirs, kind))
            mujoco.mj_getState(theirs, data, state, kind)
            states = np.tile(state, (count, 1))
            other = partial(rollout.rollout, theirs, [data], states, nstep=steps)
            rows.append(
                compare(
                    f"rollouts {place}, against mujoco.rollout {integrator}",
                    ours,
                    n * STEPS,
                    other,
                    count * steps,
                    repeats,
                )
            )
    return rows


def mujoco_model(mujoco: Any, scene: tc.Scene, integrator: str) -> Any:
    """Convert a scene to a MuJoCo model."""
    with TemporaryDirectory() as folder:
        model = mujoco.MjModel.from_xml_path(
            str(tc.export_mjcf(scene, Path(folder) / "scene.xml", step=STEP))
        )
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    return model


def stiffnesses(structure: tc.Structure, values: int, models: int) -> Row:
    """Compare runs of many stiffness values by one parameter and by separate models."""
    scales = np.linspace(0.5, 2.0, values)[:, None]

    def clocked(run: Callable[[], Any]) -> float:
        began = time.perf_counter()
        run()
        return time.perf_counter() - began

    model = tc.Model(tc.Scene(structure, parameters=tc.Parameters(scale=["stiffness"])))
    first, again = (
        clocked(partial(tc.rollouts, model, 0.1, STEP, parameters=factor * scales))
        for factor in (1.0, 1.01)
    )

    def build() -> None:
        for scale in np.random.default_rng().uniform(
            0.5, 2.0, models
        ):  # values that no cache has seen
            tc.simulate(
                tc.Model(tc.Scene(structure.replace(stiffness=structure.stiffness * scale))),
                0.1,
                STEP,
            )

    each = clocked(build) / models
    print(
        f"\n{values} values of stiffness, 0.1 s each: {first:.2f} s as a parameter ({again:.3f} s for other values: nothing is compiled again), "
        f"{each * values:,.0f} s as {values} models ({each:.2f} s each, from {models} of them)"
    )
    return Row(
        "values of stiffness per second, a parameter against models",
        values / again,
        1 / each,
        values / again * each,
    )


if __name__ == "__main__":
    main()

"""The same motion by tenscasadi, MuJoCo and SciPy: seconds per simulated second over the error, each swept over its own step or tolerance.

A free prism and a free six-bar ball with elastic strings, prestressed, turning at 3.7 rad/s, no
gravity, one second. MuJoCo reads what `tenscasadi.export_mjcf` writes: each bar a free body and
each string a tendon that pulls beyond its rest length; contacts and constraints are switched off.
Two things differ and do not change the motion: its bars have an inertia about their own axis, about
which they do not turn, and quaternions in place of ends.
SciPy integrates the right-hand side as one writes it in NumPy. All are measured against the same
reference solution, in whole runs: nothing is extrapolated. Three columns of seconds: the stepping
alone; the whole call from a prepared model to the end of the run; and once, before the first run,
the set-up: for tenscasadi building the equations, generating C and compiling it with an empty
cache, for MuJoCo reading its XML.

Run it with a folder for the picture: python examples/benchmark_peers.py pictures
MuJoCo is optional: pip install 'tenscasadi[peers]'
"""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: small matrices gain nothing from threads

import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

import tenscasadi as tc
from tenscasadi.analysis.reference_solution import distance
from tenscasadi.plots.diagrams import work_precision

T_END = 1.0
TURNING = np.array([1.0, 2.0, 3.0])  # rad/s
TOLERANCES = (1e-3, 1e-6, 1e-9)  # m
_WORST = 0.1  # m: what is further off is not drawn


class Point(NamedTuple):
    """Error [m] and cost of one run.

    The costs are seconds per simulated second of the stepping alone and of the whole call, and
    steps per second, NaN for variable steps.
    """

    error: float
    seconds: float
    whole: float
    rate: float


class Result(NamedTuple):
    """Results of one structure.

    They are the error of the reference [m], the points of each program and method, and the set-up
    times.
    """

    shape: str
    reference_error: float
    curves: dict[str, list[Point]]
    setup: dict[str, float]

    def cheapest(self, program: str, tolerance: float, whole: bool = False) -> tuple[float, str]:
        """Find the fastest method of a program within a tolerance.

        Returns seconds per simulated second and its name; inf if there is none.
        """
        within = [
            (point.whole if whole else point.seconds, name)
            for name, points in self.curves.items()
            for point in points
            if name.startswith(program) and point.error + self.reference_error <= tolerance
        ]
        return min(within, default=(np.inf, "none"))

    def rate(self, name: str) -> float:
        """Compute the median steps per second of a fixed-step method, NaN if not run."""
        return (
            float(median([point.rate for point in self.curves[name]]))
            if name in self.curves
            else np.nan
        )


def main(folder: Path = Path(), quick: bool = False) -> list[Result]:
    """Measure, print the tables, save pictures, and return the results.

    With `quick`, only the prism is simulated, with few steps.
    """
    folder.mkdir(parents=True, exist_ok=True)
    try:
        mujoco: Any = import_module("mujoco")
        mujoco.set_mju_user_warning(lambda _: None)  # of steps that are too long, into a file
    except ImportError:
        mujoco = None
        print("MuJoCo is not installed and left out: pip install 'tenscasadi[peers]'\n")
    shapes = {
        "prism": tc.shapes.prism(prestress=50.0, stiffness=1000.0),
        "six-bar ball": tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0),
    }
    results = []
    for shape, structure in list(shapes.items())[: 1 if quick else 2]:
        result = measure(shape, structure, mujoco, quick)
        results.append(result)
        report(result)
        curves = {
            name: [point[:2] for point in points if point.error < _WORST]
            for name, points in result.curves.items()
        }
        picture = folder / f"benchmark_peers_{shape.replace(' ', '_').replace('-', '_')}.png"
        work_precision(
            curves,
            reference_error=result.reference_error,
            title=f"{shape}, elastic strings, 1 s",
            path=picture,
        )
    return results


def measure(shape: str, s: tc.Structure, mujoco: Any, quick: bool) -> Result:
    """Simulate one structure by all programs with several steps or tolerances."""
    model = tc.Model(tc.Scene(s))
    velocities = np.cross(TURNING, s.nodes)
    start = model.state(s.nodes, velocities)
    reference = tc.reference_solution(model, T_END, start)
    repeats = 1 if quick else 5
    counts = np.unique(
        np.geomspace(100 if quick else 40, 4000, 4 if quick else 16).astype(int)
    ).tolist()

    curves: dict[str, list[Point]] = {}
    setup: dict[str, float] = {}
    schemes: tuple[Any, ...] = (
        tc.RungeKutta4(),
        tc.DormandPrince853(),
        tc.DormandPrince54(),
        tc.Rattle(),
    )[: 2 if quick else 4]
    for scheme in schemes:
        for correction in (None, tc.Projection())[
            : 1 if quick or scheme == tc.Rattle() else 2
        ]:  # Rattle keeps bars by itself
            name = f"tenscasadi {type(scheme).__name__}" + (
                "" if correction is None else ", Projection"
            )
            setup[name] = our_setup(s, start, scheme, correction)
            points = [
                our_run(model, start, scheme, correction, count, reference.nodes, repeats)
                for count in counts
            ]
            curves[name] = [point for point in points if np.isfinite(point.error)]
    if mujoco is not None:
        for integrator in ("RK4", "Euler", "implicitfast"):
            points = [
                mujoco_run(mujoco, s, integrator, count, reference.nodes, repeats)
                for count in counts
            ]
            curves[f"MuJoCo {integrator}"] = [point for point in points if np.isfinite(point.error)]
            setup[f"MuJoCo {integrator}"] = clock(
                lambda: mujoco.MjData(mujoco.MjModel.from_xml_string(mujoco_scene(s, 1e-3)))
            )
    for method in ("DOP853", "RK45"):
        tolerances = np.geomspace(1e-3, 1e-12, 4 if quick else 19)
        curves[f"SciPy {method}"] = [
            scipy_run(s, start, method, float(rtol), reference.nodes, repeats)
            for rtol in tolerances
        ]
        setup[f"SciPy {method}"] = clock(lambda: numpy_rhs(s))
    return Result(shape, reference.error, curves, setup)


def report(result: Result) -> None:
    """Print the times of all methods for several accuracies.

    They are those of stepping, of the whole call, and of the set-up of the method that steps
    fastest.
    """
    programs = [
        name
        for name in ("tenscasadi", "MuJoCo", "SciPy")
        if any(curve.startswith(name) for curve in result.curves)
    ]
    print(
        f"{result.shape}: seconds per simulated second of the fastest within a tolerance; reference error {result.reference_error:.1g} m"
    )
    print(
        f"{'m':>6}  {'':<12}{'stepping':>10}{'whole call':>12}{'set-up, once':>14}  times ours: stepping, whole call"
    )
    for tolerance in TOLERANCES:
        ours = [result.cheapest("tenscasadi", tolerance, whole)[0] for whole in (False, True)]
        for program in programs:
            seconds, name = result.cheapest(program, tolerance)
            whole = result.cheapest(program, tolerance, True)[0]
            setup = result.setup.get(name, np.nan)
            times = (
                ""
                if program == "tenscasadi"
                else f"  {seconds / ours[0]:.0f}, {whole / ours[1]:.2g}"
            )
            print(
                f"{tolerance:6.0e}  {program:<12}{seconds:>10.2g}{whole:>12.2g}{setup:>14.2g}{times:<14} {name.removeprefix(program + ' ')}"
            )
    ours_rk4, theirs = result.rate("tenscasadi RungeKutta4"), result.rate("MuJoCo RK4")
    compared = (
        "" if np.isnan(theirs) else f", MuJoCo's {theirs:,.0f}: {ours_rk4 / theirs:.0f} times"
    )
    print(f"steps of RK4 per second: {ours_rk4:,.0f}{compared}\n")


def clock(call: Callable[[], object]) -> float:
    """Measure the wall time of a call [s]."""
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def our_setup(s: tc.Structure, start: np.ndarray, scheme: Any, correction: Any) -> float:
    """Measure the time to build and compile a model with an empty cache [s]."""
    before = os.environ.get("TENSCASADI_CACHE")
    with TemporaryDirectory() as empty:
        os.environ["TENSCASADI_CACHE"] = empty
        try:
            return clock(
                lambda: tc.simulate(
                    tc.Model(tc.Scene(s)),
                    1e-3,
                    1e-3,
                    scheme,
                    state=start,
                    correction=correction,
                    energy_balance=False,
                )
            )
        finally:
            os.environ.pop("TENSCASADI_CACHE")
            if before is not None:
                os.environ["TENSCASADI_CACHE"] = before


def our_run(
    model: tc.Model,
    start: np.ndarray,
    scheme: Any,
    correction: Any,
    count: int,
    reference: np.ndarray,
    repeats: int,
) -> Point:
    """Simulate `count` equal steps by tenscasadi in one call."""
    runs = []
    for _ in range(repeats + 1):  # the first one may compile
        began = time.perf_counter()
        run = tc.simulate(
            model,
            T_END,
            T_END / count,
            scheme,
            state=start,
            correction=correction,
            save_every=count,
            energy_balance=False,
        )
        runs.append((time.perf_counter() - began, run.seconds))
    whole, seconds = (median(values) for values in zip(*runs[1:], strict=True))
    return Point(
        distance(run.nodes[-1], reference) if run.success else np.inf,
        seconds / T_END,
        whole / T_END,
        count / seconds,
    )


def mujoco_run(
    mujoco: Any, s: tc.Structure, integrator: str, count: int, reference: np.ndarray, repeats: int
) -> Point:
    """Simulate `count` equal steps by MuJoCo in one call."""
    model = mujoco.MjModel.from_xml_string(mujoco_scene(s, T_END / count))
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data = mujoco.MjData(model)

    def run() -> tuple[float, float]:
        called = time.perf_counter()
        mujoco.mj_resetDataKeyframe(model, data, 0)
        began = time.perf_counter()
        mujoco.mj_step(model, data, count)
        ended = time.perf_counter()
        return ended - called, ended - began

    runs = [run() for _ in range(repeats)]
    whole, seconds = (median(values) for values in zip(*runs, strict=True))
    mujoco.mj_kinematics(model, data)
    nodes = np.array([data.site(f"n{node}").xpos for node in range(len(s.nodes))])
    lost = data.time < 0.99 * T_END  # MuJoCo starts again where it diverges
    return Point(
        np.inf if lost else distance(nodes, reference),
        seconds / T_END,
        whole / T_END,
        count / seconds,
    )


def mujoco_scene(s: tc.Structure, step: float) -> str:
    """Write the structure as MuJoCo's XML, with its initial rotation."""
    with TemporaryDirectory() as folder:
        return tc.export_mjcf(
            tc.Scene(s), Path(folder) / "scene.xml", np.cross(TURNING, s.nodes), step=step
        ).read_text()


def scipy_run(
    s: tc.Structure,
    start: np.ndarray,
    method: str,
    rtol: float,
    reference: np.ndarray,
    repeats: int,
) -> Point:
    """Simulate with `solve_ivp` and a NumPy right-hand side."""
    rhs = numpy_rhs(s)

    def run() -> tuple[float, Any]:
        began = time.perf_counter()
        solution = solve_ivp(
            rhs, (0.0, T_END), start, method=method, rtol=max(rtol, 3e-14), atol=rtol
        )
        return time.perf_counter() - began, solution

    runs = [run() for _ in range(repeats)]
    nodes = runs[0][1].y[: len(start) // 2, -1].reshape(-1, 3)
    seconds = median(seconds for seconds, _ in runs) / T_END
    return Point(distance(nodes, reference), seconds, seconds, np.nan)


def numpy_rhs(s: tc.Structure) -> Callable[[float, np.ndarray], np.ndarray]:
    """Build ẋ of an unsupported structure of class 1 in NumPy."""
    C_b, C_s, k, rest = s.C_b, s.C_s, s.stiffness, s.rest_length
    inverse_mass = np.linalg.inv(s.mass_matrix().toarray())
    pull, push = -inverse_mass @ C_s.T, inverse_mass @ C_b.T
    G = np.diag(C_b @ push)

    def rhs(_: float, x: np.ndarray) -> np.ndarray:
        N, V = x.reshape(2, -1, 3)
        S, B, Bd = C_s @ N, C_b @ N, C_b @ V
        gamma = np.maximum(k * (1 - rest / np.sqrt((S * S).sum(1))), 0.0)
        A = pull @ (gamma[:, None] * S)
        lam = -((Bd * Bd).sum(1) + (B * (C_b @ A)).sum(1)) / (G * (B * B).sum(1))
        return np.concatenate([V.ravel(), (A + push @ (lam[:, None] * B)).ravel()])

    return rhs


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path())

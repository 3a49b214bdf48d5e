"""Odd input to every public name: a TypeError, a ValueError or an exception of the packages that names a field, or a result without NaN."""

# ruff: noqa: E501

from __future__ import annotations

import inspect
import os
import re
import warnings
from collections.abc import Callable
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import ocp
import tenscasadi as tc

OWN = (TypeError, ValueError, tc.CompileError, tc.EquilibriumError, tc.NoReference, tc.NoScheme, ocp.UnreachableGoal)
NUMBER_OF_CALLS = int(os.environ.get("TENSCASADI_FUZZ", "20000"))  # of the slow run


class Broken:
    """NumPy cannot read it."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("broken")

    def __repr__(self) -> str:
        return "Broken()"


def raising(*_: Any) -> Any:
    """Raise in place of what a user's function should return."""
    raise KeyError("lost")


ODD: list[Any] = [
    float("nan"), float("inf"), -float("inf"), -1, 0, 0.0, 1e-320, 1e200, 10**400, -(10**400), 10**9 + 0.5, True, None, "x", "", b"x", 1j, 1 + 0j,
    np.complex128(2), np.array(3), np.array(3.0), np.array([]), np.zeros((0, 3)), np.zeros((2, 2, 2)), np.array([1 + 1j]), np.array(["a"]),
    np.array([None]), np.array([np.nan, 1.0]), np.float32("nan"), np.int64(-3), np.datetime64("2020-01-01"), np.ma.masked,
    np.ma.array([1.0, 2.0], mask=[True, False]), np.ma.array([[1.0, 2.0, 3.0]], mask=[[False, True, False]]), np.ma.array(1.0, mask=True),
    sp.csr_array(np.eye(3)), sp.coo_matrix(np.eye(2)), ca.SX.sym("x"), ca.MX.sym("x", 3), ca.DM(2), ca.DM.eye(3), ca.DM(3, 3), ca.DM(float("nan")),
    Broken(), [Broken()], object, object(), len, raising, lambda t: float("nan"), lambda *a: "x", Decimal("NaN"), Decimal(1), (), [], {}, set(), [[]],
    [1, [2]], {"a": 1}, {0: "x"}, {-1: 0.0}, {10**400: 1}, [float("nan")] * 3, (None, None, None), [0, 0], [(0, 1)], range(3), slice(None), Ellipsis,
    NotImplemented, iter([1, 2]), "x" * 300, "\0", Path("/nonexistent/x"), memoryview(b"ab"), tc.RungeKutta4(), tc.Projection(), tc.RungeKutta4,
]  # fmt: skip


def altered(draw: Callable[[Any], Any], value: Any) -> Any:
    """An odd value in place of `value`, or of one of its entries, or the value in another container."""
    odd = ODD[draw(st.integers(0, len(ODD) - 1))]
    way = draw(st.integers(0, 5))
    if isinstance(value, (tuple, list)) and value and way < 3:
        k = draw(st.integers(0, len(value) - 1))
        changed = [*value[:k], *([altered(draw, value[k])] if way else []), *value[k + 1 :]]
        return changed if isinstance(value, list) else tuple(changed)
    if isinstance(value, dict) and value and way < 3:
        key = draw(st.sampled_from(list(value)))
        try:
            return {odd: value[key]} if way == 0 else {**value, key: altered(draw, value[key])}
        except Exception:  # noqa: BLE001  each kind of object refuses to be a key in its own way
            return odd
    if isinstance(value, np.ndarray) and value.size and way < 4:
        entries = np.array(value, dtype=float)
        place = np.unravel_index(draw(st.integers(0, value.size - 1)), value.shape)
        if way == 0:
            entries[place] = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e200, 1e-320]))
            return entries
        if way == 1:
            hidden = np.ma.array(entries, mask=np.zeros(value.shape, dtype=bool))
            hidden[place] = np.ma.masked
            return hidden
        return draw(
            st.sampled_from(
                [entries.T, entries[..., :-1], entries[None], entries * 1j, entries.astype(str), entries.astype(object), sp.coo_array(entries)]
            )
        )
    return odd


@cache
def model() -> tc.Model:
    structure = tc.shapes.prism(3, stiffness=1000.0, prestress=30.0)
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity()))


@cache
def timed() -> tc.Model:
    structure = tc.shapes.pendulum()
    start = structure.nodes[0]
    return tc.Model(tc.Scene(structure, gravity=tc.Gravity(), supports=tc.SupportMotion({0: lambda t: [start[0] + t**2, start[1], start[2]]})))


@cache
def problem(**changes: Any) -> ocp.Problem:
    taller = tc.shapes.prism(3, height=1.05)
    goals = [ocp.StringLengths(taller.string_lengths), ocp.AtRest()]
    return ocp.Problem(model(), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)], costs=[ocp.Effort()])


@cache
def plan() -> ocp.Plan:
    found = ocp.solve(problem(), ocp.MultipleShooting(6))
    assert found.success
    return found


@cache
def trajectory() -> tc.Trajectory:
    return tc.simulate(model(), 0.05, 0.01, compiled=False)


@cache
def mpc() -> ocp.Mpc:
    return ocp.Mpc(problem(), 0.05, 4)


@cache
def tracker() -> ocp.Tracker:
    return ocp.track(plan())


NODES = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
SEGMENTED = tc.Structure(NODES, [(0, 1), (2, 3)], [(0, 2), (1, 3)], string_mass=1.0)
MEMBERS = {"nodes": NODES, "bars": [(0, 1), (2, 3)], "strings": [(0, 2), (1, 3)]}
MATRICES = {"N": NODES.T, "C_b": np.array([[-1.0, 1, 0, 0], [0, 0, -1, 1]]), "C_s": np.array([[-1.0, 0, 1, 0], [0, -1, 0, 1]])}
STRING_VALUES = {"stiffness": 100.0, "damping": np.array([0.1, 0.2]), "rest_length": np.array([1.0, 1.0]), "string_mass": 0.1}

Call = tuple[Callable[..., Any], dict[str, Any]]


@cache
def cases() -> dict[str, Call]:
    """Each public name with input that is right."""
    m = model()
    x, u, n = m.initial_state, m.initial_control, len(m.structure.nodes)
    pair = {"model": m, "x": x, "u": u}
    run = {"model": m, "t_end": 0.02, "step": 0.01, "scheme": tc.RungeKutta4(), "state": x, "control": u, "correction": tc.Projection(),
           "save_every": 1, "compiled": False}  # fmt: skip
    weight = {"weight": 1.0}
    mesh = {"intervals": 5, "control": ocp.PiecewiseConstant(), "accuracy": None}
    scene = {"structure": SEGMENTED, "control": tc.ForceDensity(), "segments": [2, 2], "gravity": tc.Gravity(), "ground": tc.Ground(10.0, 1.0),
             "pressure": tc.Pressure([(0, 1, 2)], 5.0), "forces": tc.NodalForce(np.ones((4, 3))), "slack": tc.Smooth(0.01)}  # fmt: skip
    found: dict[str, Call] = {
        "Structure": (tc.Structure, MEMBERS | STRING_VALUES | {"bar_mass": 1.0, "bar_radius": np.array([0.0, 0.01]), "node_mass": np.zeros(4), "pinned": {0: "xyz"}}),
        "Structure.from_matrices": (tc.Structure.from_matrices, MATRICES | {"P": np.array([[0.0], [1], [0], [0]]), "D": np.array([[1.0], [0], [0]]), "node_mass": np.zeros(4)}),
        "Structure.class_one": (SEGMENTED.class_one, {"sparse": True}),
        "Structure.replace": (SEGMENTED.replace, {"nodes": NODES, "bar_mass": 2.0, "pinned": (0,)}),
        "Structure.prestressed": (SEGMENTED.prestressed, {"force_density": np.array([1.0, 2.0])}),
        "Structure.subdivide": (SEGMENTED.subdivide, {"segments": [2, 2], "ends": "lumped", "fractions": np.array([0.5, 0.5])}),
        "Structure.parent_mean": (SEGMENTED.parent_mean, {"values": np.array([1.0, 2.0])}),
        "equilibrium_force_density": (tc.equilibrium_force_density, {"structure": SEGMENTED, "loads": np.zeros((4, 3)), "minimum": np.zeros(2)}),
        "self_stress": (tc.self_stress, {"structure": SEGMENTED}),
        "Scene": (tc.Scene, scene),
        "Smooth": (tc.Smooth, {"width": 0.01}),
        "Gravity": (tc.Gravity, {"acceleration": (0.0, 0.0, -9.81)}),
        "Ground": (tc.Ground, {"stiffness": 10.0, "damping": 1.0, "friction": 0.4, "height": 0.0}),
        "Pressure": (tc.Pressure, {"faces": [(0, 1, 2)], "difference": 5.0}),
        "NodalForce": (tc.NodalForce, {"values": np.ones((2, 4, 3)), "times": np.array([0.0, 1.0])}),
        "SupportMotion": (lambda motion: tc.Model(tc.Scene(tc.shapes.pendulum(), supports=tc.SupportMotion(motion))), {"motion": {0: lambda t: [0.0, 0.0, t]}}),
        "Model": (tc.Model, {"scene": m.scene, "coordinates": "full", "bar_length": "current"}),
        "Model.state": (m.state, {"nodes": m.structure.nodes, "velocities": np.zeros((n, 3))}),
        "Model.nodes": (m.nodes, {"x": np.array([x, x])}),
        "Model.velocities": (timed().velocities, {"x": timed().initial_state}),
        "Model.constraints": (m.constraints, {"x": x}),
        "linearize": (tc.linearize, {"model": m, "x": x, "u": u}),
        "modes": (tc.modes, pair),
        "projection": (tc.projection, {"model": m, "iterations": 2}),
        "stable_step": (tc.stable_step, pair | {"scheme": tc.RungeKutta4(), "safety": 0.9}),
        "simulate": (tc.simulate, run),
        "simulate, moved support": (tc.simulate, {**run, "model": timed(), "state": timed().initial_state, "control": None}),
        "DormandPrince54": (tc.DormandPrince54, {"rtol": 1e-6, "atol": 1e-6, "max_attempts": 10}),
        "DormandPrince853": (tc.DormandPrince853, {"rtol": 1e-6, "atol": 1e-6, "max_attempts": 10}),
        "Rattle": (tc.Rattle, {"order": 2, "iterations": 6}),
        "Collocation": (tc.Collocation, {"degree": 2, "points": "gauss", "tolerance": 1e-10, "iterations": 5}),
        "Cvodes": (tc.Cvodes, {"rtol": 1e-6, "atol": 1e-6, "max_steps": 10}),
        "Idas": (tc.Idas, {"rtol": 1e-6, "atol": 1e-6, "max_steps": 10}),
        "Projection": (tc.Projection, {"every": 1, "iterations": 3}),
        "BarLengthCorrection": (tc.BarLengthCorrection, {"weight": 1.0, "every": 1}),
        "export_c": (tc.export_c, {"model": m, "folder": "c", "scheme": tc.RungeKutta4()}),
        "certify": (tc.certify, {"model": timed(), "t_end": 0.01, "state": timed().initial_state, "control": None, "accuracy": 1e-3, "enough": None, "compiled": False, "work": 1e6}),
        "recommend": (tc.recommend, {"what": timed(), "t_end": 0.01, "tolerance": 1e-2, "state": timed().initial_state, "control": None, "schemes": (tc.RungeKutta4(),), "corrections": (None,), "compiled": False}),
        "tradeoff": (tc.tradeoff, {"models": timed(), "t_end": 0.01, "schemes": (tc.RungeKutta4(),), "steps": (0.01,), "reference": None, "state": None, "control": None, "corrections": (None,), "compiled": (False,), "repeats": 1, "progress": False}),
        "Problem": (ocp.Problem, {"model": m, "duration": (0.5, 1.0), "start": x, "goals": [ocp.AtRest()], "bounds": [ocp.ForceDensityLimits(1.0, 100.0)], "costs": [ocp.Effort()]}),
        "FreeStart": (ocp.FreeStart, {"near": x, "goals": [ocp.AtRest()]}),
        "StringLengths": (bounded(ocp.StringLengths, goal=True), {"lengths": {0: 1.0, 1: 1.0}}),
        "NodePositions": (bounded(ocp.NodePositions, goal=True), {"positions": {0: (None, 0.0, 1.0)}}),
        "Shape": (bounded(ocp.Shape, goal=True), {"nodes": m.structure.nodes}),
        "Periodic": (bounded(ocp.Periodic, goal=True), {"shift": (0.0, None, 0.0), "start": (m.structure.nodes, np.zeros((n, 3)))}),
        "Waypoint": (bounded(ocp.Waypoint, goal=True), {"goals": [ocp.AtRest()], "time": 0.5, "share": None}),
        "ForceDensityLimits": (bounded(ocp.ForceDensityLimits), {"lower": 1.0, "upper": np.full(9, 100.0)}),
        "TensionLimits": (bounded(ocp.TensionLimits), {"lower": 1.0, "upper": np.full(9, 100.0)}),
        "RestLengthLimits": (bounded(ocp.RestLengthLimits), {"lower": 0.1, "upper": 5.0, "stiffness": np.full(9, 1000.0)}),
        "RestLengthRateLimits": (bounded(ocp.RestLengthRateLimits), {"speed": np.full(9, 1.0), "stiffness": 1000.0}),
        "BarForceLimits": (bounded(ocp.BarForceLimits), {"compression": 100.0, "tension": np.full(3, 100.0)}),
        "Buckling": (bounded(lambda **k: ocp.Buckling(**k), structure=m.structure.replace(bar_radius=0.01)), {"modulus": np.full(3, 1e9), "safety": 2.0}),
        "InsideBox": (bounded(ocp.InsideBox), {"lower": (None, None, -1.0), "upper": (5.0, 5.0, 5.0), "nodes": [0, 1]}),
        "AboveGround": (bounded(ocp.AboveGround), {"height": -1.0, "nodes": [0, 1]}),
        "BarClearance": (bounded(ocp.BarClearance), {"distance": 0.01, "pairs": [(0, 1)]}),
        "Obstacle": (bounded(ocp.Obstacle), {"centre": (5.0, 5.0, 5.0), "radius": 0.5, "bars": [0], "nodes": [1]}),
        "Effort": (bounded(ocp.Effort, cost=True), weight),
        "Smoothness": (bounded(ocp.Smoothness, cost=True), weight),
        "Prestress": (bounded(ocp.Prestress, cost=True), {"level": np.full(9, 1.0), **weight}),
        "Tracking": (bounded(ocp.Tracking, cost=True), {"positions": {0: (0.0, 0.0, 0.0), 1: lambda t: (t, t, t)}, **weight}),
        "Duration": (bounded(ocp.Duration, cost=True), weight),
        "Work": (bounded(ocp.Work, cost=True), {**weight, "smoothing": 0.1}),
        "Constraint": (bounded(ocp.Constraint), {"name": "c", "expression": lambda now: now.nodes[2, 0], "lower": -9.0, "upper": 9.0}),
        "Integral": (bounded(ocp.Integral, cost=True), {"name": "c", "expression": lambda now: now.nodes[2, 0] ** 2, **weight}),
        "AtEnd": (bounded(ocp.AtEnd, cost=True), {"name": "c", "expression": lambda now: now.nodes[2, 0] ** 2, **weight}),
        "MultipleShooting": (ocp.MultipleShooting, mesh | {"scheme": tc.RungeKutta4(), "substeps": 1}),
        "ImplicitMidpoint": (ocp.ImplicitMidpoint, mesh),
        "Variational": (ocp.Variational, mesh),
        "ocp.Collocation": (ocp.Collocation, mesh | {"degree": 2}),
        "PiecewiseConstant": (ocp.PiecewiseConstant, {"groups": ((0, 1), (2, 3))}),
        "PiecewiseLinear": (ocp.PiecewiseLinear, {"groups": ((0, 1), (2, 3))}),
        "Ipopt": (ocp.Ipopt, {"max_iterations": 5, "tolerance": 1e-6, "verbose": False, "options": {"mu_init": 0.1}, "seconds": 1.0, "watch": None, "warm": False}),
        "Fatrop": (ocp.Fatrop, {"max_iterations": 5, "tolerance": 1e-6, "verbose": False, "options": {"mu_init": 0.1}}),
        "solve": (ocp.solve, {"problem": problem(), "transcription": ocp.MultipleShooting(3), "solver": ocp.Ipopt(max_iterations=3), "guess": ocp.InverseDynamics(), "tolerance": None}),
        "InverseDynamics": (ocp.InverseDynamics, {"path": np.array([m.structure.nodes] * 2)}),
        "Arrays": (ocp.Arrays, {"states": np.array([x] * 4), "force_density": np.array([u] * 3), "duration": 1.0}),
        "replay_wound": (ocp.replay_wound, {"plan": plan(), "stiffness": np.full(9, 1000.0), "damping": 0.0, "updates": 1}),
        "reachable": (ocp.reachable, {"plan": plan(), "stiffness": 1000.0, "shortest": np.full(9, 0.01)}),
        "Plan.rest_lengths": (plan().rest_lengths, {"stiffness": np.full(9, 1000.0)}),
        "Plan.replay": (plan().replay, {"scheme": tc.RungeKutta4(), "step": 0.05}),
        "Plan.tension": (plan().tension, {"end": True}),
        "Mpc": (ocp.Mpc, {"problem": problem(), "period": 0.05, "intervals": 3, "plan": plan(), "iterations": 1, "substeps": 1, "place": 1.0, "effort": 1.0}),
        "Mpc.control": (mpc().control, {"time": 0.0, "state": x}),
        "Tracker.control": (tracker().control, {"time": 0.0, "state": x}),
        "track": (ocp.track, {"plan": plan(), "decisions": 6, "place": 1.0, "effort": 1.0, "lower": 0.0, "upper": np.full(9, 200.0)}),
        "run": (ocp.run, {"controller": tracker(), "t_end": 0.05, "model": m, "state": x, "steps": 1, "disturbance": lambda t, x: x}),
        "export_program": (ocp.export_program, {"problem": problem(), "transcription": ocp.MultipleShooting(2), "folder": "c", "guess": None}),
        "export_mpc": (ocp.export_mpc, {"mpc": mpc(), "folder": "c"}),
        "Trajectory.save": (trajectory().save, {"path": "run.npz"}),
        "Trajectory.load": (tc.Trajectory.load, {"path": "missing.npz"}),
        "Plan.save": (plan().save, {"path": "plan.npz"}),
        "Plan.load": (ocp.Plan.load, {"path": "missing.npz", "problem": problem()}),
    }  # fmt: skip
    for name in ("pendulum", "double_pendulum", "prism", "d_bar", "t_bar", "six_bar_ball", "membrane"):
        make = getattr(tc.shapes, name)
        given = {k: p.default for k, p in inspect.signature(make).parameters.items() if p.default is not inspect.Parameter.empty}
        found[name] = (make, given)
    return found


def bounded(kind: Callable[..., Any], goal: bool = False, cost: bool = False, structure: tc.Structure | None = None) -> Callable[..., Any]:
    """The value, put into a problem, which then checks it."""

    def make(**options: Any) -> Any:
        value = kind(**options)
        m = model() if structure is None else tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
        goals = [value] if goal else []
        return ocp.Problem(m, goals=goals, bounds=[] if goal or cost else [value], costs=[value] if cost else [])

    return make


COSTLY = {
    "certify",
    "recommend",
    "tradeoff",
    "solve",
    "Mpc",
    "export_program",
    "export_mpc",
    "export_c",
    "replay_wound",
    "track",
    "run",
    "Plan.replay",
}


def finite(result: Any) -> bool:
    """No NaN in a result that says success."""
    if isinstance(result, ocp.Plan):
        return not result.success or (finite(result.trajectory) and np.isfinite(result.force_density).all() and np.isfinite(result.objective))
    if isinstance(result, tc.Trajectory):
        values = (result.time, result.nodes, result.velocities, result.tension, result.energy, result.states)
        return not result.success or all(np.isfinite(value).all() for value in values)
    return True


def attempt(draw: Callable[[Any], Any], names: list[str]) -> None:
    """One public name with one or two odd arguments."""
    name = draw(st.sampled_from(names))
    function, right = cases()[name]
    fields = draw(st.lists(st.sampled_from(sorted(right)), min_size=1, max_size=2, unique=True))
    changed = {**right, **{field: altered(draw, right[field]) for field in fields}}
    fault = ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = function(**changed)
        except OWN as error:
            words = [*right, *HINTS.get(name, ()), "Problem.start", name]
            if not any(re.search(rf"(?<![A-Za-z]){re.escape(word)}(?![A-Za-z])", str(error)) for word in words):
                fault = f"no field in {error}"
        except OSError as error:
            fault = "" if {"path", "folder"} & set(right) else str(error)
        else:
            fault = "" if finite(result) else "NaN"
    assert not fault, f"{name}: {fault}"


HINTS: dict[str, tuple[str, ...]] = {  # fields that are asked about in place of those given
    "Structure.replace": ("bars", "strings"),
    "SupportMotion": ("SupportMotion.positions",),
    **dict.fromkeys(("six_bar_ball", "prism", "d_bar", "t_bar", "membrane"), ("force_density",)),
    "Trajectory.load": ("trajectory",),
    "Plan.load": ("plan",),
}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Odd names of files are names in an empty folder."""
    monkeypatch.chdir(tmp_path)


def quick() -> list[str]:
    """The names whose calls take milliseconds."""
    return [name for name in cases() if name not in COSTLY]


@settings(max_examples=200, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
@given(st.data())
def test_odd_input_is_refused_by_name(data: st.DataObject) -> None:
    attempt(data.draw, quick())


@pytest.mark.slow
def test_thousands_of_odd_inputs_are_refused_by_name() -> None:
    own = "TENSCASADI_FUZZ" not in os.environ  # the same calls each time, unless somebody explores

    @settings(max_examples=NUMBER_OF_CALLS, deadline=None, database=None, derandomize=own, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def run(data: st.DataObject) -> None:
        attempt(data.draw, quick())

    run()

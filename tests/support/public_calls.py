"""Public names with input that is right, whose calls take milliseconds."""

# ruff: noqa: E501

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import fields
from functools import cache
from typing import Any

import numpy as np
from statics_calls import statics_calls

import ocp
import tenscasadi as tc

Call = tuple[Callable[..., Any], dict[str, Any]]


@cache
def model() -> tc.Model:
    structure = tc.shapes.prism(3, stiffness=1000.0, prestress=30.0)
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity()))


@cache
def timed() -> tc.Model:
    structure = tc.shapes.pendulum()
    start = structure.nodes[0]
    return tc.Model(
        tc.Scene(
            structure,
            gravity=tc.Gravity(),
            supports=tc.SupportMotion({0: lambda t: [start[0] + t**2, start[1], start[2]]}),
        )
    )


@cache
def problem(**changes: Any) -> ocp.Problem:
    taller = tc.shapes.prism(3, height=1.05)
    goals = [ocp.StringLengths(taller.string_lengths), ocp.AtRest()]
    return ocp.Problem(
        model(), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)], costs=[ocp.Effort()]
    )


@cache
def plan() -> ocp.Plan:
    found = ocp.solve(problem(), ocp.MultipleShooting(6))
    assert found.success
    return found


@cache
def trajectory() -> tc.Trajectory:
    return tc.simulate(model(), 0.05, 0.01, compiled=False)


def arrays_of(value: tc.Trajectory) -> dict[str, Any]:
    return {field.name: np.asarray(getattr(value, field.name)) for field in fields(value)}


def row() -> dict[str, Any]:
    """The fields of a row of a study."""
    numbers = {
        "seconds": 0.1,
        "setup": 1.0,
        "position": 1e-3,
        "bar": 0.0,
        "joint": 0.0,
        "energy": 1e-3,
        "instructions": 100,
        "steps": 10,
    }
    ways = {
        "scheme": tc.RungeKutta4(),
        "step": 0.01,
        "correction": tc.Projection(),
        "fidelity": "fine",
        "compiled": True,
        "single": False,
    }
    return {**ways, **numbers, "success": True, "message": "finished"}


@cache
def table() -> tc.Tradeoff:
    return tc.Tradeoff(
        (tc.TradeoffRow(**row()),), t_end=1.0, reference_error=1e-9, reference_message="known"
    )


NODES = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
SEGMENTED = tc.Structure(NODES, [(0, 1), (2, 3)], [(0, 2), (1, 3)], string_mass=1.0)
MEMBERS = {"nodes": NODES, "bars": [(0, 1), (2, 3)], "strings": [(0, 2), (1, 3)]}
MATRICES = {
    "N": NODES.T,
    "C_b": np.array([[-1.0, 1, 0, 0], [0, 0, -1, 1]]),
    "C_s": np.array([[-1.0, 0, 1, 0], [0, -1, 0, 1]]),
}
STRING_VALUES = {
    "stiffness": 100.0,
    "damping": np.array([0.1, 0.2]),
    "rest_length": np.array([1.0, 1.0]),
    "string_mass": 0.1,
}


@cache
def body_run() -> tc.Trajectory:
    """A rigid body at rest."""
    structure = tc.Structure(NODES, bodies=[tc.RigidBody(range(4), 1.0)])
    return tc.simulate(tc.Model(tc.Scene(structure)), 0.1, 0.05, compiled=False)


SIMULATION = {
    **{
        "scene": tc.Scene(tc.Structure(**MEMBERS)),
        "t_end": 0.1,
        "step": 0.01,
        "scheme": tc.RungeKutta4(),
        "correction": tc.Projection(),
    },
    **{
        "save_every": 1,
        "coordinates": "reduced",
        "bar_length": "current",
        "nodes": NODES,
        "velocities": NODES,
        "project": False,
        "state": None,
    },
    **{"control": None, "parameters": None, "energy_balance": True},
}


@cache
def quick_calls() -> dict[str, Call]:
    """Each public name whose call takes milliseconds, with input that is right."""
    return dynamics_calls() | statics_calls() | file_calls() | planning_calls() | shape_calls()


def dynamics_calls() -> dict[str, Call]:
    """Names of `tenscasadi`."""
    m = model()
    x, u, n = m.initial_state, m.initial_control, len(m.structure.nodes)
    pair = {"model": m, "x": x, "u": u}
    run = {"model": m, "t_end": 0.02, "step": 0.01, "scheme": tc.RungeKutta4(), "state": x, "control": u, "correction": tc.Projection(),
           "save_every": 1, "compiled": False}  # fmt: skip
    scene = {"structure": SEGMENTED, "control": tc.ForceDensity(), "segments": [2, 2], "gravity": tc.Gravity(), "ground": tc.Ground(10.0, 1.0),
             "pressure": tc.Pressure([(0, 1, 2)], 5.0), "forces": tc.NodalForce(np.ones((4, 3))), "slack": tc.Smooth(0.01)}  # fmt: skip
    found: dict[str, Call] = {
        "Structure": (tc.Structure, MEMBERS | STRING_VALUES | {"bar_mass": 1.0, "bar_radius": np.array([0.0, 0.01]), "node_mass": np.zeros(4), "pinned": {0: "xyz"}}),
        "Structure, cables": (tc.Structure, {"nodes": NODES, "strings": [(0, 1), (1, 2), (2, 3)], "node_mass": 1.0, "cables": [[0, 1]], "cable_friction": np.array([0.1])}),
        "RigidBody": (tc.RigidBody, {"nodes": (0, 1, 2, 3), "mass": 2.0, "center": (0.1, 0.2, 0.3), "inertia": np.diag([1.0, 1.2, 1.1]), "faces": ((0, 1, 2), (1, 2, 3))}),
        "Structure.from_matrices": (tc.Structure.from_matrices, MATRICES | {"P": np.array([[0.0], [1], [0], [0]]), "D": np.array([[1.0], [0], [0]]), "node_mass": np.zeros(4)}),
        "Structure.class_one": (SEGMENTED.class_one, {"sparse": True}),
        "Structure.replace": (SEGMENTED.replace, {"nodes": NODES, "bar_mass": 2.0, "pinned": (0,)}),
        "Structure.prestressed": (SEGMENTED.prestressed, {"force_density": np.array([1.0, 2.0]), "compression_strings": [1]}),
        "Structure.subdivide": (SEGMENTED.subdivide, {"segments": [2, 2], "ends": "lumped", "fractions": np.array([0.5, 0.5])}),
        "Structure.parent_mean": (SEGMENTED.parent_mean, {"values": np.array([1.0, 2.0])}),
        "equilibrium_force_density": (tc.equilibrium_force_density, {"structure": SEGMENTED, "loads": np.zeros((4, 3)), "minimum": np.zeros(2), "compression_strings": [0]}),
        "self_stress": (tc.self_stress, {"structure": SEGMENTED}),
        "Scene": (tc.Scene, scene),
        "export_mjcf": (tc.export_mjcf, {"scene": m.scene, "path": "scene.xml", "velocities": np.zeros((n, 3)), "joints": "ball", "step": 1e-3, "strict": True}),
        "import_mjcf": (tc.import_mjcf, {"path": "missing.xml"}),
        "Clip": (tc.Clip, {"damping": "unclamped"}),
        "Scene, laws": (tc.Scene, {"structure": SEGMENTED, "slack": {0: tc.Linear(), 1: tc.Clip()}}),
        "Smooth": (tc.Smooth, {"width": 0.01}),
        "Gravity": (tc.Gravity, {"acceleration": (0.0, 0.0, -9.81)}),
        "Winch": (tc.Winch, {"radius": 0.02, "inertia": 1e-3, "friction": 0.1, "torque": 2.0, "speed": 30.0}),
        "Ground": (tc.Ground, {"stiffness": 10.0, "damping": 1.0, "friction": 0.4, "height": 0.0}),
        "BarContact": (tc.BarContact, {"pairs": [(0, 1)], "stiffness": 10.0, "damping": 1.0, "friction": 0.3, "slip_speed": 0.01}),
        "Breaking": (tc.Breaking, {"force": 40.0, "margin": 0.1}),
        "Breaking, by string": (tc.Breaking, {"force": {0: 40.0}}),
        "Yielding": (tc.Yielding, {"force": 40.0, "viscosity": 2.0, "margin": 0.1}),
        "Scene, yielding": (tc.Scene, {"structure": SEGMENTED, "strength": tc.Yielding([40.0, np.inf], 2.0)}),
        "Scene, strength": (tc.Scene, {"structure": SEGMENTED, "strength": tc.Breaking([40.0, np.inf])}),
        "Pressure": (tc.Pressure, {"faces": [(0, 1, 2)], "difference": 5.0}),
        "Gravity, table": (tc.Gravity, {"acceleration": [(0.0, 0.0, -9.81), (0.0, 0.0, 0.0)], "times": np.array([0.0, 1.0])}),
        "Gravity, function": (tc.Gravity, {"acceleration": lambda t: [0, 0, t], "breakpoints": [0.5]}),
        "Pressure, table": (tc.Pressure, {"faces": [(0, 1, 2)], "difference": [5.0, 6.0], "times": [0.0, 1.0]}),
        "NodalForce": (tc.NodalForce, {"values": np.ones((2, 4, 3)), "times": np.array([0.0, 1.0])}),
        "ControlFunction": (tc.ControlFunction, {"function": lambda t: [t], "breakpoints": [0.5], "resolution": 1e-3}),
        "SupportMotion": (lambda motion: tc.Model(tc.Scene(tc.shapes.pendulum(), supports=tc.SupportMotion(motion))), {"motion": {0: lambda t: [0.0, 0.0, t]}}),
        "Model": (tc.Model, {"scene": m.scene, "coordinates": "full", "bar_length": "current"}),
        "Model.with_scene": (m.with_scene, {"scene": m.scene, "coordinates": "full"}),
        "Model.interpolate_functions": (timed().interpolate_functions, {"first": 0.0, "last": 1.0}),
        "Model.state": (m.state, {"nodes": m.structure.nodes, "velocities": np.zeros((n, 3))}),
        "Model.nodes": (m.nodes, {"x": np.array([x, x])}),
        "Model.velocities": (timed().velocities, {"x": timed().initial_state}),
        "Model.constraints": (m.constraints, {"x": x}),
        "linearize": (tc.linearize, {"model": m, "x": x, "u": u}),
        "modes": (tc.modes, pair),
        "build_projection": (tc.build_projection, {"model": m, "iterations": 2}),
        "stable_step": (tc.stable_step, pair | {"scheme": tc.RungeKutta4(), "safety": 0.9}),
        "simulate": (tc.simulate, run),
        "simulate, moved support": (tc.simulate, {**run, "model": timed(), "state": timed().initial_state, "control": None}),
        "DormandPrince54": (tc.DormandPrince54, {"rtol": 1e-6, "atol": 1e-6, "max_attempts": 10}),
        "DormandPrince853": (tc.DormandPrince853, {"rtol": 1e-6, "atol": 1e-6, "max_attempts": 10}),
        "Rattle": (tc.Rattle, {"order": 2, "iterations": 6}),
        "Collocation": (tc.Collocation, {"degree": 2, "points": "gauss", "tolerance": 1e-10, "iterations": 5}),
        "Cvodes": (tc.Cvodes, {"rtol": 1e-6, "atol": 1e-6, "max_steps": 10, "locate_events": True}),
        "Idas": (tc.Idas, {"rtol": 1e-6, "atol": 1e-6, "max_steps": 10, "locate_events": True}),
        "Projection": (tc.Projection, {"every": 1, "iterations": 3}),
        "BarLengthCorrection": (tc.BarLengthCorrection, {"weight": 1.0, "every": 1}),
        "Trajectory.save": (trajectory().save, {"path": "run.npz"}),
        "load_mat": (tc.load_mat, {"path": "missing.mat", "name": "task"}),
        "load_mat_trajectory": (tc.load_mat_trajectory, {"path": "missing.mat", "model": m, "parameters": None}),
        "load_ntrt": (tc.load_ntrt, {"path": "missing.yaml", "length_unit": 0.1, "ball_joints": False, "folder": "."}),
        "save_ntrt": (tc.save_ntrt, {"structure": tc.shapes.prism(), "path": "x.yaml", "length_unit": 0.1}),
        "save_mat": (tc.save_mat, {"data": SEGMENTED, "path": "run.mat", "class_one": False}),
        "export_gltf": (tc.export_gltf, {"data": trajectory(), "path": "run.glb", "time": 0.1}),
        "to_jax": (tc.to_jax, {"model": m}),
        "export_vtk": (tc.export_vtk, {"trajectory": trajectory(), "path": "run.pvd", "model": m, "every": 2}),
        "Trajectory.orientation": (body_run().orientation, {"body": 0}),
        "Trajectory.angular_velocity": (body_run().angular_velocity, {"body": 0}),
        "Trajectory.to_csv": (trajectory().to_csv, {"path": "run.csv"}),
        "Trajectory.load": (tc.Trajectory.load, {"path": "missing.npz"}),
        "Trajectory.from_arrays": (lambda **k: tc.Trajectory.from_arrays(k), arrays_of(trajectory())),
        "Trajectory": (lambda **k: repr(tc.Trajectory(**k)), {field.name: getattr(trajectory(), field.name) for field in fields(tc.Trajectory)}),
        "Model.force_density": (m.force_density, {"x": x, "u": u}),
        "Model.tension": (m.tension, {"x": x, "u": u}),
        "Model.multipliers": (m.multipliers, {"x": x, "u": u}),
        "Model.energy": (m.energy, {"x": x, "u": u}),
        "Model.bar_length_error": (m.bar_length_error, {"x": x}),
        "Model.joint_error": (m.joint_error, {"x": x}),
        "mode_motion": (tc.mode_motion, {"model": m, "modes": tc.modes(m), "index": 0, "amplitude": 0.1, "rows": 4}),
        "ReferenceSolution": (tc.ReferenceSolution, {"nodes": NODES, "error": 1e-12, "t_end": 1.0, "message": "known"}),
        "TradeoffRow": (lambda **k: [getattr(tc.TradeoffRow(**k), name) for name in ("name", "curve", "work")], row()),
        "Tradeoff": (lambda **k: [tc.Tradeoff(**k).summary(), tc.Tradeoff(**k).pareto()], {"rows": (tc.TradeoffRow(**row()),), "t_end": 1.0, "reference_error": 1e-9, "reference_message": "known", "complete": True, "message": ""}),
        "Tradeoff.pareto": (table().pareto, {"cost": "work"}),
        "Tradeoff.cheapest": (table().cheapest, {"tolerance": 1.0, "cost": "seconds"}),
        "Tradeoff.save": (table().save, {"path": "table.npz"}),
        "Tradeoff.load": (tc.Tradeoff.load, {"path": "missing.npz"}),
        "simulate, adaptive": (tc.simulate, {**run, "scheme": tc.DormandPrince54(rtol=1e-3, max_attempts=100)}),
    }  # fmt: skip
    return found


def file_calls() -> dict[str, Call]:
    """Scenes as files."""
    return {
        "Simulation": (tc.Simulation, SIMULATION),
        "load_scene": (tc.load_scene, {"path": "missing.toml"}),
        "load_simulation": (tc.load_simulation, {"path": "missing.toml"}),
        "save_scene": (tc.save_scene, {"scene": model().scene, "path": "scene.toml"}),
    }


def planning_calls() -> dict[str, Call]:
    """Names of `ocp`."""
    m = model()
    x, u, n = m.initial_state, m.initial_control, len(m.structure.nodes)
    weight = {"weight": 1.0}
    mesh = {"intervals": 5, "control": ocp.PiecewiseConstant(), "accuracy": None}
    found: dict[str, Call] = {
        "Problem": (ocp.Problem, {"model": m, "duration": (0.5, 1.0), "start": x, "goals": [ocp.AtRest()], "bounds": [ocp.ForceDensityLimits(1.0, 100.0)], "costs": [ocp.Effort()], "strength": tc.Breaking(1e6)}),
        "Phase": (ocp.Phase, {"duration": (0.1, 0.5), "contact_nodes": [0, 1], "goals": [ocp.AtRest()], "bounds": [ocp.ForceDensityLimits(0.0, 9.0)], "until": (0.1, 0.5)}),
        "FreeStart": (ocp.FreeStart, {"near": x, "goals": [ocp.AtRest()]}),
        "StringLengths": (bounded(ocp.StringLengths, goal=True), {"lengths": {0: 1.0, 1: 1.0}}),
        "NodePositions": (bounded(ocp.NodePositions, goal=True), {"positions": {0: (None, 0.0, 1.0)}}),
        "Shape": (bounded(ocp.Shape, goal=True), {"nodes": m.structure.nodes}),
        "NodeVelocities": (bounded(ocp.NodeVelocities, goal=True), {"velocities": {0: (None, 0.0, 1.0)}}),
        "BodyOrientation": (ocp.BodyOrientation, {"body": 0, "rotation": (0.0, 0.0, 0.5)}),
        "BarOrientation": (bounded(ocp.BarOrientation, goal=True), {"bar": 0, "direction": (0.1, 0.2, 1.0)}),
        "NodeTripleOrientation": (bounded(ocp.NodeTripleOrientation, goal=True), {"nodes": (3, 4, 5), "rotation": (0.0, 0.0, 0.5)}),
        "CenterOfMassVelocity": (bounded(ocp.CenterOfMassVelocity, goal=True), {"velocity": (None, 0.0, 1.0)}),
        "AngularMomentum": (bounded(ocp.AngularMomentum, goal=True), {"momentum": (None, 0.0, 1.0)}),
        "CenterOfMass": (bounded(ocp.CenterOfMass, goal=True), {"position": (None, 0.0, 1.0), "masses": np.full(n, 0.5)}),
        "Periodic": (bounded(ocp.Periodic, goal=True), {"shift": (0.0, None, 0.0), "start": (m.structure.nodes, np.zeros((n, 3)))}),
        "Waypoint": (bounded(ocp.Waypoint, goal=True), {"goals": [ocp.AtRest()], "time": 0.5, "share": None}),
        "SoftGoal": (bounded(ocp.SoftGoal, goal=True), {"goal": ocp.AtRest(), **weight}),
        "Shape.soft": (ocp.Shape(m.structure.nodes).soft, weight),
        "Waypoint.soft": (ocp.Waypoint([ocp.AtRest()], share=0.5).soft, weight),
        "InstantFormula": (ocp.InstantFormula, {"text": "z[0] - side", "numbers": {"side": 0.4}}),
        "ForceDensityLimits": (bounded(ocp.ForceDensityLimits), {"lower": 1.0, "upper": np.full(9, 100.0)}),
        "ForceDensityRateLimits": (bounded(ocp.ForceDensityRateLimits), {"rate": np.full(9, 100.0)}),
        "TensionLimits": (bounded(ocp.TensionLimits), {"lower": 1.0, "upper": np.full(9, 100.0)}),
        "TerminalTensions": (bounded(ocp.TerminalTensions), {"lower": 1.0, "upper": np.full(9, 100.0)}),
        "CenterOfMassVelocityLimits": (bounded(ocp.CenterOfMassVelocityLimits), {"lower": (None, None, -1.0), "upper": (5.0, 5.0, 5.0)}),
        "AngularMomentumLimits": (bounded(ocp.AngularMomentumLimits), {"lower": (None, None, -1.0), "upper": (5.0, 5.0, 5.0)}),
        "NodeAccelerationLimits": (bounded(ocp.NodeAccelerationLimits), {"magnitude": 50.0, "nodes": [3, 4]}),
        "RestLengthLimits": (bounded(ocp.RestLengthLimits), {"lower": 0.1, "upper": 5.0, "stiffness": np.full(9, 1000.0)}),
        "RestLengthRateLimits": (bounded(ocp.RestLengthRateLimits), {"speed": np.full(9, 1.0), "stiffness": 1000.0}),
        "BarForceLimits": (bounded(ocp.BarForceLimits), {"compression": 100.0, "tension": np.full(3, 100.0)}),
        "Buckling": (bounded(lambda **k: ocp.Buckling(**k), structure=m.structure.replace(bar_radius=0.01)), {"modulus": np.full(3, 1e9), "safety": 2.0}),
        "InsideBox": (bounded(ocp.InsideBox), {"lower": (None, None, -1.0), "upper": (5.0, 5.0, 5.0), "nodes": [0, 1]}),
        "AboveGround": (bounded(ocp.AboveGround), {"height": -1.0, "nodes": [0, 1]}),
        "AboveSurface": (bounded(ocp.AboveSurface), {"ground": tc.Ground(height=-5.0), "distance": 0.1, "nodes": [0, 1]}),
        "BarClearance": (bounded(ocp.BarClearance), {"distance": 0.01, "pairs": [(0, 1)]}),
        "Obstacle": (bounded(ocp.Obstacle), {"centre": (5.0, 5.0, 5.0), "radius": 0.5, "bars": [0], "nodes": [1]}),
        "Effort": (bounded(ocp.Effort, cost=True), weight),
        "Smoothness": (bounded(ocp.Smoothness, cost=True), weight),
        "Prestress": (bounded(ocp.Prestress, cost=True), {"level": np.full(9, 1.0), **weight}),
        "Tracking": (bounded(ocp.Tracking, cost=True), {"positions": {0: (0.0, 0.0, 0.0), 1: lambda t: (t, t, t)}, **weight}),
        "Duration": (bounded(ocp.Duration, cost=True), weight),
        "Work": (bounded(ocp.Work, cost=True), {**weight, "smoothing": 0.1}),
        "Constraint": (bounded(ocp.Constraint), {"name": "c", "expression": lambda now: now.nodes[2, 0], "lower": -9.0, "upper": 9.0, "at_end": False}),
        "Integral": (bounded(ocp.Integral, cost=True), {"name": "c", "expression": lambda now: now.nodes[2, 0] ** 2, **weight}),
        "AtEnd": (bounded(ocp.AtEnd, cost=True), {"name": "c", "expression": lambda now: now.nodes[2, 0] ** 2, **weight}),
        "MultipleShooting": (ocp.MultipleShooting, mesh | {"scheme": tc.RungeKutta4(), "substeps": 1}),
        "ImplicitMidpoint": (ocp.ImplicitMidpoint, mesh),
        "Variational": (ocp.Variational, mesh),
        "ocp.DirectCollocation": (ocp.DirectCollocation, mesh | {"degree": 2}),
        "PiecewiseConstant": (ocp.PiecewiseConstant, {"groups": ((0, 1), (2, 3)), "max_changes": 3}),
        "PiecewiseLinear": (ocp.PiecewiseLinear, {"groups": ((0, 1), (2, 3))}),
        "Ipopt": (ocp.Ipopt, {"max_iterations": 5, "tolerance": 1e-6, "verbose": False, "options": {"mu_init": 0.1}, "time_limit": 1.0, "callback": None, "warm_start": False, "restart_at_saddle": True}),
        "CondensedNewton": (ocp.CondensedNewton, {"max_iterations": 5, "tolerance": 1e-6, "verbose": False}),
        "Sampling": (
            ocp.Sampling,
            {"groups": [(0, 1), (2, 3)], "knots": 4, "samples": 8, "seed": 1, "rounds": 2, "iterations": 1, "attempts": 1, "threads": 1}
            | {"verbose": False, "callback": None},
        ),
        "InverseDynamics": (ocp.InverseDynamics, {"path": np.array([m.structure.nodes] * 2), "noise": 0.3, "seed": 0}),
        "TrajectoryGuess": (ocp.TrajectoryGuess, {"states": np.array([x] * 4), "force_density": np.array([u] * 3), "duration": 1.0}),
        "is_realizable": (
            ocp.is_realizable,
            {"plan": plan(), "stiffness": 1000.0, "min_rest_length": np.full(9, 0.01)},
        ),
        "Plan.rest_lengths": (plan().rest_lengths, {"stiffness": np.full(9, 1000.0)}),
        "Plan.tension": (plan().tension, {"end": True}),
        "Plan.save": (plan().save, {"path": "plan.npz"}),
        "Plan.to_csv": (plan().to_csv, {"path": "plan.csv"}),
        "Plan.load": (ocp.Plan.load, {"path": "missing.npz", "problem": problem()}),
        "load_problem": (ocp.load_problem, {"path": "missing.toml"}),
        "load_solve_arguments": (ocp.load_solve_arguments, {"path": "missing.toml"}),
        "load_studies": (ocp.load_studies, {"path": "missing.toml"}),
        "save_problem": (ocp.save_problem, {"problem": problem(), "path": "problem.toml", "studies": {"refinement": {"tolerance": 1e-3}}, "tolerance": 1e-3, "time_limit": 1.0, "n_starts": 1}),
        "Plan.require_model": (plan().require_model, {"user": "a test"}),
        "Progress": (ocp.Progress, {"iteration": 1, "objective": 1.0, "infeasibility": 0.0}),
    }  # fmt: skip
    return found


def shape_calls() -> dict[str, Call]:
    """Ready-made structures with their defaults."""
    found: dict[str, Call] = {}
    for name, make in tc.shapes.ShapeFamily.members.items():
        given = {
            k: p.default
            for k, p in inspect.signature(make).parameters.items()
            if p.default is not inspect.Parameter.empty
        }
        found[name] = (make, given)
    return found


def bounded(
    kind: Callable[..., Any],
    goal: bool = False,
    cost: bool = False,
    structure: tc.Structure | None = None,
) -> Callable[..., Any]:
    """The value, put into a problem, which then checks it."""

    def make(**options: Any) -> Any:
        value = kind(**options)
        m = (
            model()
            if structure is None
            else tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
        )
        goals = [value] if goal else []
        return ocp.Problem(
            m, goals=goals, bounds=[] if goal or cost else [value], costs=[value] if cost else []
        )

    return make

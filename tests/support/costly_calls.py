"""Public names whose calls simulate, solve or draw, with input that is right and costs as little as can be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from public_calls import Call, timed, trajectory

import ocp
import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.animation import animate


@cache
def cross() -> tc.Model:
    return tc.Model(
        tc.Scene(tc.shapes.d_bar(pinned=[0], stiffness=1000.0), control=tc.ForceDensity())
    )


@cache
def turned() -> ocp.Problem:
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    return ocp.Problem(
        cross(), goals=goals, bounds=[ocp.ForceDensityLimits(0.0, 50.0)], costs=[ocp.Effort()]
    )


@cache
def short_plan() -> ocp.Plan:
    found = ocp.solve(turned(), ocp.MultipleShooting(4))
    assert found.success
    return found


@cache
def weighed() -> ocp.Plan:
    scene = replace(cross().scene, parameters=tc.Parameters("bar_mass"))
    return ocp.solve(
        ocp.Problem(tc.Model(scene), goals=turned().goals),
        ocp.MultipleShooting(3),
        ocp.Ipopt(max_iterations=3),
    )


@cache
def mpc() -> ocp.Mpc:
    return ocp.Mpc(turned(), 0.1, 3)


@cache
def tracker() -> ocp.Tracker:
    return ocp.track(short_plan())


@cache
def reeled() -> ocp.Plan:
    """Build a plan with rest-length rates as control, which has not converged."""
    wound = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0, damping=2.0)
    model = tc.Model(tc.Scene(wound, control=tc.RestLengthRate()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.75).string_lengths), ocp.AtRest()]
    problem = ocp.Problem(model, 0.6, goals=goals, bounds=[ocp.RestLengthRateLimits(1.0)])
    return ocp.solve(problem, ocp.MultipleShooting(3), ocp.Ipopt(max_iterations=3))


@cache
def costly_calls() -> dict[str, Call]:
    """List public functions that simulate, solve or draw, with valid arguments."""
    return measuring_calls() | planning_calls() | drawing_calls()


def measuring_calls() -> dict[str, Call]:
    """List functions that simulate repeatedly, or write C code."""
    start = {"state": timed().initial_state, "control": None}
    study = {"models": timed(), "t_end": 0.01, "schemes": (tc.RungeKutta4(),), "steps": (0.01,), "reference": None, "state": None, "control": None,
             "corrections": (None,), "compiled": (False,), "repeats": 1, "progress": False}  # fmt: skip
    many = {"model": timed(), "t_end": 0.01, "step": 0.01, "states": np.tile(timed().initial_state, (2, 1)), "controls": np.zeros((2, 0)),
            "parameters": {}, "scheme": tc.RungeKutta4(), "correction": tc.Projection(), "save_every": 1, "threads": 1,
            "progress": False}  # fmt: skip
    driven = {
        "model": cross(),
        "t_end": 0.1,
        "step": 0.02,
        "states": cross().initial_state,
        "controls": tracker().feedback,
    }
    derivatives = {"model": timed(), "start": timed().initial_state, "t_end": 0.01, "step": 0.01, "scheme": tc.RungeKutta4(), "control": None,
                   "correction": tc.Projection(), "output": lambda x, u: x[0], "by": "state", "mode": "forward", "compiled": False}  # fmt: skip
    return {
        "rollouts": (tc.rollouts, many),
        "rollouts, controls": (tc.rollouts, {**driven, "controls": np.full((2, 3, 2), 10.0)}),
        "rollouts, feedback": (tc.rollouts, driven),
        "Feedback": (
            tc.Feedback,
            {
                name: getattr(tracker().feedback, name)
                for name in ("time", "controls", "states", "gains", "lower", "upper")
            },
        ),
        "sensitivities": (tc.sensitivities, derivatives),
        "reference_solution": (
            tc.reference_solution,
            {
                "model": timed(),
                "t_end": 0.01,
                **start,
                "max_difference": 1e-3,
                "target_difference": 1e-3,
                "compiled": False,
                "max_instructions": 1e6,
                "progress": False,
            },
        ),
        "recommend": (
            tc.recommend,
            {
                "model": timed(),
                "t_end": 0.01,
                "tolerance": 1e-2,
                **start,
                "schemes": (tc.RungeKutta4(),),
                "corrections": (None,),
                "compiled": False,
                "time_limit": 2.0,
                "progress": False,
            },
        ),
        "tradeoff": (tc.tradeoff, study),
        "to_jax": (tc.to_jax, {"model": cross()}),
        "export_c": (
            tc.export_c,
            {
                "model": cross(),
                "folder": "c",
                "scheme": tc.RungeKutta4(),
                "precision": None,
                "t_end": 1.0,
            },
        ),
        "export_fmu": (
            tc.export_fmu,
            {"model": cross(), "path": "cross.fmu", "step": 1e-3, "scheme": tc.RungeKutta4()},
        ),
    }


def planning_calls() -> dict[str, Call]:
    """List functions that compute plans, track them, or write them as C code."""
    m = cross()
    return {
        "solve": (
            ocp.solve,
            {
                "problem": turned(),
                "transcription": ocp.MultipleShooting(3),
                "solver": ocp.Ipopt(max_iterations=3),
                "guess": ocp.InverseDynamics(),
                "tolerance": 0.1,
                "time_limit": 20.0,
                "n_starts": 2,
                "executor": None,
                "tracked": True,
            },
        ),
        "solve, at values": (
            ocp.solve,
            {
                "problem": weighed().problem,
                "transcription": ocp.MultipleShooting(3),
                "solver": ocp.Ipopt(max_iterations=3),
                "parameters": {"bar_mass": 1.1},
            },
        ),
        "replay_rest_lengths": (
            ocp.replay_rest_lengths,
            {"plan": short_plan(), "stiffness": np.full(2, 1000.0), "damping": 0.0, "updates": 1},
        ),
        "Plan.replay": (short_plan().replay, {"scheme": tc.RungeKutta4(), "step": 0.05}),
        "Plan.replay, at values": (
            weighed().replay,
            {"parameters": {"bar_mass": [1.1, 1.0, 1.0, 1.0]}},
        ),
        "Plan.replay, tracked": (short_plan().replay, {"tracked": True}),
        "Plan.refine": (short_plan().refine, {"tolerance": 0.1, "attempts": 1}),
        "Plan.replan": (
            short_plan().replan,
            {"duration": 1.0, "tolerance": 0.1, "time_limit": 1.0, "costs": [ocp.Effort()]},
        ),
        "Plan.replan, at values": (
            weighed().replan,
            {"parameters": {"bar_mass": [1.1, 1.0, 1.0, 1.0]}, "time_limit": 1.0},
        ),
        "Mpc": (
            ocp.Mpc,
            {
                "problem": turned(),
                "period": 0.1,
                "intervals": 2,
                "plan": short_plan(),
                "iterations": 1,
                "substeps": 1,
                "position_scale": 1.0,
                "control_scale": 1.0,
            },
        ),
        "Mpc, of winches": (
            ocp.Mpc,
            {"problem": reeled().problem, "plan": reeled(), "intervals": 2, "control_scale": 1.0},
        ),
        "track, of winches": (
            ocp.track,
            {"plan": reeled(), "control_scale": 1.0, "lower": -1.0, "upper": np.ones(2)},
        ),
        "Mpc.function": (mpc().function, {"solver": None}),
        "Mpc.control": (mpc().control, {"time": 0.0, "state": m.initial_state}),
        "Tracker.control": (tracker().control, {"time": 0.0, "state": m.initial_state}),
        "track": (
            ocp.track,
            {
                "plan": short_plan(),
                "decisions": 4,
                "position_scale": 1.0,
                "control_scale": 1.0,
                "lower": 0.0,
                "upper": np.full(2, 200.0),
            },
        ),
        "run": (
            ocp.run,
            {
                "controller": tracker(),
                "t_end": 0.05,
                "model": m,
                "state": m.initial_state,
                "steps": 1,
                "disturbance": lambda t, x: x,
            },
        ),
        "export_program": (
            ocp.export_program,
            {
                "problem": turned(),
                "transcription": ocp.MultipleShooting(2),
                "folder": "c",
                "guess": None,
            },
        ),
        "export_acados": (ocp.export_acados, {"mpc": mpc(), "folder": "acados"}),
        "export_mpc": (ocp.export_mpc, {"mpc": mpc(), "folder": "c"}),
    }


def drawing_calls() -> dict[str, Call]:
    """List functions that draw pictures."""
    motion, named = trajectory(), {"title": "a title", "path": "picture.svg"}
    curves = {"RungeKutta4": [(1e-3, 0.1), (1e-6, 0.6)]}

    def watched(path: Any, every: Any, now: Any) -> Any:
        watch = plots.Convergence(path, every)
        watch(now)
        return watch.figure()

    many = tc.rollouts(cross(), 0.1, 0.02, [cross().initial_state] * 3, save_every=1)
    return {
        "plots.fan": (
            plots.fan,
            {"rollouts": many, "node": 1, "axes": "xz", "bands": [0.1, 0.2], **named},
        ),
        "plots.histogram": (
            plots.histogram,
            {"rollouts": many, "outcome": many.final[:, 0], "label": "x", "bins": 3, **named},
        ),
        "Rollouts.path": (many.path, {"node": 1}),
        "plots.structure": (
            plots.structure,
            {"data": motion, "tension": np.ones(9), "time": 0.01, "labels": True, **named},
        ),
        "plots.time_lapse": (plots.time_lapse, {"data": motion, "instants": 2, **named}),
        "plots.node_histories": (
            plots.node_histories,
            {"trajectory": motion, "nodes": [0, 1], **named},
        ),
        "plots.force_densities": (
            plots.force_densities,
            {
                "history": motion,
                "strings": [0, 1],
                "lower": 0.0,
                "upper": np.full(9, 100.0),
                **named,
            },
        ),
        "plots.errors": (plots.errors, {"trajectory": motion, **named}),
        "plots.work_precision": (
            plots.work_precision,
            {
                "curves": curves,
                "front": [(1e-3, 0.1)],
                "reference_error": 1e-9,
                "cost": "seconds",
                **named,
            },
        ),
        "plots.Convergence": (
            watched,
            {"path": None, "every": 1.0, "now": ocp.Progress(1, 2.0, 0.1)},
        ),
        "Tradeoff.plot": (
            tc.Tradeoff((), 1.0, 1e-9, "known").plot,
            {"path": "picture.svg", "title": "a title"},
        ),
        "animate": (
            animate,
            {
                "data": motion,
                "path": "motion.gif",
                "speed": 0.5,
                "frames_per_second": 20,
                "title": "a title",
                "progress": False,
            },
        ),
    }

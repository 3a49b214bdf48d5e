"""Names for parameters, many motions and derivatives, with input that is right."""

# ruff: noqa: E501

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.util import find_spec
from typing import Any

import casadi as ca
import numpy as np
from costly_calls import cross, mpc, short_plan, turned
from public_calls import Call

import ocp
import tenscasadi as tc

FLAT = np.zeros((3, 3))
THREAD = ThreadPoolExecutor(1)


@cache
def open_model() -> tc.Model:
    """A pendulum whose bar's mass and gravity stay open."""
    return tc.Model(
        tc.Scene(
            tc.shapes.pendulum(),
            gravity=tc.Gravity(),
            parameters=tc.Parameters("bar_mass", "gravity"),
        )
    )


@cache
def many() -> tc.Rollouts:
    return tc.rollouts(
        cross(), 0.02, 0.01, states=np.tile(cross().initial_state, (2, 1)), save_every=1, threads=1
    )


@cache
def robust() -> ocp.Robustness:
    return short_plan().robustness({"bar_mass": 0.1}, samples=4)


def doubled(case: Any) -> dict[str, float]:
    """A study of one number."""
    return {"double": 2.0 * float(case)}


def environment_calls(model: tc.Model) -> dict[str, Call]:
    """Tasks and environments, where gymnasium is installed."""
    if find_spec("gymnasium") is None:
        return {}
    from tenscasadi.envs import Task, TensegrityEnv, TensegrityVectorEnv

    task = {"model": model, "reward": lambda now: now.time, "lower": np.zeros(model.nu), "upper": np.full(model.nu, 9.0), "rest_length_rate": None,
            "period": 0.05, "steps": 2, "duration": 0.1, "state": model.initial_state, "start": (0.01, 0.0), "parameters": {},
            "observation": lambda nodes, velocities, control: nodes[:, :, 0], "terminated": lambda now: now.time > 1.0, "correction": None, "end_on_failure": False}  # fmt: skip
    env, envs = TensegrityEnv(Task(**task)), TensegrityVectorEnv(Task(**task), 2)
    env.reset(seed=0)
    envs.reset(seed=0)

    def moved(**given: Any) -> Any:
        begun = TensegrityEnv(Task(**given))
        begun.reset(seed=0)
        return begun.step(np.zeros(model.nu))[:2]

    return {
        "Task": (moved, task),
        "TensegrityVectorEnv": (
            TensegrityVectorEnv,
            {"task": Task(**task), "num_envs": 2, "threads": 1},
        ),
        "TensegrityEnv.step": (lambda action: env.step(action)[:2], {"action": np.zeros(model.nu)}),
        "TensegrityVectorEnv.step": (
            lambda actions: envs.step(actions)[:2],
            {"actions": np.zeros((2, model.nu))},
        ),
    }


@cache
def ensemble_calls() -> dict[str, Call]:
    """Each with input that is right."""
    m, opened = cross(), open_model()
    page = {
        "html": "page.html",
        "title": "a cross",
        "ground": tc.Ground(),
        "color": "tension",
        "speed": 1.0,
        "follow": False,
    }
    x, u, p = m.initial_state, m.initial_control, opened.parameters.nominal
    fed = {
        "time": np.array([0.0, 0.1]),
        "controls": u[None],
        "states": np.array([x, x]),
        "gains": np.zeros((1, len(u), len(x))),
        "lower": 0.0,
        "upper": np.full(len(u), 9.0),
    }
    decided = {
        "problem": turned(),
        "period": 0.05,
        "horizon": 0.1,
        "samples": 4,
        "noise": np.full(2, 1.0),
        "initial": u,
        "temperature": 0.1,
        "iterations": 1,
        "steps": 1,
        "position_scale": 0.1,
        "seed": 0,
    }
    derived = {"model": opened, "start": opened.initial_state, "t_end": 0.02, "step": 0.01, "scheme": tc.RungeKutta4(), "control": None, "correction": None,
               "output": None, "over": "end", "by": "parameters", "parameters": p, "mode": "forward", "compiled": False}  # fmt: skip
    return {
        **environment_calls(m),
        "Terrain": (
            lambda **k: tc.Scene(tc.shapes.pendulum(), ground=tc.Terrain(**k)),
            {
                "heights": FLAT,
                "lower": (0.0, 0.0),
                "upper": (1.0, 1.0),
                "stiffness": 10.0,
                "damping": 1.0,
                "friction": 0.1,
                "slip_speed": 0.01,
                "nodes": [0],
                "bars": [0],
                "bar_points": 3,
            },
        ),
        "Parameters": (
            lambda name, **k: tc.Model(
                tc.Scene(tc.shapes.prism(), parameters=tc.Parameters(name, "bar_mass", **k))
            ),
            {"name": "stiffness", "scale": ("damping",), "groups": {"stiffness": [(0, 1), (2, 3)]}},
        ),
        "ParameterLayout.values": (
            lambda given, **k: opened.parameters.values(given, **k),
            {"given": p, "bar_mass": 2.0},
        ),
        "Model.with_parameters": (opened.with_parameters, {"parameters": p}),
        "simulate, parameters": (
            tc.simulate,
            {"model": opened, "t_end": 0.02, "step": 0.01, "parameters": p, "compiled": False},
        ),
        "linearize, parameters": (
            tc.linearize,
            {"model": opened, "x": opened.initial_state, "parameters": p},
        ),
        "stable_step, parameters": (
            tc.stable_step,
            {"model": opened, "x": opened.initial_state, "parameters": p},
        ),
        "sensitivities": (tc.sensitivities, derived),
        "rollouts": (
            tc.rollouts,
            {
                "model": m,
                "t_end": 0.02,
                "step": 0.01,
                "states": np.array([x, x]),
                "controls": np.array([u, u]),
                "parameters": None,
                "scheme": tc.RungeKutta4(),
                "correction": None,
                "save_every": 1,
                "threads": 1,
                "progress": False,
            },
        ),
        "rollouts, parameters": (
            tc.rollouts,
            {
                "model": opened,
                "t_end": 0.02,
                "step": 0.01,
                "parameters": np.array([p, p]),
                "threads": 1,
            },
        ),
        "rollouts, feedback": (
            tc.rollouts,
            {
                "model": m,
                "t_end": 0.1,
                "step": 0.01,
                "states": np.array([x, x]),
                "controls": tc.Feedback(**fed),
                "threads": 1,
            },
        ),
        "Rollouts.path": (many().path, {"node": 0}),
        "Rollouts.save": (many().save, {"path": "many.npz"}),
        **{
            f"{type(thing).__name__}.view": (thing.view, page)
            for thing in (many(), short_plan(), m.structure)
            if find_spec("viser")
        },
        "Rollouts.load": (tc.Rollouts.load, {"path": "missing.npz"}),
        "Feedback": (tc.Feedback, fed),
        "sweep": (
            tc.sweep,
            {
                "function": doubled,
                "cases": [1.0, 2.0],
                "executor": THREAD,
                "folder": None,
                "progress": False,
            },
        ),
        "Sweep.to_csv": (tc.sweep(doubled, [1.0, 2.0], THREAD).to_csv, {"path": "table.csv"}),
        "Plan.robustness": (
            short_plan().robustness,
            {
                "parameters": {"bar_mass": 0.1},
                "start": (0.0, 0.0),
                "samples": 2,
                "seed": 0,
                "tracked": False,
                "tolerance": 0.1,
            },
        ),
        "Robustness.quantiles": (robust().quantiles, {"shares": [0.5, 0.9]}),
        "Mppi": (ocp.Mppi, decided),
        "Mppi, of a cost": (
            ocp.Mppi,
            {
                "problem": ocp.Effort(),
                "model": m,
                "noise": 1.0,
                "samples": 2,
                "period": 0.1,
                "horizon": 0.1,
            },
        ),
        "Mppi.control": (ocp.Mppi(**decided).control, {"time": 0.0, "state": x}),
        "SplineNoise": (
            lambda **k: ocp.Mppi(turned(), 0.05, 0.1, 4, noise=ocp.SplineNoise(**k)),
            {"deviation": np.ones(2), "knots": 2, "groups": [[0], [1]], "min_scale": 0.01},
        ),
        "run, sampled": (
            ocp.run,
            {
                "controller": mpc(),
                "t_end": 0.1,
                "model": m,
                "state": x,
                "steps": 1,
                "disturbance": None,
            },
        ),
        "Instant.rest_lengths": (
            lambda **k: ocp.Instant(
                m, ca.MX.sym("x", len(x)), ca.MX.sym("u", len(u)), 0.0
            ).rest_lengths(**k),
            {"stiffness": np.full(2, 1000.0)},
        ),
    }

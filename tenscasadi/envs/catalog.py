"""Ready-made control tasks and their names in Gymnasium."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.envs.environments import TensegrityEnv, TensegrityVectorEnv
from tenscasadi.envs.task import Task, Transition
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.structure import shapes


@lru_cache(maxsize=1)
def build_prism_jump() -> Task:
    """Build the task of a three-bar prism that jumps from the ground.

    Actions are rates of rest lengths. The reward of a period is the height of the center above its
    start [m], times the share of the period in the episode of 1 s.

    Examples
    --------
    >>> from tenscasadi.envs.catalog import build_prism_jump
    >>> build_prism_jump().decisions
    20
    """
    prism = shapes.prism(stiffness=1000.0, damping=5.0, prestress=100.0)
    prism = prism.replace(nodes=prism.nodes - [0, 0, prism.nodes[:, 2].min()])
    ground = Ground(stiffness=5e3, damping=50.0, friction=0.7, slip_speed=0.05)
    scene = Scene(prism, control=RestLength(), gravity=Gravity(), ground=ground)
    height = float(prism.nodes[:, 2].mean())

    def reward(now: Transition) -> Any:
        return (now.nodes[:, :, 2].mean(axis=1) - height) * 0.05

    return Task(
        Model(scene),
        reward,
        lower=0.3 * prism.rest_length,
        upper=1.2 * prism.rest_length,
        rest_length_rate=5.0,
        duration=1.0,
        steps=50,
        start=0.002,
    )


@lru_cache(maxsize=1)
def build_ball_travel() -> Task:
    """Build the task of a six-bar ball that travels along x.

    Actions are rates of rest lengths. The reward is the distance of the center along x [m] in 3 s.
    Ground stiffness and bar masses differ from episode to episode.

    Examples
    --------
    >>> from tenscasadi.envs.catalog import build_ball_travel
    >>> build_ball_travel().decisions
    60
    """
    ball = shapes.six_bar_ball(stiffness=1000.0, damping=5.0, prestress=100.0)
    face = ball.nodes[[11, 3, 7]].sum(axis=0)
    x = ball.nodes[[3, 7]].mean(axis=0) - ball.nodes[11]
    x, z = x / np.linalg.norm(x), -face / np.linalg.norm(face)
    nodes = ball.nodes @ np.array([x, np.cross(z, x), z]).T
    scene = Scene(
        ball.replace(nodes=nodes - [0, 0, nodes[:, 2].min()]),
        control=RestLength(),
        gravity=Gravity(),
        ground=Ground(stiffness=5e3, damping=50.0, friction=0.7, slip_speed=0.05),
        parameters=Parameters("ground_stiffness", scale=["bar_mass"]),
    )

    def reward(now: Transition) -> Any:
        return (now.nodes - now.nodes_before)[:, :, 0].mean(axis=1)

    return Task(
        Model(scene),
        reward,
        lower=0.2,
        upper=1.0,
        rest_length_rate=0.5,
        duration=3.0,
        steps=25,
        start=0.005,
        parameters={"ground_stiffness": 0.3, "bar_mass": 0.1},
    )


TASKS: dict[str, Callable[[], Task]] = {
    "PrismJump-v0": build_prism_jump,
    "BallTravel-v0": build_ball_travel,
}


def make_env(task: str, render_mode: str | None = None) -> TensegrityEnv:
    """Build the environment of a named task of `TASKS`."""
    return TensegrityEnv(TASKS[task](), render_mode)


def make_vector_env(
    task: str, num_envs: int, threads: int = 1, render_mode: None = None
) -> TensegrityVectorEnv:
    """Build the vectorized environment of a named task of `TASKS`."""
    return TensegrityVectorEnv(TASKS[task](), num_envs, threads)


def register_environments() -> None:
    """Register all tasks as ``tenscasadi/NAME``.

    Gymnasium calls it by the entry point of the package.
    """
    from gymnasium.envs.registration import register

    for name in TASKS:
        register(
            f"tenscasadi/{name}",
            entry_point="tenscasadi.envs.catalog:make_env",
            vector_entry_point="tenscasadi.envs.catalog:make_vector_env",
            kwargs={"task": name},
        )

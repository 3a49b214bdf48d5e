"""A prism to simulate, how it is set in motion, and its steps taken one by one."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.integrators.stabilization import Projection, build_projection
from tenscasadi.scene.scene import Scene
from tenscasadi.structure import shapes


def prism(control: Any = None, coordinates: Any = "reduced", **options: Any) -> Model:
    structure = shapes.prism(**{"stiffness": 1000.0, "prestress": 30.0, **options})
    return Model(Scene(structure, control=control), coordinates)


def moving(model: Model, speed: float = 0.1) -> np.ndarray:
    """Compute an initial state with random velocities that satisfy the bars."""
    shape = model.structure.nodes.shape
    velocities = speed * np.random.default_rng(3).normal(size=shape) * ~model.structure.fixed
    return build_projection(model)(model.state(model.structure.nodes, velocities)).full().ravel()


def by_hand(
    model: Model,
    x: np.ndarray,
    controls: np.ndarray,
    h: float,
    correction: Projection | None = None,
) -> np.ndarray:
    """Compute the states of `simulate` by separate calls of the step Function."""
    step = RungeKutta4().step(model.ode)
    project = correction.step(model) if correction else None
    states = [x]
    for k, u in enumerate(controls):
        x = step(x, u, h).full().ravel()
        if correction and project and (k + 1) % correction.every == 0:
            x = project(x).full().ravel()
        states.append(x)
    return np.array(states)

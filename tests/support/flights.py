"""Motions with exact bars, and means over their mass, for tests against physics."""

from __future__ import annotations

from typing import Any

import numpy as np

import tenscasadi as tc

G = 9.81  # m/s²


def fly(
    scene: tc.Scene, t_end: float, step: float, velocities: Any = None, **options: Any
) -> tuple[tc.Model, tc.Trajectory]:
    """Return the model of a scene and its motion, which has succeeded."""
    model = tc.Model(scene)
    state = None if velocities is None else model.state(model.structure.nodes, velocities)
    run = tc.simulate(
        model,
        t_end,
        step,
        state=state,
        **{"compiled": False, "correction": tc.Projection(), **options},
    )
    assert run.success, run.message
    return model, run


def centre(model: tc.Model, values: Any) -> Any:
    """Return the mean over nodes (…, n, 3) weighted by the mass that moves with each."""
    weight = np.asarray(model.structure.mass_matrix().sum(axis=0)).ravel()
    return np.einsum("...nx,n->...x", values, weight) / weight.sum()

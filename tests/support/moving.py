"""Motions that are easily seen to move."""

from __future__ import annotations

import numpy as np

import tenscasadi as tc


def thrown(t_end: float) -> tc.Trajectory:
    """A prism that flies and turns, with a row every hundredth of a second."""
    prism = tc.shapes.prism(stiffness=500.0, prestress=30.0)
    model = tc.Model(tc.Scene(prism))
    speeds = np.cross((0.0, 2.0, 1.0), prism.nodes - prism.nodes.mean(axis=0)) + (0.5, 0.0, 0.3)
    return tc.simulate(model, t_end, 1e-3, state=model.state(prism.nodes, speeds), save_every=10)

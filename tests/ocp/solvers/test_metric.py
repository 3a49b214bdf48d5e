"""Projections onto constraints in a metric."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.solvers.condensed_newton.metric import Metric, Projector


def test_steps_meet_constraints_of_different_sizes():
    """Rows of 1e-4 beside rows of one, where barriers are stiff: steps meet all of them."""
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(4, 40)) * np.array([1.0, 1.0, 1e-4, 1e-4])[:, None]
    metric = Metric(10.0 ** rng.uniform(0, 8, 40))
    projector, wanted = Projector(rows, np.zeros(4), metric), rng.normal(size=4)
    assert rows @ projector.shortest(wanted) == pytest.approx(wanted, rel=1e-6)
    force = rng.normal(size=40)
    step = projector.project(force)
    assert np.abs(rows @ step / np.linalg.norm(rows, axis=1)).max() < 1e-8 * np.abs(step).max()
    # the steepest descent in the metric that keeps the rows, by dense least squares
    half = rows / np.sqrt(metric.diagonal)
    null = np.linalg.svd(half)[2][4:]
    known = null.T @ (null @ (force / np.sqrt(metric.diagonal))) / np.sqrt(metric.diagonal)
    assert step == pytest.approx(known, abs=1e-8 * np.abs(known).max())

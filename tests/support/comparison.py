"""Comparisons of models: both coordinates, accelerations of physical nodes, relative differences."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.structure.structure import PARAMETERS, Structure

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])


def accelerations(model: Model, x: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
    """Compute the accelerations N̈ (n, 3) of physical nodes."""
    rate = model.split(
        model.ode(x, model.initial_control if u is None else u).full().ravel()
    ).velocities
    shifted = np.concatenate([rate, np.zeros(model.nx - model.nq)])
    return model.nodes(shifted) - model.nodes(np.zeros(model.nx))


def relative(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Compute the largest difference relative to the largest entry."""
    return float(abs(ours - theirs).max(initial=0.0) / max(abs(theirs).max(initial=0.0), 1e-12))


def assert_same_structure(one: Structure, other: Structure) -> None:
    """Two structures agree in every keyword but names, to the last bit."""
    for name in PARAMETERS:
        if name.endswith("_names"):
            continue
        a, b = getattr(one, name), getattr(other, name)
        assert np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b, name

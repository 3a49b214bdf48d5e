"""The plan that many tests look at."""

from __future__ import annotations

import pytest
from planning import raising, taller

import ocp


@pytest.fixture(scope="session")
def plan():
    """The prism raised by a tenth, in 12 intervals."""
    return ocp.solve(raising(), ocp.MultipleShooting(12))


@pytest.fixture(scope="session")
def coarse():
    """The prism made taller, in 8 intervals."""
    return ocp.solve(taller(), ocp.MultipleShooting(8))

"""The plan that controllers follow."""

from __future__ import annotations

import pytest
from controlling import problem

import ocp


@pytest.fixture(scope="session")
def plan():
    """The prism grows, in 20 intervals."""
    return ocp.solve(problem(), ocp.MultipleShooting(20))

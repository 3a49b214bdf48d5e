"""The plan that tests of bounds and costs compare with."""

from __future__ import annotations

import pytest
from rising import raised


@pytest.fixture(scope="session")
def free():
    """The plan without further bounds."""
    return raised()

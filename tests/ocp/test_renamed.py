"""Names of earlier versions."""

from __future__ import annotations

import pytest

import ocp


def test_old_name_warns_and_works():
    with pytest.warns(DeprecationWarning, match=r"use ocp\.InfeasibleGoalError"):
        assert ocp.UnreachableGoal is ocp.InfeasibleGoalError
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        ocp.Nothing  # noqa: B018

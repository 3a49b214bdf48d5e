"""Tensions at the end of a plan."""

from __future__ import annotations

import numpy as np
import pytest
from moving_prism import PRISM, problem, rise

import ocp
import tenscasadi as tc


@pytest.mark.parametrize("control", [tc.ForceDensity(), tc.Tension()], ids=repr)
def test_plan_ends_with_prescribed_tensions(control):
    model = tc.Model(tc.Scene(PRISM.replace(pinned=(0, 1, 2)), control=control))
    limits = np.full(9, np.inf)
    limits[3:] = 5.0
    bound = ocp.TerminalTensions(np.where(np.isfinite(limits), 5.0, 0.0), limits)
    plan = ocp.solve(problem(rise(), bound, model=model))
    assert plan.success, plan.message
    given = plan.input_tension
    end = plan.tension(end=True)[-1] if given is None else given[-1]
    np.testing.assert_allclose(end[3:], 5.0, rtol=1e-3)
    assert plan.tension()[5, 3:].min() < 4.0  # before the end, they are free


def test_problem_files_hold_the_limits(tmp_path):
    ocp.save_problem(problem(rise(), ocp.TerminalTensions(2.0, 9.0)), tmp_path / "problem.toml")
    again = ocp.load_problem(tmp_path / "problem.toml").bounds[1]
    assert (again.lower, again.upper) == (2.0, 9.0)


def test_wrong_fields_are_rejected():
    with pytest.raises(ValueError, match=r"TerminalTensions.lower and .upper are both None"):
        ocp.TerminalTensions()
    with pytest.raises(ValueError, match="lower is 3 and upper is 2 for string 0"):
        problem(rise(), ocp.TerminalTensions(3.0, 2.0))

"""Two strings between the same two nodes: each has its own law, and together they act as the sum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from planning import save_and_load

import ocp
import tenscasadi as tc
from ocp.plan.plan_files import find_differences

RIG = {"nodes": [(0, 0, 0), (1, 0, 0)], "node_mass": [0.0, 2.0], "pinned": [0]}


def test_equal_ones_swing_as_one_of_both_stiffnesses() -> None:
    pair = tc.Structure(
        **RIG, strings=[(0, 1), (1, 0)], stiffness=[60.0, 40.0], damping=[1.8, 1.2], rest_length=0.9
    )  # alike, as slack takes each at its own time
    one = tc.Structure(**RIG, strings=[(0, 1)], stiffness=100.0, damping=3.0, rest_length=0.9)
    ends = [tc.simulate(tc.Model(tc.Scene(s)), 0.4, 1e-3, compiled=False) for s in (pair, one)]
    np.testing.assert_allclose(ends[0].nodes, ends[1].nodes, rtol=0, atol=1e-14)
    np.testing.assert_allclose(
        ends[0].tension.sum(axis=1), ends[1].tension[:, 0], rtol=0, atol=1e-11
    )


def test_one_goes_slack_before_the_other() -> None:
    """Two parts of a parabola: ω² = k/m with both, with one where the other is slack."""
    pair = tc.Structure(
        **RIG, strings=[(0, 1), (0, 1)], stiffness=[50.0, 50.0], rest_length=[0.8, 0.9]
    )
    run = tc.simulate(
        tc.Model(tc.Scene(pair)), 0.5, 0.05, tc.DormandPrince853(rtol=1e-11), compiled=False
    )
    first, second = (
        np.sqrt(50.0),
        5.0,
    )  # rad/s: of 100 N/m about 0.85 m and of 50 N/m about 0.8 m, on 2 kg
    meet = np.arccos((0.9 - 0.85) / 0.15) / first
    speed = -0.15 * first * np.sin(first * meet)
    after = second * (run.time - meet)
    early, late = (
        0.85 + 0.15 * np.cos(first * run.time),
        0.8 + 0.1 * np.cos(after) + speed / second * np.sin(after),
    )
    taut = late > 0.8
    np.testing.assert_allclose(
        run.nodes[taut, 1, 0], np.where(run.time < meet, early, late)[taut], rtol=0, atol=1e-9
    )
    assert taut[run.time > meet].any()


def test_they_carry_a_load_together_and_have_a_self_stress() -> None:
    pair = tc.Structure(**RIG, strings=[(0, 1), (1, 0)])
    np.testing.assert_allclose(abs(tc.self_stress(pair)), np.sqrt([[0.5, 0.5]]))
    np.testing.assert_allclose(
        tc.equilibrium_force_density(pair, loads=[(0, 0, 0), (5, 0, 0)]), [2.5, 2.5]
    )


def test_segments_files_and_plans(tmp_path: Path) -> None:
    pair = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        strings=[(0, 1), (0, 1), (1, 2)],
        node_mass=[0, 1, 0],
        pinned=[0, 2],
        string_mass=0.1,
    )
    assert tc.Scene(pair, segments=2).modelled.string_parent.tolist() == [0, 0, 1, 1, 2, 2]
    model = tc.Model(tc.Scene(pair, control=tc.ForceDensity()))
    again = save_and_load(model=model)["model"]
    assert not list(find_differences(again, model, "Model"))
    problem = ocp.Problem(
        model,
        duration=1.0,
        goals=[ocp.NodePositions({1: (0.8, 0.2, None)})],
        bounds=[ocp.ForceDensityLimits(0.0, 50.0)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem, ocp.Variational(intervals=10))
    assert plan.success, plan.message
    np.testing.assert_allclose(
        plan.force_density[:, 0], plan.force_density[:, 1], atol=1e-4
    )  # least effort: both alike
    plan.save(tmp_path / "plan.npz")
    assert ocp.Plan.load(tmp_path / "plan.npz").force_density.shape == (10, 3)


def test_bars_between_the_same_nodes_are_refused() -> None:
    with pytest.raises(ValueError, match="bars: bars 0 and 1 join the same nodes 1 and 0"):
        tc.Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1), (1, 0)])

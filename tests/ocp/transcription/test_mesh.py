"""Meshes and profiles: unequal intervals, linear and grouped force densities, wrong values."""

from __future__ import annotations

import numpy as np
import pytest
from planning import GROUPS, integrated, raising

import ocp

LINEAR = ocp.PiecewiseLinear()


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(ocp.MultipleShooting, marks=pytest.mark.slow),
        ocp.ImplicitMidpoint,
        ocp.Variational,
    ],
    ids=lambda kind: kind.__name__,
)
def test_linear_force_densities(make):
    problem = raising(costs=[ocp.Effort(), ocp.Smoothness(1e-3)])
    found = ocp.solve(problem, make(12, control=LINEAR))
    assert found.success
    assert found.linear
    assert found.force_density.shape == (13, 9)
    assert found.tension(end=True)[:-1] == pytest.approx(found.tension()[1:])
    assert found.rest_lengths(500.0).shape == (13, 9)
    assert found.replay_error < 2e-3
    assert found.replay(step=1e-3).nodes[-1] == pytest.approx(found.replay().nodes[-1], abs=1e-4)


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(ocp.MultipleShooting, marks=pytest.mark.slow),
        ocp.ImplicitMidpoint,
        ocp.Variational,
    ],
    ids=lambda kind: kind.__name__,
)
def test_few_changes(make):
    problem = raising()
    few, fewer, many = (
        ocp.solve(problem, make(14, control=ocp.PiecewiseConstant(max_changes=n)))
        for n in (6, 3, 13)
    )
    assert few.success
    assert fewer.success
    assert few.force_density == pytest.approx(np.repeat(few.force_density[::2], 2, axis=0), abs=0)
    assert [len(np.unique(plan.force_density, axis=0)) for plan in (few, fewer, many)] == [7, 4, 14]
    assert len(fewer.duals["force density of string 0"]) == 4
    assert (
        fewer.objective
        > few.objective
        > many.objective
        == pytest.approx(ocp.solve(problem, make(14)).objective, rel=1e-9)
    )
    assert np.abs(fewer.model.nodes(integrated(fewer)) - fewer.trajectory.nodes[-1]).max() < 5e-3


def test_goals_need_changes():
    plan = ocp.solve(raising(), ocp.Variational(14, control=ocp.PiecewiseConstant(max_changes=0)))
    assert not plan.success
    assert "18 rows of goals need more than 9 controls before them" in plan.message
    with pytest.raises(ValueError, match=r"PiecewiseConstant.max_changes"):
        ocp.PiecewiseConstant(max_changes=-1)


@pytest.mark.parametrize(
    "make", [ocp.MultipleShooting, ocp.Variational], ids=lambda kind: kind.__name__
)
def test_unequal_intervals(make, tmp_path):
    shares = np.linspace(1.0, 3.0, 12)
    found = ocp.solve(raising(), make(shares))
    assert found.success
    assert np.diff(found.time) == pytest.approx(shares / shares.sum())
    assert found.replay_error < 1e-3
    effort = np.sum(np.diff(found.time)[:, None] * found.force_density**2)
    assert found.objective == pytest.approx(effort, rel=1e-6)
    loaded = ocp.Plan.load(found.save(tmp_path / "plan.npz"))
    assert np.array_equal(loaded.replay().states, found.replay().states)


def test_equal_shares_are_equal_intervals():
    even, shares = (
        ocp.solve(raising(), ocp.Variational(10)),
        ocp.solve(raising(), ocp.Variational([2.0] * 10)),
    )
    assert shares.force_density == pytest.approx(even.force_density, rel=1e-9)


def test_groups_share_their_force_density():
    found = ocp.solve(raising(), ocp.Variational(12, control=ocp.PiecewiseConstant(GROUPS)))
    assert found.success
    for group in GROUPS:
        assert np.ptp(found.force_density[:, group], axis=1).max() == 0.0
    assert found.objective == pytest.approx(
        ocp.solve(raising(), ocp.Variational(12)).objective, rel=1e-4
    )  # which is symmetric by itself
    with pytest.raises(
        ValueError, match=r"PiecewiseConstant.groups\[0\]\[1\] is 9: string indices run from 0 to 8"
    ):
        ocp.solve(raising(), ocp.Variational(12, control=ocp.PiecewiseConstant(((0, 9),))))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ocp.Variational(0), "Variational.intervals is 0: it must be at least 1"),
        (lambda: ocp.Variational([]), "Variational.intervals is empty"),
        (lambda: ocp.Variational([1.0, -1.0]), r"Variational.intervals\[1\] is -1"),
        (
            lambda: ocp.PiecewiseLinear(((0, 1), (1, 2))),
            "PiecewiseLinear.groups has string 1 twice",
        ),
    ],
)
def test_wrong_values_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_wrong_types_are_refused():
    with pytest.raises(TypeError, match=r"Variational.control is 'linear'"):
        ocp.Variational(5, control="linear")
    with pytest.raises(TypeError, match=r"PiecewiseConstant\.groups"):
        ocp.PiecewiseConstant(5)


@pytest.mark.parametrize(
    "build",
    [
        lambda groups: ocp.PiecewiseConstant(groups=groups),
        lambda groups: ocp.Sampling(groups=groups),
        lambda groups: ocp.SplineNoise(1.0, groups=groups),
    ],
    ids=["PiecewiseConstant", "Sampling", "SplineNoise"],
)
def test_groups_are_read_alike(build):
    assert build([[0, 2], ["long", 1]]).groups == ((0, 2), ("long", 1))
    with pytest.raises(ValueError, match=r"\.groups has string 2 twice: give each string once"):
        build([[0, 2], [2]])
    with pytest.raises(TypeError, match=r"\.groups\[1\] is 3: give a list, such as \(0, 1, 2\)"):
        build([[0, 2], 3])
    with pytest.raises(TypeError, match=r"\.groups is 3: give a list, such as \(\(0, 1, 2\), "):
        build(3)

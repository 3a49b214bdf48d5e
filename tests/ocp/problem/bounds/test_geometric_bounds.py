"""Limits of places: boxes, bars that keep apart, obstacles."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import driven, prism
from rising import MODEL, raised
from scipy.sparse import coo_matrix

import ocp
import tenscasadi as tc
from ocp.problem.bounds.geometric_bounds import segment_distance


def test_bars_keep_clear_of_each_other(free):
    def gap(plan):
        return min(true_distance(*state[[0, 4]], *state[[1, 5]]) for state in plan.trajectory.nodes)

    least = true_distance(*MODEL.structure.nodes[[0, 4]], *MODEL.structure.nodes[[1, 5]])
    plan = raised(ocp.BarClearance(0.5 * least))
    assert plan.success
    assert gap(plan) > 0.5 * least
    with pytest.raises(ValueError, match=r"Problem.start has clearance of bars \d and \d"):
        raised(ocp.BarClearance(1.1 * least))


def true_distance(a, b, c, d):
    """By trying points along both segments."""
    s = np.linspace(0, 1, 201)
    return np.linalg.norm(
        (a + s[:, None] * (b - a))[:, None] - (c + s[:, None] * (d - c))[None], axis=2
    ).min()


@pytest.mark.parametrize("seed", range(20))
def test_the_distance_of_segments(seed):
    a, b, c, d = np.random.default_rng(seed).normal(size=(4, 3))
    symbols = [ca.SX.sym("p", 3) for _ in range(4)]
    value = float(ca.Function("d", symbols, [segment_distance(*symbols)])(a, b, c, d))
    exact = true_distance(a, b, c, d)
    assert exact * 0.999 - 1e-3 < value < exact + 0.03


def test_parallel_bars_have_a_distance():
    symbols = [ca.SX.sym("p", 3) for _ in range(4)]
    slope = ca.Function(
        "d",
        symbols,
        [segment_distance(*symbols), ca.jacobian(segment_distance(*symbols), symbols[0])],
    )
    value, gradient = slope([0, 0, 0], [1, 0, 0], [0, 0.3, 0], [1, 0.3, 0])
    assert float(value) == pytest.approx(0.3, rel=1e-3)
    assert np.all(np.isfinite(gradient.full()))


def arm():
    """A bar on a hinge between two strings, in the plane."""
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    return tc.Structure(
        nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5]
    )


def swung(*bounds):
    start = arm().nodes.copy()
    start[1] = (-0.6, 0.1, np.sqrt(1 - 0.37))
    goals = [ocp.NodePositions({1: (0.6, 0.1, None)}), ocp.AtRest()]
    problem = ocp.Problem(
        driven(arm()),
        1.0,
        start,
        goals=goals,
        bounds=bounds,
        costs=[ocp.Effort(), ocp.Smoothness(1e-3)],
    )
    return ocp.solve(problem, ocp.MultipleShooting(16))


@pytest.fixture(scope="module")
def over():
    return swung()


def test_an_arm_goes_round_an_obstacle(over):
    centre = np.array([0.0, -0.05, 0.9])
    round_it = swung(ocp.Obstacle(centre, 0.2))
    assert over.success
    assert round_it.success, round_it.message
    least = [
        min(true_distance(*state[[0, 1]], centre, centre + 1e-9) for state in plan.trajectory.nodes)
        for plan in (over, round_it)
    ]
    assert least[0] < 0.19
    assert least[1] > 0.199


def test_bounds_of_one_kind_are_told_apart():
    tight, close = ocp.Obstacle((0.0, -0.05, 0.9), 0.25), ocp.Obstacle((0.0, 0.55, 0.83), 0.38)
    plan = swung(tight, close)
    assert plan.success, plan.message
    found = {one.name: one for one in plan.report().active if one.name.startswith("obstacle")}
    names = [f"obstacle clear of bar 0 (bounds[{k}])" for k in (0, 1)]
    assert [found[name].limit for name in names] == [0.25, 0.38]
    for name in names:
        assert found[name].dual == pytest.approx(-plan.duals[name].sum(), rel=1e-3)
        assert found[name].dual > 1.0
    with pytest.raises(KeyError, match=r"bounds\[0\].* or .*bounds\[1\]"):
        plan.duals["obstacle clear of bar 0"]


def test_an_arm_stays_in_its_box(over):
    low = swung(ocp.InsideBox(upper=(None, None, 0.95), nodes=[1]))
    assert low.success, low.message
    assert over.trajectory.nodes[:, 1, 2].max() > 0.98
    assert low.trajectory.nodes[:, 1, 2].max() == pytest.approx(0.95, abs=1e-6)


def test_the_ground_is_a_box():
    assert ocp.AboveGround(0.1, nodes=[2]).corners()[0] == pytest.approx([-np.inf, -np.inf, 0.1])


BAD = {
    "box open": (lambda: ocp.InsideBox(), ValueError, "InsideBox.lower and .upper are open"),
    "box inside out": (
        lambda: ocp.InsideBox((1, None, None), (0, None, None)),
        ValueError,
        "InsideBox.lower is 1",
    ),
    "box of two": (lambda: ocp.InsideBox((1, None)), ValueError, "InsideBox.lower"),
    "box of a number": (lambda: ocp.InsideBox(1.0), TypeError, "InsideBox.lower"),
    "box without a node": (
        lambda: raised(ocp.AboveGround(-1.0, nodes=[7])),
        ValueError,
        r"InsideBox.nodes\[0\] is 7",
    ),
    "start below ground": (
        lambda: raised(ocp.AboveGround(0.5)),
        ValueError,
        "Problem.start has z of node 0 at 0",
    ),
    "pin below ground": (
        lambda: raised(ocp.AboveGround(0.5), model=driven(prism(1.0, pinned=[0]))),
        ValueError,
        "leaves out node 0",
    ),
    "clearance negative": (lambda: ocp.BarClearance(-0.1), ValueError, "BarClearance.distance"),
    "clearance of no bar": (
        lambda: raised(ocp.BarClearance(0.1, [(0, 3)])),
        ValueError,
        "BarClearance.pairs: bar is 3: bar indices run from 0 to 2",
    ),
    "clearance of one bar": (
        lambda: ocp.BarClearance(0.1, (0, 1)),
        TypeError,
        r"BarClearance.pairs\[0\] is 0: give a list",
    ),
    "clearance of three bars": (
        lambda: ocp.BarClearance(0.1, [(0, 1, 2)]),
        ValueError,
        r"BarClearance.pairs\[0\] is \(0, 1, 2\): give two bars",
    ),
    "box of one node": (
        lambda: ocp.AboveGround(-1.0, nodes=3),
        TypeError,
        "InsideBox.nodes is 3: give a list",
    ),
    "obstacle of one bar": (
        lambda: ocp.Obstacle((9, 0, 0), 1.0, bars=3),
        TypeError,
        "Obstacle.bars is 3: give a list",
    ),
    "clearance of a sparse matrix": (
        lambda: ocp.BarClearance(0.1, coo_matrix(np.eye(2))),
        TypeError,
        "BarClearance.pairs is",
    ),
    "obstacle of a matrix of CasADi": (
        lambda: ocp.Obstacle((9, 0, 0), 1.0, bars=ca.DM.eye(2)),
        TypeError,
        "Obstacle.bars is",
    ),
    "goals sparse": (
        lambda: ocp.FreeStart(goals=coo_matrix(np.eye(2))),
        TypeError,
        "FreeStart.goals is",
    ),
    "clearance at a joint": (
        lambda: ocp.Problem(driven(tc.shapes.d_bar()), bounds=[ocp.BarClearance(0.1, [(0, 1)])]),
        ValueError,
        "bars 0 and 1 share a node",
    ),
    "obstacle of no size": (lambda: ocp.Obstacle((0, 0, 0), 0.0), ValueError, "Obstacle.radius"),
    "obstacle of no bar": (
        lambda: raised(ocp.Obstacle((9, 0, 0), 1.0, bars=[5])),
        ValueError,
        r"Obstacle.bars\[0\] is 5",
    ),
    "start in obstacle": (
        lambda: raised(ocp.Obstacle(prism(1.0).nodes[0], 0.1)),
        ValueError,
        "Problem.start has obstacle clear of bar",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_limits_of_places_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()

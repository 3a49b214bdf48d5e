"""Recommendations on scenes that nothing was tuned on: they meet the tolerance, at no more than twice the cost of the best of a fine grid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.correction import projection
from tenscasadi.recommend import SCHEMES
from tenscasadi.reference import distance
from tenscasadi.runners import own_steps


def turning(structure, **scene):
    """A model and its start: it turns about the origin as a rigid body."""
    model = tc.Model(tc.Scene(structure, **scene))
    return model, model.state(structure.nodes, np.cross((1.0, 2.0, 3.0), structure.nodes))


def pendulum():
    return turning(tc.shapes.pendulum(angle=2.0), gravity=tc.Gravity())


def five_bars():
    return turning(tc.shapes.prism(bars=5, prestress=30.0), control=tc.ForceDensity(), gravity=tc.Gravity())


def t_bar():
    """Goes slack, damped."""
    structure = tc.shapes.t_bar(prestress=30.0, stiffness=300.0, pinned=[4], damping=1.0)
    return turning(structure, gravity=tc.Gravity())


def stiff():
    return turning(tc.shapes.prism(prestress=100.0, stiffness=1e5))


def slack_ball():
    ball = tc.shapes.six_bar_ball(prestress=2.0, stiffness=300.0)
    model = tc.Model(tc.Scene(ball))
    wild = model.state(ball.nodes, 2 * np.random.default_rng(1).normal(size=ball.nodes.shape))
    return model, projection(model)(wild).full().ravel()


SLOW = [
    (pendulum, 2.0, 1e-6),
    (five_bars, 1.0, 1e-4),
    (five_bars, 1.0, 1e-9),
    (t_bar, 1.0, 1e-3),
    (t_bar, 1.0, 1e-6),
    (stiff, 0.3, 1e-3),
    (stiff, 0.3, 1e-7),
    (slack_ball, 1.0, 1e-3),
    (slack_ball, 1.0, 1e-6),
]
CASES = [
    (pendulum, 2.0, 1e-6, (tc.DormandPrince853(), tc.RungeKutta4(), tc.DormandPrince54(rtol=1e-6))),
    *(pytest.param(*case, SCHEMES, marks=pytest.mark.slow) for case in SLOW),
]


@pytest.mark.parametrize(("scene", "t_end", "tolerance", "schemes"), CASES)
def test_meets_the_tolerance_at_no_more_than_twice_the_cost_of_the_best(scene, t_end, tolerance, schemes):
    model, start = scene()
    advice = tc.recommend(model, t_end, tolerance, start, schemes=schemes)
    run = tc.simulate(model, t_end, state=start, **advice.options)
    reference = tc.certify(model, t_end, start)
    error = distance(run.nodes[-1], reference.nodes) + reference.error
    assert error <= tolerance
    assert error == pytest.approx(advice.error, abs=0.11 * tolerance)  # that of the reference it was measured against

    fixed = [scheme for scheme in schemes if not own_steps(scheme)]
    steps = t_end / np.unique(np.geomspace(4, 4000, 28).astype(int))
    tables = [tc.tradeoff(model, t_end, fixed, steps, reference, start, corrections=(None, tc.Projection()), repeats=1)]
    own = [replace(scheme, rtol=float(rtol)) for scheme in schemes if own_steps(scheme) for rtol in np.geomspace(1e-9, 1e-3, 5)]
    tables.append(tc.tradeoff(model, t_end, own, [t_end / 20], reference, start, compiled=(False,), repeats=1))
    rows = [row for table in tables for row in table.rows if row.success and row.position + reference.error <= tolerance]
    assert len(rows) >= 3
    assert advice.work <= 2 * min(row.work for row in rows)


def test_a_scene_will_do():
    advice = tc.recommend(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), 0.5, 1e-4, schemes=[tc.RungeKutta4()], compiled=False)
    assert advice.scheme == tc.RungeKutta4()
    assert 0 < advice.error <= 1e-4
    assert advice.seconds > 0
    assert "compared with RungeKutta4; reference: DormandPrince853" in advice.message


def test_what_cannot_serve_is_left_out_and_told():
    scene = tc.Scene(tc.shapes.pendulum(), supports=tc.SupportMotion({0: lambda t: (0.1 * t, 0.0, 0.0)}), gravity=tc.Gravity())
    advice = tc.recommend(scene, 0.2, 1e-4, schemes=[tc.Rattle(), tc.RungeKutta4()], compiled=False)
    assert advice.scheme == tc.RungeKutta4()
    assert "Rattle left out" in advice.message


def test_none_that_serves_is_told():
    scene = tc.Scene(tc.shapes.pendulum(), supports=tc.SupportMotion({0: lambda t: (0.1 * t, 0.0, 0.0)}), gravity=tc.Gravity())
    with pytest.raises(tc.NoScheme, match=r"none of Rattle meets it"):
        tc.recommend(scene, 0.2, 1e-4, schemes=[tc.Rattle()], compiled=False)


def test_a_tolerance_beyond_rounding_has_no_reference():
    with pytest.raises(tc.NoReference, match=r"wanted 1e-21 m"):
        tc.recommend(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), 0.5, 1e-20, compiled=False)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"what": 3}, "what"),
        ({"t_end": 0}, "t_end"),
        ({"tolerance": -1}, "tolerance"),
        ({"schemes": [tc.RungeKutta4]}, "scheme"),
        ({"schemes": [tc.Cvodes()]}, "explicit"),
        ({"schemes": []}, "schemes"),
        ({"corrections": []}, "corrections"),
        ({"corrections": ["yes"]}, "corrections"),
        ({"state": np.zeros(2)}, "state"),
    ],
)
def test_wrong_input_is_named(change, named):
    arguments = {"what": tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()), "t_end": 0.1, "tolerance": 1e-3, "compiled": False, **change}
    with pytest.raises((TypeError, ValueError), match=named):
        tc.recommend(**arguments)

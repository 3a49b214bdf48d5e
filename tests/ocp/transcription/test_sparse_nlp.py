"""Sparse programs: derivatives put together from blocks are exact, rows are found by kind."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import GROUPS, driven, prism, program, raising

import ocp
import tenscasadi as tc

LINEAR = ocp.PiecewiseLinear()

METHODS = [
    ocp.MultipleShooting(3),
    ocp.ImplicitMidpoint(3),
    ocp.Variational(3),
    ocp.DirectCollocation(3, degree=2),
    ocp.MultipleShooting((1, 2, 1), control=LINEAR),
    ocp.ImplicitMidpoint((1, 2, 1), control=LINEAR),
    ocp.Variational((1, 2, 1), control=ocp.PiecewiseLinear(GROUPS)),
    ocp.DirectCollocation(3, degree=1, control=ocp.PiecewiseConstant(GROUPS)),
]

ASKED = {
    "duration": (0.8, 1.2),
    "costs": [
        ocp.Effort(2.0),
        ocp.Smoothness(0.1),
        ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities)),
        ocp.Duration(1.0),
    ],
    "bounds": [ocp.ForceDensityLimits(5.0, 100.0), ocp.TensionLimits(upper=50.0)],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "transcription",
    METHODS,
    ids=lambda value: f"{type(value).__name__}-{type(value.control).__name__}",
)
def test_derivatives_put_together_from_blocks_are_those_of_the_whole(transcription):
    built = program(
        raising(
            model=driven(prism(1.0), forces=tc.NodalForce(lambda t: np.full((6, 3), 0.1) * t)),
            **ASKED,
        ),
        transcription,
    )
    w, f, g = (built.problem[name] for name in "xfg")
    rng = np.random.default_rng(0)
    at, weights = built.first + 0.1 * rng.normal(size=w.shape[0]), rng.normal(size=g.shape[0])
    lam = ca.MX.sym("lam", g.shape[0])
    whole = ca.Function(
        "whole",
        [w, lam],
        [ca.gradient(f, w), ca.jacobian(g, w), ca.triu(ca.hessian(0.7 * f + ca.dot(lam, g), w)[0])],
    )(at, weights)
    exact = built.derivatives()
    parts = (
        exact["nlp_grad_f"](at, [])[1],
        exact["nlp_jac_g"](at, [])[1],
        exact["nlp_hess_l"](at, [], 0.7, weights),
    )
    for one, other in zip(parts, whole, strict=True):
        size = np.abs(other.full()).max()
        assert one.full() == pytest.approx(other.full(), rel=1e-9, abs=1e-12 * size)
    assert len(built.names) == g.shape[0]
    assert len(built.w_names) == w.shape[0]


def test_rows_are_found_by_kind():
    goals = [ocp.Waypoint([ocp.AtRest()], share=0.5), *raising().goals]
    built = program(
        raising(goals=goals, bounds=[ocp.TensionLimits(upper=12.0)]), ocp.MultipleShooting(4)
    )
    motion = [*built.rows("stage"), *built.rows("defect")]
    assert all(name.startswith("dynamics of") for rows in motion for name in built.names[rows])
    beginnings = {
        "path": "tension of",
        "waypoint": "goal of waypoint 0, combination",
        "end": "goal, combination",
    }
    for kind, beginning in beginnings.items():
        found = [name for rows in built.rows(kind) for name in built.names[rows]]
        assert found
        assert found == [name for name in built.names if name.startswith(beginning)]
    dependent = [name for rows in built.rows("dependent") for name in built.names[rows]]
    assert dependent
    assert all(name.startswith(("goal of waypoint 0, AtRest", "goal, ")) for name in dependent)
    kinds = ("stage", "defect", "dependent", *beginnings)
    assert sum(rows.stop - rows.start for rows in built.rows(*kinds)) == len(built.names)
    assert not built.rows("start", "periodic")


@pytest.mark.parametrize(
    "make",
    [
        pytest.param(ocp.MultipleShooting, marks=pytest.mark.slow),
        ocp.ImplicitMidpoint,
        ocp.Variational,
    ],
    ids=lambda kind: kind.__name__,
)
def test_large_structures_have_the_same_derivatives(make, monkeypatch):
    """Their equations are kept as vector operations, which CasADi differentiates by whole symbols."""
    values = []
    for large in (False, True):
        if large:
            monkeypatch.setattr("tenscasadi.dynamics.mechanism.UNROLL_MEMBERS", 0)
        model = driven(prism(1.0))
        assert model.ode.is_a("SXFunction") != large
        exact = program(raising(model=model, **ASKED), make(2)).derivatives()
        at = 0.1 * np.random.default_rng(0).normal(size=exact["nlp_jac_g"].size1_in(0))
        J = exact["nlp_jac_g"](at, [])[1]
        values.append((J.full(), exact["nlp_hess_l"](at, [], 0.7, np.ones(J.shape[0])).full()))
    for one, other in zip(*values, strict=True):
        assert other == pytest.approx(one, rel=1e-6, abs=1e-8 * np.abs(one).max())

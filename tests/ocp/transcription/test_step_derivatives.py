"""Derivatives of steps from those of their stages: those of the whole step, by CasADi and by differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from planning import GROUPS, driven, folding, prism, program, raising

import ocp
import tenscasadi as tc
from ocp.transcription.interval_step import ramped_step, shooting_step
from ocp.transcription.mesh import group_matrix
from ocp.transcription.step_derivatives import StepDerivatives

COUNT, SHARE, DURATION = 3, np.array([[0.1], [0.2], [0.15]]), 0.4


def pulled(time):
    return 0.5 * np.ones((6, 3)) * time**2


PINNED = {"pinned": [0]}
MODELS = {
    "bars alone": lambda: driven(prism(1.0)),
    "a clock": lambda: driven(prism(1.0), forces=tc.NodalForce(pulled)),
    "a ground": lambda: driven(prism(1.0), gravity=tc.Gravity(), ground=tc.Ground()),
    "bars that meet": lambda: driven(tc.shapes.d_bar(**PINNED)),
    "full coordinates": lambda: tc.Model(
        tc.Scene(tc.shapes.d_bar(**PINNED), control=tc.ForceDensity()), coordinates="full"
    ),
}
RK4, TWICE = tc.RungeKutta4(), 2


class Point:
    """Some intervals of a model, and the end of an interval as one Function (x, c, T, share)."""

    def __init__(self, model, scheme, substeps, linear, groups):
        rng = np.random.default_rng(0)
        m = groups.shape[1]
        self.x = model.initial_state + 0.05 * rng.standard_normal((COUNT, model.nx))
        self.c = rng.uniform(5, 15, (COUNT, m * (1 + linear)))
        self.weights = rng.standard_normal((COUNT, model.nx))
        z, share = ca.MX.sym("z", model.nx + self.c.shape[1] + 1), ca.MX.sym("share")
        x, c, h = z[: model.nx], z[model.nx : -1], z[-1] * share
        E = ca.DM(groups)
        ends = [ca.mtimes(E, c[:m]), ca.mtimes(E, c[m:])] if linear else [ca.mtimes(E, c)]
        end = (ramped_step if linear else shooting_step)(model, scheme, substeps)(x, *ends, h)
        self.end = ca.Function("end", [z, share], [end])
        self.scalar = model.ode.is_a("SXFunction")
        self.z = np.hstack([self.x, self.c, np.full((COUNT, 1), DURATION)])

    def inputs(self, z=None):
        z = self.z if z is None else z
        nx = self.x.shape[1]
        return (
            np.ascontiguousarray(z[:, :nx]),
            np.ascontiguousarray(z[:, nx:-1]),
            np.ascontiguousarray(z[:, -1:]),
            SHARE,
        )

    def whole(self):
        """Jacobian and Hessian that CasADi derives from the whole step."""
        function = self.end.expand() if self.scalar else self.end
        kind = ca.SX if function.is_a("SXFunction") else ca.MX
        z, share, weights = (
            kind.sym("z", self.z.shape[1]),
            kind.sym("share"),
            kind.sym("weights", self.x.shape[1]),
        )
        end = function(z, share)
        both = ca.Function(
            "both",
            [z, share, weights],
            [ca.jacobian(end, z), ca.hessian(ca.dot(weights, end), z)[0]],
        )
        values = [both(*given) for given in zip(self.z, SHARE, self.weights, strict=True)]
        return tuple(np.array([value[k].full() for value in values]) for k in (0, 1))


def close(one, other, tolerance):
    return np.abs(one - other).max() <= tolerance * np.abs(other).max()


@pytest.mark.parametrize("free_time", [False, True], ids=["given duration", "free duration"])
@pytest.mark.parametrize(
    ("make", "scheme", "substeps", "linear"),
    [
        ("bars alone", RK4, 1, False),
        ("bars alone", RK4, TWICE, True),
        ("a clock", RK4, TWICE, False),
        ("a ground", RK4, 1, False),
        ("bars that meet", tc.DormandPrince54(), TWICE, True),
        ("full coordinates", RK4, 1, False),
        ("bars that meet", tc.Collocation(2), TWICE, True),
        ("a clock", tc.Collocation(2, "radau"), 1, False),
    ],
)
def test_derivatives_are_those_of_the_whole_step(make, scheme, substeps, linear, free_time):
    model = MODELS[make]()
    groups = np.eye(model.nu)
    point = Point(model, scheme, substeps, linear, groups)
    parts = StepDerivatives(model, groups, scheme, substeps, linear, free_time, COUNT)
    J, H = point.whole()
    own = parts.jacobian(*point.inputs()).transpose(0, 2, 1)
    assert close(own, J[:, :, : parts.size], 1e-11)
    assert close(
        parts.hessian(*point.inputs(), point.weights), H[:, : parts.size, : parts.size], 1e-10
    )


def test_derivatives_are_differences():
    """Of a step that runs as a plan does, with groups of strings and ramps."""
    model, groups = (
        driven(prism(1.0, stiffness=500.0), gravity=tc.Gravity()),
        group_matrix(ocp.PiecewiseLinear(GROUPS), 9),
    )
    point = Point(model, RK4, TWICE, True, groups)
    parts = StepDerivatives(model, groups, RK4, TWICE, True, True, COUNT)
    J, H = parts.jacobian(*point.inputs()), parts.hessian(*point.inputs(), point.weights)
    step = 1e-6
    for k in range(parts.size):
        moved = step * (np.arange(parts.size) == k)
        ahead, behind = (
            np.array(
                [point.end(z, s).full().ravel() for z, s in zip(point.z + d, SHARE, strict=True)]
            )
            for d in (moved, -moved)
        )
        assert (ahead - behind) / (2 * step) == pytest.approx(
            J[:, k], rel=1e-5, abs=1e-7 * np.abs(J).max()
        )
        ahead, behind = (
            np.einsum("kpn,kn->kp", parts.jacobian(*point.inputs(point.z + d)), point.weights)
            for d in (moved, -moved)
        )
        assert (ahead - behind) / (2 * step) == pytest.approx(
            H[:, k], rel=1e-5, abs=1e-7 * np.abs(H).max()
        )


def test_a_point_is_seen_anew():
    """What is kept from the last Jacobian serves the same point only, also where the arrays are used again for another."""
    model = driven(prism(1.0))
    groups = np.eye(9)
    point = Point(model, RK4, 1, False, groups)
    parts = StepDerivatives(model, groups, RK4, 1, False, False, COUNT)
    fresh = StepDerivatives(model, groups, RK4, 1, False, False, COUNT)
    inputs = point.inputs()
    parts.jacobian(*inputs)
    inputs[0][:] += 0.01
    assert np.array_equal(
        parts.hessian(*inputs, point.weights), fresh.hessian(*inputs, point.weights)
    )


@pytest.mark.parametrize("make", [raising, folding])
def test_optima_are_those_of_unrolled_derivatives(make):
    problem, shooting = make(), ocp.MultipleShooting(6)
    built = program(problem, shooting)
    solved = ocp.Ipopt().solve(built)
    unrolled = ca.nlpsol(
        "unrolled",
        "ipopt",
        built.problem,
        {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-8,
            "ipopt.nlp_scaling_method": "none",
        },
    )
    found = unrolled(
        x0=built.first, lbx=built.w_lower, ubx=built.w_upper, lbg=built.lower, ubg=built.upper
    )
    assert solved.success
    objective = ca.Function("f", [built.problem["x"]], [built.problem["f"]])
    assert float(objective(solved.w)) == pytest.approx(float(found["f"]), rel=1e-6)

"""Schemes: what they offer and what they refuse."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.integrators.runge_kutta import DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme, check_scheme, stability_limit


def test_a_scheme_without_limit_has_an_infinite_step() -> None:
    class Midpoint:
        order = 2
        adaptive = False
        implicit = True

        def step(self, ode: ca.Function) -> ca.Function:
            raise NotImplementedError

        advance = step

        def amplification(self, z: np.ndarray) -> np.ndarray:
            return (1 + z / 2) / (1 - z / 2)

    assert stability_limit(Midpoint(), np.array([1j, -1.0 + 0j])).tolist() == [np.inf, np.inf]


@pytest.mark.parametrize("wrong", [RungeKutta4, "RK4", None, 4])
def test_what_is_no_scheme_is_refused(wrong: object) -> None:
    with pytest.raises(TypeError, match=r"scheme is .*RungeKutta4\(\)"):
        check_scheme(wrong)  # type: ignore[arg-type]


def test_a_scheme_that_lacks_a_member_is_told_which() -> None:
    class Euler:
        order = 1

        def step(self, ode: ca.Function) -> ca.Function:
            raise NotImplementedError

        def amplification(self, z: np.ndarray) -> np.ndarray:
            return 1 + z

    with pytest.raises(
        TypeError, match=r"Euler object .* and lacks adaptive, implicit, advance: give"
    ):
        check_scheme(Euler())  # type: ignore[arg-type]


class SymplecticEuler:
    """A scheme of one's own: velocities first, then positions with the new ones."""

    order, adaptive, implicit = 1, False, False

    def step(self, ode: ca.Function) -> ca.Function:
        raise TypeError("SymplecticEuler tells positions from velocities: use advance(model)")

    def advance(self, model: tc.Model, power: ca.Function | None = None) -> ca.Function:
        assert power is None
        x, u, h = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("h")
        v = x[model.nq :] + h * model.ode(x, u)[model.nq :]
        return ca.Function("step", [x, u, h], [ca.vertcat(x[: model.nq] + h * v, v)])

    def amplification(self, z: np.ndarray) -> np.ndarray:
        return np.where(np.abs(z) <= 2, 1.0, np.inf).astype(complex)


def test_a_scheme_of_ones_own_is_simulated_like_others() -> None:
    spring = tc.Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[0, 1.0],
        pinned=[0],
        stiffness=100.0,
        rest_length=0.9,
    )
    model = tc.Model(tc.Scene(spring))
    assert tc.stable_step(model, scheme=SymplecticEuler(), safety=1.0) == pytest.approx(
        0.2, rel=1e-3
    )
    coarse, fine = (
        tc.simulate(model, 0.1, step, SymplecticEuler(), compiled=False)
        for step in (2.5e-3, 1.25e-3)
    )
    assert fine.success
    exact = 0.9 + 0.1 * np.cos(10 * 0.1)  # taut all the while
    assert (coarse.nodes[-1, 1, 0] - exact) / (fine.nodes[-1, 1, 0] - exact) == pytest.approx(
        2, rel=0.05
    )


@pytest.mark.parametrize(
    "scheme",
    [RungeKutta4(), DormandPrince853(1e-6), tc.Rattle(), tc.Collocation(), tc.Cvodes(), tc.Idas()],
    ids=repr,
)
def test_what_is_no_model_is_refused(scheme: Scheme) -> None:
    for wrong in (tc.Scene(tc.shapes.prism()), tc.Model, 4, None):
        with pytest.raises(TypeError, match=r"^model is .*: give a tenscasadi\.Model$"):
            scheme.advance(wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^model is None: give a tenscasadi\.Model$"):
        DormandPrince853(1e-6).tolerances(None)  # type: ignore[arg-type]

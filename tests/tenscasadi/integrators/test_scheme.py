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

    with pytest.raises(TypeError, match=r"Euler object .* and lacks adaptive, implicit, advance: give"):
        check_scheme(Euler())  # type: ignore[arg-type]


@pytest.mark.parametrize("scheme", [RungeKutta4(), DormandPrince853(1e-6), tc.Rattle(), tc.Collocation(), tc.Cvodes(), tc.Idas()], ids=repr)
def test_what_is_no_model_is_refused(scheme: Scheme) -> None:
    for wrong in (tc.Scene(tc.shapes.prism()), tc.Model, 4, None):
        with pytest.raises(TypeError, match=r"^model is .*: give a tenscasadi\.Model$"):
            scheme.advance(wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"^model is None: give a tenscasadi\.Model$"):
        DormandPrince853(1e-6).tolerances(None)  # type: ignore[arg-type]

"""The string law: Hooke's law, damping, slack, and its inverse."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tenscasadi.scene.strings import Clip, Smooth, StringLaw, rest_length

POSITIVE = st.floats(1e-3, 1e3)


def gamma(slack: StringLaw, s: float, rho: float, k: float, rate: float | None = None) -> float:
    return float(
        slack.force_density(
            ca.DM(s * s), ca.DM(rho), ca.DM(k), None if rate is None else ca.DM(rate), ca.DM(rho)
        )
    )


def test_taut_slack_and_damped_values() -> None:
    assert gamma(Clip(), 2.0, 1.0, 100.0) == pytest.approx(50.0)  # k (1 − ρ/s)
    assert gamma(Clip(), 1.0, 2.0, 100.0) == 0.0
    assert gamma(Clip(), 2.0, 1.0, 100.0, rate=8.0) == pytest.approx(52.0)  # + c sᵀṡ/s²
    assert (
        gamma(Clip(), 2.0, 1.0, 100.0, rate=-1e4) == 0.0
    )  # a string cannot push, however fast it shortens
    assert gamma(Clip(), 1.0, 2.0, 100.0, rate=1e4) == 0.0  # nor does it damp while slack


@given(share=st.floats(0.05, 20), rho=POSITIVE, k=POSITIVE)
def test_force_density_is_never_negative_and_matches_the_energy_slope(
    share: float, rho: float, k: float
) -> None:
    s = share * rho
    for slack in (Clip(), Smooth(0.01 * rho)):
        value = gamma(slack, s, rho, k)
        assert value >= 0
        if abs(s - rho) < 1e-3 * rho:
            continue  # the clipped law has a corner there
        h = 1e-6 * s
        energies = [
            float(slack.energy(ca.DM((s + d) ** 2), ca.DM(rho), ca.DM(k), ca.DM(rho)))
            for d in (-h, h)
        ]
        assert (energies[1] - energies[0]) / (2 * h) == pytest.approx(
            value * s, rel=1e-4, abs=1e-6 * k * rho
        )


@given(s=POSITIVE, rho=POSITIVE)
def test_smooth_tension_is_within_half_its_width(s: float, rho: float) -> None:
    width = 0.05
    difference = s * (gamma(Smooth(width), s, rho, 10.0) - gamma(Clip(), s, rho, 10.0))
    assert -1e-9 <= difference <= 10.0 * width / 2 * (1 + 1e-9)


@given(s=POSITIVE, k=POSITIVE, share=st.floats(0, 0.99))
def test_rest_length_inverts_the_law(s: float, k: float, share: float) -> None:
    rho = rest_length(np.array([share * k]), np.array([s]), np.array([k]))
    assert gamma(Clip(), s, float(rho[0]), k) == pytest.approx(share * k, rel=1e-9, abs=1e-9 * k)


def test_second_derivatives_of_a_smooth_string_exist_everywhere() -> None:
    s = ca.SX.sym("s", 3)
    law = Smooth(1e-2).force_density(ca.dot(s, s), ca.SX(1.0), ca.SX(5.0), None, ca.SX(1.0))
    hessian = ca.Function("h", [s], [ca.hessian(law, s)[0]])
    for point in ([0, 0, 0], [1, 0, 0], [0.3, 0.2, 0.1], [2, 0, 0]):
        assert np.isfinite(hessian(ca.DM(point)).full()).all()


@pytest.mark.parametrize("width", [0.0, -1.0, float("nan"), "wide"])
def test_width_must_be_positive(width: object) -> None:
    with pytest.raises((ValueError, TypeError), match=r"Smooth\.width"):
        Smooth(width)  # type: ignore[arg-type]

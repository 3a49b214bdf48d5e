"""Random functions of time with declared breakpoints: no run that succeeds, and no certificate, is further off than it says.

The truth is SciPy's integration of the model's equations, cut at the features that the test itself
has put into the function.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import tenscasadi as tc

END = 1.0  # s
SKIPPED = 1e-13  # s, on both sides of a jump, where SciPy would look across it


class Feature(NamedTuple):
    """A part of a function of time, and the times between which it is smooth and wide."""

    value: Callable[[Any], Any]
    edges: list[float]


def bell(at: float, width: float, impulse: float) -> Feature:
    size = impulse / (width * np.sqrt(np.pi))
    return Feature(
        lambda t: size * ca.exp(-(((t - at) / width) ** 2)),
        [at + k * width for k in (-20, -6, -2, 0, 2, 6, 20)],
    )


def window(at: float, width: float, impulse: float) -> Feature:
    return Feature(lambda t: impulse / width * ((t > at) * (t < at + width)), [at, at + width])


def beats(rate: float, level: float, impulse: float) -> Feature:
    """On while a sine is near its top."""
    rise = np.arcsin(level)
    turns = 2 * np.pi * np.arange(int(rate * END / 6) + 2)
    width = (np.pi - 2 * rise) / rate
    edges = np.concatenate([(rise + turns) / rate, (np.pi - rise + turns) / rate])
    return Feature(lambda t: impulse / width * (ca.sin(rate * t) > level), edges.tolist())


def wave(rate: float, size: float) -> Feature:
    return Feature(lambda t: size * ca.sin(rate * t), np.arange(0, END, 3 / rate).tolist())


TIME, IMPULSE = st.floats(0.05, 0.95), st.sampled_from([-0.1, 0.02, 0.1])


def width(least: int) -> Any:
    return st.floats(least, -2).map(lambda power: 10.0**power)


FEATURES = st.one_of(
    st.builds(bell, TIME, width(-6), IMPULSE),
    st.builds(window, TIME, width(-5), IMPULSE),
    st.builds(
        beats, st.floats(10, 60), st.floats(3, 7).map(lambda power: 1 - 10.0**-power), IMPULSE
    ),
    st.builds(wave, st.floats(1, 400), st.floats(0.1, 3)),
)
SPRING = tc.Structure(
    [(0, 0, 0), (1, 0, 0)],
    strings=[(0, 1)],
    node_mass=[0, 1.5],
    pinned=[0],
    stiffness=20.0,
    rest_length=0.9,
)
BAR = tc.Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], pinned=[0])
SAIL = tc.Structure(
    [(0, 0, 0), (1, 0, 0), (0, 2, 0)],
    strings=[(0, 1), (1, 2)],
    node_mass=1.0,
    stiffness=15.0,
    rest_length=[0.8, 2.5],
)
SCENES: dict[str, Callable[[Any, Any], tc.Scene]] = {
    "force": lambda f, breakpoints: tc.Scene(
        SPRING,
        forces=tc.NodalForce(lambda t: [[0, 0, 0], [f(t), 0, 0.3 * f(t)]], breakpoints=breakpoints),
        slack=tc.Linear(),
    ),
    "gravity": lambda f, breakpoints: tc.Scene(
        BAR, gravity=tc.Gravity(lambda t: [0, 0, f(t)], breakpoints=breakpoints)
    ),
    "pressure": lambda f, breakpoints: tc.Scene(
        SAIL,
        pressure=tc.Pressure([(0, 1, 2)], f, breakpoints=breakpoints),
        slack={0: tc.Linear(), 1: tc.Linear()},
    ),
}


def truth(model: tc.Model, features: list[Feature]) -> Any:
    """Return the nodes at the end."""
    edges = np.unique(
        [0.0, END, *(edge for feature in features for edge in feature.edges if 0 < edge < END)]
    )
    x = model.initial_state.copy()
    for first, last in pairwise(edges):
        if last - first < 4 * SKIPPED:
            continue
        x[-1] = first + SKIPPED
        found = solve_ivp(
            lambda _, y: model.ode(y, []).full().ravel(),
            (first + SKIPPED, last - SKIPPED),
            x,
            "DOP853",
            rtol=1e-10,
            atol=1e-12,
        )
        x = found.y[:, -1]
    return model.nodes(x)


@pytest.mark.parametrize(
    "scheme", [tc.RungeKutta4(), tc.Rattle(), tc.Collocation(), tc.DormandPrince54(rtol=1e-8)]
)
@pytest.mark.parametrize(
    ("jumping", "impulse"),
    [
        (lambda t: ca.sign(t - 0.5), 1.0),
        (lambda t: ca.floor(2 * t), 3.0),
        (lambda t: ca.fmod(t, 0.4), 0.4),
        (lambda t: ca.if_else(t < 1, 3, 1), 4.0),
    ],
)
def test_steps_see_nothing_of_jumps_at_their_ends(
    jumping: Callable[[Any], Any], impulse: float, scheme: Any
) -> None:
    free = tc.Structure([(0, 0, 0)], node_mass=1.0)
    model = tc.Model(tc.Scene(free, forces=tc.NodalForce(lambda t: [[jumping(t), 0, 0]])))
    run = tc.simulate(model, 2.0, 0.01, scheme, compiled=False)
    assert run.velocities[-1, 0, 0] == pytest.approx(impulse, abs=1e-8)


def check(kind: str, features: list[Feature], certified: bool) -> None:
    def value(t: Any) -> Any:
        return sum((feature.value(t) for feature in features), start=0.5 + 0 * t)

    edges = [edge for feature in features for edge in feature.edges if 0 < edge < END]
    model = tc.Model(SCENES[kind](value, edges))
    wanted = truth(model, features)
    for scheme in (
        tc.DormandPrince853(rtol=1e-9),
        tc.DormandPrince54(rtol=1e-9),
        tc.Cvodes(rtol=1e-9),
    ):
        run = tc.simulate(model, END, 0.05, scheme, compiled=False, save_every=10**6)
        assert not run.success or abs(run.nodes[-1] - wanted).max() < 2e-6, (
            run.message,
            abs(run.nodes[-1] - wanted).max(),
        )
    if certified:
        try:
            found = tc.reference_solution(
                model,
                END,
                max_difference=1e-5,
                target_difference=1e-8,
                compiled=False,
                max_instructions=1e8,
            )
        except tc.NoReferenceError:
            return
        assert abs(found.nodes - wanted).max() < 5 * found.error + 2e-7, found.message


@pytest.mark.parametrize("kind", SCENES)
@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(features=st.lists(FEATURES, min_size=1, max_size=2))
@example(features=[bell(0.5, 1e-5, -0.1), bell(0.375, 10**-2.875, -0.1)])
def test_declared_features_are_followed(kind: str, features: list[Feature]) -> None:
    check(kind, features, certified=False)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCENES)
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(features=st.lists(FEATURES, min_size=1, max_size=3))
def test_declared_features_are_followed_and_certified(kind: str, features: list[Feature]) -> None:
    check(kind, features, certified=True)


PLACES = st.one_of(
    st.builds(lambda at, size: lambda t: size * (t > at), TIME, width(-6)),
    st.builds(
        lambda at, wide, size: lambda t: size * ((t > at) * (t < at + wide)),
        TIME,
        width(-7),
        width(-4),
    ),
    st.builds(lambda at, size: lambda t: size * ca.fmax(t - at, 0), TIME, width(-4)),
    st.builds(lambda at, size: lambda t: size * ca.fabs(t - at) - size * at, TIME, width(-4)),
    st.builds(lambda size: lambda t: size * ca.sqrt(t), width(-4)),
    st.builds(lambda at, size: lambda t: size * ca.fmax(t - at, 0) ** 2, TIME, st.floats(0.01, 1)),
    st.builds(
        lambda rate, size: lambda t: size * ca.sin(rate * t) / rate,
        st.floats(1, 50),
        st.floats(0.01, 1),
    ),
    st.builds(
        lambda at, wide, size: lambda t: size * (ca.tanh((t - at) / wide) - ca.tanh(-at / wide)),
        TIME,
        st.floats(0.01, 0.1),  # narrower than a step it would have to be declared
        st.floats(1e-6, 1e-4),
    ),
)


@settings(max_examples=12, deadline=None, suppress_health_check=list(HealthCheck))
@given(place=PLACES)
def test_supports_jump_with_an_error_or_not_at_all(place: Callable[[Any], Any]) -> None:
    """Refused by name; or the bar keeps its length and turns as two schemes agree that it does."""
    model = tc.Model(tc.Scene(BAR, supports=tc.SupportMotion({0: lambda t: (0, 0, place(t))})))
    try:
        runs = [
            tc.simulate(model, END, step, scheme, compiled=False, save_every=10**6)
            for step, scheme in (
                (0.05, tc.DormandPrince853(rtol=1e-10)),
                (0.011, tc.DormandPrince54(rtol=1e-10)),
            )
        ]
    except ValueError as error:
        assert "SupportMotion.positions[0]" in str(error)  # noqa: PT017
        return
    for run in runs:
        assert not run.success or run.bar_length_error.max() < 1e-7
    if all(run.success for run in runs):
        assert abs(runs[0].nodes[-1] - runs[1].nodes[-1]).max() < 1e-6
        final = float(ca.Function("place", [t := ca.SX.sym("t")], [place(t)])(END))
        assert abs(runs[0].nodes[-1, 0, 2] - final) < 1e-12

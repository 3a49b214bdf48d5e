"""Strings that push, and damping that is not clamped: against closed forms and an independent integration; energy closes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from references import stedy
from scipy.integrate import solve_ivp

import tenscasadi as tc
from tenscasadi.integrators.events import build_switching
from tenscasadi.integrators.scheme import Scheme

SCHEMES = [
    tc.RungeKutta4(),
    tc.Rattle(4),
    tc.Collocation(3),
    tc.DormandPrince853(rtol=1e-10),
    tc.Cvodes(rtol=1e-10),
    tc.Idas(rtol=1e-9),
]
RIG = {
    "nodes": [(0, 0, 0), (1, 0, 0)],
    "strings": [(0, 1)],
    "node_mass": [0.0, 2.0],
    "pinned": [0],
    "stiffness": 50.0,
}


def damped(time: Any, start: float, rate: float, decay: float) -> Any:
    """x of ẍ + 2 decay ẋ + rate² x = 0 from rest at `start`."""
    root = np.sqrt(complex(rate**2 - decay**2))
    return (
        start * np.exp(-decay * time) * (np.cos(root * time) + decay / root * np.sin(root * time))
    ).real


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("damping", [0.0, 4.0])
def test_a_linear_string_is_a_spring_in_both_directions(scheme: Scheme, damping: float) -> None:
    scene = tc.Scene(tc.Structure(**RIG, damping=damping, rest_length=0.7), slack=tc.Linear())
    assert build_switching(tc.Model(scene)) is None
    run = tc.simulate(tc.Model(scene), 2.0, 4e-3, scheme, compiled=False)
    assert run.success, run.message
    wanted = 0.7 + damped(run.time, 0.3, 5.0, damping / 4)
    np.testing.assert_allclose(run.nodes[:, 1, 0], wanted, rtol=0, atol=2e-7)
    assert run.tension.min() < -4.0
    np.testing.assert_allclose(
        run.energy_parts[:, 1], 25.0 * (run.nodes[:, 1, 0] - 0.7) ** 2, atol=1e-12
    )
    assert abs(run.energy_error).max() < 1e-5


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_unclamped_damping_acts_in_full_while_the_string_is_stretched(scheme: Scheme) -> None:
    """Overdamped, so that it never comes to its rest length: a linear motion, which clamped damping is not."""
    taut = tc.Structure(**RIG, damping=40.0, rest_length=0.7)
    runs = [
        tc.simulate(
            tc.Model(tc.Scene(taut, slack=tc.Clip(damping=way))), 1.0, 4e-3, scheme, compiled=False
        )
        for way in ("unclamped", "clamped")
    ]
    wanted = 0.7 + damped(runs[0].time, 0.3, 5.0, 10.0)
    np.testing.assert_allclose(runs[0].nodes[:, 1, 0], wanted, rtol=0, atol=2e-7)
    assert runs[0].tension.min() < -0.5
    assert runs[1].tension.min() >= 0
    assert abs(runs[1].nodes[-1] - runs[0].nodes[-1]).max() > 0.05
    assert abs(runs[0].energy_error).max() < 1e-5
    spent = runs[0].energy[0] - runs[0].energy[-1]
    rate = runs[0].velocities[:, 1, 0]
    assert spent == pytest.approx(np.trapezoid(40.0 * rate**2, runs[0].time), rel=1e-3)  # ∫ c ė² dt


def test_stedys_law_against_an_independent_integration() -> None:
    """STEDY's T-bar with dampers: forces on shared nodes, bars by multipliers, each step as SciPy takes it."""
    case = stedy("stedy_tbar_undamped")
    structure = case.scene.structure.replace(damping=60.0)
    free = ~structure.fixed.ravel()
    C, M = structure.C_s, np.kron(structure.mass_matrix().toarray(), np.eye(3))[np.ix_(free, free)]

    def slope(_: float, y: Any) -> Any:
        q, v = structure.nodes.ravel().copy(), np.zeros(structure.nodes.size)
        q[free], v[free] = y.reshape(2, -1)
        S, rates = C @ q.reshape(-1, 3), C @ v.reshape(-1, 3)
        length = np.linalg.norm(S, axis=1)
        gamma = (
            structure.stiffness * (1 - structure.rest_length / length)
            + structure.damping * (S * rates).sum(axis=1) / length**2
        )
        F = -(C.T @ (np.where(length > structure.rest_length, gamma, 0.0)[:, None] * S)).ravel()[
            free
        ]
        B, turn = structure.C_b @ q.reshape(-1, 3), structure.C_b @ v.reshape(-1, 3)
        A = np.einsum("bn,bx->bnx", structure.C_b, B).reshape(len(B), -1)[:, free]
        saddle = np.block([[M, A.T], [A, np.zeros((len(B), len(B)))]])
        return np.concatenate(
            [
                v[free],
                np.linalg.solve(saddle, np.concatenate([F, -(turn**2).sum(axis=1)]))[: free.sum()],
            ]
        )

    speeds, (first, second) = np.zeros(structure.nodes.shape), structure.bars.T
    bars = structure.nodes[second] - structure.nodes[first]
    speeds[second] = 2.0 * np.column_stack(
        [-bars[:, 2], np.zeros(2), bars[:, 0]]
    )  # both turn at 2 rad/s in their plane
    start = np.concatenate([structure.nodes.ravel()[free], speeds.ravel()[free]])
    seen = solve_ivp(
        slope,
        (0, 1.0),
        start,
        rtol=1e-9,
        atol=1e-9,
        max_step=5e-3,
        t_eval=np.linspace(0, 1, 11),
        method="DOP853",
    )
    models = [
        tc.Model(tc.Scene(structure, slack=tc.Clip(damping=way)))
        for way in ("unclamped", "clamped")
    ]
    state = models[0].state(structure.nodes, speeds)
    runs = [
        tc.simulate(model, 1.0, 0.1, tc.DormandPrince853(rtol=1e-10), state, compiled=False)
        for model in models
    ]
    places = runs[0].nodes.reshape(len(seen.t), -1)[:, free].T
    assert runs[0].tension.min() < 0
    np.testing.assert_allclose(places, seen.y[: len(places)], rtol=0, atol=1e-6)
    assert abs(runs[1].nodes - runs[0].nodes).max() > 0.1
    assert abs(runs[0].energy_error).max() < 1e-6


def test_laws_by_string() -> None:
    """Three strings about one node: two springs that push along x and a clipped string along y."""
    nodes = [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 0, 0)]
    cross = tc.Structure(
        nodes,
        strings=[(0, 3), (1, 3), (2, 3)],
        node_mass=[0, 0, 0, 1],
        pinned=[0, 1, 2],
        stiffness=[30, 20, 10],
        rest_length=[1.1, 0.9, 1],
    )
    scene = tc.Scene(cross, slack={1: tc.Linear(), 0: tc.Linear()})
    model = tc.Model(scene)
    x = model.state([*nodes[:3], (0.05, -0.1, 0)])
    length = np.hypot([1.05, 0.95, 0.05], [0.1, 0.1, 0.9])
    np.testing.assert_allclose(
        model.tension(x), [30 * (length[0] - 1.1), 20 * (length[1] - 0.9), 0.0]
    )
    assert model.energy(x).elastic == pytest.approx(
        15 * (length[0] - 1.1) ** 2 + 10 * (length[1] - 0.9) ** 2
    )
    for scheme in SCHEMES:
        run = tc.simulate(model, 0.5, 2e-3, scheme, x, compiled=False)
        assert run.success, run.message
        assert abs(run.energy_error).max() < 1e-4
    assert tc.Scene(cross, slack=[tc.Clip()] * 3).slack == tc.Clip()


def test_segments_have_the_law_of_their_string() -> None:
    beam = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        strings=[(0, 1), (0, 2)],
        node_mass=[0, 1, 1],
        pinned=[0],
        string_mass=0.1,
        rest_length=1.2,
    )
    scene = tc.Scene(beam, segments=[3, 2], slack=(tc.Linear(), tc.Clip()))
    assert scene.compression_strings.tolist() == [0, 1, 2]
    assert scene.switching_strings.tolist() == [3, 4]
    model = tc.Model(scene)
    np.testing.assert_allclose(model.tension(model.initial_state), [-20, -20, -20, 0, 0], atol=1e-6)


def test_only_strings_that_may_push_are_asked_to() -> None:
    """A node pressed against a wall by 5 N: a string that may push carries it, with its rest length longer than it is."""
    strut = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1], pinned=[0], stiffness=100.0
    )
    load = [(0, 0, 0), (-5.0, 0, 0)]
    with pytest.raises(tc.EquilibriumError):
        tc.equilibrium_force_density(strut, load)
    gamma = tc.equilibrium_force_density(strut, load, compression_strings=[0])
    np.testing.assert_allclose(gamma, [-5.0])
    with pytest.raises(ValueError, match="force_density of string 0 is -5"):
        strut.prestressed(gamma)
    pressed = strut.prestressed(gamma, compression_strings=[0])
    np.testing.assert_allclose(pressed.rest_length, [1.05])
    model = tc.Model(tc.Scene(pressed, forces=tc.NodalForce(load), slack=tc.Linear()))
    np.testing.assert_allclose(model.ode(model.initial_state, []).full(), 0, atol=1e-12)


def test_the_least_of_pulling_and_pushing() -> None:
    """Node 2 between two strings along x: of all pairs with γ₀ − γ₁ = 3 the least, each free or bounded."""
    line = tc.Structure(
        [(-1, 0, 0), (1, 0, 0), (0, 0, 0)],
        strings=[(0, 2), (1, 2)],
        node_mass=[0, 0, 1],
        pinned=[0, 1],
    )
    load = [(0, 0, 0), (0, 0, 0), (3.0, 0, 0)]
    np.testing.assert_allclose(tc.equilibrium_force_density(line, load), [4.0, 1.0])
    np.testing.assert_allclose(
        tc.equilibrium_force_density(line, load, compression_strings=[0, 1]), [1.5, -1.5]
    )
    np.testing.assert_allclose(
        tc.equilibrium_force_density(line, load, minimum=2.0, compression_strings=[1]), [2.0, -1.0]
    )


REFUSED: list[tuple[str, type[Exception], Any]] = [
    (r"Scene\.slack is 'soft'", TypeError, "soft"),
    (r"Scene\.slack has 2 entries", ValueError, [tc.Clip(), tc.Linear()]),
    (r"Scene\.slack\[0\] is None", TypeError, [None]),
    (r"Scene\.slack, string is 1: string indices run from 0 to 0", ValueError, {1: tc.Linear()}),
    (r"Scene\.slack names string 'a', which is not there", ValueError, {"a": tc.Linear()}),
    (r"Scene\.slack\[0\] is 3", TypeError, {0: 3}),
]


@pytest.mark.parametrize(("message", "kind", "slack"), REFUSED, ids=range(len(REFUSED)))
def test_what_is_no_law_is_refused_by_name(message: str, kind: type[Exception], slack: Any) -> None:
    with pytest.raises(kind, match=message):
        tc.Scene(tc.Structure(**RIG), slack=slack)


def test_what_is_no_damping_is_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"Clip\.damping is 'free': give 'clamped' or 'unclamped'"):
        tc.Clip(damping="free")  # type: ignore[arg-type]

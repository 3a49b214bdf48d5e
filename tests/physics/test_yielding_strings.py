"""Strings that yield: analytic flow, perfect plasticity, plastic work, cables, derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tenscasadi as tc

G, STIFFNESS, FORCE = 9.81, 1000.0, 15.0


def hanging(**changes: Any) -> tc.Structure:
    fields = {
        "nodes": [(0, 0, 0), (0, 0, -1)],
        "strings": [(0, 1)],
        "pinned": [0],
        "node_mass": 1.0,
        "stiffness": STIFFNESS,
    }
    return tc.Structure(**fields | changes)


def falling(viscosity: float, **changes: Any) -> tc.Model:
    strength = tc.Yielding(FORCE, viscosity)
    return tc.Model(tc.Scene(hanging(**changes), gravity=tc.Gravity(), strength=strength))


def test_tension_of_a_pulled_string_follows_its_analytic_flow():
    """At a constant speed, t = F + η v (1 − exp(−k (time − onset)/η)) after the onset F/(k v)."""
    speed, viscosity = 0.1, 20.0
    towed = hanging(pinned=[0, 1])
    scene = tc.Scene(
        towed,
        supports=tc.SupportMotion({1: lambda t: (0, 0, -1 - speed * t)}, breakpoints=()),
        strength=tc.Yielding(FORCE, viscosity),
    )
    assert tc.Model(scene).na == 1
    run = tc.simulate(tc.Model(scene), 0.3, 1e-4, compiled=False)
    time = run.time - FORCE / (STIFFNESS * speed)
    flow = FORCE + viscosity * speed * (1 - np.exp(-STIFFNESS * time / viscosity))
    assert run.success, run.message
    expected = np.where(time < 0, STIFFNESS * speed * run.time, flow)
    assert np.abs(run.tension[:, 0] - expected).max() < 1e-4
    (found,) = run.yields
    assert found.time == pytest.approx(FORCE / (STIFFNESS * speed), abs=2e-3)
    assert "yields after t =" in run.message
    assert "yield         string 0" in run.summary()


def test_elongation_tends_to_that_of_perfect_plasticity():
    omega = np.sqrt(STIFFNESS)
    speed = G / omega * np.sin(np.arccos(1 - FORCE / G))
    perfect = speed**2 / (2 * (FORCE - G))  # of 1 kg, decelerated by F − m g
    errors = []
    for viscosity in (2.0, 1.0, 0.5):
        run = tc.simulate(
            falling(viscosity), 0.3, scheme=tc.DormandPrince853(rtol=1e-9), compiled=False
        )
        errors.append(perfect - run.yields[0].elongation)
    assert 0 < errors[2] < 0.02 * perfect
    assert np.allclose(np.array(errors[:2]) / errors[1:], 2.0, atol=0.1)


@pytest.mark.parametrize(
    ("scheme", "step", "tolerance"),
    [
        (tc.RungeKutta4(), 2e-4, 1e-9),
        (tc.DormandPrince853(rtol=1e-9), None, 1e-12),
        (tc.Collocation(2), 1e-3, 1e-12),
        (tc.Rattle(), 1e-4, 1e-6),
        (tc.Cvodes(rtol=1e-9), None, 1e-6),
    ],
    ids=lambda value: type(value).__name__,
)
def test_plastic_work_equals_the_energy_that_is_lost(scheme, step, tolerance):
    run = tc.simulate(falling(5.0), 0.3, step, scheme, compiled=False)
    assert run.success, run.message
    assert np.abs(run.energy_error).max() < tolerance
    fine = tc.simulate(falling(5.0), 0.3, 5e-5, save_every=1, compiled=False)
    growth = np.diff(fine.internal_states["plastic elongation"][:, 0])
    work = float(np.sum((fine.tension[1:, 0] + fine.tension[:-1, 0]) / 2 * growth))
    assert run.energy[0] - run.energy[-1] == pytest.approx(work, abs=1e-5)
    assert run.nodes[-1, 1, 2] == pytest.approx(fine.nodes[-1, 1, 2], abs=1e-6)


def test_fixed_steps_converge_across_the_onset():
    exact = tc.simulate(falling(20.0), 0.3, scheme=tc.DormandPrince853(rtol=1e-12), compiled=False)
    errors = [
        abs(
            tc.simulate(falling(20.0), 0.3, step, compiled=False).nodes[-1, 1, 2]
            - exact.nodes[-1, 1, 2]
        )
        for step in (2e-3, 2.5e-4)
    ]
    assert errors[0] < 1e-7
    assert errors[1] < errors[0] / 8


def test_strings_below_their_force_do_not_yield():
    held = tc.Scene(hanging(), gravity=tc.Gravity(), strength=tc.Yielding(20.0, 5.0))
    run = tc.simulate(tc.Model(held), 0.5, 1e-3, compiled=False)
    free = tc.simulate(
        tc.Model(tc.Scene(hanging(), gravity=tc.Gravity())), 0.5, 1e-3, compiled=False
    )
    assert not run.yields
    assert np.abs(run.nodes - free.nodes).max() < 1e-14
    eq = tc.find_equilibrium(falling(5.0, node_mass=2.0))
    assert "string 0 yields, its tension of 19.62 N reaches its strength of 15 N" in eq.message


@pytest.mark.parametrize("control", [tc.RestLength(), tc.RestLengthRate()], ids=str)
def test_controls_of_rest_lengths_add_to_the_elongation(control):
    prism = tc.shapes.prism(prestress=10.0, damping=1.0)
    scene = tc.Scene(prism, control=control, strength=tc.Yielding({3: 8.0}, 10.0))
    run = tc.simulate(tc.Model(scene), 0.3, 1e-3, compiled=False)
    assert [found.strings for found in run.yields] == [(3,)]
    assert np.abs(run.energy_error).max() < 1e-7


def test_cables_and_strings_in_segments_lengthen_as_a_whole():
    line = tc.Structure(
        [(-1, 0, 0), (0, 0, -0.8), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        node_mass=[0, 2, 0],
        pinned=[0, 2],
        cables=[[0, 1]],
    )
    scene = tc.Scene(line, gravity=tc.Gravity(), strength=tc.Yielding([np.inf, 8.0], 50.0))
    run = tc.simulate(tc.Model(scene), 0.8, 1e-3, compiled=False)
    assert [found.member for found in run.yields] == ["cable 0"]
    assert np.abs(run.energy_error).max() < 1e-6
    whole = falling(20.0, string_mass=1e-3)
    parts = tc.Model(
        tc.Scene(
            hanging(string_mass=1e-3, damping=0.5),
            segments=2,
            gravity=tc.Gravity(),
            strength=tc.Yielding(FORCE, 20.0),
        )
    )
    amounts = [
        tc.simulate(one, 0.3, 2e-5, compiled=True).yields[0].elongation for one in (whole, parts)
    ]
    assert amounts[0] == pytest.approx(amounts[1], rel=0.1)


def test_rollouts_and_derivatives_take_yielding():
    model = falling(20.0)
    many = tc.rollouts(model, 0.2, 1e-3, states=[model.initial_state] * 3)
    assert many.success.all()
    assert [len(found) for found in many.yields] == [1, 1, 1]
    taut = model.state([(0, 0, 0), (0, 0, -1.005)], [(0, 0, 0), (0, 0, -0.3)])
    found = tc.sensitivities(model, taut, t_end=0.2, step=1e-4, compiled=False)
    moved = [taut + sign * 1e-6 * np.eye(model.nx)[2] for sign in (1, -1)]
    ends = [tc.simulate(model, 0.2, 1e-4, state=x, compiled=False).states[-1] for x in moved]
    assert found.success
    assert tc.simulate(model, 0.2, 1e-4, state=taut, compiled=False).yields
    assert np.allclose(found.jacobian[:, 2], (ends[0] - ends[1]) / 2e-6, rtol=1e-3, atol=1e-3)


def test_forces_that_are_commanded_do_not_yield():
    with pytest.raises(ValueError, match=r"Scene\.strength is Yielding.*give control=RestLength"):
        tc.Scene(tc.shapes.prism(), control=tc.Tension(), strength=tc.Yielding(5.0, 1.0))
    with pytest.raises(ValueError, match=r"Yielding\.viscosity is 0"):
        tc.Yielding(5.0, 0.0)
    with pytest.raises(ValueError, match=r"Yielding\.force has 2 entries"):
        tc.Scene(tc.shapes.prism(), strength=tc.Yielding([5.0, 1.0], 1.0))

"""Strings that break: analytic motion, order of convergence, energy, cables, cascades."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

import tenscasadi as tc

G, STIFFNESS, FORCE = 9.81, 1000.0, 15.0
OMEGA = np.sqrt(STIFFNESS)  # of 1 kg, rad/s
# A mass that is released at the rest length: T = g (1 − cos ω t).
BREAK = float(np.arccos(1 - FORCE / G) / OMEGA)
END = 0.2


def hanging(**changes: Any) -> tc.Structure:
    fields = {
        "nodes": [(0, 0, 0), (0, 0, -1)],
        "strings": [(0, 1)],
        "pinned": [0],
        "node_mass": 1.0,
        "stiffness": STIFFNESS,
    }
    return tc.Structure(**fields | changes)


@cache
def falling() -> tc.Model:
    return tc.Model(tc.Scene(hanging(), gravity=tc.Gravity(), strength=tc.Breaking(FORCE)))


def expected_height(t: float) -> float:
    """Height after the break: a parabola, m."""
    start = G / OMEGA**2 * (1 - np.cos(OMEGA * BREAK))
    speed = G / OMEGA * np.sin(OMEGA * BREAK)
    return float(-1 - start - speed * (t - BREAK) - G * (t - BREAK) ** 2 / 2)


def errors(step: float | None, scheme: tc.Scheme, compiled: bool = False) -> tuple[float, float]:
    """Errors of the final height and of the time of the break."""
    run = tc.simulate(falling(), END, step, scheme, compiled=compiled)
    assert run.success, run.message
    (found,) = run.breaks
    return abs(run.nodes[-1, 1, 2] - expected_height(END)), abs(found.time - BREAK)


@pytest.mark.parametrize(
    ("step", "scheme", "tolerance"),
    [
        (1e-3, tc.RungeKutta4(), 1e-8),
        (1e-3, tc.DormandPrince853(), 1e-12),
        (1e-3, tc.Collocation(2), 1e-8),
        (1e-3, tc.Rattle(order=4), 1e-7),
        (None, tc.DormandPrince54(rtol=1e-9), 1e-8),
        (None, tc.DormandPrince853(rtol=1e-10), 1e-9),
        (None, tc.Cvodes(rtol=1e-9, locate_events=True), 1e-7),
        (None, tc.Idas(rtol=1e-9, locate_events=True), 1e-7),
    ],
    ids=lambda value: type(value).__name__,
)
def test_mass_falls_freely_from_the_analytic_time(step, scheme, tolerance):
    position, time = errors(step, scheme)
    assert position < tolerance
    assert time < tolerance


@pytest.mark.parametrize(
    ("scheme", "order"),
    [(tc.RungeKutta4(), 4), (tc.Collocation(2), 4), (tc.Rattle(), 2), (tc.DormandPrince54(), 5)],
    ids=lambda value: type(value).__name__,
)
def test_fixed_steps_keep_their_order_across_a_break(scheme, order):
    coarse, fine = (np.array(errors(step, scheme)) for step in (4e-3, 2e-3))
    assert (np.log2(coarse / fine) > order - 0.5).all()


def test_compiled_runs_equal_interpreted_ones_to_the_last_bit():
    for step, scheme in ((1e-3, tc.RungeKutta4()), (None, tc.DormandPrince54(rtol=1e-8))):
        runs = [tc.simulate(falling(), END, step, scheme, compiled=own) for own in (True, False)]
        assert np.array_equal(runs[0].states, runs[1].states)
        assert runs[0].message == runs[1].message


def test_energy_balance_includes_the_energy_that_is_lost():
    run = tc.simulate(falling(), END, 1e-3, tc.DormandPrince853(), compiled=False)
    assert np.ptp(run.energy) == pytest.approx(FORCE**2 / (2 * STIFFNESS), rel=1e-6)
    assert np.abs(run.energy_error).max() < 1e-12
    assert run.energy_parts[-1, 1] == 0


def test_message_names_member_and_time():
    structure = hanging(string_names=["rope"])
    scene = tc.Scene(structure, gravity=tc.Gravity(), strength=tc.Breaking({0: FORCE}))
    run = tc.simulate(tc.Model(scene), END, 1e-3, compiled=False)
    assert "; string 'rope' breaks at t = 0.0673 s (15 N)" in run.message
    assert "break         string 'rope' breaks at t = 0.0673 s (15 N)" in run.summary()
    assert run.breaks[0].strings == (0,)


def test_a_string_that_bears_its_load_does_not_break():
    held = tc.Model(tc.Scene(hanging(), gravity=tc.Gravity(), strength=tc.Breaking(2 * G + 1e-6)))
    run = tc.simulate(held, 1.0, 1e-3, tc.DormandPrince853(), compiled=False)
    free = tc.simulate(
        tc.Model(tc.Scene(hanging(), gravity=tc.Gravity())),
        1.0,
        1e-3,
        tc.DormandPrince853(),
        compiled=False,
    )
    assert run.success
    assert not run.breaks
    assert np.array_equal(run.nodes, free.nodes)


def test_strings_break_one_after_the_other():
    """The load of the first string passes to the second one within the same step."""
    twin = hanging(strings=[(0, 1), (0, 1)], stiffness=STIFFNESS / 2)
    scene = tc.Scene(twin, gravity=tc.Gravity(), strength=tc.Breaking([3.0, 4.0]))
    model = tc.Model(scene)
    fine = tc.simulate(model, END, scheme=tc.DormandPrince853(rtol=1e-12), compiled=False)
    run = tc.simulate(model, END, 2e-2, tc.DormandPrince853(), compiled=False, verify=False)
    assert [found.strings for found in fine.breaks] == [(0,), (1,)]
    for found, exact in zip(run.breaks, fine.breaks, strict=True):
        assert found.time == pytest.approx(exact.time, abs=1e-7)
    assert np.abs(run.nodes[-1] - fine.nodes[-1]).max() < 1e-7


def test_cables_and_strings_in_segments_break_as_a_whole():
    line = tc.Structure(
        [(-1, 0, 0), (0, 0, -0.8), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        node_mass=[0, 2, 0],
        pinned=[0, 2],
        cables=[[0, 1]],
    )
    scene = tc.Scene(line, gravity=tc.Gravity(), strength=tc.Breaking([np.inf, 8.0]))
    run = tc.simulate(tc.Model(scene), 0.8, 1e-3, compiled=False)
    assert [found.member for found in run.breaks] == ["cable 0"]
    assert (run.tension[-1] == 0).all()
    parts = hanging(string_mass=0.1)
    scene = tc.Scene(parts, segments=3, gravity=tc.Gravity(), strength=tc.Breaking(FORCE))
    run = tc.simulate(tc.Model(scene), END, 1e-4, compiled=False)
    assert [found.strings for found in run.breaks] == [(0,)]
    assert (run.tension[-1] == 0).all()


@pytest.mark.parametrize(
    "scheme", [tc.RungeKutta4(), tc.DormandPrince54(rtol=1e-8)], ids=lambda one: type(one).__name__
)
def test_a_control_that_overloads_a_string_breaks_it_at_once(scheme):
    structure = tc.shapes.prism(prestress=10.0, damping=1.0)
    scene = tc.Scene(structure, control=tc.RestLength(), strength=tc.Breaking({3: 13.0}))
    model = tc.Model(scene)
    u = model.initial_control
    tighter = u * np.where(np.arange(9) == 3, 0.8, 1.0)
    run = tc.simulate(model, 0.2, 1e-3, scheme, control=np.array([u, tighter]), compiled=False)
    assert run.success, run.message
    assert [found.time for found in run.breaks] == pytest.approx([0.1], abs=1e-12)
    assert np.abs(run.energy_error).max() < 1e-7
    commanded = tc.Model(tc.Scene(structure, control=tc.Tension(), strength=tc.Breaking({3: 13.0})))
    u = commanded.initial_control
    tighter = np.where(np.arange(9) == 3, 14.0, u)
    run = tc.simulate(commanded, 0.2, 1e-3, control=np.array([u, tighter]), compiled=False)
    assert [found.time for found in run.breaks] == pytest.approx([0.1], abs=1e-12)
    assert (run.tension[101:, 3] == 0).all()


def test_a_control_function_breaks_strings():
    scene = tc.Scene(hanging(), control=tc.Tension(), strength=tc.Breaking(FORCE))
    run = tc.simulate(tc.Model(scene), 0.2, 1e-3, control=lambda t: [100.0 * t], compiled=False)
    assert run.breaks[0].time == pytest.approx(FORCE / 100.0, abs=1e-9)
    assert "breaks at t = 0.15 s" in run.message
    assert run.internal_states["intact"][-1] == 0


@pytest.mark.parametrize(
    "control", [tc.ForceDensity(), tc.RestLengthRate(), tc.Winch(0.02, 1e-3)], ids=str
)
def test_every_control_takes_strength(control):
    structure = tc.shapes.prism(prestress=10.0)
    plain = tc.Model(tc.Scene(structure, control=control))
    model = tc.Model(tc.Scene(structure, control=control, strength=tc.Breaking(1e3)))
    assert model.nx == plain.nx + 18
    u = plain.initial_control * 1.01 + 0.01
    runs = [tc.simulate(one, 0.05, 1e-3, control=u, compiled=False) for one in (plain, model)]
    assert np.abs(runs[0].nodes - runs[1].nodes).max() < 1e-14
    assert not runs[1].breaks


def test_a_broken_string_stays_broken_in_the_next_run():
    first = tc.simulate(falling(), END, 1e-3, compiled=False)
    again = tc.simulate(falling(), 0.1, 1e-3, state=first.states[-1], compiled=False)
    assert not again.breaks
    assert (again.tension == 0).all()


def test_statics_rejects_states_with_a_broken_string():
    rope = tc.Scene(hanging(string_names=["rope"]), strength=tc.Breaking(FORCE))
    run = tc.simulate(falling(), END, 1e-3, compiled=False)
    words = r"start has the broken string '?{}'?: give a structure without it"
    with pytest.raises(ValueError, match=words.format(0)):
        tc.find_equilibrium(falling(), start=run.states[-1])
    with pytest.raises(ValueError, match=words.format("rope")):
        tc.find_equilibrium(tc.Model(rope), start=run.states[-1])
    load = [(0, 0, 0), (0, 0, -1.0)]
    with pytest.raises(ValueError, match=words.format(0)):
        tc.load_path(falling(), load=load, start=run.states[-1])
    again = tc.find_equilibrium(falling(), start=run.states[0])
    assert again.tension == pytest.approx([G])


def test_rollouts_break_strings_run_by_run():
    model = falling()
    resting = model.state([(0, 0, 0), (0, 0, -1 - G / STIFFNESS)])
    for compiled in (True, False):
        many = tc.rollouts(
            model, END, 1e-3, states=[model.initial_state, resting], compiled=compiled
        )
        assert many.success.all()
        assert [len(found) for found in many.breaks] == [1, 0]
        assert abs(many.breaks[0][0].time - BREAK) < 1e-8
        assert "breaks at" in many.message[0]
        assert "breaks at" not in many.message[1]
        assert (many.energy_error < 1e-8).all()


def test_derivatives_end_where_a_string_breaks():
    before = tc.sensitivities(falling(), t_end=0.06, step=1e-3, compiled=False)
    plain = tc.Model(tc.Scene(hanging(), gravity=tc.Gravity()))
    other = tc.sensitivities(plain, t_end=0.06, step=1e-3, compiled=False)
    assert before.success
    assert np.allclose(before.jacobian[:6, :6], other.jacobian, rtol=0, atol=1e-14)
    beyond = tc.sensitivities(falling(), t_end=0.1, step=1e-3, compiled=False)
    assert not beyond.success
    assert np.isnan(beyond.jacobian).all()
    assert "give a smaller t_end" in beyond.message


def test_sundials_needs_located_events():
    with pytest.raises(
        ValueError, match=r"Cvodes\.locate_events is False.*give locate_events=True"
    ):
        tc.simulate(falling(), END, scheme=tc.Cvodes())


def test_statics_names_overloaded_strings():
    scene = tc.Scene(hanging(), gravity=tc.Gravity(), strength=tc.Breaking(9.0))
    eq = tc.find_equilibrium(scene)
    assert eq.success
    assert "string 0 breaks, its tension of 9.81 N reaches its strength of 9 N" in eq.message
    assert "breaks" not in tc.find_equilibrium(falling()).message
    path = tc.load_path(falling(), load=[(0, 0, 0), (0, 0, -10.0)], factors=(0, 1))
    assert path.success
    assert "string 0 breaks, its tension of" in path.message
    rest = tc.find_equilibrium(falling())
    run = tc.simulate(falling(), 0.1, 1e-3, state=rest, compiled=False)
    assert np.abs(run.nodes - rest.nodes).max() < 1e-9

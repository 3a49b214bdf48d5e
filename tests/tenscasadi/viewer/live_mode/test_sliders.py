"""Sliders of live motions: which there are, and what they do."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.viewer.live_mode.simulation import LiveOptions, LiveSimulation
from tenscasadi.viewer.live_mode.sliders import (
    build_slider,
    choose_parameter_sliders,
    choose_sliders,
)

VIRTUAL = LiveOptions(compiled=False)
PRISM = tc.shapes.prism(prestress=50.0, stiffness=1000.0)
BALL = tc.shapes.six_bar_ball(prestress=50.0, stiffness=1000.0)


def simulation(structure, **options):
    return LiveSimulation(tc.Scene(structure, **options), options=VIRTUAL)


def test_few_strings_have_one_each_and_one_for_all():
    run = simulation(PRISM)
    sliders = choose_sliders(run)
    names = [f"{group}[{k}]" for group in ("bottom", "top", "vertical") for k in range(3)]
    assert [slider.name for slider in sliders] == ["all (factor)", *names]
    sliders[3].apply(run, 0.9 * run.start_control[2])
    expected = run.start_control.copy()
    expected[2] *= 0.9
    np.testing.assert_allclose(run.control, expected)
    assert sliders[3].read(run) == pytest.approx(0.9 * run.start_control[2])
    sliders[0].apply(run, 0.8)
    np.testing.assert_allclose(run.control, 0.8 * run.start_control)
    assert sliders[0].read(run) == pytest.approx(0.8)


def test_many_strings_that_are_alike_share_one():
    run = simulation(BALL)
    sliders = choose_sliders(run)
    assert len(sliders) == 1
    assert sliders[0].strings == tuple(range(24))
    assert sliders[0].name.startswith("24 strings: 0, 1, 2")
    unlike = tc.Structure(
        BALL.nodes, BALL.bars, BALL.strings, rest_length=np.linspace(0.4, 0.6, 24)
    )
    sliders = choose_sliders(simulation(unlike))
    assert len(sliders) == 1 <= MOST_LISTED
    assert sliders[0].factor
    assert build_slider(run, 7).strings == (7,)


def test_groups_of_ones_own():
    run = simulation(PRISM)
    sliders = choose_sliders(run, {"top": [0, 1, 2], "mixed": (0, 8)})
    assert [slider.name for slider in sliders[1:]] == ["top", "mixed (factor)"]
    sliders[2].apply(run, 1.2)
    np.testing.assert_allclose(run.control[[0, 8]], 1.2 * run.start_control[[0, 8]])
    for wrong, words in (
        ({"top": []}, "empty"),
        ({"top": [9]}, r"groups\['top'\]"),
        ([0, 1], "groups is"),
        ({3: [0]}, "groups"),
    ):
        with pytest.raises((TypeError, ValueError), match=words):
            choose_sliders(run, wrong)


def test_force_densities_run_from_zero():
    run = simulation(PRISM, control=tc.ForceDensity())
    sliders = choose_sliders(run)
    assert all(slider.low == 0 for slider in sliders)
    assert sliders[1].high == pytest.approx(3 * run.start_control[0])
    slack = simulation(
        PRISM.replace(rest_length=10.0), control=tc.ForceDensity()
    )  # no force at the start: a factor on it does nothing
    assert all(not slider.factor and slider.high == 100 for slider in choose_sliders(slack))


def test_what_a_page_sends_beyond_the_ends_is_cut_and_no_number_is_nothing():
    run = simulation(PRISM)
    slider = choose_sliders(run)[1]
    slider.apply(run, -5.0)
    assert run.control[0] == pytest.approx(slider.low)
    slider.apply(run, 1e9)
    assert run.control[0] == pytest.approx(slider.high)
    slider.apply(run, float("nan"))
    slider.apply(run, float("inf"))
    assert run.control[0] == pytest.approx(slider.high)


def test_no_strings_no_sliders():
    assert choose_sliders(simulation(tc.shapes.pendulum())) == []


def test_gravity_and_parameters_have_sliders():
    run = simulation(
        PRISM, gravity=tc.Gravity((0, 0, -2.0)), parameters=tc.Parameters(scale=["stiffness"])
    )
    gravity, stiffness = choose_parameter_sliders(run)
    assert (gravity.name, gravity.low, gravity.high) == ("gravity (m/s²)", 0.0, 4.0)
    assert stiffness.name == "stiffness (factor)"
    assert (gravity.read(run), stiffness.read(run)) == pytest.approx((2.0, 1.0))
    gravity.apply(run, 3.0)
    stiffness.apply(run, 9.0)  # limited to the range
    places = run.model.parameters.places
    assert run.parameters[places["gravity"]] == pytest.approx([0, 0, -3.0])
    assert run.parameters[places["stiffness"]] == pytest.approx(np.full(9, 2000.0))
    assert (gravity.read(run), stiffness.read(run)) == pytest.approx((3.0, 2.0))


def test_gravity_can_be_added_unless_it_varies():
    (gravity,) = choose_parameter_sliders(simulation(PRISM))
    assert gravity.high == 20.0
    run = simulation(PRISM, gravity=tc.Gravity(lambda t: (0, 0, -t)))
    assert choose_parameter_sliders(run) == []

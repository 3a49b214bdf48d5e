"""Scenes by chance: a run that succeeds without a word ends where CVODES in tight tolerances does, as nearly as its own errors say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import tenscasadi as tc

SCHEMES = [tc.RungeKutta4(), tc.DormandPrince54(), tc.DormandPrince853(), tc.Rattle()]
POWERS = {
    "mass": (-1.0, 1.0),
    "stiffness": (1.0, 5.0),
    "damping": (-1.0, 5.5),
}  # of ten, in kg, N/m and N s/m


def on_examples(check: Callable[[st.DataObject], None], count: int) -> None:
    """The check on so many examples."""
    options = settings(max_examples=count, deadline=None, suppress_health_check=list(HealthCheck))
    options(given(st.data())(check))()


def magnitudes(draw: Callable[[Any], Any], what: str, count: int) -> np.ndarray:
    low, high = POWERS[what]
    return 10 ** np.array(draw(st.lists(st.floats(low, high), min_size=count, max_size=count)))


def hung(draw: Callable[[Any], Any]) -> tc.Structure:
    """A chain of masses between one pin or two, or a bar on a ball joint held by three strings."""
    free = draw(st.integers(0, 3))
    if free:
        ends = draw(st.sampled_from([1, 2]))
        x = np.arange(free + ends)
        nodes, bars, pinned = np.column_stack([x, 0.3 * np.sin(x), 0 * x]), [], [0, free + 1][:ends]
        strings = [(i, i + 1) for i in range(len(x) - 1)]
        masses = {"node_mass": [0.0, *magnitudes(draw, "mass", free), 0.0][: len(x)]}
    else:
        nodes = np.array([(0, 0, 0), (0, 0, 1), (-1, 0, 0), (1, 0, 0.2), (0, 1, 0.0)])
        bars, strings, pinned = [(0, 1)], [(1, 2), (1, 3), (1, 4)], [0, 2, 3, 4]
        masses = {"bar_mass": magnitudes(draw, "mass", 1)}
    count = len(strings)
    slack = np.array(draw(st.lists(st.floats(0.8, 1.1), min_size=count, max_size=count)))
    damped = np.array(draw(st.lists(st.booleans(), min_size=count, max_size=count)))
    lengths = np.linalg.norm([nodes[b] - nodes[a] for a, b in strings], axis=1)
    laws = {
        "stiffness": magnitudes(draw, "stiffness", count),
        "damping": magnitudes(draw, "damping", count) * damped,
    }
    return tc.Structure(
        nodes, bars, strings, rest_length=slack * lengths, pinned=pinned, **laws, **masses
    )


def check_steps(data: st.DataObject) -> None:
    """Fixed steps from a thirtieth to fifty times of the stability limit that the structure has where all strings are taut."""
    structure, scheme = hung(data.draw), data.draw(st.sampled_from(SCHEMES))
    model = tc.Model(tc.Scene(structure, gravity=data.draw(st.sampled_from([None, tc.Gravity()]))))
    speed = data.draw(st.sampled_from([0.0, 1.0, 10.0]))
    velocities = speed * np.sin(7.0 * np.arange(structure.nodes.size)).reshape(-1, 3)
    velocities[sorted(structure.pinned)] = 0.0
    start = np.asarray(
        tc.build_projection(model)(model.state(structure.nodes, velocities)).full()
    ).ravel()
    taut = tc.Model(tc.Scene(structure.replace(rest_length=0.5 * structure.rest_length)))
    limit, steps = (
        tc.stable_step(taut, start, scheme=scheme, safety=1.0),
        data.draw(st.integers(10, 1000)),
    )
    step = limit * 10 ** data.draw(st.one_of(st.floats(0.02, 1.7), st.floats(-1.5, 0.0)))
    assume(np.isfinite(step) and 1e-4 < step * steps < 2.0)
    run = tc.simulate(model, step * steps, step, scheme, state=start, compiled=False)
    if not run.success or ";" in run.message:
        return
    reference = tc.simulate(
        model,
        step * steps,
        step * steps / 20,
        tc.Cvodes(rtol=1e-11, max_steps=10**6),
        state=start,
        compiled=False,
    )
    assume(reference.success)
    moved = run.energy_parts[:, 0].max() + np.ptp(run.energy_parts[:, 1:], axis=0).sum()
    claimed = (
        np.ptp(run.nodes, axis=0).max() * np.sqrt(abs(run.energy_error).max() / moved)
        if moved
        else 0.0
    )
    error = np.linalg.norm(run.nodes[-1] - reference.nodes[-1], axis=1).max()
    assert error < 0.01 + 3 * claimed, run.message


@pytest.mark.slow
def test_steps_near_the_stability_limit_end_right_or_with_a_word() -> None:
    on_examples(check_steps, 15)


@pytest.mark.slow
def test_many_steps_near_the_stability_limit_end_right_or_with_a_word() -> None:
    on_examples(check_steps, 600)


def check_start(data: st.DataObject) -> None:
    """Starts off their bars by any share, anywhere, at any speed."""
    draw = data.draw
    structure = tc.shapes.prism(
        draw(st.integers(3, 4)), stiffness=1000.0, damping=1.0, prestress=30.0
    )
    away = 10 ** draw(st.floats(-9.0, 0.0))
    place, speed = (
        10 ** draw(st.floats(0.0, power)) * np.array([0.6, 0.0, 0.8]) for power in (5.0, 4.0)
    )
    way = draw(st.sampled_from(["length", "rate"]))
    model, turned = (
        tc.Model(tc.Scene(structure.replace(nodes=structure.nodes + place))),
        np.cross([0.0, 0.0, 1.0], structure.nodes),
    )
    nodes, velocities = structure.nodes + place, turned + speed
    a, b = structure.bars[0]
    along = structure.nodes[b] - structure.nodes[a]
    if way == "length":
        nodes[b] += away * along
    else:
        velocities[b] += away * along
    run = tc.simulate(model, 0.05, 1e-3, state=model.state(nodes, velocities), compiled=False)
    told, rounding = (
        "; the start is off" in run.message,
        1e-14 * np.linalg.norm(place if way == "length" else speed),
    )
    size = np.linalg.norm(
        structure.nodes[structure.bars[:, 1]] - structure.nodes[structure.bars[:, 0]], axis=1
    ).max()
    share = (
        away
        if way == "length"
        else away
        * np.linalg.norm(along)
        / max(size, np.linalg.norm(turned[b] - turned[a]) + away * size)
    )
    if share > 1e-5 + 100 * rounding:
        assert told or not run.success
    if share < 1e-7 and rounding < 1e-9:
        assert not told
    if share > 0.25:
        assert not run.success
    if not run.success or ";" in run.message:
        return
    still = tc.Model(tc.Scene(structure))
    reference = tc.simulate(
        still,
        0.05,
        0.005,
        tc.Cvodes(rtol=1e-11),
        state=still.state(structure.nodes, turned),
        compiled=False,
    )
    moved = run.nodes[-1] - place - 0.05 * speed
    assert abs(moved - reference.nodes[-1]).max() < 1e-6 + 10 * away + 1e3 * rounding


def test_starts_off_the_bars_are_told_wherever_they_are() -> None:
    on_examples(check_start, 10)


@pytest.mark.slow
def test_many_starts_off_the_bars_are_told_wherever_they_are() -> None:
    on_examples(check_start, 400)

"""The time loop as one Function: the numbers of its steps one by one, compiled or not, for runs of any length."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import by_hand, moving, prism

import tenscasadi as tc
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")


@needs_compiler
@pytest.mark.usefixtures("users_compiler")
@pytest.mark.parametrize(
    "correction", [None, pytest.param(Projection(), marks=pytest.mark.slow), Projection(every=7)]
)
def test_compiled_and_not_give_the_same_numbers(correction: Any) -> None:
    model = prism(RestLength(), damping=1.0)
    u = model.initial_control
    options: dict[str, Any] = {
        "state": moving(model),
        "control": lambda t: u * (1 + 0.1 * np.sin(20 * t)),
        "correction": correction,
    }
    machine, virtual = (
        simulate(model, 1.5, 1e-3, compiled=compiled, **options) for compiled in (True, False)
    )
    assert (machine.compiled, virtual.compiled) == (True, False)
    for field in ("states", "energy", "energy_error", "tension", "control"):
        assert np.abs(getattr(machine, field) - getattr(virtual, field)).max() < 1e-11, field


@pytest.mark.parametrize("every", [1, 2, 5, 33, 70])
def test_corrections_come_after_every_nth_step(every: int) -> None:
    model = prism()
    correction = Projection(every=every)
    run = simulate(
        model, 1.5, 0.01, state=moving(model, 2.0), correction=correction, compiled=False
    )
    expected = by_hand(model, moving(model, 2.0), np.zeros((150, 0)), 0.01, correction)
    assert np.abs(run.states - expected).max() < 1e-12
    assert (run.bar_length_error[::every] < 1e-14).all()
    assert every == 1 or run.bar_length_error[every - 1] > 1e-12


@needs_compiler
def test_one_compiled_loop_serves_every_length_and_step(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path))
    model = prism(RestLength())
    for t_end, step, save_every in ((1.0, 1e-3, 1), (0.01, 1e-4, None), (7.0, 3e-3, 13)):
        simulate(model, t_end, step, save_every=save_every, compiled=True)
    simulate(model, 1.0, state=moving(model), control=model.initial_control * 1.1, compiled=True)
    assert len(list(tmp_path.iterdir())) == 2  # the engine, and the model's code


def test_runs_of_any_length_end_at_the_same_states():
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0)))
    start = model.state(model.structure.nodes, model.structure.nodes)
    long = tc.simulate(model, 0.2, 1e-3, state=start, save_every=1)
    for steps in (1, 31, 32, 33, 100):
        short = tc.simulate(model, steps * 1e-3, 1e-3, state=start, save_every=1)
        assert short.states[-1] == pytest.approx(long.states[steps], rel=1e-13, abs=1e-15)


def test_a_second_run_writes_no_new_function():
    model = tc.Model(tc.Scene(tc.shapes.pendulum()))
    tc.simulate(model, 0.1, 1e-3)
    written = dict(model.functions)
    tc.simulate(model, 0.3, 2e-3)
    assert model.functions == written
    tc.simulate(model, 0.3, 2e-3, tc.DormandPrince54())
    assert len(model.functions) == len(written) + 1

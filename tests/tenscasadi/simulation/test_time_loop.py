"""The time loop as one Function: the numbers of its steps one by one, compiled or not, for runs of any length."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from runs import by_hand, moving, prism

import tenscasadi as tc
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.time_loop import chunk_function, chunk_steps
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")


@needs_compiler
@pytest.mark.parametrize("correction", [None, Projection(), Projection(every=7)])
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
    assert len(list(tmp_path.iterdir())) == 1


def test_chunks_shrink_with_the_model_and_fit_the_correction() -> None:
    many = Structure(
        np.random.default_rng(0).normal(size=(3000, 3)),
        bars=[(2 * i, 2 * i + 1) for i in range(1500)],
    )
    small, large = chunk_steps(prism(), 1), chunk_steps(Model(Scene(many)), 1)
    assert 1 <= large < small
    assert chunk_steps(prism(), 7) % 7 == 0
    assert chunk_steps(prism(), 10**5) == 10**5


@dataclass(frozen=True)
class Count(tc.RungeKutta4):
    """Adds one for each step, whatever its length."""

    def step(self, ode):
        x, u, h = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("h")
        return ca.Function("step", [x, u, h], [x + 1], ["x", "u", "h"], ["x_next"])


PENDULUM = tc.Model(tc.Scene(tc.shapes.pendulum()))


def test_blocks_of_steps_without_length_are_passed_over():
    lengths = np.zeros(128)
    lengths[:40] = 1e-3
    after = chunk_function(PENDULUM, Count(), None, False, False, 128)(
        np.zeros(PENDULUM.nx), lengths, np.zeros((0, 128))
    ).full()
    assert after[0, :40].tolist() == list(range(1, 41))
    assert after[0, -1] == 64  # the block in which the run ends is the last


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

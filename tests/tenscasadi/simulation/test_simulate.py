"""Simulation: against exact motions and conservation laws, and every way to drive, save, stop and break a run."""

from __future__ import annotations

import _thread
import importlib.util
import re
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ellipj, ellipk

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import DormandPrince54, RungeKutta4
from tenscasadi.integrators.stability import fastest_rate, stable_step
from tenscasadi.integrators.stabilization import Projection, projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.steppers import SundialsStepper
from tenscasadi.simulation.time_loop import chunk_steps
from tenscasadi.simulation.trajectory import observe_states
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError, find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
G = 9.81


def prism(control: Any = None, coordinates: Any = "reduced", **options: Any) -> Model:
    structure = shapes.prism(**{"stiffness": 1000.0, "prestress": 30.0, **options})
    return Model(Scene(structure, control=control), coordinates)


def moving(model: Model, speed: float = 0.1) -> np.ndarray:
    """The model's start with random velocities that no bar resists."""
    shape = model.structure.nodes.shape
    velocities = speed * np.random.default_rng(3).normal(size=shape) * ~model.structure.fixed
    return projection(model)(model.state(model.structure.nodes, velocities)).full().ravel()


# --- against what is known exactly ---


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_a_pendulum_swings_as_the_elliptic_functions_say(coordinates: Any) -> None:
    length, angle, t_end = 0.7, 2.0, 3.0
    model = Model(Scene(shapes.pendulum(length, angle), gravity=Gravity((0, 0, -G))), coordinates)
    errors = []
    for step in (0.01, 0.005):
        run = simulate(model, t_end, step, compiled=False)
        k = np.sin(angle / 2)
        rate = np.sqrt(1.5 * G / length)  # a uniform bar about its end
        _, cn, dn, _ = ellipj(rate * run.time, k * k)
        theta = 2 * np.arcsin(k * cn / dn)
        assert run.success
        errors.append(np.abs(run.nodes[:, 1] - length * np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=1)).max())
        assert 4 * ellipk(k * k) / rate < t_end  # more than one period
    assert errors[1] < 1e-5
    assert 14 < errors[0] / errors[1] < 18  # fourth order


def test_energy_and_momenta_of_free_motion_are_kept_at_fourth_order() -> None:
    model = prism()
    masses = model.structure.mass_matrix().toarray()
    losses = []
    for step in (0.004, 0.002):
        run = simulate(model, 1.0, step, state=moving(model), compiled=False)
        assert run.tension.min() > 1  # taut: smooth
        linear = np.einsum("ij,tjk->tk", masses, run.velocities)
        angular = np.cross(run.nodes, np.einsum("ij,tjk->tik", masses, run.velocities)).sum(axis=1)
        assert np.abs(linear - linear[0]).max() < 1e-14
        losses.append([np.abs(angular - angular[0]).max(), np.abs(run.energy_error).max(), run.bar_length_error.max()])
        assert np.array_equal(run.energy_error, run.energy - run.energy[0])
        assert run.energy_parts.sum(axis=1) == pytest.approx(run.energy)
    ratios = np.divide(*losses)
    assert np.all(ratios > 13), (losses, ratios)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_projection_keeps_bars_over_many_steps(coordinates: Any) -> None:
    model = prism(coordinates=coordinates)
    run = simulate(model, 100.0, 1e-3, state=moving(model, 0.3), correction=Projection())
    assert run.success
    assert run.time[-1] == 100.0
    assert run.bar_length_error.max() <= 1e-12
    assert np.abs(run.energy_error).max() < 1e-3 * run.energy[0]


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("shape", [shapes.double_pendulum(), shapes.d_bar(pinned=(0,))])
def test_joints_hold(shape: Structure, coordinates: Any) -> None:
    model = Model(Scene(shape, gravity=Gravity((0, -G, 0))), coordinates)
    run = simulate(model, 1.0, 1e-3, correction=Projection())
    assert run.joint_error.max() <= 1e-12
    assert run.bar_length_error.max() <= 1e-12
    assert np.abs(run.energy_error).max() < 1e-6
    assert np.ptp(run.nodes[:, -1], axis=0).max() > 0.1  # it does move


def test_damping_is_accounted_for() -> None:
    model = prism(damping=5.0)
    errors = []
    for step in (0.002, 0.001):
        run = simulate(model, 0.5, step, state=moving(model), compiled=False)
        assert run.tension.min() > 1
        assert run.energy[-1] < run.energy[0] - 1e-3
        errors.append(np.abs(run.energy_error).max())
    assert errors[1] < 1e-7
    assert errors[0] / errors[1] > 14
    unknown = simulate(model, 0.01, 1e-3, state=moving(model), compiled=False, energy_balance=False)
    assert np.isnan(unknown.energy_error).all()
    assert np.isfinite(unknown.energy).all()


@pytest.mark.parametrize("kind", [ForceDensity(), RestLength()])
def test_the_work_of_a_control_is_no_error(kind: Any) -> None:
    model = prism(kind)
    u = model.initial_control
    for control in (u * np.array([[1.0], [1.02], [0.99]]), lambda t: u * (1 + 0.02 * np.sin(9 * t))):
        errors = []
        for step in (1e-3, 5e-4):
            run = simulate(model, 0.3, step, state=moving(model), control=control, compiled=False)
            assert np.ptp(run.energy) > 1e-3
            errors.append(np.abs(run.energy_error).max())
        assert errors[1] < 1e-6
        assert errors[0] / errors[1] > 10


# --- the loop ---


@needs_compiler
@pytest.mark.parametrize("correction", [None, Projection(), Projection(every=7)])
def test_compiled_and_not_give_the_same_numbers(correction: Any) -> None:
    model = prism(RestLength(), damping=1.0)
    u = model.initial_control
    options: dict[str, Any] = {"state": moving(model), "control": lambda t: u * (1 + 0.1 * np.sin(20 * t)), "correction": correction}
    machine, virtual = (simulate(model, 1.5, 1e-3, compiled=compiled, **options) for compiled in (True, False))
    assert (machine.compiled, virtual.compiled) == (True, False)
    for field in ("states", "energy", "energy_error", "tension", "control"):
        assert np.abs(getattr(machine, field) - getattr(virtual, field)).max() < 1e-11, field


def by_hand(model: Model, x: np.ndarray, controls: np.ndarray, h: float, correction: Projection | None = None) -> np.ndarray:
    """The states that simulate should give, by calls of the step from Python."""
    step = RungeKutta4().step(model.ode)
    project = correction.step(model) if correction else None
    states = [x]
    for k, u in enumerate(controls):
        x = step(x, u, h).full().ravel()
        if correction and project and (k + 1) % correction.every == 0:
            x = project(x).full().ravel()
        states.append(x)
    return np.array(states)


@pytest.mark.parametrize("every", [1, 2, 5, 33, 70])
def test_corrections_come_after_every_nth_step(every: int) -> None:
    model = prism()
    correction = Projection(every=every)
    run = simulate(model, 1.5, 0.01, state=moving(model, 2.0), correction=correction, compiled=False)
    expected = by_hand(model, moving(model, 2.0), np.zeros((150, 0)), 0.01, correction)
    assert np.abs(run.states - expected).max() < 1e-12
    assert (run.bar_length_error[::every] < 1e-14).all()
    assert every == 1 or run.bar_length_error[every - 1] > 1e-12


@pytest.mark.parametrize("save_every", [1, 3, 7, 100, 999, 2999, 3000, 10**9, None])
def test_rows_that_are_kept(save_every: int | None) -> None:
    model = prism()
    steps = 3000
    everything = simulate(model, 3.0, 1e-3, state=moving(model), save_every=1, compiled=False)
    run = simulate(model, 3.0, 1e-3, state=moving(model), save_every=save_every, compiled=False)
    kept = [*range(0, steps, save_every or 3), steps]
    assert len(everything.time) == steps + 1
    assert run.time == pytest.approx(np.array(kept) * 1e-3, abs=1e-12)
    assert run.time[-1] == 3.0
    assert np.array_equal(run.states, everything.states[kept])


@pytest.mark.parametrize(("t_end", "step", "steps"), [(1.0, 0.3, 4), (0.3, 0.1, 3), (0.25, 5.0, 1), (0.7, 0.1, 7), (2.1, 0.01, 210), (0.7, 0.02, 35)])
def test_the_last_row_is_exactly_t_end(t_end: float, step: float, steps: int) -> None:
    model = Model(Scene(shapes.pendulum(angle=0.01), gravity=Gravity((0, 0, -G))))
    run = simulate(model, t_end, step, compiled=False)
    assert run.time[-1] == t_end
    assert len(run.time) == steps + 1
    assert run.step == pytest.approx(t_end / steps)
    assert (run.attempts, run.interrupted) == (steps, False)
    assert np.diff(run.time) == pytest.approx(run.step)


@needs_compiler
def test_one_compiled_loop_serves_every_length_and_step(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path))
    model = prism(RestLength())
    for t_end, step, save_every in ((1.0, 1e-3, 1), (0.01, 1e-4, None), (7.0, 3e-3, 13)):
        simulate(model, t_end, step, save_every=save_every, compiled=True)
    simulate(model, 1.0, state=moving(model), control=model.initial_control * 1.1, compiled=True)
    assert len(list(tmp_path.iterdir())) == 1


def test_chunks_shrink_with_the_model_and_fit_the_correction() -> None:
    many = Structure(np.random.default_rng(0).normal(size=(3000, 3)), bars=[(2 * i, 2 * i + 1) for i in range(1500)])
    small, large = chunk_steps(prism(), 1), chunk_steps(Model(Scene(many)), 1)
    assert 1 <= large < small
    assert chunk_steps(prism(), 7) % 7 == 0
    assert chunk_steps(prism(), 10**5) == 10**5


# --- controls ---


@pytest.mark.parametrize("kind", [ForceDensity(), RestLength()])
def test_every_form_of_control(kind: Any) -> None:
    model = prism(kind)
    u, x, steps, h = model.initial_control, moving(model), 1200, 1e-3
    wave = u * (1 + 0.1 * np.sin(7 * h * np.arange(steps)))[:, None]
    table = u * np.array([1.0, 1.1, 0.9])[:, None]
    times: list[float] = []

    def function(t: float) -> np.ndarray:
        times.append(t)
        return u * (1 + 0.1 * np.sin(7 * t))

    forms = [(None, [u] * steps), (1.1 * u, [1.1 * u] * steps), (table, np.repeat(table, 400, axis=0)), (table[1:2], [1.1 * u] * steps)]
    for control, used in [*forms, (function, wave)]:
        run = simulate(model, steps * h, h, state=x, control=control, save_every=1, compiled=False)
        assert np.abs(run.states - by_hand(model, x, np.array(used), h)).max() < 1e-11
        assert run.control == pytest.approx(np.concatenate([used, used[-1:]]))
        assert run.force_density[5] == pytest.approx(model.force_density(run.states[5], used[5]))
    assert times == pytest.approx(h * np.arange(steps))  # once each, in order, at the start of each step


def test_steps_fit_the_intervals_of_a_table() -> None:
    model = prism(ForceDensity())
    u = model.initial_control
    run = simulate(model, 1.0, 0.01, control=np.outer(np.linspace(1, 1.1, 7), u), compiled=False)
    assert len(run.time) == 7 * 15 + 1
    changes = np.flatnonzero(np.abs(np.diff(run.control, axis=0)).max(axis=1) > 0) + 1
    assert run.time[changes] == pytest.approx(np.arange(1, 7) / 7, abs=1e-15)


def test_a_scene_without_control_takes_an_empty_one() -> None:
    model = prism()
    reference = simulate(model, 0.1, 0.01, state=moving(model), compiled=False)
    assert reference.control.shape == (11, 0)
    for control in ([], np.zeros((3, 0)), lambda t: []):
        run = simulate(model, 0.1, 0.01, state=moving(model), control=control, compiled=False)
        assert np.array_equal(run.states, reference.states)


# --- ends that are not the end ---


def test_a_step_above_the_stability_limit_ends_with_advice() -> None:
    model = prism()
    limit = stable_step(model, safety=1.0)
    for step in (1.3 * limit, 10 * limit):
        for correction in (None, Projection()):
            run = simulate(model, 200.0, step, state=moving(model), correction=correction, compiled=False)
            assert not run.success
            assert run.message.startswith("diverged between t = ")
            for part in (f"{limit:.3g} s of RungeKutta4", f"{fastest_rate(model):.4g} rad/s", f"try step={0.9 * limit:.2g}"):
                assert part in run.message
            assert 0 <= run.time[-1] < 200
            assert np.isfinite(run.states).all()
            assert np.isfinite(run.nodes).all()
    assert simulate(model, 20.0, 0.9 * limit, state=moving(model, 1e-3), correction=Projection(), compiled=False).success


def test_divergence_is_told_however_few_rows_are_kept() -> None:
    """The loop ends in the chunk of steps in which the state overflows, whether or not a row was to be kept there."""
    model = Model(Scene(shapes.prism(prestress=30.0, stiffness=1e6, damping=100.0)))
    start = model.state(model.structure.nodes, np.cross([1.0, 2.0, 3.0], model.structure.nodes))
    for every in (1, 700, 10**9):
        run = simulate(model, 100.0, 0.01, state=start, save_every=every, compiled=False)
        assert not run.success
        assert run.message.startswith("diverged between t = 0 and" if every > 1 else "diverged between t = ")


def test_divergence_below_the_limit_names_other_causes() -> None:
    model = Model(Scene(shapes.pendulum()))
    spinning = model.state(model.structure.nodes, [[0, 0, 0], [0, 300.0, 0]])
    run = simulate(model, 10.0, 0.01, state=spinning, compiled=False)
    assert not run.success
    assert "try step=" in run.message or "Projection()" in run.message
    stretching = model.state(model.structure.nodes, [[0, 0, 0], [1.0, 0, -1.0]])
    run = simulate(model, 10.0, 0.001, state=stretching, compiled=False)
    assert "start from tenscasadi.projection(model)(state)" in run.message
    assert "projection" not in simulate(model, 0.1, 0.001, state=projection(model)(stretching), compiled=False).message
    run = simulate(model, 10.0, 0.5, Collocation(2), state=spinning, compiled=False)
    assert not run.success
    assert "the step 0.5 s is stable, as any of Collocation, so accuracy was lost elsewhere" in run.message
    assert "no solution" in run.message


def test_a_step_above_the_stability_limit_is_told_before_the_run_breaks_down() -> None:
    model = Model(Scene(shapes.prism(stiffness=1e6, prestress=50.0)))
    limit = stable_step(model, safety=1.0)
    shaken = projection(model)(model.state(model.structure.nodes, 1e-3 * np.sin(np.arange(18)).reshape(6, 3)))
    run = simulate(model, 0.2, 1.1 * limit, state=shaken, compiled=False)
    assert run.success
    suggested = re.search(r"J move: the step is above the stability limit, try step=(\S+)$", run.message)
    assert suggested
    assert 0.8 * limit < float(suggested[1]) < limit


def test_what_is_not_to_be_trusted_is_spoken_of() -> None:
    model = prism()
    off = moving(model) + 1e-3
    off[-1] += 0.1
    for options in ({}, {"correction": Projection()}, {"scheme": DormandPrince54(1e-6)}):
        run = simulate(model, 0.01, state=off, compiled=False, **options)
        assert run.success
        assert re.search(r"the start is off .* by 0\.\d+: start from tenscasadi\.projection\(model\)\(state\)$", run.message)
        assert ";" not in simulate(model, 0.01, state=moving(model), compiled=False, **options).message
    pendulum = Model(Scene(shapes.pendulum(), gravity=Gravity((0, -G, 0))))
    run = simulate(pendulum, 2.0, 0.1, compiled=False)
    assert run.success
    assert 0.01 < run.bar_length_error.max() < 0.1
    assert f"bars are off by up to {run.bar_length_error.max():.2g} of their length (correction=Projection() holds them): try a" in run.message
    run = simulate(pendulum, 4.0, 0.02, Cvodes(1e-3))
    assert "try a smaller Cvodes(rtol)" in run.message


def test_energy_that_a_correction_hides_is_spoken_of() -> None:
    model = prism()
    run = simulate(model, 50.0, 0.9 * stable_step(model, safety=1.0), state=moving(model), correction=Projection(), compiled=False)
    assert run.success
    assert "energy is off by" in run.message
    assert "energy" not in simulate(model, 1.0, 1e-3, state=moving(model), correction=Projection(), compiled=False).message
    assert "energy" not in simulate(prism(ForceDensity()), 1.0, 1e-2, compiled=False).message  # at rest but for rounding


def test_a_bad_row_inside_a_chunk_cuts_there() -> None:
    model = prism(ForceDensity())
    u = model.initial_control
    run = simulate(model, 1.0, 1e-3, control=lambda t: u if t < 0.5 else 1e9 * u, compiled=False)
    assert not run.success
    assert 0.5 <= run.time[-1] < 0.52
    assert len(run.time) == len(run.nodes) == len(run.energy_error) == len(run.control)


@pytest.mark.usefixtures("keyboard")
def test_the_keyboard_interrupts() -> None:
    model = prism(ForceDensity())
    u = model.initial_control

    def control(t: float) -> np.ndarray:
        if t > 5:
            _thread.interrupt_main()
        return u

    run = simulate(model, 1000.0, 1e-3, control=control, compiled=False)
    assert not run.success
    assert run.interrupted
    assert run.message.startswith("interrupted from the keyboard, the last state kept is at t = ")
    assert 1 < run.time[-1] <= 5
    assert len(run.time) == len(run.states)


@pytest.mark.usefixtures("keyboard")
@pytest.mark.parametrize("scheme", [Cvodes(1e-7), Idas(1e-7)])
def test_the_keyboard_interrupts_integrators_of_casadi(monkeypatch: pytest.MonkeyPatch, scheme: Any) -> None:
    """They tell of a failure where Python raises KeyboardInterrupt."""
    model = prism(ForceDensity())
    usual = signal.getsignal(signal.SIGINT)
    original = SundialsStepper._run

    def pressed(self: Any, *arguments: Any) -> Any:
        rows = original(self, *arguments)
        if calls.append(rows) is None and len(calls) == 3:
            try:
                _thread.interrupt_main()
                rows = original(self, *arguments)
            except KeyboardInterrupt:
                raise RuntimeError('CVode returned "CV_RHSFUNC_FAIL"') from None
        return rows

    calls: list[Any] = []
    monkeypatch.setattr(SundialsStepper, "_run", pressed)
    run = simulate(model, 10.0, 1e-3, scheme)
    assert run.interrupted
    assert not run.success
    assert run.message.startswith("interrupted from the keyboard")
    assert run.time[-1] == pytest.approx(0.1)
    assert signal.getsignal(signal.SIGINT) is usual


def test_a_run_that_ends_in_its_first_step_has_a_summary() -> None:
    model = Model(Scene(shapes.pendulum(), gravity=Gravity((0, 0, -G))))
    for scheme in (DormandPrince54(1e-13, max_attempts=64), Cvodes(1e-13, max_steps=5)):
        run = simulate(model, 1000.0, 500.0, scheme, compiled=False)
        assert not run.success
        assert len(run.time) == 1
        assert run.step > 0
        assert "0 … 0 s, 0 steps" in run.summary()
        assert "casadi" not in run.message  # no path in the source of CasADi


def test_rows_beyond_memory_are_refused() -> None:
    with pytest.raises(ValueError, match=r"save_every is 1: 1e\+12 rows do not fit"):
        simulate(prism(), 1e9, 1e-3, save_every=1, compiled=False)


def test_a_clock_too_late_for_its_steps_is_refused() -> None:
    mass = Structure(nodes=[(0, 0, 0)], bars=[], strings=[], node_mass=1.0)
    model = Model(Scene(mass, forces=NodalForce(lambda t: [(t, 0, 0)])))
    late = np.append(np.zeros(6), 1e12)
    with pytest.raises(ValueError, match=r"clock runs to 1e\+12 s, where steps of 0.001 s drown in rounding: start it nearer to 0"):
        simulate(model, 1.0, 1e-3, state=late, compiled=False)
    assert simulate(model, 1.0, 1e-3, state=late * 1e-6, compiled=False).success


def test_progress_is_shown_only_on_request(capfd: pytest.CaptureFixture[str]) -> None:
    model = prism()
    simulate(model, 0.1, 1e-2, compiled=False)
    assert capfd.readouterr() == ("", "")
    simulate(model, 0.1, 1e-2, compiled=False, progress=True)
    assert "10.0/10.0" in capfd.readouterr().err


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    model = prism()
    run = simulate(model, 0.1, 1e-2)
    assert run.success
    assert not run.compiled
    assert "not compiled: no C compiler found: install" in run.message
    with pytest.raises(CompileError, match="no C compiler found"):
        simulate(model, 0.1, 1e-2, compiled=True)
    assert "compiled" not in simulate(model, 0.1, 1e-2, compiled=False).message


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
def test_with_a_broken_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    broken = tmp_path / "brokencc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o700)
    monkeypatch.setenv("CC", str(broken))
    run = simulate(prism(), 0.1, 1e-2)
    assert run.success
    assert "brokencc failed" in run.message
    with pytest.raises(CompileError, match="brokencc"):
        simulate(prism(), 0.1, 1e-2, compiled=True)


def test_saved_and_loaded(tmp_path: Path) -> None:
    run = simulate(prism(), 0.1, 1e-2, compiled=False)
    loaded = type(run).load(run.save(tmp_path / "run.npz"))
    assert np.array_equal(loaded.nodes, run.nodes)
    assert loaded.summary() == run.summary()


def test_observed_is_what_the_model_says_row_by_row() -> None:
    model = Model(Scene(shapes.d_bar(pinned=(0,), prestress=10.0), control=RestLength(), gravity=Gravity((0, 0, -G))), "full")
    states = moving(model) + 1e-3 * np.random.default_rng(0).normal(size=(5, model.nx))
    observed = observe_states(model, states, np.tile(model.initial_control, (5, 1)))
    for row, x in enumerate(states):
        assert observed["nodes"][row].reshape(-1, 3) == pytest.approx(model.nodes(x))
        assert observed["velocities"][row].reshape(-1, 3) == pytest.approx(model.velocities(x))
        assert observed["tension"][row] == pytest.approx(model.tension(x))
        assert observed["energy"][row] == pytest.approx(np.array(model.energy(x)))
        assert observed["bar_length_error"][row, 0] == pytest.approx(model.bar_length_error(x))
        assert observed["joint_error"][row, 0] == pytest.approx(model.joint_error(x))


# --- mistakes ---


@pytest.mark.parametrize(
    ("argument", "value", "error"),
    [
        ("model", shapes.prism(), TypeError), ("t_end", 0, ValueError), ("t_end", -1.0, ValueError), ("t_end", np.inf, ValueError),
        ("t_end", "long", TypeError), ("t_end", 1e12, ValueError), ("step", 0.0, ValueError), ("step", np.nan, ValueError),
        ("step", "small", TypeError), ("scheme", "rk4", TypeError), ("scheme", RungeKutta4, TypeError), ("state", np.zeros(3), ValueError),
        ("state", np.full(36, np.nan), ValueError), ("state", "rest", TypeError),
        ("control", np.zeros(4), ValueError), ("control", np.zeros((0, 9)), ValueError),
        ("control", np.zeros((2, 4)), ValueError), ("control", np.full(9, np.inf), ValueError), ("control", 1.0, ValueError),
        ("control", [[1.0], [1.0, 2.0]], TypeError), ("control", "tight", TypeError), ("control", lambda t: np.zeros(3), ValueError),
        ("control", lambda t: np.full(9, np.nan if t > 0.005 else 1), ValueError), ("control", lambda t: None, TypeError),
        ("correction", "projection", TypeError), ("correction", Projection, TypeError), ("save_every", 0, ValueError), ("save_every", 1.5, TypeError),
        ("save_every", True, TypeError), ("compiled", "yes", TypeError), ("progress", 1, TypeError), ("energy_balance", None, TypeError),
    ],
)  # fmt: skip
def test_mistakes_are_named(argument: str, value: Any, error: type[Exception]) -> None:
    arguments: dict[str, Any] = {"model": prism(ForceDensity()), "t_end": 0.01, "compiled": False} | {argument: value}
    with pytest.raises(error, match=r"step|t_end" if argument in ("t_end", "step") else argument):
        simulate(**arguments)


def test_the_benchmark_runs(capsys: pytest.CaptureFixture[str]) -> None:
    path = Path(__file__).parents[3] / "examples" / "benchmark_rhs.py"
    spec = importlib.util.spec_from_file_location("benchmark_rhs", path)
    assert spec is not None
    assert spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    rows = benchmark.main(quick=True)
    assert [row.scene.split(",")[0] for row in rows] == ["prism", "prism", "six-bar ball", "six-bar ball"]
    assert "six-bar ball, elastic strings" in capsys.readouterr().out
    for row in rows:
        assert row.virtual_machine > 2 * row.numpy
        assert row.compiled is None or row.compiled > 20 * row.numpy  # what an idle machine gives is several times that

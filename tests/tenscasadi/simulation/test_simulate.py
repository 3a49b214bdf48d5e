"""Simulation: against exact motions and conservation laws, and every way to drive, save, stop and break a run."""

from __future__ import annotations

import _thread
import time
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
import pytest
from runs import moving, prism
from scipy.special import ellipj, ellipk

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity, RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
G = 9.81


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
        errors.append(
            np.abs(
                run.nodes[:, 1]
                - length * np.stack([np.sin(theta), 0 * theta, -np.cos(theta)], axis=1)
            ).max()
        )
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
        losses.append(
            [
                np.abs(angular - angular[0]).max(),
                np.abs(run.energy_error).max(),
                run.bar_length_error.max(),
            ]
        )
        assert np.array_equal(run.energy_error, run.energy - run.energy[0])
        assert run.energy_parts.sum(axis=1) == pytest.approx(run.energy)
    ratios = np.divide(*losses)
    assert np.all(ratios > 13), (losses, ratios)


@pytest.mark.parametrize("coordinates", ["reduced", pytest.param("full", marks=pytest.mark.slow)])
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
    for control in (
        u * np.array([[1.0], [1.02], [0.99]]),
        lambda t: u * (1 + 0.02 * np.sin(9 * t)),
    ):
        errors = []
        for step in (1e-3, 5e-4):
            run = simulate(model, 0.3, step, state=moving(model), control=control, compiled=False)
            assert np.ptp(run.energy) > 1e-3
            errors.append(np.abs(run.energy_error).max())
        assert errors[1] < 1e-6
        assert errors[0] / errors[1] > 10


# --- the loop ---


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


@pytest.mark.parametrize(
    ("t_end", "step", "steps"),
    [
        (1.0, 0.3, 4),
        (0.3, 0.1, 3),
        (0.25, 5.0, 1),
        (0.7, 0.1, 7),
        (2.1, 0.01, 210),
        (0.7, 0.02, 35),
    ],
)
def test_the_last_row_is_exactly_t_end(t_end: float, step: float, steps: int) -> None:
    model = Model(Scene(shapes.pendulum(angle=0.01), gravity=Gravity((0, 0, -G))))
    run = simulate(model, t_end, step, compiled=False)
    assert run.time[-1] == t_end
    assert len(run.time) == steps + 1
    assert run.step == pytest.approx(t_end / steps)
    assert (run.attempts, run.interrupted) == (steps, False)
    assert np.diff(run.time) == pytest.approx(run.step)


# --- ends that are not the end ---


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
    Timer(1.0, _thread.interrupt_main).start()
    run = simulate(model, 1000.0, 1e-3, compiled=False)
    assert not run.success
    assert run.interrupted
    assert run.message.startswith("interrupted from the keyboard, the last state kept is at t = ")
    assert 0 < run.time[-1] < 1000
    assert len(run.time) == len(run.states)


def test_rows_beyond_memory_are_refused() -> None:
    with pytest.raises(ValueError, match=r"save_every is 1: 1e\+12 rows take .* GB are free"):
        simulate(prism(), 1e9, 1e-3, save_every=1, compiled=False)


def test_a_clock_too_late_for_its_steps_is_refused() -> None:
    mass = Structure(nodes=[(0, 0, 0)], bars=[], strings=[], node_mass=1.0)
    model = Model(Scene(mass, forces=NodalForce(lambda t: [(t, 0, 0)])))
    late = np.append(np.zeros(6), 1e12)
    with pytest.raises(
        ValueError,
        match=r"clock runs to 1e\+12 s, where steps of 0.001 s are lost in rounding: start it nearer to 0",
    ):
        simulate(model, 1.0, 1e-3, state=late, compiled=False)
    assert simulate(model, 1.0, 1e-3, state=late * 1e-6, compiled=False).success


def test_progress_is_shown_only_on_request(capfd: pytest.CaptureFixture[str]) -> None:
    model = prism()
    simulate(model, 0.1, 1e-2, compiled=False)
    assert capfd.readouterr() == ("", "")
    simulate(model, 0.1, 1e-2, compiled=False, progress=True)
    assert "10.0/10.0" in capfd.readouterr().err


def test_saved_and_loaded(tmp_path: Path) -> None:
    run = simulate(prism(), 0.1, 1e-2, compiled=False)
    loaded = type(run).load(run.save(tmp_path / "run.npz"))
    assert np.array_equal(loaded.nodes, run.nodes)
    assert loaded.summary() == run.summary()


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
    arguments: dict[str, Any] = {
        "model": prism(ForceDensity()),
        "t_end": 0.01,
        "compiled": False,
    } | {argument: value}
    with pytest.raises(error, match=r"step|t_end" if argument in ("t_end", "step") else argument):
        simulate(**arguments)


@pytest.mark.parametrize(
    ("scheme", "step"),
    [(RungeKutta4(), 1e-3), (DormandPrince853(1e-12), 0.1), (DormandPrince54(1e-12), 1000.0)],
)
def test_a_run_stops_when_its_seconds_are_over(scheme: Any, step: float) -> None:
    """What it has is kept, as by Ctrl-C; one grid step alone may take longer than there is time for."""
    model = Model(Scene(shapes.double_pendulum(), gravity=Gravity((0, -9.81, 0))))
    began = time.perf_counter()
    run = simulate(
        model,
        1e5,
        step,
        scheme,
        compiled=False,
        save_every=1 if scheme.adaptive else 1000,
        time_limit=0.3,
    )
    assert time.perf_counter() - began < 20.0
    assert not run.success
    assert not run.interrupted
    assert "the time limit of 0.3 s has expired: increase time_limit" in run.message
    assert np.isfinite(run.states).all()
    assert (run.time[-1] == 0.0) == (step == 1000.0)
    assert simulate(model, 0.1, scheme=scheme, compiled=False, time_limit=100.0).success
    with pytest.raises(ValueError, match="time_limit is 0"):
        simulate(model, 0.1, time_limit=0)
    with pytest.warns(DeprecationWarning, match="time_limit"):
        assert simulate(model, 0.1, compiled=False, seconds=100.0).success  # type: ignore[call-arg]


def test_numpy_booleans_are_options() -> None:
    no: Any = np.False_
    options = {"compiled": no, "progress": no, "energy_balance": no, "verify": no}
    found = simulate(prism(), 0.01, 1e-3, **options)
    assert found.success
    assert not found.compiled
    assert np.isnan(found.error_estimate)

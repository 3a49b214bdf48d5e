"""Error control: tolerances that are kept, events that are located, and every way in which a run may fail."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from references import solve_certified

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators import adaptive
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, EmbeddedRungeKutta
from tenscasadi.integrators.stabilization import BarLengthCorrection, Projection, build_projection
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler on this machine")
SMOOTH = ["prism_n1", "double_pendulum", "cross_bar", "spin_bar"]
EVENTS = {
    "net4": 11,
    "dbar_regular": 12,
    "lander_mass": 20,
    "redundant_triangle": 8,
}  # as many as the certified solution met


# --- accuracy ---


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("scheme", [DormandPrince54, DormandPrince853])
def test_order_on_smooth_certified_scenes(name: str, scheme: type[EmbeddedRungeKutta]) -> None:
    coarse, fine = (solve_certified(name, scheme(rtol)) for rtol in (1e-6, 1e-9))
    assert fine[0] < 2e-5 * coarse[0] ** 0.2  # some 1e-9, times what the motion makes of it
    order = np.log(coarse[0] / fine[0]) / np.log(coarse[1].step / fine[1].step)
    assert order > scheme.order - 0.5
    assert "events" not in fine[1].message


@pytest.mark.parametrize("name", EVENTS)
def test_order_is_kept_across_events(name: str) -> None:
    coarse, fine = (solve_certified(name, DormandPrince54(rtol)) for rtol in (1e-7, 1e-11))
    order = np.log(coarse[0] / fine[0]) / np.log(coarse[1].step / fine[1].step)
    assert order > 4.5
    assert fine[0] < 1e-9
    for _, run in (coarse, fine):
        assert 0 < located(run, EVENTS[name]) <= 2 * EVENTS[name]


def located(run: Trajectory, events: int) -> int:
    """Attempts that it took to locate so many events."""
    found = re.search(rf"(\d+) to locate {events} events", run.message)
    assert found is not None, run.message
    return int(found[1])


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("name", EVENTS)
def test_order_eight_reaches_a_tenth_of_a_nanometre_across_events(
    name: str, coordinates: Any
) -> None:
    error, run = solve_certified(
        name, DormandPrince853(1e-12), coordinates, correction=Projection()
    )
    assert error < 1e-10
    assert located(run, EVENTS[name]) <= 3 * EVENTS[name]
    assert run.bar_length_error.max() < 1e-14
    assert run.joint_error.max() < 1e-14


def test_energy_is_accounted_for_across_contact() -> None:
    _, run = solve_certified("lander_mass", DormandPrince853(1e-10))
    assert run.energy[-1] < run.energy[0] - 10
    assert abs(run.energy_error).max() < 1e-7


@needs_compiler
@pytest.mark.parametrize(
    ("scheme", "correction"),
    [(DormandPrince54(1e-7), None), (DormandPrince853(1e-9), Projection())],
)
def test_compiled_and_not_give_the_same_numbers(
    scheme: EmbeddedRungeKutta, correction: Any
) -> None:
    (_, machine), (_, virtual) = (
        solve_certified("net4", scheme, compiled=compiled, correction=correction)
        for compiled in (True, False)
    )
    assert (machine.compiled, virtual.compiled) == (True, False)
    assert abs(machine.states - virtual.states).max() < 1e-11
    assert machine.message == virtual.message


@needs_compiler
def test_one_compiled_function_serves_all_tolerances(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("TENSCASADI_CACHE", str(tmp_path))
    schemes = [DormandPrince54(1e-4), DormandPrince54(1e-9), DormandPrince54(1e-9, 1e-4)]
    runs = [
        simulate(spring(1.5), 0.15, step, scheme, compiled=True)
        for scheme, step in zip(schemes, (0.1, 0.1, 0.15), strict=True)
    ]
    assert len(list(tmp_path.iterdir())) == 2  # the engine, and the model's code
    errors = [abs(run.nodes[-1, 1, 0] - 1 - 0.5 * np.cos(1.5)) for run in runs]  # taut all along
    assert errors[1] < 1e-3 * errors[0]
    assert errors[2] > 100 * errors[1]  # atol counts too


# --- events ---


def test_events_are_located_even_where_interpolation_is_of_no_help(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def useless(gaps: ca.Function, model: Model) -> ca.Function:
        arguments = exact(gaps, model).mx_in()
        return ca.Function("root", arguments, [arguments[-3]])  # the start of the bracket

    exact = adaptive.build_root
    monkeypatch.setattr(adaptive, "build_root", useless)
    error, run = solve_certified("net4", DormandPrince853(1e-10))
    assert error < 1e-8
    assert located(run, EVENTS["net4"]) > 5 * EVENTS["net4"]


def spring(length: float = 1.0, **options: Any) -> Model:
    """A mass of 1 kg on a string of 100 N/m, at rest at 1 m."""
    structure = Structure(
        [[0, 0, 0], [length, 0, 0]],
        strings=[(0, 1)],
        node_mass=1.0,
        pinned=[0],
        stiffness=100.0,
        rest_length=1.0,
        **options,
    )
    return Model(Scene(structure))


@pytest.mark.parametrize("damping", [0.0, 3.0])
def test_a_string_that_starts_exactly_at_its_rest_length(damping: float) -> None:
    model = spring(damping=damping)
    still = simulate(model, 1.0, scheme=DormandPrince54(1e-8), compiled=False)
    assert still.success
    assert abs(still.nodes - still.nodes[0]).max() == 0
    away = simulate(
        model,
        0.2,
        scheme=DormandPrince54(1e-9),
        state=model.state([[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [1.0, 0, 0]]),
        compiled=False,
    )
    rate = np.sqrt(100.0 - damping**2 / 4)
    exact = 1 + np.exp(-damping / 2 * away.time) * np.sin(rate * away.time) / rate
    assert abs(away.nodes[:, 1, 0] - exact).max() < 1e-8


def test_a_bounce_within_one_step_is_seen() -> None:
    """A ball on a stiff ground: contact lasts a fiftieth of the largest step, and every flight is exact at any step."""
    k, height = 1e6, 0.5
    model = Model(
        Scene(
            Structure([[0, 0, height]], node_mass=1.0),
            gravity=Gravity((0, 0, -10.0)),
            ground=Ground(stiffness=k),
        )
    )
    fall = np.sqrt(2 * height / 10)
    run = simulate(model, 3.5 * fall, 0.5 * fall, scheme=DormandPrince853(1e-10), compiled=False)
    assert run.success
    assert "to locate 4 events" in run.message
    speed, rate = np.sqrt(20 * height), np.sqrt(k)
    contact = (np.pi + 2 * np.arctan(10 / (rate * speed))) / rate
    t = 3.5 * fall - fall - contact
    bounce = 2 * speed / 10
    assert t > bounce + contact
    t -= bounce + contact
    assert run.nodes[-1, 0, 2] == pytest.approx(speed * t - 5 * t * t, abs=1e-7)


def test_a_string_that_is_taut_for_a_moment_is_seen() -> None:
    """The mass flies past the end of a slack string: taut for a sixtieth of the largest step."""
    structure = Structure(
        [[0, 0, 0], [-0.2, 0.999, 0]],
        strings=[(0, 1)],
        node_mass=1.0,
        pinned=[0],
        stiffness=100.0,
        rest_length=1.0,
    )
    model = Model(Scene(structure))
    start = model.state(structure.nodes, [[0, 0, 0], [1.0, 0, 0]])
    reference = simulate(model, 0.4, 1e-5, state=start).nodes[-1]
    assert abs(reference[1] - [0.2, 0.999, 0]).max() > 1e-2  # it does pull
    run = simulate(model, 0.4, 0.4, scheme=DormandPrince54(1e-9), state=start, compiled=False)
    assert abs(run.nodes[-1] - reference).max() < 1e-8


# --- controls, corrections, rows ---


def test_controls_change_on_the_grid_and_their_work_is_no_error() -> None:
    model = Model(
        Scene(shapes.prism(stiffness=1000.0, prestress=30.0, damping=1.0), control=RestLength())
    )
    table = model.initial_control * np.array([[1.0], [1.02], [0.99]])
    run = simulate(model, 0.3, 0.1, DormandPrince853(1e-11), control=table, compiled=False)
    fine = simulate(model, 0.3, 1e-4, control=table, compiled=False)
    assert abs(run.nodes[-1] - fine.nodes[-1]).max() < 1e-9
    assert np.ptp(run.energy) > 1e-3
    assert abs(run.energy_error).max() < 1e-8
    waves = simulate(
        model,
        0.3,
        1e-3,
        DormandPrince853(1e-11),
        control=lambda t: table[0] * (1 + 0.1 * np.sin(20 * t)),
        compiled=False,
    )
    assert waves.success, waves.message  # strings of equal length change their mode together
    fixed = simulate(
        model,
        0.3,
        1e-4,
        DormandPrince853(),
        control=lambda t: table[0] * (1 + 0.1 * np.sin(20 * t)),
        compiled=False,
    )
    assert abs(waves.nodes[-1] - fixed.nodes[-1]).max() < 2e-6
    unknown = simulate(
        model, 0.3, 0.1, DormandPrince54(1e-6), control=table, compiled=False, energy_balance=False
    )
    assert np.isnan(unknown.energy_error).all()


def test_loads_that_depend_on_time() -> None:
    structure = Structure([[0, 0, 0]], node_mass=2.0)
    model = Model(Scene(structure, forces=NodalForce(lambda t: [[np.cos(3 * t), 0, 0]])))
    run = simulate(model, 2.0, scheme=DormandPrince54(1e-10), compiled=False)
    assert run.nodes[:, 0, 0] == pytest.approx((1 - np.cos(3 * run.time)) / 18, abs=1e-9)
    assert abs(run.energy_error).max() < 1e-8


def test_corrections_follow_each_step() -> None:
    model = Model(Scene(shapes.prism(stiffness=1000.0, prestress=30.0)))
    start = (
        build_projection(model)(
            model.state(model.structure.nodes, np.random.default_rng(3).normal(size=(6, 3)))
        )
        .full()
        .ravel()
    )
    plain = simulate(model, 1.0, scheme=DormandPrince54(1e-5), state=start, compiled=False)
    assert plain.bar_length_error.max() > 1e-8
    for correction in (Projection(), BarLengthCorrection()):
        run = simulate(
            model,
            1.0,
            scheme=DormandPrince54(1e-5),
            state=start,
            correction=correction,
            compiled=False,
        )
        assert run.bar_length_error.max() < 1e-14
        assert np.isnan(run.correction_shift).all()
        assert "not measured" in run.summary()
    with pytest.raises(ValueError, match=r"correction\.every is 3"):
        simulate(model, 1.0, scheme=DormandPrince54(1e-5), correction=Projection(every=3))


def test_rows_and_steps() -> None:
    model = spring(1.5)
    run = simulate(model, 2.0, scheme=DormandPrince54(1e-8), compiled=False)
    assert run.time == pytest.approx(np.linspace(0, 2, 101))
    assert 0 < run.step <= 0.02
    counts = [int(word) for word in re.findall(r"\b(\d+) (?:steps|more|to)\b", run.message)]
    assert len(counts) == 3
    assert all(counts)
    assert run.attempts == sum(counts)
    assert f"by {run.attempts} attempts" in run.summary()
    few = simulate(model, 2.0, scheme=DormandPrince54(1e-8), save_every=30, compiled=False)
    assert few.time == pytest.approx([0, 0.6, 1.2, 1.8, 2.0])
    assert np.array_equal(few.nodes[-1], run.nodes[-1])


# --- failures and mistakes ---


def test_too_many_attempts_end_the_run_with_a_reason() -> None:
    model = spring(1.5)
    run = simulate(model, 10.0, 5.0, DormandPrince54(1e-12, max_attempts=64), compiled=False)
    assert not run.success
    assert "64 attempts did not reach" in run.message
    assert "max_attempts" in run.message
    assert run.time.tolist() == [0.0]


def test_a_motion_that_runs_away_is_no_silent_nan() -> None:
    force = NodalForce(
        lambda t: [[0, 0, 0], [0, ca.exp(690 * t), 0]]
    )  # finite over the whole run, its square is not
    model = Model(Scene(Structure([[0, 0, 0], [1, 0, 0]], bars=[(0, 1)]), forces=force))
    run = simulate(model, 1.0, scheme=DormandPrince54(1e-8, max_attempts=1000), compiled=False)
    assert not run.success
    assert run.time[-1] < 1.0
    assert np.isfinite(run.states).all()
    assert "breaks down" in run.message or "attempts" in run.message


def test_mistakes_are_named() -> None:
    for name, wrong in {"rtol": -1.0, "max_attempts": 0, "atol": -1e-3}.items():
        options: dict[str, Any] = {"rtol": 1e-6} | {name: wrong}
        for scheme in (DormandPrince54, DormandPrince853):
            with pytest.raises(ValueError, match=rf"{scheme.__name__}\.{name}"):
                scheme(**options)
    for wrong in (1e-17, 2.0):
        with pytest.raises(ValueError, match=r"DormandPrince54\.rtol"):
            DormandPrince54(wrong)
    with pytest.raises(ValueError, match=r"DormandPrince54\.atol .* rtol is None"):
        DormandPrince54(atol=1e-6)
    with pytest.raises(TypeError, match=r"DormandPrince54\.atol is not a real number"):
        DormandPrince54(atol=10**5000)  # which has no text
    with pytest.raises(TypeError, match=r"DormandPrince54\.rtol"):
        DormandPrince54("tight")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rtol is None"):
        DormandPrince54().tolerances(spring())
    assert DormandPrince54(1e-6).tolerances(spring(1.5)) == (1e-6, 1.5e-6)
    assert DormandPrince54(1e-6, 1e-9).tolerances(spring()) == (1e-6, 1e-9)

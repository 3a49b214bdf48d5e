"""Messages of runs: why one broke down, what in one that finished is not to be trusted."""

from __future__ import annotations

import re

import numpy as np
import pytest
from runs import moving, prism

import tenscasadi as tc
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.stability import stable_step
from tenscasadi.integrators.stabilization import Projection, build_projection
from tenscasadi.integrators.sundials import Cvodes
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure

G = 9.81


def test_a_step_above_the_stability_limit_ends_with_advice() -> None:
    model = prism()
    limit = stable_step(model, safety=1.0)
    for step in (1.3 * limit, 10 * limit):
        for correction in (None, Projection()):
            run = simulate(
                model, 200.0, step, state=moving(model), correction=correction, compiled=False
            )
            assert not run.success
            assert run.message.startswith("diverged between t = ")
            for part in (
                f"{limit:.3g} s of RungeKutta4",
                f"try step={0.9 * limit:.2g}",
            ):
                assert part in run.message
            assert 0 <= run.time[-1] < 200
            assert np.isfinite(run.states).all()
            assert np.isfinite(run.nodes).all()
    assert simulate(
        model, 20.0, 0.9 * limit, state=moving(model, 1e-3), correction=Projection(), compiled=False
    ).success


def test_divergence_is_told_however_few_rows_are_kept() -> None:
    """The loop ends in the chunk of steps in which the state overflows, whether or not a row was to be kept there."""
    model = Model(Scene(shapes.prism(prestress=30.0, stiffness=1e6, damping=100.0)))
    start = model.state(model.structure.nodes, np.cross([1.0, 2.0, 3.0], model.structure.nodes))
    for every in (1, 700, 10**9):
        run = simulate(model, 100.0, 0.01, state=start, save_every=every, compiled=False)
        assert not run.success
        assert run.message.startswith(
            "diverged between t = 0 and" if every > 1 else "diverged between t = "
        )


def test_divergence_below_the_limit_names_other_causes() -> None:
    model = Model(Scene(shapes.pendulum()))
    spinning = model.state(model.structure.nodes, [[0, 0, 0], [0, 300.0, 0]])
    run = simulate(model, 10.0, 0.01, state=spinning, compiled=False)
    assert not run.success
    assert "try step=" in run.message or "Projection()" in run.message
    stretching = model.state(model.structure.nodes, [[0, 0, 0], [1.0, 0, -1.0]])
    run = simulate(model, 10.0, 0.001, state=stretching, compiled=False)
    assert "start from tenscasadi.build_projection(model)(state)" in run.message
    assert (
        "projection"
        not in simulate(
            model, 0.1, 0.001, state=build_projection(model)(stretching), compiled=False
        ).message
    )
    run = simulate(model, 10.0, 0.5, Collocation(2), state=spinning, compiled=False)
    assert not run.success
    assert (
        "the step 0.5 s is stable, as any of Collocation, so accuracy was lost elsewhere"
        in run.message
    )
    assert "stages that did not converge" in run.message


def test_a_step_above_the_stability_limit_is_told_before_the_run_breaks_down() -> None:
    model = Model(Scene(shapes.prism(stiffness=1e6, prestress=50.0)))
    limit = stable_step(model, safety=1.0)
    shaken = build_projection(model)(
        model.state(model.structure.nodes, 1e-3 * np.sin(np.arange(18)).reshape(6, 3))
    )
    run = simulate(model, 0.2, 1.1 * limit, state=shaken, compiled=False)
    assert not run.success
    assert run.message.startswith("finished")
    suggested = re.search(r"above the stability limit .*: try step=(\S+)$", run.message)
    assert suggested
    assert 0.8 * limit < float(suggested[1]) < limit


def test_what_is_not_to_be_trusted_is_spoken_of() -> None:
    model = prism()
    off = moving(model) + 1e-3
    off[-1] += 0.1
    for options in ({}, {"correction": Projection()}, {"scheme": DormandPrince54(1e-6)}):
        run = simulate(model, 0.01, state=off, compiled=False, **options)
        assert run.success
        assert re.search(
            r"the start is off .* by 0\.\d+: start from tenscasadi\.build_projection\(model\)\(state\)$",
            run.message,
        )
        assert (
            ";" not in simulate(model, 0.01, state=moving(model), compiled=False, **options).message
        )
    pendulum = Model(Scene(shapes.pendulum(), gravity=Gravity((0, -G, 0))))
    run = simulate(pendulum, 2.0, 0.1, compiled=False)
    assert run.success
    assert 0.01 < run.bar_length_error.max() < 0.1
    assert (
        f"bars are off by up to {run.bar_length_error.max():.2g} of their length (correction=Projection() holds them)"
        in run.message
    )
    run = simulate(pendulum, 4.0, 0.02, Cvodes(1e-3))
    assert "try Cvodes(rtol=" in run.message


def test_energy_that_a_correction_hides_is_spoken_of() -> None:
    model = prism()
    run = simulate(
        model,
        50.0,
        0.9 * stable_step(model, safety=1.0),
        state=moving(model),
        correction=Projection(),
        compiled=False,
    )
    assert run.success
    assert "energy is off by" in run.message
    assert (
        "energy"
        not in simulate(
            model, 1.0, 1e-3, state=moving(model), correction=Projection(), compiled=False
        ).message
    )
    assert (
        "energy" not in simulate(prism(ForceDensity()), 1.0, 1e-2, compiled=False).message
    )  # at rest but for rounding


def test_a_start_off_its_bars_is_told_wherever_it_is_and_however_fast_it_flies() -> None:
    """Lengths and speeds of bars are the measure, not the largest entry of the state."""
    for coordinates in ("reduced", "full"):
        model = Model(Scene(shapes.prism()), coordinates=coordinates)
        nodes, still = model.structure.nodes, np.zeros((6, 3))
        for origin, flight in ((0.0, 0.0), (1e4, 0.0), (0.0, 1e4), (1e5, 1e3)):
            kept = simulate(
                model, 0.01, state=model.state(nodes + origin, still + flight), compiled=False
            )
            assert kept.success
            assert ";" not in kept.message
            for factor, success in ((1.00001, True), (1.009, True), (2.0, False)):
                run = simulate(
                    model,
                    0.01,
                    state=model.state(factor * nodes + origin, still + flight),
                    compiled=False,
                )
                assert run.success is success
                assert "; the start is off the lengths of its bars" in run.message
            stretching = simulate(
                model,
                0.01,
                state=model.state(nodes + origin, 1e-4 * nodes + flight),
                compiled=False,
            )
            assert "; the start is off the lengths of its bars" in stretching.message


def _pair(damping: float, length: float = 1.1, stiffness: float = 1e3) -> Model:
    """Two masses of 1 kg on a string of 1 m at rest."""
    ends = [(0, 0, 0), (length, 0, 0)]
    return Model(
        Scene(
            Structure(
                ends,
                strings=[(0, 1)],
                node_mass=1.0,
                stiffness=stiffness,
                damping=damping,
                rest_length=1.0,
            )
        )
    )


def test_steps_above_the_limit_of_damped_strings_are_no_success() -> None:
    """StringLaw bounds what the steps blow up: the run ends, far from the motion."""
    for damping in (300.0, 1e3, 1e5):
        model = _pair(damping)
        run = simulate(model, 1.0, 0.01, compiled=False)
        assert not run.success
        assert "; the step 0.01 s is above the stability limit" in run.message
        fine = simulate(model, 0.01, 0.1 * stable_step(model), compiled=False, save_every=10**6)
        assert fine.success
        assert "stability" not in fine.message


def test_steps_above_the_limit_are_told_where_a_string_goes_taut_later_on() -> None:
    """Also one that is taut within a step alone, and slack at all kept rows."""
    model = _pair(1e5, length=0.9)
    parting = model.state(model.structure.nodes, [[-0.57, 0, 0], [0.57, 0, 0]])
    run = simulate(model, 1.0, 0.01, state=parting, compiled=False)
    assert not run.success
    assert "; the step 0.01 s is above the stability limit" in run.message
    assert (
        simulate(model, 0.05, 0.01, state=parting, compiled=False).message
        == "finished 5 steps of 0.01 s"
    )


def test_steps_of_sound_runs_are_not_spoken_of() -> None:
    model = _pair(0.0)
    limit = stable_step(model, safety=1.0)
    for scheme in (RungeKutta4(), Rattle(), Collocation(2), DormandPrince54()):
        assert "stability" not in simulate(model, 1.0, 0.05 * limit, scheme, compiled=False).message
    assert "stability" not in simulate(model, 5.0, 0.98 * limit, compiled=False).message
    assert (
        "stability"
        not in simulate(_pair(1e5), 0.1, 0.01, Collocation(2, "radau"), compiled=False).message
    )


def test_friction_that_chatters_is_told_and_trusted():
    scene = tc.Scene(
        tc.Structure([(0, 0, 0)], node_mass=1.0),
        gravity=tc.Gravity((2.0, 0.0, -9.81)),
        ground=tc.Ground(stiffness=1e4, damping=100.0, friction=0.5, slip_speed=1e-4),
    )
    run = tc.simulate(tc.Model(scene), 0.5, 1e-4)
    assert run.success
    assert "above the stability limit" in run.message
    assert np.abs(run.nodes[-1, 0, 0]) < 1e-3  # it sticks


@pytest.mark.parametrize(("share", "told"), [(0.4, False), (0.75, True), (0.9, True)])
def test_stable_steps_too_long_for_damped_strings_that_go_slack_are_told(
    share: float, told: bool
) -> None:
    """An overdamped string lets go and catches within a step: centimetres off long before vibrations grow."""
    pair = Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[1, 1],
        stiffness=1e3,
        damping=100.0,
        rest_length=0.9,
    )
    model = Model(Scene(pair))
    limit = stable_step(model, safety=1.0)
    truth = simulate(model, 1.0, scheme=DormandPrince853(1e-10), compiled=False)
    run = simulate(model, 1.0, share * limit, compiled=False)
    wrong = abs(run.nodes[-1] - truth.nodes[-1]).max()
    assert (wrong > 0.02) == told
    assert not told or "(position error about" in run.message
    if told:
        cured = simulate(model, 1.0, float(run.message.rsplit("step=")[-1]), compiled=False)
        assert cured.success
        assert abs(cured.nodes[-1] - truth.nodes[-1]).max() < 1e-3


def test_strings_are_judged_with_the_parameters_of_the_run() -> None:
    """Strings that are slack and undamped with the scene's own values: taut within a step alone, or damped and let go."""
    parameters = tc.Parameters("rest_length", "damping")
    taut = {"rest_length": 1.0, "damping": 1e3}, 0.9, [[-0.57, 0, 0], [0.57, 0, 0]], 0.01
    damped = {"rest_length": 0.9, "damping": 100.0}, 1.0, None, 0.011
    for values, length, speeds, step in (taut, damped):
        pair = Structure(
            [(0, 0, 0), (length, 0, 0)],
            strings=[(0, 1)],
            node_mass=1.0,
            stiffness=1e3,
            rest_length=5.0,
        )
        model = Model(Scene(pair, parameters=parameters))
        start = model.state(pair.nodes, speeds)
        runs = [
            simulate(m, 1.0, step, state=start, parameters=p, compiled=False)
            for m, p in ((model, values), (model.with_parameters(values), None))
        ]
        assert runs[0].message == runs[1].message
        assert runs[0].success == runs[1].success
        assert "(position error about" in runs[0].message

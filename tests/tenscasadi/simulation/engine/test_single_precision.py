"""Single precision: the loop computes in float and nothing else changes; what asks for more than float holds is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.util.compile import find_compiler

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")


def turning(control: tc.ForceDensity | None = None) -> tuple[tc.Model, np.ndarray]:
    """A prism that turns and vibrates: smooth, no string goes slack."""
    prism = tc.shapes.prism(prestress=50.0, stiffness=500.0, damping=0.5)
    model = tc.Model(tc.Scene(prism, control=control, gravity=tc.Gravity()))
    return model, model.state(prism.nodes, np.cross((1.0, 2.0, 3.0), prism.nodes))


@needs_compiler
@pytest.mark.parametrize(
    "scheme",
    [
        tc.RungeKutta4(),
        pytest.param(tc.DormandPrince853(), marks=pytest.mark.slow),
        tc.DormandPrince54(rtol=1e-6),
        pytest.param(tc.Rattle(), marks=pytest.mark.slow),
        pytest.param(tc.Collocation(tolerance=1e-6), marks=pytest.mark.slow),
    ],
)
def test_every_scheme_runs_in_float(scheme: tc.RungeKutta4) -> None:
    model, start = turning()
    double = tc.simulate(
        model, 0.5, 5e-3, scheme, start, correction=tc.Projection(), compiled=False
    )
    single = tc.simulate(
        model, 0.5, 5e-3, scheme, start, correction=tc.Projection(), compiled=tc.Single()
    )
    assert single.success
    assert single.compiled
    assert "single precision" in single.message
    assert np.array_equal(single.states[1:], single.states[1:].astype(np.float32))
    assert 1e-8 < abs(single.nodes[-1] - double.nodes[-1]).max() < 2e-5
    assert 1e-9 < single.bar_length_error.max() < 1e-6
    assert abs(single.energy_error).max() < 1e-3


@needs_compiler
def test_controls_and_long_loops() -> None:
    model, start = turning(tc.ForceDensity())
    control = model.initial_control * np.array([[1.0], [1.2], [0.9], [1.0]])
    double, single = (
        tc.simulate(model, 2.0, 1e-3, state=start, control=control, compiled=how)
        for how in (False, tc.Single())
    )
    assert 1e-8 < abs(single.nodes[-1] - double.nodes[-1]).max() < 1e-4
    assert np.ptp(single.control, axis=0).min() > 1


@needs_compiler
def test_rounding_at_rest_is_no_lost_energy() -> None:
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=20.0)))
    run = tc.simulate(
        model, 0.1, state=tc.build_projection(model)(model.initial_state), compiled=tc.Single()
    )
    assert abs(run.energy_error).max() > 1e-6
    assert run.message == "finished 100 steps of 0.001 s; in single precision"


@needs_compiler
def test_rounding_of_commanded_forces_is_no_lost_energy() -> None:
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0), control=tc.ForceDensity()))
    u = model.initial_control
    run = tc.simulate(model, 0.1, control=lambda t: u * (1 + 0.1 * t), compiled=tc.Single())
    assert run.energy.max() < 1e-9 < abs(run.energy_error).max()
    assert run.success, run.message


@needs_compiler
def test_rollouts_in_float_fill_twice_the_lanes() -> None:
    ground = tc.Ground(stiffness=2e3, damping=10.0, friction=0.5)
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0), gravity=tc.Gravity(), ground=ground))
    speeds = np.random.default_rng(0).normal(0.0, 0.1, (20, 6, 3))
    project, nodes = tc.build_projection(model), model.structure.nodes
    starts = np.array([project(model.state(nodes, v)).full().ravel() for v in speeds])
    starts[3] = np.nan

    def roll(rows: slice, compiled: tc.Single | bool) -> tc.Rollouts:
        return tc.rollouts(
            model, 0.3, states=starts[rows], correction=tc.Projection(), compiled=compiled
        )

    single, double, alone = (
        roll(slice(None), tc.Single()),
        roll(slice(None), True),
        roll(slice(8, 9), tc.Single()),
    )
    good = np.arange(20) != 3
    assert single.lanes == 2 * double.lanes
    assert np.array_equal(single.success, good)
    assert np.array_equal(single.final[good], single.final[good].astype(np.float32))
    assert np.array_equal(single.final[8], alone.final[0])
    assert 1e-8 < abs(single.final - double.final)[good, : model.nq].max() < 2e-5


@needs_compiler
def test_error_control_finer_than_float_is_refused() -> None:
    model, start = turning()
    with pytest.raises(
        ValueError, match=r"DormandPrince853\.rtol is 1e-10: give 1e-06 or more in single precision"
    ):
        tc.simulate(
            model, 0.1, scheme=tc.DormandPrince853(rtol=1e-10), state=start, compiled=tc.Single()
        )
    with pytest.raises(
        ValueError, match=r"Collocation\.tolerance is 1e-10: give 1e-06 or more in single precision"
    ):
        tc.simulate(model, 0.1, scheme=tc.Collocation(), state=start, compiled=tc.Single())


def test_without_a_compiler_it_says_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    model, start = turning()
    with pytest.raises(tc.CompileError, match="no C compiler found: install gcc"):
        tc.simulate(model, 0.1, state=start, compiled=tc.Single())
    table = tc.tradeoff(
        model,
        0.1,
        [tc.RungeKutta4()],
        [0.01],
        state=start,
        compiled=(tc.Single(), False),
        repeats=1,
    )
    assert [row.success for row in table.rows] == [False, True]
    assert "no C compiler found" in table.summary()


@needs_compiler
def test_schemes_without_code_are_refused() -> None:
    with pytest.raises(tc.CompileError, match="makes no C code"):
        tc.simulate(turning()[0], 0.1, scheme=tc.Cvodes(), compiled=tc.Single())

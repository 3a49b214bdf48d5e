"""Companions of one run in spare lanes: steps of 2 h and 4 h, without an effect on the run."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.kernel import SLICE, Watch
from tenscasadi.simulation.engine.request import Intervals, Rolled

STEP, STEPS = 1e-3, 88


def prism(**options) -> tc.Model:
    shape = tc.shapes.prism(stiffness=800.0, damping=2.0, prestress=5.0)
    return tc.Model(tc.Scene(shape, gravity=tc.Gravity(), **options))


def starts(model: tc.Model) -> np.ndarray:
    nodes = model.structure.nodes
    spin = np.cross([1.0, 2.0, 0.5], nodes)
    return model.state(nodes, np.where(model.structure.fixed, 0.0, spin))[None]


def roll(kernel, x, w, factor: int = 1, compare_every: int = 0, **options) -> Rolled:
    """Roll two intervals in steps of `factor` h."""
    count = STEPS // 2 // factor
    steps = Intervals(np.arange(2), np.full(2, count), np.full(2, factor * STEP))
    return kernel.run(x, w, steps, 8 // factor, compare_every=compare_every, **options)


@pytest.mark.parametrize("correction", [None, tc.Projection()], ids=["plain", "projected"])
@pytest.mark.parametrize(
    "scheme",
    [tc.RungeKutta4(), pytest.param(tc.DormandPrince853(), marks=pytest.mark.slow)],
    ids=["RK4", "853"],
)
def test_companions_are_runs_in_longer_steps(scheme, correction):
    model = prism(control=tc.RestLength())
    x = starts(model)
    w = model.initial_control * np.array([1.0, 0.97])[None, :, None]
    kernel = build_kernel(model, scheme, correction, measured="all", lanes=1, companions=True)
    assert kernel.backend.companions
    alone = roll(build_kernel(model, scheme, correction, measured="all", lanes=1), x, w)
    together = roll(kernel, x, w, compare_every=8)
    for name in ("states", "saved", "measured", "worst", "corrected"):
        np.testing.assert_array_equal(getattr(together, name), getattr(alone, name), name)
    np.testing.assert_array_equal(together.compared[:, 0], together.saved[0])
    for lane, factor in ((1, 2), (2, 4)):
        longer = roll(kernel, x, w, factor)
        np.testing.assert_allclose(together.compared[:, lane], longer.saved[0], atol=1e-13)
        assert np.abs(longer.saved[0] - alone.saved[0]).max() > 1e-12 or scheme.order > 4


def test_slices_of_a_run_continue_its_companions():
    """Slices may end between the steps of companions."""
    model = prism()
    x, w = starts(model), np.zeros((1, 2, 0))
    kernel = build_kernel(model, tc.RungeKutta4(), measured="all", lanes=1, companions=True)
    whole = roll(kernel, x, w, compare_every=12)
    done: list[int] = []
    kernel._rates[kernel.lanes] = 5.0 / SLICE  # five steps in a slice
    take = kernel.take

    def keep_rate(*arguments):
        take(*arguments)
        kernel._rates[kernel.lanes] = 5.0 / SLICE

    kernel.take = keep_rate
    sliced = roll(kernel, x, w, compare_every=12, watch=Watch(seen=done.append))
    assert len(done) > 10
    np.testing.assert_array_equal(sliced.compared, whole.compared)


@pytest.mark.parametrize("step", [1e-3, 1 / 998])
def test_error_estimate_is_that_of_repetitions(step, monkeypatch):
    """Steps whose number is no multiple of 4 have no companions."""
    model = prism()
    given = {"state": starts(model)[0], "step": step, "compiled": True}
    run = tc.simulate(model, 1.0, **given)
    monkeypatch.setattr("tenscasadi.simulation.engine.roll.Request.compare_every", 0)
    repeated = tc.simulate(prism(), 1.0, **given)
    np.testing.assert_array_equal(run.states, repeated.states)
    assert run.error_estimate == pytest.approx(repeated.error_estimate, rel=1e-3)
    assert run.message == repeated.message

"""The kernel of rollouts against `simulate`, motion by motion, to the last bit: lanes, threads and neighbours change nothing."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.simulation.engine import native as module
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.request import BEYOND, NOT_FINITE
from tenscasadi.util.compile import CompileError

STEP, STEPS = 1e-3, 20


def prism(**options):
    return tc.Scene(
        tc.shapes.prism(stiffness=800.0, damping=2.0, prestress=5.0),
        gravity=tc.Gravity(),
        **options,
    )


def table(t):
    # Kinks on the grid, at which `simulate` cuts no step.
    push = np.zeros((6, 3)).tolist()
    push[3] = [ca.sin(9 * t), 250 * ca.if_else(t > 0.008, t - 0.008, 0.0), 100 * ca.fabs(t - 0.01)]
    return ca.vertcat(*(ca.horzcat(*row) for row in push))


CASES = {
    "prism": (
        lambda: tc.Model(prism(ground=tc.Ground(friction=0.5))),
        tc.RungeKutta4(),
        tc.Projection(),
    ),
    "clock": (lambda: tc.Model(prism(forces=tc.NodalForce(table))), tc.DormandPrince54(), None),
    "rattle": (lambda: tc.Model(prism(ground=tc.Ground(friction=0.5))), tc.Rattle(), None),
    "rattle, bars that meet": (
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar(), gravity=tc.Gravity())),
        tc.Rattle(4),
        None,
    ),
    "853": (
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar(), gravity=tc.Gravity())),
        tc.DormandPrince853(),
        tc.Projection(every=3),
    ),
    "full": (
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar()), coordinates="full"),
        tc.RungeKutta4(),
        tc.BarLengthCorrection(),
    ),
    "full, rattle": (
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar()), coordinates="full"),
        tc.Rattle(),
        tc.Projection(),
    ),
    "net": (
        lambda: tc.Model(
            tc.Scene(tc.shapes.prism(string_mass=0.1), gravity=tc.Gravity(), segments=6)
        ),
        tc.RungeKutta4(),
        None,
    ),
    "controlled": (
        lambda: tc.Model(prism(control=tc.RestLength(), slack=tc.Smooth(0.01))),
        tc.RungeKutta4(),
        tc.Projection(),
    ),
}


def starts(model, n):
    rng = np.random.default_rng(0)
    nodes = model.structure.nodes
    free = np.where(model.structure.fixed, 0.0, 1.0)
    project = tc.build_projection(model)
    given = [model.state(nodes, free * rng.normal(0, 0.3, nodes.shape)) for _ in range(n)]
    return np.array([np.asarray(project(x).full()).ravel() for x in given])


def inputs(model, n, intervals):
    rng = np.random.default_rng(1)
    return model.initial_control * (1 + 0.05 * rng.random((n, intervals, model.nu)))


SLOW = ("rattle, bars that meet", "full, rattle", "full", "853")  # to compile


@pytest.mark.parametrize(
    ("name", "lanes"),
    [
        *(pytest.param(name, None, marks=[pytest.mark.slow] * (name in SLOW)) for name in CASES),
        ("prism", 1),
    ],
)
def test_equal_to_simulate(name, lanes):
    build, scheme, correction = CASES[name]
    model = build()
    n = 11
    x, u = starts(model, n), inputs(model, n, 4)
    kernel = build_kernel(model, scheme, correction, measured=True, lanes=lanes)
    assert kernel.lanes == (lanes or kernel.lanes) > 0
    assert kernel.note == ""
    result = kernel(x, u, STEP, STEPS // 4, save_every=7)
    assert not result.status.any()
    for k in (0, 10):
        control = u[k] if model.nu else None
        run = tc.simulate(
            model,
            STEP * STEPS,
            STEP,
            scheme,
            x[k],
            control,
            correction,
            save_every=7,
            compiled=False,
        )
        # the clock of simulate starts each interval without rounding
        rounding = 1e-14 if name == "clock" else 0.0
        np.testing.assert_allclose(result.saved[k], run.states, rounding, rounding)
        np.testing.assert_allclose(result.states[k], run.states[-1], rounding, rounding)
        energy = result.measured[k, :, 2:5].sum(axis=1)
        np.testing.assert_allclose(
            energy - energy[0] - result.measured[k, :, 5],
            run.energy_error,
            rtol=0,
            atol=1e-12 * abs(energy).max(),
        )
        np.testing.assert_allclose(
            result.measured[k, :, 0], run.bar_length_error, rtol=0, atol=1e-15
        )


def refuse(*_, build):
    raise CompileError("no C++")


def test_without_cpp_the_same_numbers(monkeypatch):
    model = CASES["controlled"][0]()
    x, u = starts(model, 5), inputs(model, 5, 2)
    x[3, 0] = np.nan
    cost = ca.Function("cost", [ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nu)], [ca.MX(2.0)])
    code = build_kernel(model, tc.RungeKutta4(), tc.Projection(2), cost, cost, measured=True)(
        x, u, STEP, 5, save_every=3
    )

    monkeypatch.setattr(module, "compile_library", refuse)
    model = CASES["controlled"][0]()
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection(2), cost, cost, measured=True)
    assert (kernel.lanes, kernel.note) == (0, "not compiled: no C++")
    for one, other, name in zip(
        kernel(x, u, STEP, 5, save_every=3), code, code._fields, strict=True
    ):
        if name == "compared":  # only with companions
            continue
        np.testing.assert_allclose(
            one[[0, 1, 2, 4]], other[[0, 1, 2, 4]], rtol=1e-12, atol=1e-14, err_msg=name
        )
        if name != "worst":
            np.testing.assert_array_equal(one[3], other[3])


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("n", [0, 1, 3, 8, 17])
def test_any_number_of_motions_and_threads(n, threads):
    model = CASES["prism"][0]()
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection())
    x, w = starts(model, 17), np.zeros((1, 1, 0))
    whole = kernel(x, w, STEP, 4).states
    np.testing.assert_array_equal(kernel(x[:n], w, STEP, 4, threads=threads).states, whole[:n])


@pytest.mark.parametrize(
    "lanes", [2, pytest.param(4, marks=pytest.mark.slow), pytest.param(8, marks=pytest.mark.slow)]
)
def test_any_number_of_lanes(lanes):
    model = CASES["prism"][0]()
    x, w = starts(model, 5), np.zeros((1, 1, 0))
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection(), lanes=lanes)
    assert kernel.lanes == lanes
    np.testing.assert_array_equal(
        kernel(x, w, STEP, 4).states,
        build_kernel(model, tc.RungeKutta4(), tc.Projection())(x, w, STEP, 4).states,
    )


def test_a_motion_that_is_lost_leaves_its_neighbours_alone():
    model = CASES["prism"][0]()
    kernel = build_kernel(model, tc.RungeKutta4(), measured=True)
    x, w = starts(model, 6), np.zeros((1, 1, 0))
    alone = kernel(x, w, STEP, 10, save_every=5)
    x[2, 5] = np.nan
    x[4, model.nq :] *= 1e5
    result = kernel(x, w, STEP, 10, save_every=5)
    assert result.status.tolist() == [0, 0, NOT_FINITE, 0, BEYOND, 0]
    fine = [0, 1, 3, 5]
    np.testing.assert_array_equal(result.saved[fine], alone.saved[fine])
    assert result.fault[[2, 4]].tolist() == [0, 5]
    assert np.isnan(result.saved[2]).all()
    assert not np.isnan(result.saved[4, 0]).any()
    assert np.isnan(result.saved[4, 1:]).all()
    assert np.isinf(result.cost[[2, 4]]).all()


def test_costs_are_those_of_interval_ends():
    model = tc.Model(tc.Scene(tc.shapes.prism(stiffness=800.0), control=tc.ForceDensity()))
    x, w = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nu)
    stage = ca.Function("any", [x, w], [ca.sumsqr(x) + w[3]])
    final = ca.Function("exp", [x, w], [ca.if_else(x[2] > 0, x[0], x[1] ** 2)])
    n, intervals, per = 9, 3, 4
    start, u = starts(model, n), inputs(model, n, intervals) + 50.0
    result = build_kernel(model, tc.RungeKutta4(), stage=stage, final=final)(
        start, u, STEP, per, save_every=per
    )
    states = result.saved
    running = (
        sum((states[:, k + 1] ** 2).sum(axis=1) + u[:, k, 3] for k in range(intervals)) * STEP * per
    )
    end = np.where(states[:, -1, 2] > 0, states[:, -1, 0], states[:, -1, 1] ** 2)
    np.testing.assert_allclose(result.cost, running + end, rtol=1e-13)


def test_costs_may_depend_on_more_than_the_motion_does(monkeypatch):
    model = CASES["controlled"][0]()
    x, u = starts(model, 3), inputs(model, 3, 2)
    z, w = ca.MX.sym("x", model.nx), ca.MX.sym("w", model.nu + 1)
    cost = ca.Function("cost", [z, w], [w[-1]])
    w = np.concatenate([u, np.broadcast_to([[1.0], [2.0]], (3, 2, 1))], axis=2)
    plain = build_kernel(model, tc.RungeKutta4())(x, u, STEP, STEPS // 2)
    for without in (False, True):
        if without:
            monkeypatch.setattr(module, "compile_library", refuse)
            model = CASES["controlled"][0]()
        found = build_kernel(model, tc.RungeKutta4(), None, cost, cost)(x, w, STEP, STEPS // 2)
        np.testing.assert_array_equal(found.states, plain.states)
        assert found.cost == pytest.approx(np.full(3, STEP * STEPS / 2 * (1.0 + 2.0) + 2.0))


def test_wrong_shapes_and_schemes():
    model = CASES["prism"][0]()
    kernel = build_kernel(model, tc.RungeKutta4(), tc.Projection())
    with pytest.raises(
        ValueError, match=r"states has shape \(3, 4\): give an array of shape \(any, 36\)"
    ):
        kernel(np.zeros((3, 4)), np.zeros((1, 1, 0)), STEP, 1)
    with pytest.raises(ValueError, match=r"inputs has shape \(1, 0\)"):
        kernel(np.zeros((3, 36)), np.zeros((1, 0)), STEP, 1)
    with pytest.raises(
        ValueError, match="states has 3 rows and inputs has 2 rows: give as many of each"
    ):
        kernel(np.zeros((3, 36)), np.zeros((2, 1, 0)), STEP, 1)


@pytest.mark.parametrize(
    "scheme",
    [
        tc.DormandPrince54(rtol=1e-6),
        tc.DormandPrince853(rtol=1e-9),
        tc.Collocation(2),
        tc.Cvodes(1e-7),
    ],
)
def test_schemes_that_choose_their_steps_or_iterate(scheme):
    model = CASES["prism"][0]()
    x = starts(model, 3)
    many = tc.rollouts(model, 0.1, 0.01, x, scheme=scheme, save_every=2)
    assert many.success.all()
    for k in (0, 2):
        run = tc.simulate(model, 0.1, 0.01, scheme, x[k], save_every=2)
        np.testing.assert_allclose(many.states[k], run.states, rtol=1e-9, atol=1e-9)

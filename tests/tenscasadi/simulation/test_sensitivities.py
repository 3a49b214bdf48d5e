"""Sensitivities are the derivatives of the steps taken: by finite differences, by matrices of linear motions, by CVODES, by conserved momentum."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tenscasadi as tc
from tenscasadi.simulation.tangent_loop import CHUNK
from tenscasadi.util.compile import find_compiler

MODES = ("forward", "adjoint")
STEPS = {"step": 0.01, "compiled": False}


def difference(function, at, along, size=1e-6):
    """Central difference (m,) along a direction."""
    return (function(at + size * along) - function(at - size * along)) / (2 * size)


def prism(**options):
    structure = tc.shapes.prism(stiffness=1000.0, prestress=50.0, damping=1.0)
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), gravity=tc.Gravity(), **options))


def linkage():
    """Two bars that meet, one pinned, pulled by a string, its pin shaken and its end pushed over time: a clock, Newton's method, cut steps."""
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (1.5, 0.2, 0.8), (0, 0, 2)],
        [(0, 1), (1, 2)],
        [(2, 3)],
        pinned=(0, 3),
        stiffness=50.0,
        rest_length=1.0,
    )
    push = np.zeros((2, 4, 3))
    push[1, 2] = 1.0, 2.0, 3.0
    shaken = tc.SupportMotion({0: lambda t: (0.1 * ca.sin(5 * t), 0, 0)})
    return tc.Model(
        tc.Scene(
            structure,
            gravity=tc.Gravity(),
            forces=tc.NodalForce(push, times=(0.0, 0.0537)),
            supports=shaken,
        )
    )


def moving(model):
    nodes = model.structure.nodes
    state = model.state(
        nodes, np.where(model.structure.fixed, 0.0, np.cross((0.3, 1.0, 0.5), nodes))
    )
    return tc.build_projection(model)(state).full().ravel()


LINE = tc.Structure(
    [(-1, 0, 0), (0, 0, 0), (1, 0, 0)],
    strings=[(0, 1), (1, 2)],
    node_mass=2.0,
    pinned=(0, 2),
    stiffness=36.0,
    rest_length=0.5,
)
SCHEMES = [
    tc.RungeKutta4(),
    tc.Rattle(),
    *(
        pytest.param(scheme, marks=pytest.mark.slow)
        for scheme in (tc.DormandPrince54(), tc.Collocation(2))
    ),
]


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
@pytest.mark.parametrize("make", [prism, linkage])
def test_by_the_start_as_finite_differences_say(make, scheme):
    model = make()
    start, options = (
        moving(model),
        {"scheme": scheme, "correction": tc.Projection(every=3), **STEPS},
    )
    along = np.random.default_rng(0).normal(size=model.nx)
    along[2 * model.nq :] = 0.0  # the clock would lay other steps
    expected = difference(
        lambda x: tc.simulate(model, 0.1, state=x, energy_balance=False, **options).states[-1],
        start,
        along,
    )
    for mode in MODES:
        found = tc.sensitivities(model, start, 0.1, mode=mode, **options)
        assert found.success, found.message
        assert found.mode == mode
        np.testing.assert_allclose(
            found.jacobian @ along, expected, atol=2e-7 * np.abs(expected).max()
        )


@settings(max_examples=4, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 4),
    st.sampled_from(MODES),
    st.sampled_from(["end", "run"]),
)
def test_by_the_control_as_finite_differences_say(seed, intervals, mode, over):
    draw = np.random.default_rng(seed)
    model = tc.Model(
        tc.Scene(
            linkage().structure,
            control=tc.RestLength(),
            ground=tc.Ground(stiffness=500.0, damping=3.0, height=0.1),
        )
    )
    start, table, along = (
        moving(model),
        1 + 0.5 * draw.random((intervals, 1)),
        draw.normal(size=(intervals, 1)),
    )
    weight = ca.DM(draw.normal(size=model.nx))
    options = {"output": lambda x, u: ca.dot(weight, x) ** 2 + ca.sumsqr(u), "over": over, **STEPS}

    found = tc.sensitivities(model, start, 0.2, control=table, by="control", mode=mode, **options)
    expected = difference(
        lambda u: tc.sensitivities(model, start, 0.2, control=u, **options).value,
        table,
        along,
        1e-5,
    )
    assert found.jacobian.shape == (1, intervals, 1)
    np.testing.assert_allclose(
        [np.sum(found.jacobian * along)], expected, atol=1e-6 * np.abs(expected).max()
    )


PARAMETERS = tc.Parameters("stiffness", "rest_length", "bar_mass", "gravity", scale=["damping"])


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: type(scheme).__name__)
def test_by_the_parameters_as_finite_differences_say(scheme):
    structure, start = prism().structure, moving(prism())
    model = tc.Model(tc.Scene(structure, gravity=tc.Gravity(), parameters=PARAMETERS))
    p, options = (
        1.1 * model.parameters.nominal,
        {
            "scheme": scheme,
            "correction": tc.Projection(),
            "output": lambda x, u, p: ca.vertcat(x, p[0]),
            **STEPS,
        },
    )
    along = p * np.random.default_rng(0).normal(size=model.np)
    run = tc.simulate(
        model, 0.1, state=start, parameters=p, scheme=scheme, correction=tc.Projection(), **STEPS
    )

    def ends(values):
        return tc.simulate(
            model,
            0.1,
            state=start,
            parameters=values,
            scheme=scheme,
            correction=tc.Projection(),
            energy_balance=False,
            **STEPS,
        ).states[-1]

    expected = np.append(difference(ends, p, along), along[0])
    for mode in MODES:
        found = tc.sensitivities(
            model, start, 0.1, parameters=p, by="parameters", mode=mode, **options
        )
        assert found.success, found.message
        assert found.jacobian.shape == (37, model.np)
        np.testing.assert_allclose(
            found.jacobian @ along, expected, atol=2e-7 * np.abs(expected).max()
        )
    del options["step"]
    again = tc.sensitivities(model, run, by="parameters", mode="forward", **options)
    np.testing.assert_allclose(
        again.jacobian, found.jacobian, atol=1e-12 * np.abs(found.jacobian).max()
    )


def test_by_a_mass_and_a_stiffness_as_the_formula_says():
    """x = a cos(ω t) with ω² = 2 k / m, and its derivatives by k and m."""
    model = tc.Model(tc.Scene(LINE, parameters=tc.Parameters("node_mass", scale=["stiffness"])))
    a, omega, t = 0.1, 6.0, 0.7
    found = tc.sensitivities(
        model,
        model.state([(-1, 0, 0), (a, 0, 0), (1, 0, 0)]),
        t,
        1e-3,
        output=lambda x, u, p: x[0],
        by="parameters",
        compiled=False,
    )
    slope = -a * t * np.sin(omega * t)  # of x by ω
    by_name = dict(zip(model.parameters.names, found.jacobian[0], strict=True))
    assert found.value[0] == pytest.approx(a * np.cos(omega * t), rel=1e-9)
    assert by_name["stiffness scale"] == pytest.approx(slope * omega / 2, rel=1e-8)
    assert sum(value for name, value in by_name.items() if "mass" in name) == pytest.approx(
        -slope * omega / (2 * 2.0), rel=1e-8
    )


def test_both_modes_agree_over_many_calls_of_unequal_steps():
    model = prism()
    table = model.initial_control * (1 + 0.2 * np.random.default_rng(1).random((7, model.nu)))
    assert 5 * CHUNK / 2 < 7 * 100
    found = {
        mode: tc.sensitivities(
            model, None, 0.7, 1e-3, control=table, by="control", mode=mode, compiled=False
        )
        for mode in MODES
    }
    scale = np.abs(found["adjoint"].jacobian).max()
    np.testing.assert_allclose(
        found["forward"].jacobian, found["adjoint"].jacobian, atol=1e-12 * scale
    )
    assert found["adjoint"].jacobian.shape == (36, 7, 9)


def test_a_linear_motion_has_the_powers_of_its_step():
    """A mass between two taut strings along their line: x'' = −2 k x / m, and each step is RK4's polynomial of the matrix."""
    model = tc.Model(tc.Scene(LINE))
    hA = 0.02 * np.array([[0.0, 1.0], [-36.0, 0.0]])
    one = sum(
        np.linalg.matrix_power(hA, k) / factorial for k, factorial in enumerate((1, 1, 2, 6, 24))
    )
    expected = np.linalg.matrix_power(one, 300)
    for mode in MODES:
        found = tc.sensitivities(
            model,
            model.state([(-1, 0, 0), (0.1, 0, 0), (1, 0, 0)]),
            6.0,
            0.02,
            mode=mode,
            compiled=False,
        )
        np.testing.assert_allclose(found.jacobian[np.ix_([0, 3], [0, 3])], expected, atol=1e-12)


def test_momentum_at_the_end_is_that_of_the_start():
    model = tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0)))
    M = ca.DM(model.structure.mass_matrix().toarray())
    found = tc.sensitivities(
        model,
        moving(model),
        0.2,
        output=lambda x, u: ca.sum1(ca.mtimes(M, model.velocities(x))).T,
        **STEPS,
    )
    by_node = np.asarray(M).sum(axis=0)
    expected = np.hstack([np.zeros((3, 18)), np.kron(by_node, np.eye(3))])
    np.testing.assert_allclose(found.jacobian, expected, atol=1e-12)
    assert found.mode == "adjoint"


@pytest.mark.parametrize("mode", MODES)
def test_as_cvodes_says(mode):
    """CasADi's integrator has forward and adjoint sensitivities of its own, with control of their error."""
    model = prism()
    start, u = moving(model), model.initial_control
    tight = {"abstol": 1e-12, "reltol": 1e-12, "fsens_err_con": True}
    x, v = model.ode.mx_in()
    end = ca.integrator("end", "cvodes", {"x": x, "p": v, "ode": model.ode(x, v)}, 0.0, 0.2, tight)
    X, P = ca.MX.sym("X", model.nx), ca.MX.sym("P", model.nu)
    after, seeds = end(x0=X, p=P)["xf"], np.random.default_rng(3).normal(size=(2, model.nx))
    if mode == "forward":
        expected = ca.Function(
            "d",
            [X, P],
            [ca.jtimes(after, X, ca.DM(seeds[0])), ca.jtimes(after, P, ca.DM(seeds[0, :9]))],
        )(start, u)
    else:
        expected = ca.Function(
            "d", [X, P], [ca.jtimes(after, at, ca.DM(seeds[0]), True) for at in (X, P)]
        )(start, u)
    options = {"scheme": tc.DormandPrince853(), "step": 2e-3, "mode": mode, "compiled": False}
    by_x = tc.sensitivities(model, start, 0.2, **options).jacobian
    by_u = tc.sensitivities(model, start, 0.2, by="control", **options).jacobian[:, 0]
    found = (
        (by_x @ seeds[0], by_u @ seeds[0, :9])
        if mode == "forward"
        else (seeds[0] @ by_x, seeds[0] @ by_u)
    )
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(ours, theirs.full().ravel(), rtol=1e-7, atol=1e-7)


def test_through_slack_and_impact_the_steps_are_differentiated():
    """A ball of elastic strings lands: strings go slack, nodes touch; each finite difference of the same steps agrees."""
    ball = tc.shapes.six_bar_ball(stiffness=300.0, prestress=5.0)
    model = tc.Model(
        tc.Scene(
            ball,
            gravity=tc.Gravity(),
            ground=tc.Ground(stiffness=2e3, damping=5.0, friction=0.5, slip_speed=0.1, height=-0.6),
        )
    )
    run = tc.simulate(model, 0.4, 2e-3, compiled=False)
    assert (run.tension == 0).any()
    assert run.nodes[:, :, 2].min() < -0.6
    x, move = model.initial_state, np.random.default_rng(0).normal(size=model.nx)
    ends = [
        tc.simulate(model, 0.4, 2e-3, state=x + side * 1e-7 * move, compiled=False).states[-1]
        for side in (1, -1)
    ]
    found = tc.sensitivities(model, run, output=None, compiled=False)
    expected = (ends[0] - ends[1]) / 2e-7
    np.testing.assert_allclose(found.jacobian @ move, expected, atol=1e-6 * np.abs(expected).max())


def test_integrals_over_the_run():
    model = prism()
    for mode in MODES:
        found = tc.sensitivities(
            model, None, 0.3, output=lambda x, u: ca.MX(1), over="run", mode=mode, **STEPS
        )
        assert found.value == pytest.approx([0.3])
        assert not found.jacobian.any()
    fall = tc.sensitivities(
        model,
        None,
        0.3,
        output=lambda x, u: ca.sum1(model.velocities(x)[:, 2]),
        over="run",
        **STEPS,
    )
    run = tc.simulate(model, 0.3, **STEPS)
    assert fall.value[0] == pytest.approx(
        (run.nodes[-1] - run.nodes[0])[:, 2].sum(), abs=1e-7
    )  # what velocities add up to


@pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("mode", MODES)
def test_machine_code_gives_the_same(mode):
    model = tc.Model(tc.Scene(LINE, control=tc.RestLength(), gravity=tc.Gravity()))
    options = {
        "t_end": 0.6,
        "step": 1e-3,
        "output": lambda x, u: x[:2],
        "by": "control",
        "mode": mode,
    }
    code, virtual = (tc.sensitivities(model, compiled=way, **options) for way in (True, False))
    assert (code.compiled, virtual.compiled) == (True, False)
    np.testing.assert_allclose(
        code.jacobian, virtual.jacobian, atol=1e-12 * np.abs(virtual.jacobian).max()
    )


def test_a_second_call_builds_nothing(monkeypatch):
    model = tc.Model(tc.Scene(LINE))
    first = [tc.sensitivities(model, t_end=0.1, mode=mode, compiled=False) for mode in MODES]
    for name in ("tangent_function", "gradient_function"):
        monkeypatch.setattr(f"tenscasadi.simulation.sensitivities.{name}", pytest.fail)
    for one in first:
        again = tc.sensitivities(model, t_end=0.1, mode=one.mode, compiled=False)
        np.testing.assert_array_equal(again.jacobian, one.jacobian)


# --- runs that are given ---


@pytest.mark.parametrize("varying", [False, True])
def test_a_run_tells_its_start_steps_and_control(varying):
    model = prism()
    table = model.initial_control * np.linspace(1.0, 1.5, 5 if varying else 1)[:, None]
    run = tc.simulate(
        model, 0.25, state=moving(model), control=table, save_every=5, scheme=tc.Rattle(), **STEPS
    )
    one = tc.sensitivities(model, run, scheme=tc.Rattle(), by="control", compiled=False)
    other = tc.sensitivities(
        model, moving(model), 0.25, control=table, scheme=tc.Rattle(), by="control", **STEPS
    )
    np.testing.assert_allclose(
        one.jacobian, other.jacobian, atol=1e-12 * np.abs(other.jacobian).max()
    )
    np.testing.assert_allclose(one.state, run.states[-1], atol=1e-13)


def test_runs_by_other_steps_are_refused():
    model = prism()
    run = tc.simulate(model, 0.2, state=moving(model), scheme=tc.Rattle(), **STEPS)
    with pytest.raises(
        ValueError,
        match=r"last state is .* from where these steps end: give the scheme, the correction",
    ):
        tc.sensitivities(model, run, compiled=False)
    with pytest.raises(
        ValueError, match=r"step is 0.01, and start is a trajectory, which provides it"
    ):
        tc.sensitivities(model, run, step=0.01)
    with pytest.raises(ValueError, match=r"give a run of this model, with states of 36"):
        tc.sensitivities(
            model, tc.simulate(tc.Model(tc.Scene(tc.shapes.pendulum())), 0.01, **STEPS)
        )


def test_runs_that_fail_say_so():
    model = prism()
    with np.errstate(all="ignore"):
        found = tc.sensitivities(model, moving(model), 20.0, 1.0, compiled=False)
    assert not found.success
    assert "diverged" in found.message
    assert np.isnan(found.jacobian).all()
    assert found.jacobian.shape == (36, 36)


# --- arguments ---


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"t_end": None}, ValueError, "t_end is None: give the end"),
        ({"start": np.zeros(3)}, ValueError, r"start has shape \(3,\)"),
        (
            {"scheme": tc.DormandPrince54(rtol=1e-6)},
            ValueError,
            "chooses its steps: give one with fixed steps",
        ),
        ({"scheme": tc.Cvodes()}, ValueError, "chooses its steps: give one with fixed steps"),
        ({"output": 3}, TypeError, r"output is 3: give a casadi.Function"),
        (
            {"output": ca.Function("f", [ca.MX.sym("x", 3)], [ca.MX(1)])},
            ValueError,
            r"output is f:.*: give a casadi.Function of 36 and 9 entries",
        ),
        ({"output": lambda x, u: "height"}, TypeError, "output returns 'height'"),
        ({"output": lambda x: x}, ValueError, "output fails with TypeError"),
        ({"over": "run"}, ValueError, 'output has 36 entries: give one for over="run"'),
        ({"over": "all"}, ValueError, "over is 'all'"),
        ({"by": "mass"}, ValueError, "by is 'mass'"),
        ({"mode": "backward"}, ValueError, "mode is 'backward'"),
        ({"compiled": tc.Single()}, TypeError, "compiled is Single"),
        ({"compiled": "yes"}, TypeError, "give True, False or None, as derivatives are"),
        ({"model": 3}, TypeError, "model is 3"),
    ],
)
def test_wrong_arguments(options, error, message):
    with pytest.raises(error, match=message):
        tc.sensitivities(**{"model": prism(), "t_end": 0.1, "compiled": False, **options})


@pytest.mark.parametrize("by", ["control", "parameters"])
def test_a_scene_without_control_or_parameters_has_none_to_differentiate(by):
    with pytest.raises(ValueError, match=f'by is "{by}", and the scene has none'):
        tc.sensitivities(tc.Model(tc.Scene(tc.shapes.prism())), t_end=0.1, by=by)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_steps():
    import resource

    model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    tc.sensitivities(model, t_end=1.0, step=1e-3, output=lambda x, u: x[0])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = tc.sensitivities(model, t_end=1000.0, step=1e-3, output=lambda x, u: x[0])
    assert found.success, found.message
    assert (
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000
    )  # kB; the states alone are 48 MB

"""Predictive control problems for acados: the files hold the expressions of the model and of the controller."""

from __future__ import annotations

import importlib.util
import json
import os

import casadi as ca
import numpy as np
import pytest
from moving_prism import PINNED, problem, rise

import ocp
import tenscasadi as tc

TENSION = ocp.TensionLimits(upper=25.0)


def controller(*bounds, **options):
    """A controller of the pinned prism."""
    return ocp.Mpc(problem(rise(), *bounds), period=0.05, intervals=4, **options)


def load(folder):
    """The written module."""
    spec = importlib.util.spec_from_file_location("acados_mpc", folder / "acados_mpc.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def evaluate(module, name, x, u, p=0.0):
    """Value of one of the module's expressions."""
    own = module.expressions()
    return ca.Function(name, [own["x"], own["u"], own["p"]], [own[name]])(x, u, p).full().ravel()


def test_expressions_are_those_of_the_model(tmp_path):
    mpc = controller(TENSION, ocp.AboveGround(-0.1))
    ocp.export_acados(mpc, tmp_path)
    module, rng = load(tmp_path), np.random.default_rng(0)
    x = PINNED.initial_state + 0.01 * rng.normal(size=PINNED.nx)
    u = rng.uniform(1, 9, PINNED.nu)
    np.testing.assert_allclose(
        evaluate(module, "f_expl", x, u), PINNED.ode(x, u).full().ravel(), rtol=1e-12, atol=1e-12
    )
    output = mpc.formulation.output(x).full().ravel()
    y = np.append(output, u / mpc.formulation.control_scale)
    np.testing.assert_allclose(evaluate(module, "y", x, u), y, rtol=1e-12)
    np.testing.assert_allclose(evaluate(module, "y_e", x, u), output, rtol=1e-12)
    tension = PINNED.tension(x, u)
    data = json.loads((tmp_path / "mpc.json").read_text(encoding="utf-8"))
    names, upper = data["path"]["names"], np.array(data["path"]["upper"])
    value = evaluate(module, "h", x, u)
    own = [k for k, name in enumerate(names) if name.startswith("tension")]
    np.testing.assert_allclose(value[own] / upper[own], tension / 25.0, rtol=1e-12)
    assert data["end"]["names"] == ["z of node 3", "z of node 4", "z of node 5"]
    assert len(evaluate(module, "h_e", x, u)) == 3


def test_exported_strings_do_not_go_slack(tmp_path):
    """As in the predictions of the controller: a slack string would not respond to its rest length."""
    cross = tc.shapes.d_bar(pinned=[0], prestress=20.0, stiffness=500.0)
    model = tc.Model(tc.Scene(cross, control=tc.RestLength()))
    mpc = ocp.Mpc(ocp.Problem(model, goals=[ocp.AtRest()]), period=0.05, intervals=3)
    ocp.export_acados(mpc, tmp_path)
    slack = cross.string_lengths * [1.2, 0.9]
    linear = tc.Model(tc.Scene(cross, control=tc.RestLength(), slack=tc.Linear()))
    own = evaluate(load(tmp_path), "f_expl", model.initial_state, slack)
    np.testing.assert_allclose(
        own, linear.ode(model.initial_state, slack).full().ravel(), rtol=1e-9, atol=1e-9
    )
    assert abs(own - model.ode(model.initial_state, slack).full().ravel()).max() > 1.0


def test_references_are_those_of_the_plan(tmp_path):
    plan = ocp.solve(problem(rise()))
    mpc = controller(plan=plan)
    ocp.export_acados(mpc, tmp_path)
    references = load(tmp_path).references(0.2)
    assert [len(one) for one in references] == 4 * [2 * PINNED.nq + 9] + [2 * PINNED.nq]
    output, held = (value.full() for value in mpc.formulation.reference(0.2))
    np.testing.assert_allclose(references[-1], output[:, -1], rtol=1e-12)
    np.testing.assert_allclose(references[2][: 2 * PINNED.nq], output[:, 1], rtol=1e-12)
    scaled = held[:, 2] / mpc.formulation.control_scale
    np.testing.assert_allclose(references[2][2 * PINNED.nq :], scaled, rtol=1e-12)


def test_written_problem_has_the_cost_of_the_controller(tmp_path):
    """Newton's method on the sum of squares decides as the controller does after many iterations."""
    mpc = controller(iterations=20)
    ocp.export_acados(mpc, tmp_path)
    module, count = load(tmp_path), 4
    own, references = module.expressions(), module.references(0.0)
    ode = ca.Function("ode", [own["x"], own["u"]], [own["f_expl"]])
    y = ca.Function("y", [own["x"], own["u"]], [own["y"]])
    y_e = ca.Function("y_e", [own["x"]], [own["y_e"]])
    from tenscasadi.integrators.runge_kutta import RungeKutta4

    step, u = RungeKutta4().step(ode), ca.MX.sym("u", PINNED.nu, count)
    x, cost = ca.DM(PINNED.initial_state), 0
    for k in range(count):
        cost += ca.sumsqr(y(x, u[:, k]) - references[k]) / 2
        x = step(x, u[:, k], 0.05)
    cost += ca.sumsqr(y_e(x) - references[-1]) / 2
    least, most = mpc.problem.force_density_limits
    nlp = {"x": ca.vec(u), "f": cost}
    solve = ca.nlpsol("solve", "ipopt", nlp, {"ipopt.print_level": 0, "print_time": False})
    found = solve(
        x0=np.tile(references[0][-9:], count), lbx=np.tile(least, count), ubx=np.tile(most, count)
    )
    expected = mpc.control(0.0, PINNED.initial_state)
    np.testing.assert_allclose(found["x"].full().ravel()[:9], expected, rtol=1e-2, atol=1e-2)


def test_acados_template_accepts_the_problem(tmp_path, monkeypatch):
    pytest.importorskip("acados_template")
    if "ACADOS_SOURCE_DIR" not in os.environ:
        pytest.skip("acados is not installed")
    ocp.export_acados(controller(TENSION, ocp.AboveGround(-0.1)), tmp_path)
    made = load(tmp_path).make_ocp()
    made.make_consistent()
    assert (made.dims.nx, made.dims.nu, made.dims.nh, made.dims.nh_e) == (18, 9, 12, 3)


@pytest.mark.parametrize(
    ("bound", "message"),
    [
        (ocp.ForceDensityRateLimits(50.0), "leave rate limits out"),
        (ocp.TerminalTensions(2.0, 9.0), "where acados has no control"),
    ],
)
def test_limits_that_acados_lacks_are_rejected(bound, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        ocp.export_acados(controller(bound), tmp_path)
    assert not list(tmp_path.iterdir())

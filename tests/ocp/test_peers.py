"""`model.ode` as it is in the tools of others: rockit and do-mpc find the plan that this package finds."""

from __future__ import annotations

import importlib
import warnings

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.guess.path import make_guess
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target

BAR, LEAST, MOST, COUNT = 1.4, 5.0, 100.0, 8
QUIET = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}


def prism(height):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height)


MODEL = tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()))
PROBLEM = ocp.Problem(
    MODEL,
    goals=[ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()],
    bounds=[ocp.ForceDensityLimits(LEAST, MOST)],
    costs=[ocp.Effort()],
)
TARGET = find_target(PROBLEM, Scales.of(PROBLEM))
GUESS = make_guess(PROBLEM, TARGET, COUNT)


def imported(name):
    """A module that may be missing, or warn of what it misses itself."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pytest.importorskip(name)
        return importlib.import_module(name)


def same(plan, force_density):
    assert plan.success
    assert force_density.shape == plan.force_density.shape
    assert force_density == pytest.approx(plan.force_density, abs=1e-2)
    assert np.sum(force_density**2) / COUNT == pytest.approx(plan.objective, rel=1e-5)


@pytest.mark.filterwarnings("ignore")
def test_rockit_finds_the_same_plan():
    rockit = imported("rockit")
    stage = rockit.Ocp(T=1.0)
    x, u = stage.state(MODEL.nx), stage.control(MODEL.nu)
    stage.set_der(x, MODEL.ode(x, u))
    stage.subject_to(stage.at_t0(x) == TARGET.start)
    stage.subject_to(TARGET.rows(stage.at_tf(x)) == 0)
    stage.subject_to(u >= LEAST)
    stage.subject_to(u <= MOST)
    stage.add_objective(stage.integral(ca.sumsqr(u)))
    stage.solver("ipopt", QUIET)
    stage.method(rockit.MultipleShooting(N=COUNT, M=2, intg="rk"))
    stage.set_initial(x, GUESS.states.T)
    stage.set_initial(u, GUESS.force_density.T)
    same(
        ocp.solve(PROBLEM, ocp.MultipleShooting(COUNT, substeps=2)),
        stage.solve().sample(u, grid="control")[1][:COUNT],
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_do_mpc_finds_the_same_plan():
    do_mpc = imported("do_mpc")
    model = do_mpc.model.Model("continuous", "SX")
    x, u = (
        model.set_variable(kind, kind[1], shape=(size, 1))
        for kind, size in (("_x", MODEL.nx), ("_u", MODEL.nu))
    )
    model.set_rhs("x", MODEL.ode(x, u))
    model.setup()
    mpc = do_mpc.controller.MPC(model)
    mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.collocation_deg = COUNT, 1 / COUNT, 3
    mpc.settings.supress_ipopt_output()
    mpc.set_objective(lterm=ca.sumsqr(u) / 1e3, mterm=ca.DM(0))
    mpc.set_rterm(u=0)
    mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = LEAST, MOST
    mpc.prepare_nlp()
    goal = TARGET.rows(mpc.opt_x["_x", -1, 0, -1])
    mpc.nlp_cons.append(goal)
    mpc.nlp_cons_lb.append(np.zeros(goal.shape))
    mpc.nlp_cons_ub.append(np.zeros(goal.shape))
    mpc.create_nlp()
    mpc.x0, mpc.u0 = TARGET.start, GUESS.force_density[0]
    mpc.set_initial_guess()
    for k in range(COUNT):
        mpc.opt_x_num["_x", k, 0] = [GUESS.states[k]] * len(mpc.opt_x_num["_x", k, 0])
        mpc.opt_x_num["_u", k, 0] = GUESS.force_density[k]
    mpc.make_step(TARGET.start)
    assert mpc.solver_stats["success"]
    found = np.array([mpc.opt_x_num["_u", k, 0].full().ravel() for k in range(COUNT)])
    same(ocp.solve(PROBLEM, ocp.DirectCollocation(COUNT, degree=3)), found)

"""IPOPT: progress that is watched, stops that keep the best iterate, warm starts."""

from __future__ import annotations

import signal
import sys

import numpy as np
import pytest
from planning import prism, raising

import ocp
import tenscasadi as tc


def test_progress_is_told_and_a_stop_keeps_the_best():
    seen = []

    def watch(now):
        seen.append(now)
        return now.iteration < 3

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(callback=watch), tolerance=1e-9)
    assert not plan.success
    assert plan.status == "User_Requested_Stop"
    assert [now.iteration for now in seen] == [0, 1, 2, 3]
    assert min(now.infeasibility for now in seen) < seen[0].infeasibility
    assert all(now.objective > 0 for now in seen)
    assert np.all(np.isfinite(plan.force_density))
    whole = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(callback=lambda now: None))
    assert whole.success


def begins(problem, guess=None):
    """How often the solver begins, and the plan."""
    seen = []
    plan = ocp.solve(
        problem,
        ocp.Variational(20),
        ocp.Ipopt(callback=lambda now: seen.append(now.iteration)),
        guess=guess,
    )
    assert plan.success, plan.message
    last = seen[::-1].index(0)  # iterations of the last run
    assert (
        plan.iterations == last if seen.count(0) == 1 else plan.iterations > last
    )  # those of all runs count
    return seen.count(0), plan


def test_noise_is_added_where_a_saddle_is_met_and_nowhere_else():
    """The prism's symmetric rise is a minimum; there and back it passes a saddle."""
    assert begins(raising())[0] == 1
    goals = [ocp.Waypoint([ocp.Shape(prism(1.1).nodes)], time=0.5), ocp.Periodic()]
    back = raising(goals=goals, bounds=[ocp.ForceDensityLimits(2.0, 200.0)])
    once, plan = begins(back)
    at_once, noisy = begins(back, ocp.InverseDynamics(noise=0.3))
    assert (once, at_once) == (2, 1)
    assert plan.objective == pytest.approx(noisy.objective, rel=0.01)
    stopped = ocp.solve(back, ocp.Variational(12), ocp.Ipopt(restart_at_saddle=False))
    assert not stopped.success
    assert stopped.iterations < plan.iterations
    assert "stopped at a saddle: leave out restart_at_saddle=False" in stopped.message


def test_an_interruption_keeps_the_best():
    def watch(now):
        if now.iteration == 2:
            raise KeyboardInterrupt

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(callback=watch))
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations <= 3
    assert np.all(np.isfinite(plan.trajectory.nodes))


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different there")
def test_ctrl_c_keeps_the_best_and_leaves_the_keyboard_as_it_was(keyboard):

    def watch(now):
        if now.iteration == 2:  # within the solver, not within this function
            signal.raise_signal(signal.SIGINT)

    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(callback=watch))
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations <= 3
    assert "from the keyboard" in plan.message
    assert signal.getsignal(signal.SIGINT) is keyboard


def test_what_a_watcher_raises_is_raised(capfd):
    def watch(now):
        raise ZeroDivisionError("a mistake of the watcher")

    with pytest.raises(ZeroDivisionError, match="a mistake of the watcher"):
        ocp.solve(raising(), ocp.Variational(6), ocp.Ipopt(callback=watch))
    assert not capfd.readouterr().err


def test_a_time_limit_stops():
    plan = ocp.solve(raising(), ocp.Variational(10), ocp.Ipopt(time_limit=1e-6))
    assert "stopped at the time limit of the solver: increase it" in plan.message
    assert not plan.success
    assert plan.status == "Maximum_WallTime_Exceeded"


def test_a_plan_as_guess_takes_fewer_iterations():
    cold = ocp.solve(raising(), ocp.Variational(12))
    warm = ocp.solve(raising(), ocp.Variational(12), ocp.Ipopt(warm_start=True), guess=cold)
    assert warm.success
    assert warm.iterations < cold.iterations
    assert warm.objective == pytest.approx(cold.objective, rel=1e-5)


def test_numpy_booleans_are_options():
    yes = np.True_
    assert ocp.Ipopt(verbose=yes, warm_start=yes, restart_at_saddle=yes).warm_start


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (lambda: ocp.Ipopt(time_limit=-1.0), ValueError, "Ipopt.time_limit"),
        (lambda: ocp.Ipopt(callback=3), TypeError, "Ipopt.callback is 3: give a function"),
        (
            lambda: ocp.Ipopt(warm_start="yes"),
            TypeError,
            "Ipopt.warm_start is 'yes': give True or False",
        ),
        (
            lambda: ocp.Ipopt(restart_at_saddle=1),
            TypeError,
            "Ipopt.restart_at_saddle is 1: give True or False",
        ),
    ],
)
def test_wrong_values_are_refused(make, error, words):
    with pytest.raises(error, match=words):
        make()


def test_points_without_derivatives_are_left():
    """A mass on strings starts on a straight way through the center of an obstacle."""
    anchors = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    strings = [(0, k) for k in range(1, 7)]
    hung = tc.Structure(
        [(-0.4, 0, 0), *anchors], bars=[], strings=strings, node_mass=0.5, pinned=range(1, 7)
    )
    model = tc.Model(tc.Scene(hung, control=tc.ForceDensity(), gravity=tc.Gravity()))
    bounds = [ocp.ForceDensityLimits(0.5, 60.0), ocp.Obstacle((0, 0, 0), 0.2, bars=[], nodes=[0])]
    goals = [ocp.NodePositions({0: (0.4, 0, 0)}), ocp.AtRest()]
    problem = ocp.Problem(model, 1.5, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    plan = ocp.solve(problem)
    assert plan.success, plan.message

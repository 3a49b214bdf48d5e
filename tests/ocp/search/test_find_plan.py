"""The search for a plan by several attempts."""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import time

import casadi as ca
import numpy as np
import pytest
from jumping import flight, jumping, push
from planning import driven, raising

import ocp
import tenscasadi as tc
from ocp.results.diagnosis import interpolate_plan
from ocp.search.find_plan import find_plan
from ocp.search.task import prepare
from ocp.solvers.base import Solution
from ocp.solvers.monitor import Monitor, Progress


@pytest.mark.parametrize("solver", [ocp.Ipopt(), ocp.CondensedNewton()])
def test_bars_come_to_rest_at_right_angles_to_the_target(solver):
    """A bar that turns by 90° in the given time keeps its speed along the target's bar.

    The row of `AtRest` that the bar's length makes redundant at the target is not so there.
    """
    anchors = [[0, 2, 0], [0, -2, 0], [2, 0, 0], [-2, 0, 0]]
    strings = [[1, node] for node in range(2, 6)]
    structure = tc.Structure(
        [[0, 0, 0], [1, 0, 0], *anchors], [[0, 1]], strings, pinned=[0, 2, 3, 4, 5]
    )
    model, speed = driven(structure), np.pi / 2

    def turned(angle):
        nodes, velocities = structure.nodes.copy(), np.zeros((6, 3))
        nodes[1] = np.cos(angle), np.sin(angle), 0.0
        velocities[1] = -speed * np.sin(angle), speed * np.cos(angle), 0.0
        return model.state(nodes, velocities)

    free = [turned(angle) for angle in np.linspace(0.0, np.pi / 2, 13)]
    bounds = [ocp.ForceDensityLimits(upper=100.0)]
    problem = ocp.Problem(model, 1.0, free[0], [ocp.AtRest()], bounds, costs=[ocp.Effort()])
    guess = ocp.TrajectoryGuess(free, np.full((12, 4), 0.1))
    plan = ocp.solve(problem, ocp.Variational(12), solver, guess)
    assert plan.success, plan.message
    assert abs(plan.trajectory.velocities[-1]).max() < 1e-6
    other = ocp.solve(problem, ocp.Variational(12), solver)
    assert plan.objective == pytest.approx(other.objective, rel=1e-3)
    ends = [
        prepare(problem, ocp.PiecewiseConstant(), 0.01, near=near).target.state
        for near in (None, interpolate_plan(plan))
    ]
    distances = [abs(model.nodes(end) - plan.trajectory.nodes[-1]).max() for end in ends]
    assert distances[1] < 1e-3 < distances[0]  # next attempts start from the end of the plan


def test_a_goal_that_fixes_a_free_duration_is_met():
    """Supports come back after 1 s, where their velocity vanishes: bars meet no goal at other times."""
    low = tc.shapes.prism(pinned=[0, 1, 2])
    feet = {
        k: lambda t, place=tuple(low.nodes[k]): (
            *place[:2],
            place[2] + 0.05 * ca.sin(np.pi * t) ** 2,
        )
        for k in range(3)
    }
    model = driven(low, supports=tc.SupportMotion(feet))
    goals = [ocp.NodePositions({k: tuple(low.nodes[k]) for k in (4, 5)}), ocp.AtRest()]
    bounds = [ocp.ForceDensityLimits(1.0, 200.0)]
    problem = ocp.Problem(model, (0.5, 2.0), goals=goals, bounds=bounds, costs=[ocp.Effort()])
    plan = ocp.solve(problem)
    assert plan.success, plan.message
    assert np.abs(plan.trajectory.nodes[-1][4:] - low.nodes[4:]).max() < 0.01


def test_interruption_before_the_solver_begins_blames_no_limit():
    monitor = Monitor()
    monitor.stop()
    plan = find_plan(raising(), ocp.Variational(6), monitor=monitor)
    assert "before the solver began" in plan.message
    assert "time_limit" not in plan.message


class Stubborn:
    """Solver that reports an iterate, and then computes without checking for a stop."""

    tolerance = 1e-8

    def __init__(self):
        self.begun, self.release = threading.Event(), threading.Event()

    def solve(self, program, monitor=None):
        monitor.follow(Progress(3, 1.0, 0.1), program.first + 1e-3)
        self.begun.set()
        self.release.wait(30)
        return Solution(program.first, True, "too late", 9)


def test_time_limit_ends_a_solver_that_does_not_stop():
    problem, solver = raising(), Stubborn()
    monitor = Monitor(30.0)
    monitor.deadline = time.perf_counter() + 0.5
    plan = find_plan(problem, ocp.Variational(6), solver, monitor=monitor)
    solver.release.set()
    assert plan.status == "Time_Limit_Reached"
    assert plan.iterations == 3
    assert plan.seconds < 10
    assert np.all(np.isfinite(plan.trajectory.states))


@pytest.mark.parametrize("part", ["find_plan.prepare", "policy.evaluate_guess"])
def test_time_limit_ends_parts_before_the_solver(part, monkeypatch):
    release = threading.Event()
    monkeypatch.setattr(f"ocp.search.{part}", lambda *_: release.wait(30))
    began = time.perf_counter()
    plan = ocp.solve(raising(), time_limit=0.1)
    seconds = time.perf_counter() - began
    release.set()
    assert seconds < 10
    assert not plan.success
    known = "start" if part == "find_plan.prepare" else "(start|guess)"  # if there is time for one
    stopped = f"stopped before the solver began, with the {known}: increase time_limit"
    assert re.search(stopped, plan.message)
    assert np.all(np.isfinite(plan.trajectory.states))


def test_time_limit_ends_the_building_of_phases(monkeypatch):
    release = threading.Event()
    monkeypatch.setattr("ocp.phases.method.link_problem", lambda *_: release.wait(30))
    plan = ocp.solve(jumping(push(), flight(0.2)), time_limit=0.1)
    release.set()
    assert "stopped before the solver began, with the start" in plan.message


@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_ctrl_c_ends_a_solver_that_does_not_stop():
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    solver = Stubborn()

    def interrupt():
        solver.begun.wait(30)
        os.kill(os.getpid(), signal.SIGINT)

    keyboard = threading.Thread(target=interrupt)
    keyboard.start()
    try:
        plan = find_plan(raising(), ocp.Variational(6), solver)
    finally:
        keyboard.join()
        solver.release.set()
        signal.signal(signal.SIGINT, usual)
    assert plan.status == "User_Requested_Stop"
    assert plan.iterations == 3


def test_callbacks_run_in_the_calling_thread():
    threads = set()
    solver = ocp.Ipopt(callback=lambda now: threads.add(threading.current_thread()))
    plan = ocp.solve(
        raising(),
        ocp.Variational(6),
        solver,
        progress=lambda now: threads.add(threading.current_thread()),
    )
    assert plan.success
    assert threads == {threading.current_thread()}


def test_rounded_nodes_of_a_pinned_structure_are_planned():
    """Bars and pins contradict the goals by up to 5 mm, half of the tolerance."""
    structure = tc.shapes.prism(radius=0.3, height=0.6, pinned=[0, 1, 2])
    model = driven(structure)
    run = tc.simulate(model, 0.5, 1e-3, control=np.linspace(2.0, 20.0, 9), compiled=False)
    wanted = run.nodes[-1].round(2)
    assert np.abs(wanted - structure.nodes)[:3].max() > 1e-4
    bounds = [ocp.ForceDensityLimits(1.0, 30.0)]
    goals = [ocp.NodePositions(wanted)]
    problem = ocp.Problem(model, 0.5, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    plan = ocp.solve(problem)
    assert plan.success
    assert "goals are met up to" in plan.message
    off = np.abs(plan.replay().nodes[-1] - wanted).max()
    assert plan.replay_error == pytest.approx(off, abs=1e-6)
    assert off < 0.01
    with pytest.raises(ocp.InfeasibleGoalError, match="misses its goal by"):
        ocp.solve(problem, tolerance=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("limit", [0.5, 2.0])
@pytest.mark.parametrize(
    ("transcription", "solver"),
    [
        (None, None),
        (ocp.MultipleShooting(), None),
        (ocp.DirectCollocation(), None),
        (ocp.Variational(30), None),
        (None, ocp.CondensedNewton()),
        (None, ocp.Sampling()),
    ],
)
def test_every_method_keeps_the_time_limit(transcription, solver, limit):
    tower = tc.shapes.prism_tower(8, height=0.8)
    longer = tower.string_lengths[0] * 1.05
    goals = [ocp.StringLengths({0: longer}), ocp.AtRest()]
    bounds = [ocp.ForceDensityLimits(1.0, 200.0)]
    problem = ocp.Problem(driven(tower), 1.0, goals=goals, bounds=bounds, costs=[ocp.Effort()])
    began = time.perf_counter()
    ocp.solve(problem, transcription, solver, time_limit=limit)
    # ten times the permitted excess, as other programs may run at the same time
    assert time.perf_counter() - began < limit + 10.0


@pytest.mark.parametrize("factor", [0.5, 1.001])
def test_the_better_of_both_conversions_is_kept(factor, monkeypatch):
    """The other one has the same states, but other force densities: its replay ends far away."""
    module = sys.modules["ocp.search.find_plan"]
    run, found = module.run_attempt, []

    def convert(task, attempt):
        outcome, target = run(task, attempt)
        if not found:
            found.append(outcome)
            outcome = outcome._replace(force_density=1.01 * outcome.force_density)
        other = outcome._replace(force_density=factor * found[0].force_density)
        return outcome._replace(finer=lambda: other), target

    monkeypatch.setattr(module, "run_attempt", convert)
    plan = ocp.solve(raising(), ocp.Variational(20), tolerance=1e-5)
    assert not plan.success
    expected = min(1.01, factor, key=lambda one: abs(one - 1.0))
    assert plan.force_density == pytest.approx(expected * found[0].force_density, rel=1e-12)

"""Several starts: the best plan of them, the same whatever solves them; what processes need crosses to them."""

from __future__ import annotations

import copy
import multiprocessing
import os
import pickle
import re
import signal
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from planning import raising

import ocp

SHORT = ocp.Variational(8)


def solved(executor=None, **given):
    return ocp.solve(raising(), SHORT, tolerance=0.1, n_starts=3, executor=executor, **given)


def test_the_best_of_all_starts_is_returned_with_the_objectives_of_all(tmp_path):
    plan = solved()
    alone = [
        ocp.solve(raising(), SHORT, guess=ocp.InverseDynamics(seed=seed), tolerance=0.1).objective
        for seed in range(3)
    ]
    assert plan.success
    assert plan.start_objectives == pytest.approx(alone, rel=1e-12)
    assert plan.objective == min(plan.start_objectives)
    assert "best of 3 starts, 3 of which found a plan" in plan.message
    assert np.array_equal(
        ocp.Plan.load(plan.save(tmp_path / "plan.npz")).start_objectives, plan.start_objectives
    )
    assert ocp.solve(raising(), SHORT, tolerance=0.1).start_objectives is None


class Backwards(Executor):
    """Does last what is asked first."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Future, tuple]] = []

    def submit(self, function, /, *given):
        self.jobs.append((Future(), given))
        if len(self.jobs) == 3:
            for future, kept in reversed(self.jobs):
                future.set_result(function(*kept))
        return self.jobs[-1][0]


def test_what_finishes_first_does_not_matter():
    expected = solved().start_objectives
    assert np.array_equal(solved(Backwards()).start_objectives, expected)
    with ThreadPoolExecutor(2) as threads:
        assert np.array_equal(solved(threads).start_objectives, expected)


def test_processes_solve_starts():
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as processes:
        plan = solved(processes)
    assert np.array_equal(plan.start_objectives, solved().start_objectives)
    assert plan.replay().nodes[-1] == pytest.approx(plan.trajectory.nodes[-1], abs=0.01)


def pickled(value):
    return pickle.loads(pickle.dumps(value))  # noqa: S301  # its own


VALUES = [
    ocp.InverseDynamics(),
    ocp.EquilibriumGuess(),
    ocp.Variational(8, accuracy=1e-3),
    ocp.MultipleShooting(5),
    ocp.Ipopt(),
]


@pytest.mark.parametrize(
    "value",
    [*VALUES, ocp.CondensedNewton(), ocp.Sampling()],
    ids=lambda value: type(value).__name__,
)
@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_options_are_copied(copied, value):
    assert repr(copied(value)) == repr(value)


@pytest.mark.parametrize("copied", [copy.deepcopy, pickled])
def test_problems_and_plans_are_copied(copied):
    problem = copied(raising())
    plan = ocp.solve(problem, SHORT, tolerance=0.1)
    again = copied(plan)
    assert again.objective == ocp.solve(raising(), SHORT, tolerance=0.1).objective
    assert np.array_equal(again.replay().nodes, plan.replay().nodes)
    assert ocp.solve(problem, SHORT, guess=again, tolerance=0.1).success


def test_starts_without_seeds_are_refused():
    with pytest.raises(
        ValueError, match="n_starts is 3, and guess is EquilibriumGuess, whose start has no seed"
    ):
        solved(guess=ocp.EquilibriumGuess())
    with pytest.raises(ValueError, match="starts"):
        ocp.solve(raising(), SHORT, n_starts=0)
    with pytest.raises(TypeError, match="executor"):
        ocp.solve(raising(), SHORT, n_starts=2, executor="threads")


def test_a_time_limit_holds_for_all_starts():
    plan = ocp.solve(
        raising(),
        SHORT,
        ocp.Ipopt(tolerance=1e-30, max_iterations=10**6),
        n_starts=2,
        time_limit=0.05,
    )
    assert not plan.success
    assert np.isnan(plan.start_objectives).all()
    assert "increase time_limit" in plan.message


@pytest.fixture
def starts(monkeypatch):
    """Replace the starts in executors by waiting times [s], after which a plan is there.

    The event ends all of them.
    """
    plan = ocp.solve(raising(), SHORT, tolerance=0.1)
    found = SimpleNamespace(times=[], ended=threading.Event())

    def wait(options, time_limit, tracked):
        found.ended.wait(found.times.pop(0))
        return plan

    monkeypatch.setattr("ocp.search.multistart.find_limited_plan", wait)
    return found


def test_progress_has_the_finished_starts_of_an_executor(starts, capsys):
    starts.times += [0.9, 0.9, 0.9]
    with ThreadPoolExecutor(1) as threads:
        plan = solved(threads, progress=True, time_limit=60.0)
    best = f"best with objective {plan.objective:.5g} and error {plan.worst_error:.1e} m"
    line = rf"2 of 3 starts finished, the {re.escape(best)}: [2-9] s, 5\d s left"
    assert re.search(line, capsys.readouterr().err)


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("limit", [0.5, 30.0])
def test_searches_in_an_executor_end_with_the_finished_starts(starts, limit):
    """After the time limit, or Ctrl-C after 0.5 s."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    keyboard = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
    starts.times += [30.0, 0.0, 30.0]
    began = time.perf_counter()
    with ThreadPoolExecutor(3) as threads:
        try:
            if limit > 1.0:
                keyboard.start()
            plan = solved(threads, time_limit=limit)
            wall = time.perf_counter() - began
        finally:
            starts.ended.set()
            signal.signal(signal.SIGINT, usual)
    assert 0.4 < wall < 10.0
    assert np.isfinite(plan.start_objectives).sum() == 1

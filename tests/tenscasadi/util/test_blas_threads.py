"""BLAS takes one thread where it is told to, and as many as before afterwards."""

from __future__ import annotations

from threading import Event, Thread

import pytest
from threadpoolctl import ThreadpoolController

import ocp
import tenscasadi as tc
from tenscasadi.util.blas_threads import one_blas_thread

BLAS = ThreadpoolController().select(user_api="blas")


def threads() -> list[int]:
    return [library["num_threads"] for library in BLAS.info()]


@pytest.fixture(autouse=True)
def several():
    with BLAS.limit(limits=2):
        yield


def test_one_thread_within_and_as_many_as_before_afterwards():
    before = threads()
    assert before
    with one_blas_thread():
        assert set(threads()) == {1}
        with one_blas_thread():
            assert set(threads()) == {1}
        assert set(threads()) == {1}
    assert threads() == before
    with pytest.raises(ZeroDivisionError), one_blas_thread():
        raise ZeroDivisionError
    assert threads() == before


def test_calls_that_overlap_in_threads_keep_one_until_the_last_ends():
    BLAS.lib_controllers[0].clear_controlling_thread(
        force=True
    )  # the fixture's thread would keep others from setting it
    entered, leave = [Event(), Event()], [Event(), Event()]

    def work(k):
        with one_blas_thread():
            entered[k].set()
            leave[k].wait(10)

    workers = [Thread(target=work, args=(k,)) for k in range(2)]
    for k in range(2):
        workers[k].start()
        assert entered[k].wait(10)
    leave[0].set()
    workers[0].join()
    assert set(threads()) == {1}
    leave[1].set()
    workers[1].join()
    assert set(threads()) == {2}


def test_a_limit_that_another_thread_sets_meanwhile_stays():
    with one_blas_thread():
        BLAS.limit(limits=2)
    assert set(threads()) == {2}


def test_planning_takes_one():
    seen = []
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    assert ocp.solve(
        ocp.Problem(model, goals=goals, costs=[ocp.Effort()]),
        ocp.Variational(10),
        ocp.Ipopt(watch=lambda progress: seen.append(threads())),
    ).success
    assert set(seen[0]) == {1}
    assert set(threads()) == {2}

"""BLAS takes one thread where it is told to, and as many as before afterwards."""

from __future__ import annotations

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


def test_planning_takes_one(monkeypatch):
    seen = []
    monkeypatch.setattr(ocp.Plan, "replay", lambda self, *args, **kwargs: seen.append(threads()) or replay(self, *args, **kwargs))
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    assert ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.Variational(10)).success
    assert set(seen[0]) == {1}
    assert set(threads()) == {2}


replay = ocp.Plan.replay

"""The benchmark against others: all solve the same motion, and MuJoCo may be missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from loading import load_example

import tenscasadi as tc


@pytest.fixture
def peers(monkeypatch):
    monkeypatch.setitem(sys.modules, "benchmark_peers", None)  # leaves with the test
    return load_example("benchmark_peers")


@pytest.fixture(scope="module")
def prism():
    return tc.shapes.prism(prestress=50.0, stiffness=1000.0)


@pytest.fixture(scope="module")
def motion(prism):
    """Start and certified end."""
    model = tc.Model(tc.Scene(prism))
    start = model.state(prism.nodes, np.cross([1.0, 2.0, 3.0], prism.nodes))
    return start, tc.reference_solution(model, 1.0, start).nodes


def test_without_mujoco_it_says_so(peers, monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(
        sys.modules, "mujoco", None
    )  # what Python remembers of a module that cannot be imported
    results = peers.main(tmp_path, quick=True)
    out = capsys.readouterr().out
    assert "pip install 'tenscasadi[peers]'" in out
    assert [result.shape for result in results] == ["prism"]
    assert len(list(tmp_path.iterdir())) == 1
    for result in results:
        assert {name.split()[0] for name in result.curves} == {"tenscasadi", "SciPy"}
        assert result.cheapest("MuJoCo", 1e-3) == (np.inf, "none")
        assert np.isnan(result.rate("MuJoCo RK4"))
        for program in ("tenscasadi", "SciPy"):
            assert result.cheapest(program, 1e-6)[0] < np.inf


def test_scipy_converges_to_the_same_motion(peers, prism, motion):
    start, end = motion
    errors = [
        peers.scipy_run(prism, start, method, 1e-10, end, 1).error for method in ("DOP853", "RK45")
    ]
    assert max(errors) < 1e-8


def test_mujoco_converges_to_the_same_motion(peers, prism, motion):
    mujoco = pytest.importorskip("mujoco")
    _, end = motion
    coarse, fine = (
        peers.mujoco_run(mujoco, prism, "RK4", count, end, 1).error for count in (500, 1000)
    )
    assert fine < 1e-6
    assert coarse / fine == pytest.approx(
        16, rel=0.3
    )  # order 4, so the difference vanishes with the step
    assert peers.mujoco_run(mujoco, prism, "Euler", 4000, end, 1).error < 1e-4


def test_mujoco_that_diverges_is_no_point(peers, prism, motion):
    mujoco = pytest.importorskip("mujoco")
    mujoco.set_mju_user_warning(lambda _: None)
    assert peers.mujoco_run(mujoco, prism, "RK4", 4, motion[1], 1).error == np.inf

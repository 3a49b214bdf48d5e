"""Solver of the quadratic programs of predictive control: DAQP's points, and a status without one."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.solvers.dual_active_set import HorizonProgram, name_inputs
from tenscasadi.util.compile import find_compiler

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
SIZES = HorizonProgram(intervals=4, controls=3, outputs=5, rows=7, penalty=1e5)
COMPILED, DAQP = SIZES.compiled(), SIZES.interpreted()


def draw(seed, sizes=SIZES):
    """Inputs of a random program, at which many limits meet."""
    rng, n = np.random.default_rng(seed), sizes.intervals * sizes.controls
    blocks = [
        rng.normal(size=(sizes.controls * (k + 1), sizes.outputs)) for k in range(sizes.intervals)
    ]
    return [
        *blocks,
        20 * rng.normal(size=sizes.intervals * sizes.outputs),
        rng.uniform(0.1, 1.0, n),
        rng.normal(size=n),
        rng.normal(size=(n, sizes.rows)),
        rng.uniform(-0.5, 1.0, sizes.rows),
        -rng.uniform(0.0, 1.0, n) * (rng.uniform(size=n) > 0.2),
        np.where(rng.uniform(size=n) < 0.3, np.inf, rng.uniform(0.0, 1.0, n)),
    ]


def solve(inputs, solver=COMPILED):
    change, status = solver(*inputs)[:2]
    return change.full().ravel(), float(status)


@pytest.mark.parametrize("seed", range(20))
def test_solution_is_that_of_daqp(seed):
    inputs = draw(seed)
    change, status = solve(inputs)
    low, high = inputs[-2:]
    assert status == 0
    assert np.sum((change <= low + 1e-9) | (change >= high - 1e-9)) >= 3
    assert change == pytest.approx(solve(inputs, DAQP)[0], abs=1e-6)


def test_solution_without_rows_is_that_of_daqp():
    sizes = HorizonProgram(intervals=3, controls=6, outputs=9, rows=0, penalty=1e5)
    inputs = draw(0, sizes)
    expected, _ = solve(inputs, sizes.interpreted())
    assert solve(inputs, sizes.compiled())[0] == pytest.approx(expected, abs=1e-6)


def test_repeated_and_opposite_rows_share_the_slack():
    """Limits that no change satisfies are violated equally."""
    inputs = draw(1)
    a, b = inputs[7], inputs[8]
    a[:, 1], a[:, 2], b[:3] = a[:, 0], -a[:, 0], (-1.0, -1.0, -1.0)
    change, status = solve(inputs)
    assert status == 0
    assert change == pytest.approx(solve(inputs, DAQP)[0], abs=1e-5)
    assert a[:, 0] @ change == pytest.approx(0.0, abs=1e-3)


def test_controls_without_room_stay():
    inputs = draw(2)
    inputs[-2][:], inputs[-1][:] = 0.0, 0.0
    change, status = solve(inputs)
    assert abs(change).max() < 1e-9
    assert status == 0


@pytest.mark.parametrize("solver", [COMPILED, DAQP], ids=["compiled", "DAQP"])
@pytest.mark.parametrize("number", range(len(draw(0))))
def test_nan_is_a_status(number, solver):
    inputs = draw(3)
    inputs[number].flat[0] = np.nan
    assert solve(inputs, solver)[1] == 1


@pytest.mark.parametrize("solver", [COMPILED, DAQP], ids=["compiled", "DAQP"])
@pytest.mark.parametrize("name", ["residual", "weights", "offset", "b"])
def test_infinity_is_a_status(name, solver):
    inputs = draw(3)
    inputs[name_inputs(SIZES.intervals).index(name)][:] = -np.inf
    assert solve(inputs, solver)[1] == 1

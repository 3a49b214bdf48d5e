"""The extremes: the right answer within a stated error, or a clear refusal; never a silent NaN, never a silently wrong number.

That every row of examples/extremes.py holds is tested with the other examples.
"""

from __future__ import annotations

import numpy as np
import pytest
from loading import load_example

import tenscasadi as tc


def test_a_step_that_is_far_too_large_for_a_spin_is_told() -> None:
    """Projection keeps bars even where a step turns them by a radian and more; the energy gives it away."""
    extremes = load_example("extremes")
    assert extremes.spin(1e4, advance=1.0) > 0.1
    bar = tc.Structure([(-0.5, 0, 0), (0.5, 0, 0)], [(0, 1)])
    model = tc.Model(tc.Scene(bar))
    run = tc.simulate(
        model,
        100.0,
        1.0,
        state=model.state(bar.nodes, [(0, -0.5, 0), (0, 0.5, 0)]),
        correction=tc.Projection(),
    )
    assert "energy is off" in run.message
    assert abs(run.energy_error[-1]) > 0.05 * run.energy[0]


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e9])
def test_a_step_above_the_limit_ends_the_run_with_the_limit_named(stiffness: float) -> None:
    prism = tc.shapes.prism(prestress=1.0, stiffness=stiffness)
    run = tc.simulate(
        tc.Model(tc.Scene(prism.replace(rest_length=0.99 * prism.rest_length))), 100.0, 0.1
    )
    assert not run.success
    assert "stability limit" in run.message
    assert "try step=" in run.message
    assert np.isfinite(run.nodes).all()
    assert np.isfinite(run.energy).all()


def test_masses_and_stiffnesses_that_cannot_be_computed_with_are_refused() -> None:
    wrong = [{"node_mass": value} for value in (0.0, 5e-324, 1e-310, 1e300, np.nan)] + [
        {"stiffness": value} for value in (-1.0, 1e300, np.inf)
    ]
    for changes in wrong:
        with pytest.raises((ValueError, TypeError), match=next(iter(changes))):
            tc.Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], **{"node_mass": 1.0, **changes})
    for mass in (5e-324, 1e-310, 1e300):
        with pytest.raises(ValueError, match="bar_mass"):
            tc.Structure([(0, 0, 0), (1, 0, 0)], [(0, 1)], bar_mass=mass)
    for length in (5e-324, 1e-310, 1e-160, 1e150, np.inf):
        with pytest.raises(ValueError, match=r"bar 0 joins nodes 0 and 1, which lie|nodes\[1, 0\]"):
            tc.Structure([(0, 0, 0), (length, 0, 0)], [(0, 1)])


def test_a_stiffness_of_hardly_anything_is_as_good_as_none() -> None:
    pair = tc.Structure(
        [(0, 0, 0), (1.2, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=5e-324, rest_length=1.0
    )
    run = tc.simulate(tc.Model(tc.Scene(pair)), 1.0, 1e-2, compiled=False)
    assert run.success
    assert abs(run.nodes[-1] - pair.nodes).max() < 1e-300

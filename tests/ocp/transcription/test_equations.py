"""Independent constraints: near the initial shape, not in it alone."""

from __future__ import annotations

import numpy as np
import pytest
from planning import driven

import ocp
import tenscasadi as tc
from ocp.transcription.equations import build_constraints, constraint_names, find_independent

SQUARE = [(-0.3, -0.3, 0.0), (0.3, -0.3, 0.0), (0.3, 0.3, 0.0), (-0.3, 0.3, 0.0)]
CORNERS = [(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)]
SIDES_AND_DIAGONALS = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)]


def braced_square(planar: bool = True) -> tc.Model:
    """A square of four bars and both diagonals, held by eight strings."""
    strings = [(k, 4 + k) for k in range(4)] + [(k, 4 + (k + 1) % 4) for k in range(4)]
    pins = dict.fromkeys(range(4), "z") if planar else {}
    structure = tc.Structure(
        SQUARE + CORNERS,
        SIDES_AND_DIAGONALS,
        strings,
        bar_mass=0.2,
        pinned={**pins, **dict.fromkeys(range(4, 8), "xyz")},
    )
    with pytest.warns(tc.RedundantConstraints):
        return driven(structure)


def test_independent_constraints_lack_one_bar_of_a_braced_square():
    model = braced_square()
    assert find_independent(model).tolist() == [0, 1, 2, 3, 4]
    assert len(constraint_names(model)) == build_constraints(model).size1_out(0) == 5


def test_independent_constraints_lack_a_bar_between_pins():
    with pytest.warns(tc.RedundantConstraints):
        model = driven(tc.shapes.d_bar(pinned=[0, 1]))
    kept = [list(bar) for bar in model.structure.bars[find_independent(model)]]
    assert [0, 1] not in kept
    assert len(kept) == len(model.structure.bars) - 1


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_independent_constraints_are_all_of_a_free_linkage(coordinates):
    model = tc.Model(
        tc.Scene(tc.shapes.d_bar(), control=tc.ForceDensity()), coordinates=coordinates
    )
    count = len(model.structure.bars) + model.mechanism.active.sum()
    assert find_independent(model).tolist() == list(range(count))


def test_independent_constraints_are_all_of_a_folded_linkage():
    """In the folded shape alone, a parallelogram's bars depend on each other."""
    nodes = [(0, 0, 0), (2, 0, 0), (1, 0, 0), (3, 0, 0), (0, 5, 0)]
    held = {0: "xyz", 1: "xyz", 2: "z", 3: "z", 4: "xyz"}
    structure = tc.Structure(nodes, [(0, 2), (1, 3), (2, 3)], [(2, 4), (3, 4)], pinned=held)
    with pytest.warns(tc.RedundantConstraints):
        model = driven(structure)
    assert find_independent(model).tolist() == [0, 1, 2]


def test_independent_constraints_are_all_of_a_flat_square_in_space():
    """Out of its plane the square is rigid to second order: no bar may be left out."""
    assert len(find_independent(braced_square(planar=False))) == 6


@pytest.mark.parametrize("method", [ocp.Variational(16), ocp.DirectCollocation(8)])
def test_redundant_bars_are_planned_with_their_lengths(method):
    model = braced_square()
    turn = np.radians(20.0)
    place = 0.3 * np.array([np.sin(turn) - np.cos(turn), -np.sin(turn) - np.cos(turn)])
    problem = ocp.Problem(
        model,
        0.6,
        goals=[ocp.NodePositions({0: (*place, None)}), ocp.AtRest()],
        bounds=[ocp.ForceDensityLimits(1.0, 20.0)],
        costs=[ocp.Effort()],
    )
    plan = ocp.solve(problem, method)
    assert plan.success
    assert plan.iterations < 60  # multipliers that are not unique took IPOPT to its limit
    assert np.abs(plan.trajectory.bar_length_error).max() < 1e-7


def test_condensed_newton_takes_redundant_bars():
    problem = ocp.Problem(
        braced_square(), 0.6, goals=[ocp.NodePositions({0: (-0.35, -0.25, None)})],
        bounds=[ocp.ForceDensityLimits(1.0, 20.0)], costs=[ocp.Effort()],
    )  # fmt: skip
    assert ocp.solve(problem, ocp.Variational(12), ocp.CondensedNewton()).success

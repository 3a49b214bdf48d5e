"""Distances that fix a shape: of neighbors, of all nodes where these do not tell."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import tenscasadi as tc
from ocp.targets.distance_rows import find_distance_rows, list_neighbors, squared_distances

NODES = [(k, 0.3 * (k % 2), 0) for k in range(6)]
CHAIN = tc.Structure(NODES, [(k, k + 1) for k in range(5)], [(0, 2)])
TWO_PARTS = tc.Structure(NODES, [(0, 1), (1, 2), (3, 4), (4, 5)], [(0, 2)])


def test_neighbors_are_two_members_apart():
    pairs = {tuple(pair) for pair in list_neighbors(CHAIN).tolist()}
    assert pairs == {(k, k + 1) for k in range(5)} | {(k, k + 2) for k in range(4)} | {(0, 3)}
    assert len(list_neighbors(tc.shapes.prism())) == 15


@pytest.mark.parametrize(("moved", "near"), [(1, True), (5, True), (None, False)])
def test_rows_feel_a_direction(moved, near):
    """A node that moves is felt by its neighbors; parts that no member joins are felt by all distances."""
    structure = CHAIN if near else TWO_PARTS
    direction = np.zeros((6, 3))
    direction[[moved] if near else [3, 4, 5]] = 0.4, 0.5, 0.0
    weights, gradient, pairs = find_distance_rows(
        structure.nodes,
        sp.eye_array(18, format="csr"),
        direction.reshape(18, 1),
        list_neighbors(structure),
    )
    assert len(pairs) == (len(list_neighbors(structure)) if near else 15)

    def value(nodes):
        return weights @ squared_distances(nodes, pairs)

    along = (
        value(structure.nodes + 1e-6 * direction) - value(structure.nodes - 1e-6 * direction)
    ) / 2e-6
    assert np.abs(along).min() > 0.1
    assert gradient @ direction.ravel() == pytest.approx(along, rel=1e-6)
    shift = np.tile([0.3, -0.2, 0.5], 6)
    assert gradient @ shift == pytest.approx(0.0, abs=1e-12)

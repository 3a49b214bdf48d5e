"""Reduced and full coordinates, and the choice between them."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.dynamics.coordinates import choose_coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


def chain(bars: int) -> Structure:
    """Bars in a zigzag, one after the other, the first pinned."""
    nodes = np.column_stack([np.arange(bars + 1), np.zeros(bars + 1), np.arange(bars + 1) % 2])
    return Structure(nodes, bars=[(k, k + 1) for k in range(bars)], pinned=[0])


def pairs(count: int) -> Structure:
    """Many chains of two bars."""
    ends = np.array([(3.0 * k + x, 0, x % 2) for k in range(count) for x in range(3)])
    starts = range(0, 3 * count, 3)
    return Structure(ends, [pair for k in starts for pair in ((k, k + 1), (k + 1, k + 2))])


@pytest.mark.parametrize(
    ("structure", "expected"),
    [
        (shapes.prism(), "reduced"),
        (chain(20), "reduced"),
        (pairs(60), "reduced"),
        (chain(60), "full"),
        (chain(2000), "full"),
    ],
    ids=["prism", "short chain", "many short chains", "chain", "long chain"],
)
def test_coordinates_are_chosen_by_the_number_of_operations(structure, expected):
    assert choose_coordinates(Scene(structure)) == expected


def test_coordinates_are_those_that_support_the_scene():
    arm = shapes.double_pendulum()
    assert Model(Scene(arm), bar_length="constant").coordinates == "full"
    rolling = Structure([(0, 0, 0), (1, 0, 0)], bars=[(0, 1)], rollers={0: (1, 0, 1)})
    assert Model(Scene(rolling, parameters=Parameters("bar_mass"))).coordinates == "full"


def test_reduced_coordinates_of_a_long_chain_name_the_cheaper_ones():
    assert 'Model(scene, coordinates="full") is faster' in str(
        Model(Scene(chain(60)), "reduced").describe()
    )
    for model in (Model(Scene(chain(20))), Model(Scene(chain(60)))):
        assert model.describe().advice == ""

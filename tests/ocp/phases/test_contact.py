"""The pyramid inside the cone of friction, about any normal."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from ocp.phases.contact import SHARE, SIDES, friction_cone

MU = 0.7


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.5, -0.2, 0.8), (0, 1, 1)])
def test_pushes_well_within_the_cone_pass_and_those_outside_do_not(normal):
    cone = friction_cone(tc.Ground(friction=MU, normal=normal))
    n = np.array(normal) / np.linalg.norm(normal)
    drawn = np.random.default_rng(0)
    for _ in range(200):
        along = np.cross(n, drawn.normal(size=3))
        along /= np.linalg.norm(along)
        size = drawn.uniform(0.1, 10.0)
        for share, inside in (
            (0.9 * SHARE * np.cos(np.pi / SIDES), True),
            (0.0, True),
            (1.001, False),
        ):
            rows = np.asarray(
                cone(np.concatenate([np.zeros(3), size * (n + share * MU * along)])).full()
            )
            assert (rows.min() >= 0) == inside
        assert (
            np.asarray(cone(np.concatenate([np.zeros(3), -size * n])).full()).max() < 0
        )  # the ground does not pull


def test_the_tip_of_the_cone_is_at_the_least_push():
    cone = friction_cone(tc.Ground(friction=MU), least=2.0)
    for push, inside in ((1.9, False), (2.1, True)):
        assert (np.asarray(cone([0, 0, 0, 0, 0, push]).full()).min() > 0) == inside


def test_the_cone_of_a_terrain_is_about_its_slope():
    x = np.linspace(-1, 1, 21)
    slope = tc.Terrain(
        np.tile(0.5 * x[:, None], (1, 21)), lower=(-1, -1), upper=(1, 1), friction=MU
    )
    plane = tc.Ground(normal=(-0.5, 0, 1), friction=MU)
    at, pushed = np.array([0.31, 0.12, 0.155]), np.array([0.2, 0.3, 1.1])
    rows = [
        np.asarray(friction_cone(ground)(np.concatenate([at, pushed])).full())
        for ground in (slope, plane)
    ]
    assert np.allclose(*rows, atol=1e-9)

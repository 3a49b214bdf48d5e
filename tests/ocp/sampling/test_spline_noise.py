"""Noise of sampling controllers: as strong as asked at all times, smooth, and in groups."""

from __future__ import annotations

import numpy as np
import pytest

import ocp


@pytest.mark.parametrize(
    ("knots", "intervals"), [(1, 5), (2, 10), (4, 10), (8, 20), (6, 3), (3, 1)]
)
def test_its_deviation_is_the_same_at_all_times(knots, intervals):
    basis = ocp.SplineNoise(1.0, knots).basis(intervals)
    noise = np.random.default_rng(0).standard_normal((20000, basis.shape[1])) @ basis.T
    assert noise.std(axis=0) == pytest.approx(np.ones(intervals), abs=0.03)


def test_fewer_knots_make_it_smoother():
    basis = [ocp.SplineNoise(1.0, knots).basis(20) for knots in (1, 4, 20)]
    neighbours = [np.mean(np.sum(rows[1:] * rows[:-1], axis=1)) for rows in basis]  # correlation
    assert neighbours[0] == pytest.approx(1.0)
    assert 0.8 < neighbours[1] < 0.99
    assert neighbours[2] == pytest.approx(0.0, abs=1e-12)


def test_samples_explore_and_refine():
    sizes = ocp.SplineNoise(1.0, min_scale=0.01).sizes(6)
    assert sizes == pytest.approx([0.0, 1.0, 10**-0.5, 0.1, 10**-1.5, 0.01])
    assert ocp.SplineNoise(1.0, min_scale=1.0).sizes(3).tolist() == [0.0, 1.0, 1.0]


def test_a_group_changes_together():
    matrix = ocp.SplineNoise([1.0, 2.0, 3.0, 4.0], groups=[[0, 2], [3]]).directions(4)
    assert matrix.tolist() == [[1.0, 0.0, 3.0, 0.0], [0.0, 0.0, 0.0, 4.0]]
    assert ocp.SplineNoise(2.0).directions(2).tolist() == [[2.0, 0.0], [0.0, 2.0]]


BAD = {
    "negative": (
        lambda: ocp.SplineNoise(-1.0),
        ValueError,
        "SplineNoise.deviation of string 0 is -1",
    ),
    "a word": (lambda: ocp.SplineNoise("much"), TypeError, "SplineNoise.deviation"),
    "no knots": (lambda: ocp.SplineNoise(1.0, 0), ValueError, "SplineNoise.knots"),
    "finer than nothing": (
        lambda: ocp.SplineNoise(1.0, min_scale=0.0),
        ValueError,
        "SplineNoise.min_scale is 0",
    ),
    "finer than all": (
        lambda: ocp.SplineNoise(1.0, min_scale=2.0),
        ValueError,
        "SplineNoise.min_scale is 2: give a fraction",
    ),
    "groups of a number": (
        lambda: ocp.SplineNoise(1.0, groups=3),
        TypeError,
        "SplineNoise.groups is 3",
    ),
    "a group of a number": (
        lambda: ocp.SplineNoise(1.0, groups=[3]),
        TypeError,
        r"SplineNoise.groups\[0\] is 3",
    ),
    "no groups": (
        lambda: ocp.SplineNoise(1.0, groups=[]),
        ValueError,
        "give strings to each group",
    ),
    "an empty group": (
        lambda: ocp.SplineNoise(1.0, groups=[[0], []]),
        ValueError,
        "give strings to each group",
    ),
    "a string twice": (
        lambda: ocp.SplineNoise(1.0, groups=[[0, 1], [2, 1]]),
        ValueError,
        "string 1 twice",
    ),
    "no such string": (
        lambda: ocp.SplineNoise(1.0, groups=[[7]]).directions(4),
        ValueError,
        r"SplineNoise.groups\[0\]\[0\] is 7: string indices run from 0 to 3",
    ),
    "other strings": (
        lambda: ocp.SplineNoise([1.0, 2.0]).directions(4),
        ValueError,
        "SplineNoise.deviation has shape",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()

"""Pictures of many motions: what they draw, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi import plots


@pytest.fixture(scope="module")
def many():
    """Masses on a string of force density u, x'' = -u x, one of them not finite."""
    pins = {0: "xyz", 1: "yz"}
    structure = tc.Structure(
        [(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=[0, 1.0], pinned=pins
    )
    model = tc.Model(tc.Scene(structure, control=tc.ForceDensity()))
    starts = np.tile([1.0, 0.0], (101, 1))
    starts[7] = np.nan
    return tc.rollouts(model, 1.0, 0.01, starts, np.linspace(0.0, 2.0, 101)[:, None], save_every=10)


def test_a_fan_shows_quantiles_of_those_that_succeeded(many, tmp_path):
    figure = plots.fan(many, 1, "xz", bands=[0.25], path=tmp_path / "fan.png")
    assert (tmp_path / "fan.png").stat().st_size > 5000
    top, below = figure.axes
    assert (top.get_ylabel(), below.get_ylabel()) == ("x of node 1 (m)", "z of node 1 (m)")
    assert top.get_title() == "100 of 101 motions"
    u = np.delete(np.linspace(0.0, 2.0, 101), 7)
    median = next(line for line in top.lines if line.get_label() == "median")
    np.testing.assert_allclose(
        median.get_ydata(), np.median(np.cos(np.sqrt(u)[:, None] * many.time), axis=0), atol=1e-8
    )
    (band,) = top.collections
    ends = band.get_paths()[0].vertices[band.get_paths()[0].vertices[:, 0] == 1.0][:, 1]
    np.testing.assert_allclose(
        [ends.min(), ends.max()], np.quantile(np.cos(np.sqrt(u)), [0.25, 0.75]), atol=1e-8
    )


def test_a_histogram_counts_those_that_succeeded(many):
    figure = plots.histogram(many, many.final[:, 0], "x at the end (m)", bins=10)
    (ax,) = figure.axes
    assert ax.get_xlabel() == "x at the end (m)"
    assert sum(bar.get_height() for bar in ax.patches) == 100
    assert f"median: {np.nanmedian(many.final[:, 0]):.4g}" in [
        line.get_label() for line in ax.lines
    ]
    alike = plots.histogram(many, np.ones(101))
    assert [bar.get_height() for bar in alike.axes[0].patches] == [100]


@pytest.mark.parametrize(
    ("draw", "told"),
    [
        (lambda many: plots.fan(many, 2), "node is 2"),
        (lambda many: plots.fan(many, 1, "xq"), "axes is 'xq'"),
        (lambda many: plots.fan(many, 1, "xx"), "axes is 'xx'"),
        (lambda many: plots.fan(many, 1, ""), "axes is ''"),
        (lambda many: plots.fan(many, 1, bands=[0.5]), "bands is"),
        (lambda many: plots.fan(3, 1), "rollouts is 3"),
        (lambda many: plots.histogram(many, np.zeros(3)), r"outcome has shape \(3,\)"),
        (lambda many: plots.histogram(many, np.full(101, np.nan)), r"outcome\[0\] is nan"),
        (lambda many: plots.histogram(many, np.zeros(101), bins=0), "bins is 0"),
    ],
)
def test_wrong_arguments(many, draw, told):
    with pytest.raises((TypeError, ValueError), match=told):
        draw(many)

"""Grounds in 3-D drawings: planes cut to the box, height fields over it."""

from __future__ import annotations

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.animation import animate


def drawn(figure):
    """Corners (k, 3) of the faces of each ground, and the corners of the box."""
    axes = figure.axes[0]
    box = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]).T
    figure.canvas.draw()
    return [
        np.unique(np.concatenate(part._faces), axis=0)
        for part in axes.collections
        if isinstance(part, Poly3DCollection)
    ], box


def test_planes_are_cut_to_the_box():
    slope, wall, far = (
        tc.Ground(normal=(-0.3, 0.1, 1.0)),
        tc.Ground(normal=(1, 0, 0), height=0.1),
        tc.Ground(height=-100.0),
    )
    (one, two), (low, high) = drawn(plots.structure(tc.shapes.prism(), ground=[slope, wall, far]))
    for ground, corners in ((slope, one), (wall, two)):
        assert len(corners) >= 3
        assert np.abs(corners @ ground.normal - ground.height).max() < 1e-12
        assert np.all((corners > low - 1e-9) & (corners < high + 1e-9))
        on_edges = np.isclose(corners, low) | np.isclose(corners, high)
        assert np.all(on_edges.sum(axis=1) >= 2)  # all of the plane that the box holds
    assert not drawn(plots.structure(tc.shapes.prism()))[0]


def test_height_fields_are_drawn_over_the_whole_box_which_grows_to_hold_them(tmp_path):
    x = np.linspace(-1, 1, 21)
    bowl = tc.Terrain(x[:, None] ** 2 + x**2 - 3.0, (-1, -1), (1, 1))
    model = tc.Model(tc.Scene(tc.shapes.prism(), ground=bowl))
    run = tc.simulate(model, 0.01, 1e-3, compiled=False)
    (corners,), (low, high) = drawn(plots.time_lapse(run, 2, ground=model.scene.ground))
    assert np.abs(bowl.depth(corners.T).full()).max() < 1e-12
    assert low[2] < -3 < run.nodes[..., 2].max() < high[2]
    assert [corners.min(axis=0)[:2], corners.max(axis=0)[:2]] == [
        pytest.approx(low[:2]),
        pytest.approx(high[:2]),
    ]
    assert animate(run, tmp_path / "bowl.gif", ground=bowl).stat().st_size > 1000


def test_what_is_no_ground_is_refused_by_name():
    with pytest.raises(
        TypeError, match=r"^ground is 'floor': give a tenscasadi\.Ground or Terrain"
    ):
        plots.structure(tc.shapes.prism(), ground="floor")

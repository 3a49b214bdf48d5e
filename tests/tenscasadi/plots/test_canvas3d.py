"""Surroundings in 3-D pictures."""

from __future__ import annotations

import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

import tenscasadi as tc
from tenscasadi import plots
from tenscasadi.animation import animate


def draw_surfaces(figure):
    """Corners (k, 3) of each surface, and the corners of the axes."""
    axes = figure.axes[0]
    box = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]).T
    figure.canvas.draw()
    surfaces = [part for part in axes.collections if isinstance(part, Poly3DCollection)]
    return [np.unique(np.concatenate(part._faces), axis=0) for part in surfaces], box


def test_planes_fill_the_axes():
    slope, wall, far = (
        tc.Ground(normal=(-0.3, 0.1, 1.0)),
        tc.Ground(normal=(1, 0, 0), height=0.1),
        tc.Ground(height=-100.0),
    )
    figure = plots.structure(tc.shapes.prism(), ground=[slope, wall, far])
    (one, two), (low, high) = draw_surfaces(figure)
    for ground, corners in ((slope, one), (wall, two)):
        assert np.abs(corners @ ground.normal - ground.height).max() < 1e-12
        assert np.all((corners > low - 1e-9) & (corners < high + 1e-9))
    assert not draw_surfaces(plots.structure(tc.shapes.prism()))[0]


def test_axes_contain_height_fields(tmp_path):
    x = np.linspace(-1, 1, 21)
    bowl = tc.Terrain(x[:, None] ** 2 + x**2 - 3.0, (-1, -1), (1, 1))
    model = tc.Model(tc.Scene(tc.shapes.prism(), ground=bowl))
    run = tc.simulate(model, 0.01, 1e-3, compiled=False)
    (corners,), (low, high) = draw_surfaces(plots.time_lapse(run, 2, ground=model.scene.ground))
    assert np.abs(bowl.depth(corners.T).full()).max() < 1e-12
    assert low[2] < -2.9 < run.nodes[..., 2].max() < high[2]
    assert corners.min(axis=0)[:2] == pytest.approx(low[:2])
    assert corners.max(axis=0)[:2] == pytest.approx(high[:2])
    assert animate(run, tmp_path / "bowl.gif", ground=bowl).stat().st_size > 1000


def test_a_wrong_ground_is_named():
    message = r"^ground is 'floor': give a tenscasadi\.Ground or Terrain"
    with pytest.raises(TypeError, match=message):
        plots.structure(tc.shapes.prism(), ground="floor")


def test_bodies_are_translucent_faces(tmp_path):
    nodes = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    plate = tc.Structure(nodes, bodies=[tc.RigidBody(range(4), 1.0)])
    (corners,), _ = draw_surfaces(plots.structure(plate))
    np.testing.assert_allclose(corners, np.unique(nodes, axis=0))
    run = tc.simulate(tc.Model(tc.Scene(plate, gravity=tc.Gravity())), 0.2, 0.02)
    assert len(draw_surfaces(plots.time_lapse(run, instants=3))[0]) == 3
    assert animate(run, tmp_path / "plate.gif", frames_per_second=5).exists()


def test_broken_strings_have_no_lines():
    hung = tc.Structure(
        [(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], node_mass=1.0, pinned=[0], stiffness=1000.0
    )
    scene = tc.Scene(hung, gravity=tc.Gravity(), strength=tc.Breaking(15.0))
    run = tc.simulate(tc.Model(scene), 0.1, 1e-3, compiled=False)
    assert run.breaks
    for time, drawn in ((0.0, True), (0.1, False)):
        (lines,) = (
            part
            for part in plots.structure(run, time=time).axes[0].collections
            if isinstance(part, Line3DCollection)
        )
        widths = np.asarray(lines.get_linewidths())
        assert bool((widths == 0).any()) is not drawn

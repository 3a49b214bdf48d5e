"""Grounds are drawn where nodes meet them, and their lines are as far apart as the legend says."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.viewer.scenery import add_boxes, add_grounds, grid_spacing

LOW, HIGH = np.array([-1.0, -0.5, 0.0]), np.array([1.5, 0.5, 1.0])


class Recorder:
    """A scene that keeps what is added."""

    def __init__(self):
        self.meshes, self.lines = [], []

    def add_mesh_simple(self, name, vertices, faces, **_):
        self.meshes.append((vertices, faces))

    def add_line_segments(self, name, points, *_, **__):
        self.lines.append(points)


def depths(ground, points):
    return np.asarray(ground.depth(points.T).full()).ravel()


@pytest.mark.parametrize("size", [1e-3, 0.07, 1.0, 3.0, 4.99, 7.0, 1e4])
def test_lines_are_1_2_or_5_apart(size):
    spacing = grid_spacing(size)
    assert size / 25 <= spacing <= size / 10 * (1 + 1e-9)
    assert np.isclose(spacing / 10 ** np.floor(np.log10(spacing * (1 + 1e-9))), [1, 2, 5]).any()


@pytest.mark.parametrize(
    "normal", [(0, 0, 1), (0.3, 0, 1), (1, 0.5, 0), (0, 0, -1), (-0.2, 0.7, 0.4)]
)
def test_planes_are_where_the_ground_is(normal):
    ground, scene = tc.Ground(normal=normal, height=0.2), Recorder()
    add_grounds(scene, "ground", (ground,), LOW, HIGH)
    ((vertices, _),), (lines,) = scene.meshes, scene.lines
    np.testing.assert_allclose(depths(ground, vertices), 0.0, atol=1e-12)
    assert np.abs(depths(ground, lines.reshape(-1, 3))).max() < 0.01
    centre = (LOW + HIGH) / 2
    foot = centre + float(ground.depth(centre)) * np.array(ground.normal)
    assert np.linalg.norm(vertices.mean(axis=0) - foot) < 1.0  # under the motion


def test_height_fields_are_where_the_ground_is():
    heights = np.random.default_rng(0).normal(size=(7, 9))
    ground, scene = tc.Terrain(heights, (-1.0, -2.0), (2.0, 1.0)), Recorder()
    add_grounds(scene, "ground", (ground,), LOW, HIGH)
    ((vertices, faces),), (lines,) = scene.meshes, scene.lines
    np.testing.assert_allclose(depths(ground, vertices), 0.0, atol=1e-12)  # also beyond the grid
    corners = vertices[faces]
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
    spacing = grid_spacing(1.2 * float((HIGH - LOW).max()))
    across = (
        np.abs(lines[:, :, :2] / spacing - np.round(lines[:, :, :2] / spacing))
        .max(axis=1)
        .min(axis=1)
    )
    np.testing.assert_allclose(
        across, 0.0, atol=1e-9
    )  # each piece of a line lies at a multiple of the spacing, in x or y


def test_half_open_boxes_show_the_sides_that_there_are():
    scene = Recorder()
    add_boxes(scene, "box", ((np.array([-np.inf, -np.inf, -0.1]), np.full(3, np.inf)),), LOW, HIGH)
    (lines,) = scene.lines
    assert lines.shape == (4, 2, 3)
    np.testing.assert_allclose(lines[:, :, 2], -0.1)

"""Grounds and boxes are drawn at their positions, within the view."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.scenery import cut_ground, find_box_edges, find_view, grid_spacing

LOW, HIGH = np.array([-1.0, -0.5, -1.0]), np.array([1.5, 0.5, 1.0])


def depths(ground, points):
    return np.asarray(ground.depth(points.T).full()).ravel()


def normals(patch):
    corners = patch.vertices[patch.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def assert_inside(points):
    assert np.all((points >= LOW - 1e-9) & (points <= HIGH + 1e-9))


@pytest.mark.parametrize("size", [1e-3, 0.07, 1.0, 3.0, 4.99, 7.0, 1e4])
def test_grid_lines_are_1_2_or_5_apart(size):
    spacing = grid_spacing(size)
    assert size / 50 <= spacing <= size / 20 * (1 + 1e-9)
    assert np.isclose(spacing / 10 ** np.floor(np.log10(spacing * (1 + 1e-9))), [1, 2, 5]).any()


@pytest.mark.parametrize(
    "normal", [(0, 0, 1), (0.3, 0, 1), (1, 0.5, 0), (0, 0, -1), (-0.2, 0.7, 0.4)]
)
def test_planes_are_cut_to_the_box(normal):
    ground = tc.Ground(normal=normal, height=0.2)
    patch = cut_ground(ground, LOW, HIGH)
    for points in (patch.vertices, patch.lines.reshape(-1, 3)):
        np.testing.assert_allclose(depths(ground, points), 0.0, atol=1e-12)
        assert_inside(points)
    on_edges = np.isclose(patch.vertices, LOW) | np.isclose(patch.vertices, HIGH)
    assert np.all(on_edges.sum(axis=1) >= 2)  # the whole plane in the box
    assert len(patch.lines) > 5
    assert (normals(patch) @ np.array(ground.normal) > 0).all()


def test_planes_outside_the_box_are_left_out():
    assert cut_ground(tc.Ground(height=-100.0), LOW, HIGH) is None


def test_height_fields_fill_the_box():
    heights = np.random.default_rng(0).normal(size=(7, 9))
    ground = tc.Terrain(heights, (-0.5, -2.0), (2.0, 1.0))
    patch = cut_ground(ground, LOW, HIGH)
    np.testing.assert_allclose(depths(ground, patch.vertices), 0.0, atol=1e-12)
    np.testing.assert_allclose(patch.vertices.min(axis=0)[:2], LOW[:2])
    np.testing.assert_allclose(patch.vertices.max(axis=0)[:2], HIGH[:2])
    assert (normals(patch)[:, 2] > 0).all()
    spacing = grid_spacing(float((HIGH - LOW).max()))
    steps = patch.lines[:, :, :2] / spacing
    apart = np.abs(steps - np.round(steps)).max(axis=1).min(axis=1)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)  # pieces lie on grid lines


def test_the_view_contains_grounds_and_obstacles():
    bowl = tc.Terrain(np.full((2, 2), -3.0), (-1, -1), (1, 1))
    near, far = tc.Ground(height=-1.0), tc.Ground(height=-100.0)
    content = describe_content(tc.shapes.prism(), ground=[bowl, near, far])
    content = dataclasses.replace(content, obstacles=((np.array([5.0, 0, 0]), 0.5),))
    low, high = find_view(content, 0.0)
    assert low[2] == pytest.approx(-3.0)
    assert high[0] == pytest.approx(5.5)
    assert find_view(describe_content(tc.shapes.prism(), ground=near), 0.0)[0][2] < -1.0


def test_half_open_boxes_show_their_finite_sides():
    edges = find_box_edges((np.array([-np.inf, -np.inf, -0.1]), np.full(3, np.inf)), LOW, HIGH)
    assert edges.shape == (4, 2, 3)
    np.testing.assert_allclose(edges[:, :, 2], -0.1)
    assert len(find_box_edges((np.zeros(3), np.ones(3)), LOW, HIGH)) == 12
    assert len(find_box_edges((np.full(3, -np.inf), np.full(3, np.inf)), LOW, HIGH)) == 0

"""Shapes of a motion: arrows of forces and their scale."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.shapes import MotionShapes, choose_tint
from tenscasadi.drawing.style import STYLE
from tenscasadi.drawing.view_content import Frame, NodeForces

PRISM = tc.shapes.prism()


def arrows(values, kinds=("load",)):
    """Build the arrows of a load that is `values` at each node."""
    content = describe_content(PRISM)
    loads = NodeForces("load", lambda frame: np.outer(values, [0.0, 0.0, 1.0]))
    motion = replace(content.motions[0], forces=(loads,))
    shapes = MotionShapes(replace(content, motions=(motion,)))
    return shapes, shapes.build(motion.frame_at(0.0), None, kinds)[-1]


def test_arrows_are_as_long_as_their_forces_say():
    shapes, shape = arrows([0.0, 0.0, 0.0, 1.0, 2.0, 4.0])
    assert shape.form == "arrow"
    lengths = np.linalg.norm(shape.points[:, 1] - shape.points[:, 0], axis=1)
    assert lengths / lengths.max() == pytest.approx([0.25, 0.5, 1.0])
    assert shape.points[:, 0] == pytest.approx(PRISM.nodes[3:])
    assert shapes.force_scale(shapes.motion.forces[0]) == pytest.approx(4.0, rel=0.02)
    assert (shape.colors == STYLE.load).all()


def test_small_and_unwanted_forces_have_no_arrows():
    assert len(arrows([1e-3, 1.0, 1.0, 1.0, 1.0, 1.0])[1].points) == 5
    assert len(arrows(np.ones(6), kinds=())[1].points) == 0
    assert len(arrows(np.zeros(6))[1].points) == 0


def test_forces_that_are_not_finite_have_no_arrows():
    shape = arrows([np.nan, 1.0, 1.0, 1.0, 1.0, 1.0])[1]
    assert len(shape.points) == 5
    assert np.isfinite(shape.points).all()


@pytest.mark.parametrize("quantity", ["tension", "force density", None])
def test_broken_strings_are_left_out(quantity):
    content = describe_content(PRISM)
    shapes = MotionShapes(content)
    values = np.array([np.nan, 0.0, *np.ones(7)])
    frame = Frame(PRISM.nodes, tension=values, force_density=values)
    scale = quantity and ColorScale.of(quantity, values)
    radius = shapes.build(frame, scale)[1].radius
    assert radius[0] == 0
    assert (radius[1:] >= content.least_radius).all()


def test_only_later_motions_are_tinted():
    content = describe_content([PRISM, PRISM, PRISM])
    tints = [choose_tint(content, k) for k in range(3)]
    assert tints == [None, *STYLE.curves[:2]]

"""Hulls of rigid bodies as triangles."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.hulls import find_hulls
from tenscasadi.drawing.shapes import MotionShapes
from tenscasadi.drawing.style import STYLE

CUBE = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
HEXAGON = np.array([(np.cos(a), np.sin(a), 0.2) for a in np.arange(6) * np.pi / 3])


def body(nodes, extra=0):
    """A structure of a body, after `extra` pinned nodes without one."""
    own = range(extra, extra + len(nodes))
    free = np.zeros((extra, 3)) + 5.0
    pinned = range(extra)
    return tc.Structure(np.vstack([free, nodes]), pinned=pinned, bodies=[tc.RigidBody(own, 1.0)])


def area(nodes, faces):
    """Area of triangles [m²]."""
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


@pytest.mark.parametrize(
    ("nodes", "expected"),
    [
        (CUBE, 6.0),
        (np.vstack([CUBE, CUBE.mean(axis=0)]), 6.0),
        (HEXAGON, 1.5 * np.sqrt(3)),
        (np.vstack([HEXAGON, (0, 0, 0.2)]), 1.5 * np.sqrt(3)),
        (HEXAGON[:3], np.sqrt(3) / 4),
    ],
)
def test_hull_has_the_area_of_the_body(nodes, expected):
    s = body(nodes, extra=2)
    (faces,) = find_hulls(s)
    assert area(s.nodes, faces) == pytest.approx(expected)


def test_given_faces_replace_the_hull():
    faces = [(2, 3, 4), (2, 4, 7)]
    s = body(CUBE, extra=2)
    own = s.replace(bodies=[tc.RigidBody(s.bodies[0].nodes, 1.0, faces=faces)])
    assert find_hulls(own)[0].tolist() == [list(face) for face in faces]
    moved = own.replace(nodes=own.nodes + 1.0)
    assert find_hulls(moved)[0].tolist() == find_hulls(own)[0].tolist()


def test_rods_and_structures_without_bodies_have_no_faces():
    assert [len(hull) for hull in find_hulls(body(CUBE[:2]))] == [0]
    assert find_hulls(tc.shapes.prism()) == find_hulls(None) == []


def test_pictures_have_faces_that_move_with_the_body():
    s = body(HEXAGON)
    model = tc.Model(tc.Scene(s))
    run = tc.simulate(model, 1.0, 0.02, state=model.state(s.nodes, np.tile((1, 2, 3), (6, 1))))
    content = describe_content(run)
    motion, shapes = content.motions[0], MotionShapes(content)
    first, last = (shapes.build(motion.frame_at(time))[-1] for time in (0.0, 1.0))
    assert first.form == "face"
    assert (first.colors == STYLE.body).all()
    np.testing.assert_allclose(
        last.points - first.points, np.broadcast_to((1, 2, 3), first.points.shape), atol=1e-9
    )


def test_copies_of_rollouts_have_faces_each():
    s = body(HEXAGON)
    model = tc.Model(tc.Scene(s))
    runs = tc.rollouts(model, 0.1, 0.02, states=np.tile(model.initial_state, (3, 1)))
    assert len(MotionShapes(describe_content(runs)).hulls) == 3

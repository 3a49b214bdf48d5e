"""Pairs of bars in contact: closest points, fields, scene files, and bad input."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.scene.closest_points import Segments, find_closest_points, find_contact

BARS = [(0, 1), (2, 3), (3, 4)]
NODES = [(-1, 0, 0), (1, 0, 0), (0, -1, 0.2), (0, 1, 0.2), (1, 1, 1)]


def structure(radius: float = 0.05) -> tc.Structure:
    return tc.Structure(NODES, bars=BARS, bar_radius=radius, bar_names=["a", "b", "c"])


@pytest.mark.parametrize("kind", ["random", "parallel", "short", "crossing"])
def test_closest_points_are_closest(kind):
    random = np.random.default_rng(1)
    P = random.normal(size=(4, 3, 50))
    if kind == "parallel":
        P[3] = P[2] + (P[1] - P[0]) * random.uniform(-2, 2, 50)
    elif kind == "short":
        P[3] = P[2] + 1e-3 * (P[3] - P[2])
    elif kind == "crossing":
        P[3] = 2 * (P[0] + 0.3 * (P[1] - P[0])) - P[2]
    s, t = (values.full() for values in find_closest_points(Segments(*map(ca.DM, P))))
    assert ((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).all()
    first, second = P[1] - P[0], P[3] - P[2]
    found = np.linalg.norm(P[0] + s * first - P[2] - t * second, axis=0)
    along = np.linspace(0, 1, 2001)[:, None, None]  # exact on the second one
    points = P[0] + along * first
    other = np.einsum("kim,im->km", points - P[2], second) / np.sum(second**2, axis=0)
    gaps = points - P[2] - np.clip(other, 0, 1)[:, None] * second
    least = np.linalg.norm(gaps, axis=1).min(axis=0)
    assert (found <= least + 1e-7).all()


def test_axes_that_cross_have_finite_forces():
    at = Segments(*(ca.DM(end) for end in [(-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]))
    contact, _ = find_contact(at, ca.DM([[0.1]]))
    assert contact.depth == pytest.approx(0.1)
    assert np.isfinite(contact.outward.full()).all()


def test_all_pairs_are_those_that_share_no_node():
    assert tc.BarContact().select_pairs(structure()).tolist() == [[0, 1], [0, 2]]
    assert tc.BarContact([(2, 0)]).select_pairs(structure()).tolist() == [[2, 0]]


def test_scene_files_hold_bar_contact(tmp_path):
    scene = tc.Scene(structure(), bar_contact=tc.BarContact([(0, 1), (0, 2)], 2e3, 5.0))
    tc.save_scene(scene, tmp_path / "scene.toml")
    again = tc.load_scene(tmp_path / "scene.toml")
    assert again.bar_contact == scene.bar_contact
    text = (tmp_path / "scene.toml").read_text(encoding="utf-8")
    named = text.replace("[[0, 1], [0, 2]]", '[["a", "b"], ["a", "c"]]')
    assert named != text
    (tmp_path / "named.toml").write_text(named, encoding="utf-8")
    assert tc.load_scene(tmp_path / "named.toml").bar_contact == scene.bar_contact


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (
            {"pairs": [(0, 1), (1, 0)]},
            "BarContact.pairs is .*: give each pair once, or None for all",
        ),
        ({"pairs": []}, "give each pair once"),
        ({"pairs": [(0, 1, 2)]}, r"BarContact.pairs\[0\] is \(0, 1, 2\): give two bars"),
        ({"pairs": [(1, 1)]}, "give two different bars"),
        ({"pairs": [(0, -1)]}, r"BarContact.pairs\[0\] is -1"),
        ({"stiffness": 0.0}, "BarContact.stiffness is 0"),
        ({"damping": -1.0}, "BarContact.damping is -1"),
        ({"pairs": [(0, 3)]}, r"pairs\[0\] is 3: bar indices run from 0 to 2"),
        ({"pairs": [(1, 2)]}, "which share node 3: leave the pair out"),
    ],
)
def test_wrong_contact_is_rejected(fields, message):
    with pytest.raises(ValueError, match=message):
        tc.Scene(structure(), bar_contact=tc.BarContact(**fields))


def test_scenes_without_fitting_bars_are_rejected():
    with pytest.raises(ValueError, match="bars 0 and 1 have no bar_radius"):
        tc.Scene(structure(0.0), bar_contact=tc.BarContact())
    with pytest.raises(ValueError, match="no two bars that share no node"):
        tc.Scene(tc.shapes.double_pendulum(), bar_contact=tc.BarContact())
    with pytest.raises(TypeError, match=r"Scene\.bar_contact is 3"):
        tc.Scene(structure(), bar_contact=3)

"""Scenes: what they refuse, and which structure they model."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.structure import Structure

TRIANGLE = Structure(
    [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
    bars=[(0, 1)],
    strings=[(1, 2), (2, 0)],
    node_mass=[0, 0, 1],
    string_mass=0.2,
)


def test_segments_give_the_modelled_structure() -> None:
    scene = Scene(TRIANGLE, segments=4, ends="lumped")
    assert len(scene.modelled.strings) == 8
    assert scene.modelled.node_mass.sum() == pytest.approx(1.4)
    assert list(scene.modelled.string_parent) == [0] * 4 + [1] * 4
    assert len(Scene(TRIANGLE).modelled.nodes) == 3


def test_a_scene_is_frozen() -> None:
    with pytest.raises(AttributeError):
        Scene(TRIANGLE).gravity = Gravity()  # type: ignore[misc]


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"structure": "prism"}, r"Scene\.structure"),
        ({"gravity": (0, 0, -9.81)}, r"Scene\.gravity"),
        ({"ground": 0.0}, r"Scene\.ground"),
        ({"pressure": 5.0}, r"Scene\.pressure"),
        ({"forces": np.zeros((3, 3))}, r"Scene\.forces"),
        ({"control": "force density"}, r"Scene\.control"),
        ({"slack": 0.01}, r"Scene\.slack"),
        ({"segments": 0}, r"segments"),
        ({"segments": 2.5}, r"segments"),
        ({"segments": [1, 2, 3]}, r"segments"),
        ({"ends": "middle"}, r"ends"),
        ({"pressure": Pressure([(0, 1, 3)], 1.0)}, r"Pressure\.faces\[0\]"),
        ({"forces": NodalForce(np.zeros((2, 3)))}, r"NodalForce\.values"),
        ({"structure": TRIANGLE.replace(string_mass=0.0), "segments": 3}, r"string_mass"),
    ],
)
def test_bad_scenes_are_refused_by_name(changes: dict[str, object], field: str) -> None:
    with pytest.raises((ValueError, TypeError), match=field):
        Scene(**{"structure": TRIANGLE, **changes})  # type: ignore[arg-type]

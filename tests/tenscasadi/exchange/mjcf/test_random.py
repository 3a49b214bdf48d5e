"""Structures of random bars, strings, masses, pins and rollers: MuJoCo moves them as we do, and they read back the same."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mujoco_runs import mujoco_ends

import tenscasadi as tc


def random_structure(seed: int) -> tc.Structure:
    """Bars that share nodes, in trees and loops; some nodes pinned, some that roll."""
    draw = np.random.default_rng(seed)
    n = int(draw.integers(3, 9))
    pairs = {
        tuple(sorted(draw.choice(n, 2, replace=False).tolist()))
        for _ in range(int(draw.integers(1, n)))
    }
    bars = [pair if draw.random() < 0.5 else pair[::-1] for pair in sorted(pairs)]
    strings = [
        tuple(draw.choice(n, 2, replace=False).tolist()) for _ in range(int(draw.integers(2, 8)))
    ]
    mass = np.where(draw.random(n) < 0.4, draw.uniform(0.1, 1, n), 0.0)
    mass[[node for node in range(n) if node not in {end for bar in bars for end in bar}]] = (
        draw.uniform(0.2, 1)
    )
    pinned: dict[int, str] = {}
    rollers: dict[int, Any] = {}
    for node, share in enumerate(draw.random(n)):
        if share < 0.2:
            pinned[node] = "xyz" if share < 0.12 else "z"
        elif share < 0.28:
            rollers[node] = draw.normal(size=3)
    thick = np.where(draw.random(len(bars)) < 0.5, 0.0, draw.uniform(0.01, 0.2, len(bars)))
    law = {
        "stiffness": draw.uniform(50, 200, len(strings)),
        "damping": draw.uniform(0, 1, len(strings)),
        "rest_length": 0.5,
    }
    members = {
        "bars": bars,
        "strings": strings,
        "bar_mass": draw.uniform(0.5, 2, len(bars)),
        "bar_radius": thick,
        "node_mass": mass,
    }
    return tc.Structure(draw.normal(size=(n, 3)), **members, pinned=pinned, rollers=rollers, **law)


def check(seed: int, path: Path) -> int:
    """Compare motion and structure by each way of joints, and return how many ways there were."""
    structure = random_structure(seed)
    scene = tc.Scene(
        structure, gravity=tc.Gravity(), slack=tc.Linear()
    )  # whose damping is MuJoCo's, too
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.RedundantConstraints)
        run = tc.simulate(tc.Model(scene), 0.02, 2.5e-4, compiled=False, correction=tc.Projection())
    assert run.success
    ways = 0
    for joints in ("ball", "connect"):
        try:
            tc.export_mjcf(scene, path, joints=joints, step=2.5e-4)
        except ValueError as error:
            assert "of three directions" in str(error)  # noqa: PT017  a second node that slides
            continue
        ways += 1
        assert mujoco_ends(path, 0.02) == pytest.approx(
            run.nodes[-1], abs=1e-6 if joints == "connect" else 1e-7
        )
        found = tc.import_mjcf(path).structure
        for name in (
            "nodes",
            "bars",
            "strings",
            "bar_mass",
            "bar_radius",
            "node_mass",
            "stiffness",
            "damping",
            "rest_length",
        ):
            assert getattr(found, name) == pytest.approx(getattr(structure, name), abs=1e-12), name
        assert found.pinned == structure.pinned
        assert found.rollers.keys() == structure.rollers.keys()
    return ways


def test_random_structures_move_alike_and_read_back(tmp_path: Path) -> None:
    assert sum(check(seed, tmp_path / "scene.xml") for seed in range(8)) >= 8


@pytest.mark.slow
def test_many_random_structures_move_alike_and_read_back(tmp_path: Path) -> None:
    assert sum(check(seed, tmp_path / "scene.xml") for seed in range(8, 100)) >= 100

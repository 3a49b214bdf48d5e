"""Structures for tests of statics."""

from __future__ import annotations

from typing import Any

import numpy as np

import tenscasadi as tc
from tenscasadi.structure.structure import Structure


def row_of(one: Structure, count: int) -> Structure:
    """`count` copies of a structure above each other."""
    nodes = np.vstack([one.nodes + (0, 0, 3.0 * k) for k in range(count)])
    bars, strings = (
        np.vstack([members + len(one.nodes) * k for k in range(count)])
        for members in (one.bars, one.strings)
    )
    return Structure(nodes, bars, strings)


def random_structure(seed: int) -> tuple[Structure, np.ndarray, Any, list[int]]:
    """A net of bars and strings with loads that some force densities balance, the least that is asked of each, and strings that push."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(6, 30))
    pairs = [(i, j) for i in range(n) for j in range(i)]
    rng.shuffle(pairs)
    bars = [(2 * k, 2 * k + 1) for k in range(int(rng.integers(0, n // 3 + 1)))]
    strings = [
        pair
        for pair in map(tuple, pairs[: int(rng.integers(6, min(len(pairs), 6 * n)))])
        if tuple(sorted(pair)) not in bars
    ]
    s = Structure(
        rng.normal(size=(n, 3)),
        bars,
        strings,
        pinned=range(n - 3, n) if seed % 3 else (),
        node_mass=1.0,
    )
    gamma = (
        rng.exponential(size=len(strings))
        * (rng.random(len(strings)) < 0.7)
        * 10 ** rng.uniform(-2, 3)
    )
    N, t = s.nodes.T, rng.normal(size=len(bars)) * gamma.max()
    loads = N @ s.C_s.T @ np.diag(gamma) @ s.C_s + N @ s.C_b.T @ np.diag(t) @ s.C_b
    return s, loads.T, 0.1 * gamma if seed % 2 else 0.0, [0, 1] if seed % 4 == 0 else []


def general_prism(bars: int, top: float = 1.0, height: float = 1.0, **options: Any) -> tc.Structure:
    """A prism of `bars` bars with radii 1 and `top`: bottom, top and vertical strings in this order."""
    k = np.arange(bars)
    after = (k + 1) % bars
    bottom, turn = 2 * np.pi * k / bars, np.pi / 2 - np.pi / bars
    nodes = np.concatenate(
        [
            np.stack([np.cos(bottom), np.sin(bottom), 0.0 * k], axis=1),
            np.stack(
                [top * np.cos(bottom + turn), top * np.sin(bottom + turn), height + 0.0 * k], axis=1
            ),
        ]
    )
    strings = np.concatenate([np.c_[k, after], np.c_[bars + k, bars + after], np.c_[k, bars + k]])
    return tc.Structure(nodes, np.c_[k, bars + after], strings, **options)


def general_prism_stress(bars: int, top: float = 1.0) -> np.ndarray:
    """Force densities of the strings, then of the bars (positive in compression), for vertical strings at 1 N/m."""
    half = 2 * np.sin(np.pi / bars)
    return np.repeat([top / half, 1 / (half * top), 1.0, 1.0], bars)


def polygon(count: int, **options: Any) -> tc.Structure:
    """A regular polygon of strings with its diameters as bars, kept in its plane."""
    k = np.arange(count)
    angle = 2 * np.pi * k / count
    nodes = np.stack([np.cos(angle), np.sin(angle), 0.0 * k], axis=1)
    bars = [(i, i + count // 2) for i in range(count // 2)]
    pins = {int(i): "z" for i in k}
    return tc.Structure(nodes, bars, np.c_[k, (k + 1) % count], pinned=pins, **options)

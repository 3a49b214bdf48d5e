"""Cutting strings into segments, with the string's mass on the nodes (Sect. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.util.validate import Array, Indices, finite_array, nonnegative, whole_number


class Cut(NamedTuple):
    """Segments in the order of their strings; nodes ≥ n are the new ones."""

    points: Array  # (new nodes, 3)
    strings: Indices  # (segments, 2)
    parent: Indices  # (segments,) the string it was cut from
    fraction: Array  # (segments,) its share of that string's length
    node_mass: Array  # (n + new nodes,) the strings' mass


def split_strings(
    nodes: Array, strings: Indices, mass: Array, segments: int | Sequence[int] | Indices, lumped: bool, fractions: ArrayLike | None
) -> Cut:
    """Cuts `strings` (α, 2) of `nodes` (n, 3); `Structure.subdivide` says how. Raises TypeError, ValueError."""
    counts = _counts(segments, len(strings))
    shares = [_shares(count, fractions) for count in counts]
    points: list[Array] = []
    pairs: list[Indices] = []
    masses = [np.zeros(len(nodes))]
    new = len(nodes)
    for (a, b), count, share, m in zip(strings, counts, shares, mass, strict=True):
        inner = np.cumsum(share)[:-1, None]
        points.append((1.0 - inner) * nodes[a] + inner * nodes[b])
        path = np.concatenate([[a], np.arange(new, new + count - 1), [b]])
        pairs.append(np.column_stack([path[:-1], path[1:]]))
        new += count - 1
        if lumped:
            masses.append(0.5 * m * (share[:-1] + share[1:]))
            masses[0][a] += 0.5 * m * share[0]
            masses[0][b] += 0.5 * m * share[-1]
        else:
            masses.append(np.full(count - 1, m / max(count - 1, 1)))
    return Cut(
        points=np.concatenate([np.zeros((0, 3)), *points]),
        strings=np.concatenate([np.zeros((0, 2), dtype=np.intp), *pairs]),
        parent=np.repeat(np.arange(len(strings)), counts),
        fraction=np.concatenate([np.zeros(0), *shares]),
        node_mass=np.concatenate(masses),
    )


def _counts(segments: int | Sequence[int] | Indices, strings: int) -> list[int]:
    if not isinstance(segments, (Sequence, np.ndarray)):
        return [whole_number("segments", segments, 1)] * strings
    counts = list(segments)
    if len(counts) != strings:
        raise ValueError(f"segments has {len(counts)} entries: give one number, or one for each of {strings} strings")
    return [whole_number(f"segments[{i}]", count, 1) for i, count in enumerate(counts)]


def _shares(count: int, fractions: ArrayLike | None) -> Array:
    if fractions is None:
        return np.full(count, 1.0 / count)
    shares = nonnegative("fractions", finite_array("fractions", fractions, (count,)), "segment", strict=True)
    if abs(shares.sum() - 1.0) > 1e-12:
        raise ValueError(f"fractions sum to {shares.sum():.15g}: they must sum to 1")
    return shares

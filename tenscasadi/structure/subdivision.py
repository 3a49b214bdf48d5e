"""Subdivision of strings into segments with mass (Sect. 5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.util.validate import Array, Indices, finite_array, listed, nonnegative, whole_number

LARGEST_COUNT = 200_000  # segments of all strings


def cut_strings(
    nodes: Array, strings: Indices, string_mass: Array, shares: list[Array], lumped: bool
) -> tuple[Array, Indices, Array]:
    """Divide strings into segments with the given fractions.

    Returns all nodes (m, 3), the node pairs of segments, and the string mass (m,) of each node.
    """
    places, pairs, masses = [nodes], [np.zeros((0, 2), dtype=np.intp)], [np.zeros(len(nodes))]
    new = len(nodes)
    for (a, b), share, m in zip(strings, shares, string_mass, strict=True):
        inner = np.cumsum(share)[:-1, None]
        places.append((1.0 - inner) * nodes[a] + inner * nodes[b])
        path = np.concatenate([[a], new + np.arange(len(inner)), [b]])
        pairs.append(np.column_stack([path[:-1], path[1:]]))
        new += len(inner)
        if lumped:
            masses.append(0.5 * m * (share[:-1] + share[1:]))
            masses[0][a] += 0.5 * m * share[0]
            masses[0][b] += 0.5 * m * share[-1]
        else:
            masses.append(np.full(len(inner), m / max(len(inner), 1)))
    return np.concatenate(places), np.concatenate(pairs), np.concatenate(masses)


def segment_counts(segments: int | Sequence[int] | Indices, strings: int) -> list[int]:
    """Read the number of segments per string. Raises TypeError, ValueError."""
    if not isinstance(segments, (Sequence, np.ndarray)):
        most = max(LARGEST_COUNT // max(strings, 1), 1)
        return [whole_number("segments", segments, 1, most)] * strings
    counts = listed("segments", segments, "[2, 2, 1]")
    if len(counts) != strings:
        raise ValueError(
            f"segments has {len(counts)} entries: give one number, or one for each of {strings} strings"
        )
    found = [
        whole_number(f"segments[{i}]", count, 1, LARGEST_COUNT) for i, count in enumerate(counts)
    ]
    if sum(found) > max(LARGEST_COUNT, strings):
        raise ValueError(f"segments sum to {sum(found)}: give at most {LARGEST_COUNT} in all")
    return found


def segment_shares(count: int, fractions: ArrayLike | None) -> Array:
    """Read the length fractions of segments. Raises TypeError, ValueError.

    They are equal unless `fractions` are given.
    """
    if fractions is None:
        return np.full(count, 1.0 / count)
    shares = nonnegative(
        "fractions", finite_array("fractions", fractions, (count,)), "segment", strict=True
    )
    if abs(shares.sum() - 1.0) > 1e-12:
        raise ValueError(f"fractions sum to {shares.sum():.15g}: they must sum to 1")
    return shares

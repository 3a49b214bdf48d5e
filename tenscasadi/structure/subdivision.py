"""Subdivision of strings into segments with mass (Sect. 5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from tenscasadi.structure.class_one import extend_layout
from tenscasadi.structure.names import extend_names, name_errors, name_segments
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    MAX_COUNT,
    Array,
    Indices,
    as_tuple,
    choice,
    finite_array,
    nonnegative,
    whole_number,
)

ENDS = ("interior", "lumped", "consistent")


class Division(NamedTuple):
    """Fields of a structure that change when strings are divided.

    `fields` are keywords of `Structure` by name, and `derived` other attributes by name.
    """

    fields: dict[str, Any]
    derived: dict[str, Any]


@name_errors
def divide_strings(structure: Any, segments: Any, ends: Any, fractions: Any) -> Division | None:
    """Divide strings into segments, see `Structure.subdivide`.

    Parameters
    ----------
    structure : Structure
        The structure.
    segments : int or sequence of int, shape (α,)
        Number of segments of each string.
    ends : {"interior", "lumped", "consistent"}
        Distribution of the mass of a string.
    fractions : array_like, shape (segments,), or None
        Fractions of each string's length.

    Returns
    -------
    Division or None
        Changes, or None if there are none.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong or a subdivided string has no mass.
    """
    choice("ends", ends, *ENDS)
    s = structure
    counts = segment_counts(segments, len(s.strings))
    shares = [segment_shares(count, fractions) for count in counts]
    parent = np.repeat(np.arange(len(counts)), counts)
    share = np.concatenate([np.zeros(0), *shares])
    if len(parent) == len(s.strings) and not s.string_mass.any():
        return None
    for string in (string for cable in s.cables for string in cable if counts[string] > 1):
        raise ValueError(
            f"segments of string {string} is {counts[string]}: give 1, because a cable slides"
        )
    for i in np.flatnonzero((np.array(counts) > 1) & (s.string_mass == 0.0)):
        raise add_address(
            ValueError(
                f"string_mass of string {i} is 0: give a mass, which the nodes between segments need"
            )
        )
    nodes, strings, spread = cut_strings(s.nodes, s.strings, shares, ends != "interior")
    fields = {
        "nodes": nodes,
        "strings": strings,
        "node_mass": spread @ s.string_mass + np.pad(s.node_mass, (0, len(nodes) - len(s.nodes))),
        "node_names": extend_names(s.node_names, len(nodes)),
        "string_names": name_segments(s.string_names, counts),
        "stiffness": s.stiffness[parent] / share,
        "damping": s.damping[parent] / share,
        "rest_length": s.rest_length[parent] * share,
        "string_mass": 0.0,
        "cables": [np.searchsorted(parent, cable) for cable in s.cables],
    }
    derived = {
        "_layout": extend_layout(s._layout, len(s.nodes), strings, parent),
        "string_parent": s.string_parent[parent],
        "string_fraction": s.string_fraction[parent] * share,
        "coupled_mass": s.coupled_mass[parent] * (share == 1.0),
    }
    if ends == "consistent":
        derived["coupled_mass"] = derived["coupled_mass"] + s.string_mass[parent] * share
    return Division(fields, derived)


def average_segments(values: Array, parent: Indices, fraction: Array) -> Array:
    """Average values (..., α) of segments over each parent string.

    `parent` (α,) is the parent string of each segment, and `fraction` (α,) its part of the parent's
    length, which is its weight. The result is (..., parents).
    """
    weight = np.zeros((len(parent), int(parent.max(initial=-1)) + 1))
    weight[np.arange(len(parent)), parent] = fraction
    return np.asarray(values @ (weight / weight.sum(axis=0)))


def cut_strings(
    nodes: Array, strings: Indices, fractions: Sequence[Array], lumped: bool
) -> tuple[Array, Indices, csr_array]:
    """Divide strings into segments of given fractions.

    Parameters
    ----------
    nodes : ndarray, shape (n, 3)
        Positions [m].
    strings : ndarray of int, shape (α, 2)
        End nodes of the strings.
    fractions : sequence of ndarray
        Lengths of the segments of each string, as fractions of its length.
    lumped : bool
        Whether half of each segment's mass is lumped at each of its ends. Otherwise the mass is on
        the inner nodes.

    Returns
    -------
    tuple
        Nodes (m, 3), node pairs of the segments, and the fraction (m, α) of each string's mass on
        each node.
    """
    counts = np.array([len(own) for own in fractions], dtype=np.intp)
    parent, fraction = np.repeat(np.arange(len(counts)), counts), np.concatenate([[], *fractions])
    along = np.concatenate([[], *map(np.cumsum, fractions)])[:, None]
    first, second = strings[parent].T
    inner = np.diff(parent, append=-1) == 0  # segments that end inside their string
    total = len(nodes) + int(inner.sum())
    ends = second.copy()
    ends[inner] = np.arange(len(nodes), total)
    starts = np.where(np.roll(inner, 1), np.roll(ends, 1), first)
    between = ((1.0 - along) * nodes[first] + along * nodes[second])[inner]
    if lumped:
        rows, columns = np.append(starts, ends), np.append(parent, parent)
        shares = 0.5 * np.append(fraction, fraction)
    else:
        rows, columns = ends[inner], parent[inner]
        shares = 1.0 / (counts[columns] - 1)
    spread = csr_array((shares, (rows, columns)), shape=(total, len(strings)))
    return np.concatenate([nodes, between]), np.column_stack([starts, ends]), spread


def segment_counts(segments: int | Sequence[int] | Indices, strings: int) -> list[int]:
    """Read the number of segments of each string.

    Raises TypeError or ValueError. `segments` is one number for all strings, or one for each;
    `strings` is the number of strings.
    """
    if not isinstance(segments, (Sequence, np.ndarray)):
        most = max(MAX_COUNT // max(strings, 1), 1)
        return [whole_number("segments", segments, 1, most)] * strings
    counts = as_tuple("segments", segments, "[2, 2, 1]")
    if len(counts) != strings:
        raise ValueError(
            f"segments has {len(counts)} entries: give one number, or one for each of "
            f"{strings} strings"
        )
    found = [whole_number(f"segments[{i}]", count, 1, MAX_COUNT) for i, count in enumerate(counts)]
    if sum(found) > max(MAX_COUNT, strings):
        raise ValueError(f"segments sum to {sum(found)}: give at most {MAX_COUNT} in all")
    return found


def segment_shares(count: int, fractions: ArrayLike | None) -> Array:
    """Read segment lengths as fractions of a string, equal by default.

    The string has `count` segments. Raises TypeError or ValueError.
    """
    if fractions is None:
        return np.full(count, 1.0 / count)
    shares = nonnegative(
        "fractions", finite_array("fractions", fractions, (count,)), "segment", strict=True
    )
    if abs(shares.sum() - 1.0) > 1e-12:
        raise ValueError(f"fractions sum to {shares.sum():.15g}: they must sum to 1")
    return shares

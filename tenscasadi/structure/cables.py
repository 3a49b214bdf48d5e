"""Cables: strings that slide over nodes with one tension."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
import scipy.sparse as sp

from tenscasadi.util.validate import (
    Array,
    Indices,
    as_tuple,
    node_index,
    nonnegative,
    per_item,
)

Cables = tuple[tuple[int, ...], ...]  # strings of each cable, in order


def read_cables(given: Any, friction: Any, strings: Indices, damping: Array) -> dict[str, Any]:
    """Read the cables of a structure.

    Parameters
    ----------
    given : sequence of sequences of int
        Strings of each cable, in order.
    friction : array_like, shape (cables,)
        Coefficient of friction of each cable.
    strings : ndarray of int, shape (α, 2)
        End nodes of the strings.
    damping : ndarray, shape (α,)
        Damping of the strings [N·s/m].

    Returns
    -------
    dict of str to object
        Attributes of `Structure`: `cables`, `cable_friction` and `cable_of`.

    Raises
    ------
    TypeError, ValueError
        If the strings of a cable do not meet end to end, or a string is in two cables.
    """
    rows = as_tuple("cables", given, "[[0, 1, 2]]")
    cables = tuple(_read_cable(f"cables[{k}]", row, len(strings)) for k, row in enumerate(rows))
    owner: dict[int, int] = {}
    for k, cable in enumerate(cables):
        for string in cable:
            if owner.setdefault(string, k) != k or cable.count(string) > 1:
                raise ValueError(
                    f"cables[{k}] has string {string}, which is in cables[{owner[string]}] already: "
                    "give each string once"
                )
        find_directions(strings, cable, f"cables[{k}]")
        damped = damping[list(cable)] > 0
        if damped.any() and not damped.all():
            raise ValueError(
                f"damping of string {cable[int(np.argmin(damped))]} is 0: "
                f"give damping to all strings of cables[{k}], or to none"
            )
    coefficients = nonnegative(
        "cable_friction", per_item("cable_friction", friction, len(cables)), "cable"
    )
    return {
        "cables": cables,
        "cable_friction": coefficients,
        "cable_of": _number_inputs(cables, len(strings)),
    }


def find_directions(
    strings: Indices, cable: Sequence[int], field: str = "cables"
) -> list[tuple[int, int]]:
    """Find start and end node of each string along a cable.

    `strings` (α, 2) are the end nodes of all strings, and `cable` the indices of its strings in
    order. Raises ValueError, naming `field`, if the strings do not meet end to end.
    """
    first, *others = cable
    a, b = strings[first].tolist()
    for start, end in ((a, b), (b, a)):
        path = [(start, end)]
        for string in others:
            ends = strings[string].tolist()
            if path[-1][1] not in ends:
                break
            path.append((ends[0], ends[1]) if ends[0] == path[-1][1] else (ends[1], ends[0]))
        if len(path) == len(cable):
            return path
    raise ValueError(
        f"{field} is {list(cable)}: give strings that meet end to end, in order, "
        f"because {_describe(strings, cable)}"
    )


def wrap_angles(structure: Any, cable: Sequence[int], nodes: Array | None = None) -> Array:
    """Compute the angles (q − 1,) by which a cable turns at nodes [rad].

    `nodes` (n, 3) [m] replace those of the structure.
    """
    places = structure.nodes if nodes is None else nodes
    path = np.array(find_directions(structure.strings, cable))
    vectors = places[path[:, 1]] - places[path[:, 0]]
    across = np.linalg.norm(np.cross(vectors[:-1], vectors[1:]), axis=1)
    along = np.einsum("ij,ij->i", vectors[:-1], vectors[1:])
    return np.asarray(np.arctan2(across, along))


def name_inputs(structure: Any) -> list[str]:
    """Name the control inputs, such as "cable 0" and "string 3".

    They belong to cables, and to strings in no cable.
    """
    names = [f"string {string}" for string in select_first(structure.cable_of)]
    for k, cable in enumerate(structure.cables):
        names[structure.cable_of[cable[0]]] = f"cable {k}"
    return names


def select_first(cable_of: Indices) -> Indices:
    """Select the first string of each control input.

    Inputs belong to cables, and to strings in no cable. `cable_of` (α,) is the input of each
    string. Returns string indices (inputs,).
    """
    return np.unique(cable_of, return_index=True)[1].astype(np.intp)


def add_compliances(cable_of: Indices, stiffness: Array) -> Array:
    """Compute the stiffness (m,) of each cable [N/m].

    The strings of a cable, with `stiffness` (α,), are springs in series. `cable_of` (α,) is the
    cable of each string; a string in no cable counts as one.
    """
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.bincount(cable_of, weights=1 / stiffness))


def find_units(structure: Any) -> Indices:
    """Assign the number of its cable or bar to each member (α + β,).

    Cables and strings in no cable come first, as in `Structure.cable_of`, then the bars.
    """
    inputs = int(structure.cable_of.max(initial=-1)) + 1
    return np.append(structure.cable_of, inputs + np.arange(len(structure.bars)))


def pair_strings(cables: Cables) -> Indices:
    """List all pairs (k, 2) of strings that belong to one cable.

    `cables` has the string indices of each cable.
    """
    pairs = [pair for cable in cables for pair in combinations(cable, 2)]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def density_basis(structure: Any) -> Any:
    """Build the force densities of a unit tension in each cable or bar.

    Returns
    -------
    csc_array, shape (α + β, m + β)
        Orthonormal columns, one for each cable and each string in no cable, then for each bar. The strings of a
        cable have one tension without friction, so that their force densities are inverse to their
        lengths.
    """
    alpha, bars = len(structure.strings), len(structure.bars)
    columns = find_units(structure)
    values = np.ones(alpha + bars)
    for cable in structure.cables:
        own = 1.0 / structure.string_lengths[list(cable)]
        values[list(cable)] = own / np.linalg.norm(own)
    shape = (alpha + bars, int(columns.max(initial=-1)) + 1)
    return sp.csc_array((values, (np.arange(alpha + bars), columns)), shape=shape)


def reject_cables(structure: Any, user: str) -> None:
    """Raise ValueError if a structure has cables.

    `user` names the function that does not support them.
    """
    if structure.cables:
        raise ValueError(
            f"Structure.cables has {len(structure.cables)} cables, which {user} does not take: "
            "give structure.replace(cables=(), cable_friction=0.0)"
        )


def reject_cable_friction(structure: Any, user: str) -> None:
    """Raise ValueError if a cable has friction.

    `user` names the function that does not support it.
    """
    for cable in np.flatnonzero(structure.cable_friction):
        raise ValueError(
            f"cable_friction of cable {cable} is {structure.cable_friction[cable]:g}, which {user} "
            "does not take: give structure.replace(cable_friction=0.0)"
        )


def _read_cable(field: str, given: Any, count: int) -> tuple[int, ...]:
    entries = as_tuple(field, given, "[0, 1, 2]")
    if not entries:
        raise ValueError(f"{field} is empty: give its strings, or remove it")
    return tuple(
        node_index(f"{field}[{k}]", entry, count, "string") for k, entry in enumerate(entries)
    )


def _number_inputs(cables: Cables, count: int) -> Indices:
    """Assign the number of its control input to each string (count,).

    Each of the `cables` is the list of its strings and has one input; other strings have one each.
    Inputs are in the order of their first strings.
    """
    first = np.arange(count)
    for cable in cables:
        first[list(cable)] = cable[0]
    return np.unique(first, return_inverse=True)[1].astype(np.intp).reshape(count)


def _describe(strings: Indices, cable: Sequence[int]) -> str:
    parts = [f"string {k} joins nodes {strings[k, 0]} and {strings[k, 1]}" for k in cable]
    return ", ".join(parts[:4]) + (" …" if len(parts) > 4 else "")

"""Conversion of TsgFEM's variables to those of MOTES."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.sparse import issparse

from tenscasadi.exchange.matlab.variables import (
    Variables,
    is_filled,
    pad_rows,
    read_indices,
    read_pairs,
    read_values,
)
from tenscasadi.exchange.source import Source
from tenscasadi.structure.class_one import distances
from tenscasadi.util.validate import Array, Indices, finite_array

# variables of MOTES: keyword of Structure, and the variables of TsgFEM from which it follows
_BARS: dict[str, tuple[str, tuple[str, ...], Callable[..., Array]]] = {
    "m": ("bar_mass", ("mass",), lambda mass: mass),
    "bar_stiffness": ("bar_stiffness", ("E", "A", "l0"), lambda E, A, l0: E * A / l0),
    "bar_rest_length": ("bar_rest_length", ("l0",), lambda l0: l0),
}
_STRINGS: dict[str, tuple[str, tuple[str, ...], Callable[..., Array]]] = {
    "s_0": ("rest_length", ("l0",), lambda l0: l0),
    "k": ("stiffness", ("E", "A", "l0"), lambda E, A, l0: E * A / l0),
    "string_mass": ("string_mass", ("mass",), lambda mass: mass),
}
VARIABLES = ("C", "S", "index_b", "index_s", "E", "A", "l0", "l0_t", "t", "q", "mass", "D")


def is_tsgfem(variables: Variables) -> bool:
    """Return whether TsgFEM has written the variables."""
    return "index_s" in variables and "s_0" not in variables


def convert_tsgfem(source: Source, variables: Variables, options: Variables) -> dict[str, Any]:
    """Convert the variables of TsgFEM into those of MOTES.

    Members are the rows of C. Matrix S, if given, groups strings into cables that slide over
    nodes. Values that `options` give are not needed. Raises TypeError, ValueError.
    """
    N = finite_array("N", variables["N"], (3, None))
    keys = ("C",) if "C" in variables else ("C_b", "C_s")
    given = [read_pairs(key, variables[key], N.shape[1]) for key in keys if key in variables]
    pairs = np.concatenate(given)
    cable = _read_cables(variables, len(pairs))
    lengths = distances(N.T, pairs)
    converted = {"node_mass": np.zeros(1), **variables}
    known, variables = 0, _add_rest_lengths(variables, lengths)
    for index, key, table in (("index_b", "C_b", _BARS), ("index_s", "C_s", _STRINGS)):
        rows = read_indices(index, variables.get(index, np.zeros(0)), max(cable, default=-1) + 1)
        members = np.flatnonzero(np.isin(cable, rows))
        converted[key] = pairs[members] + 1.0
        known += len(members)
        if key == "C_b" and len(np.unique(cable[members])) < len(members):
            message = "S groups bars, which cannot slide over nodes"
            source.leave_out(ValueError(f"{message}: each becomes a bar of its own"))
        for name, (keyword, needed, formula) in table.items():
            if keyword not in options:
                values = [
                    _read_members(source, variables, key, keyword, cable, lengths) for key in needed
                ]
                converted[name] = formula(*values)[members]
    if "cables" not in options:
        cables = _order_cables(source, pairs, cable[members], members)
        converted["cable_strings"] = pad_rows(cables)
    if known != len(pairs):
        message = f"C holds {len(pairs)} members, index_b and index_s {known} of them"
        source.leave_out(ValueError(f"{message}: give each member once"))
    if "damping" not in options and is_filled(variables, "D"):
        message = "D is not 0: damping of nodes, as TsgFEM has it, cannot be modeled"
        source.leave_out(ValueError(f"{message}; give damping of strings, such as damping=0.0"))
    return converted


def _read_cables(variables: Variables, count: int) -> Indices:
    """Read the cable of each member from the matrix S.

    A cable is a row of S. The result (count,) has the row of each member.
    """
    S: Any = variables.get("S")
    S = S.toarray() if issparse(S) and np.prod(S.shape) <= count**2 else S
    if (
        not isinstance(S, np.ndarray)
        or S.ndim != 2
        or S.shape[1] != count
        or not np.isin(S, (0, 1)).all()
        or (S.sum(axis=0) != 1).any()
    ):  # without cables, or modes of prestress, which are called S too
        return np.arange(count)
    return np.asarray(np.argmax(S, axis=0))


def _order_cables(
    source: Source, pairs: Indices, cable: Indices, strings: Indices
) -> list[list[int]]:
    """Order the strings of each cable from end to end.

    Strings (α,) are rows of `pairs`, and `cable` (α,) numbers their cables. Strings that form no
    path remain separate. Raises ValueError if the import is strict.
    """
    found = []
    for own in (np.flatnonzero(cable == row) for row in np.unique(cable)):
        if len(own) == 1:
            continue
        nodes, left, ordered = pairs[strings[own]], list(range(len(own))), []
        ends, meeting = np.unique(nodes, return_counts=True)
        tip = ends[np.argmin(meeting)]  # any node of a closed cable
        while following := [k for k in left if tip in nodes[k]]:
            ordered.append(following[0])
            left.remove(following[0])
            tip = nodes[following[0]].sum() - tip
        if left:
            names = ", ".join(f"{member + 1}" for member in strings[own])
            message = f"S groups the members {names}, which do not meet end to end"
            source.leave_out(ValueError(f"{message}: each becomes a string of its own"))
        else:
            found.append(own[ordered].tolist())
    return found


def _add_rest_lengths(variables: Variables, lengths: Array) -> Variables:
    """Add the rest lengths l0 of members (m,) if they are missing.

    They are the first ones of l0_t, or E A l/(E A + t) for the forces t, or t = q l. `lengths` (m,)
    are the lengths l [m].
    """
    if "l0" in variables:
        return variables
    if isinstance(variables.get("l0_t"), np.ndarray):
        return {**variables, "l0": variables["l0_t"].reshape(len(variables["l0_t"]), -1)[:, 0]}
    given = {key: np.ravel(variables[key]) for key in ("E", "A", "t", "q") if key in variables}
    if any(values.shape != lengths.shape for values in given.values()):
        return variables
    force = given.get("t", given["q"] * lengths if "q" in given else None)
    if force is None or not {"E", "A"} <= given.keys():
        return variables
    rigidity = given["E"] * given["A"]
    with np.errstate(all="ignore"):  # readers check the values
        return {**variables, "l0": rigidity * lengths / (rigidity + force)}


def _read_members(
    source: Source, variables: Variables, key: str, keyword: str, cable: Indices, lengths: Array
) -> Array:
    """Read one positive number for each member, or for each cable.

    `key` is the name of the variable in the file, and `keyword` that of the option that replaces
    it. `cable` (m,) is the cable of each member. Rest length and mass of a cable are distributed by
    length. Raises TypeError, ValueError.
    """
    if key not in variables:
        cure = f"give {keyword}=..., or save {key} too"
        raise ValueError(f"{key} is missing, from which {keyword} follows: {cure}")
    count, members = max(cable, default=-1) + 1, len(cable)
    if np.size(variables[key]) == count != members:
        values = read_values(source, variables, key, count)[cable]
        if key in ("l0", "mass"):
            values = values * lengths / np.bincount(cable, lengths)[cable]
    else:
        values = read_values(source, variables, key, members)
    for member in np.flatnonzero(values <= 0)[:1]:
        message = f"{key} of member {member + 1} is {values[member]:g}: it must be greater than 0"
        raise ValueError(message)
    return values

"""Validation of the properties of nodes, bars and strings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.util.validate import (
    SMALLEST,
    TOLERANCE,
    Array,
    IndexOrName,
    finite_array,
    format_value,
    nesting,
    nonnegative,
    per_item,
    real_array,
)

NodalLoads = ArrayLike | Mapping[IndexOrName, ArrayLike]  # of all nodes, or of some

MAX_THICKNESS = TOLERANCE**-0.5  # radius / length of a bar; above, M loses more than six digits

_ITEMS = {
    **dict.fromkeys(("bar_mass", "bar_radius"), "bar"),
    "node_mass": "node",
    **dict.fromkeys(("stiffness", "damping", "rest_length", "string_mass"), "string"),
}
_POSITIVE = ("bar_mass", "rest_length")


def read_properties(
    given: Mapping[str, Any], nodes: int, bar_lengths: Array, string_lengths: Array
) -> dict[str, Array]:
    """Read the masses, stiffnesses and other numbers of a structure.

    Parameters
    ----------
    given : mapping of str to array_like
        Keywords of `Structure` by name.
    nodes : int
        Number of nodes.
    bar_lengths, string_lengths : ndarray, shape (β,) and (α,)
        Lengths of the members [m].

    Returns
    -------
    dict of str to ndarray
        Attributes of `Structure`, with the inertia J of bars.

    Raises
    ------
    TypeError, ValueError
        If one of them is wrong.
    """
    counts = {"node": nodes, "bar": len(bar_lengths), "string": len(string_lengths)}
    found = {}
    for name, item in _ITEMS.items():
        value = given[name]
        if name == "rest_length" and value is None:
            value = string_lengths
        array = per_item(name, value, counts[item])
        found[name] = nonnegative(name, array, item, strict=name in _POSITIVE)
    found |= _read_elastic_bars(given["bar_stiffness"], given["bar_rest_length"], bar_lengths)
    slenderness = found["bar_radius"] / bar_lengths
    for i in np.flatnonzero(slenderness > MAX_THICKNESS):
        most = f"{MAX_THICKNESS:g} times its length, {bar_lengths[i]:g} m"
        raise ValueError(
            f"bar_radius of bar {i} is {found['bar_radius'][i]:g} m: it must be at most {most}"
        )
    found["bar_inertia"] = found["bar_mass"] * (1.0 / 12.0 + slenderness**2 / 4.0)  # Eq. 19
    return found


def _read_elastic_bars(stiffness: Any, rest_length: Any, lengths: Array) -> dict[str, Any]:
    """Read the properties of elastic bars.

    A bar of `stiffness` inf or None [N/m] is rigid. A `rest_length` NaN or None is the length of
    the bar, see `lengths` (β,) [m]. Returns attributes of `Structure` by name. Raises TypeError or
    ValueError.
    """
    k = _read_entries("bar_stiffness", stiffness, len(lengths), np.inf)
    for bar in np.flatnonzero(~(k >= SMALLEST)):
        raise ValueError(
            f"bar_stiffness of bar {bar} is {k[bar]:g} N/m: "
            "give a number greater than 0, or inf for a rigid bar"
        )
    elastic = np.isfinite(k)
    finite_array("bar_stiffness", np.where(elastic, k, 0.0), lengths.shape)  # none is too large
    rest = _read_entries("bar_rest_length", rest_length, len(lengths), np.nan)
    rest = finite_array(
        "bar_rest_length", np.where(elastic & ~np.isnan(rest), rest, lengths), lengths.shape
    )
    nonnegative("bar_rest_length", rest, "bar", strict=True)
    return {"bar_stiffness": k, "bar_rest_length": rest, "elastic": elastic}


def _read_entries(field: str, given: Any, count: int, absent: float) -> Array:
    """Read one number for each bar, `absent` for None.

    `given` is one number for all, or one for each of the `count` bars. Messages name `field`.
    """
    if given is None:
        return np.full(count, absent)
    if not nesting(given):
        value = np.asarray(real_array(field, given, "one number"), dtype=float)
        return np.full(count, value)
    entries: Any = given
    if isinstance(given, (list, tuple)):
        entries = [absent if entry is None else entry for entry in given]
    values = real_array(field, entries, f"an array of shape ({count},)")
    if values.shape != (count,):
        raise ValueError(f"{field} has shape {values.shape}: give an array of shape ({count},)")
    if np.isnan(values).any() and not np.isnan(absent):
        raise ValueError(
            f"{field} is {format_value(given)}: give numbers, inf or None for rigid bars"
        )
    return values


def read_loads(field: str, loads: NodalLoads, structure: Any) -> Array:
    """Read forces on the nodes of a structure.

    Parameters
    ----------
    field : str
        Name in messages.
    loads : array_like, shape (n, 3), or mapping of int or str to array_like, shape (3,)
        Forces of all nodes, or of some by name or index [N].
    structure : Structure
        The structure.

    Returns
    -------
    ndarray, shape (n, 3)
        Forces [N].

    Raises
    ------
    TypeError, ValueError
        If a force or a node is wrong.
    """
    return finite_array(field, structure.names.place_rows(field, loads), structure.nodes.shape)

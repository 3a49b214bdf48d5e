"""Input of the properties of nodes, bars and strings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tenscasadi.structure.elastic_bars import read_elastic_bars
from tenscasadi.util.validate import TOLERANCE, Array, nonnegative, per_item

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
    """Read the numbers of nodes, bars and strings.

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
    found |= read_elastic_bars(given["bar_stiffness"], given["bar_rest_length"], bar_lengths)
    slenderness = found["bar_radius"] / bar_lengths
    for i in np.flatnonzero(slenderness > MAX_THICKNESS):
        most = f"{MAX_THICKNESS:g} times its length, {bar_lengths[i]:g} m"
        raise ValueError(
            f"bar_radius of bar {i} is {found['bar_radius'][i]:g} m: it must be at most {most}"
        )
    found["bar_inertia"] = found["bar_mass"] * (1.0 / 12.0 + slenderness**2 / 4.0)  # Eq. 19
    return found

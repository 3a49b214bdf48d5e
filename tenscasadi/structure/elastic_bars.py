"""Input of elastic bars: stiffness and rest lengths."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.util.validate import (
    SMALLEST,
    Array,
    finite_array,
    format_value,
    nesting,
    nonnegative,
    real_array,
)


def read_elastic_bars(stiffness: Any, rest_length: Any, lengths: Array) -> dict[str, Any]:
    """Read the properties of elastic bars.

    Parameters
    ----------
    stiffness : array_like, shape (β,), or None
        Stiffness of each bar [N/m]; inf or None for rigid bars.
    rest_length : array_like, shape (β,), or None
        Rest length of each elastic bar [m]; NaN or None for its length.
    lengths : ndarray, shape (β,)
        Lengths of the bars [m]. They are the rest lengths of rigid bars.

    Returns
    -------
    dict of str to ndarray
        Attributes of `Structure`: `bar_stiffness`, `bar_rest_length` and `elastic`.

    Raises
    ------
    TypeError, ValueError
        If one of them is wrong.
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
    """Read one number for each bar, `absent` for None."""
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

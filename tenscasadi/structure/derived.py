"""Results of `subdivide` and `from_matrices` as arrays, for files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from tenscasadi.structure.class_one import Layout
from tenscasadi.util.validate import Array, Indices, finite_array

_INDICES = ("physical", "bar_columns", "string_columns")
DERIVED = (
    *("string_parent", "string_fraction", "layout_mass_share", "layout_ties"),
    *(f"layout_{name}" for name in _INDICES),
)


def write_derived(structure: Any) -> dict[str, Array]:
    """Convert the derived attributes of a structure to arrays."""
    layout: Layout = structure._layout
    ties = layout.P.tocoo()
    return {
        "string_parent": structure.string_parent,
        "string_fraction": structure.string_fraction,
        "layout_mass_share": layout.mass_share,
        "layout_ties": np.column_stack([*ties.coords, ties.data]),
        **{f"layout_{name}": np.asarray(getattr(layout, name)) for name in _INDICES},
    }


def read_derived(given: Mapping[str, Any], structure: Any) -> dict[str, Any]:
    """Check derived attributes of a structure. Raises ValueError."""
    if missing := set(DERIVED) - given.keys():
        raise ValueError(f"Structure has no {min(missing)}, which its other fields need")
    columns = len(np.atleast_1d(given["layout_physical"]))
    bars, strings = len(structure.bars), len(structure.strings)
    shapes = {
        "layout_physical": ((columns,), len(structure.nodes)),
        "layout_bar_columns": ((bars, 2), columns),
        "layout_string_columns": ((strings, 2), columns),
        "string_parent": ((strings,), strings),
    }
    found = {name: _read_indices(name, given[name], *shapes[name]) for name in shapes}
    row, column, value = finite_array("layout_ties", given["layout_ties"], (None, 3)).T
    ties = (row.astype(np.intp), column.astype(np.intp))
    shape = (columns, int(column.max(initial=-1)) + 1)
    layout = Layout(
        mass_share=finite_array("layout_mass_share", given["layout_mass_share"], (columns,)),
        P=csr_array((value, ties), shape=shape),
        **{name: found.pop(f"layout_{name}") for name in _INDICES},
    )
    fraction = finite_array("string_fraction", given["string_fraction"], (strings,))
    return {**found, "string_fraction": fraction, "_layout": layout}


def _read_indices(name: str, value: Any, shape: tuple[int, ...], count: int) -> Indices:
    array = np.asarray(value)
    wrong = array.dtype.kind != "i" or array.shape != shape
    if wrong or np.any((array < 0) | (array >= count)):
        raise ValueError(f"{name} does not hold indices below {count} in the shape {shape}")
    return array

"""Attributes set by `subdivide` and `from_matrices`, as arrays for files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from tenscasadi.structure.class_one import Layout
from tenscasadi.util.validate import Array, Indices, finite_array

_INDICES = ("physical", "bar_columns", "string_columns")  # of a layout


def write_derived(structure: Any) -> dict[str, Array]:
    """Convert the derived attributes of a structure to arrays.

    They are those that `Structure.subdivide` and `Structure.from_matrices` set.
    """
    layout: Layout = structure._layout
    ties, coupled = layout.P.tocoo(), structure.coupled_mass
    found = {
        "string_parent": structure.string_parent,
        "string_fraction": structure.string_fraction,
        "coupled_mass": coupled if coupled.any() else coupled[:0],
        "mass_share": layout.mass_share,
        "ties": np.column_stack([*ties.coords, ties.data]),
        **{name: np.asarray(getattr(layout, name)) for name in _INDICES},
    }
    return {name: value for name, value in found.items() if value.size}


def read_derived(given: Mapping[str, Any], structure: Any) -> dict[str, Any]:
    """Read and check derived attributes of a structure.

    `given` has arrays by name, from `write_derived`. Empty attributes may be missing. Returns the
    attributes by name. Raises ValueError.
    """
    columns = len(np.atleast_1d(given.get("physical", ())))
    bars, strings = len(structure.bars), len(structure.strings)
    shapes = {
        "physical": ((columns,), len(structure.nodes)),
        "bar_columns": ((bars, 2), columns),
        "string_columns": ((strings, 2), columns),
        "string_parent": ((strings,), strings),
    }
    found = {name: _read_indices(name, given.get(name, ()), *shapes[name]) for name in shapes}
    rows = finite_array("derived.ties", given.get("ties", np.zeros((0, 3))), (None, 3))
    row, column, value = rows.T
    ties = (row.astype(np.intp), column.astype(np.intp))
    shape = (columns, int(column.max(initial=-1)) + 1)
    layout = Layout(
        mass_share=finite_array("derived.mass_share", given.get("mass_share", ()), (columns,)),
        P=csr_array((value, ties), shape=shape),
        **{name: found.pop(name) for name in _INDICES},
    )
    fraction, coupled = (
        finite_array(f"derived.{name}", given.get(name, default), (strings,))
        for name, default in (("string_fraction", ()), ("coupled_mass", np.zeros(strings)))
    )
    return {**found, "string_fraction": fraction, "coupled_mass": coupled, "_layout": layout}


def _read_indices(name: str, value: Any, shape: tuple[int, ...], count: int) -> Indices:
    array = np.asarray(value)
    wrong = array.size and (array.dtype.kind != "i" or array.shape != shape)
    if wrong or np.any((array < 0) | (array >= count)) or array.size != np.prod(shape):
        raise ValueError(f"derived.{name} is wrong: give indices below {count} of shape {shape}")
    return array.reshape(shape).astype(np.intp)

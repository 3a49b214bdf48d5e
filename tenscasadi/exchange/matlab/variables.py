"""Conversion of MATLAB arrays: values, indices, and pairs of nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.sparse import issparse

from tenscasadi.exchange.source import Source
from tenscasadi.util.validate import Array, Indices, finite_array, format_value

Variables = Mapping[str, Any]


def read_values(source: Source, variables: Variables, key: str, count: int) -> Array:
    """Read one number per item, or one for all.

    They are the variable `key`. The result is (count,). Of a matrix with a column for each time,
    only the first column is read. Raises TypeError, ValueError.
    """
    value = variables[key]
    cure = f"give {count} numbers or one"
    if not isinstance(value, np.ndarray):
        kind = f"a text, {value!r}, which is not run" if isinstance(value, str) else "no array"
        raise ValueError(f"{key} is {kind}: {cure}")
    if value.ndim == 2 and value.shape[0] == count and value.shape[1] > 1:
        message = f"{key} has shape {value.shape}: values over time are a control, give constants"
        source.leave_out(ValueError(message))
        value = value[:, 0]
    numbers = finite_array(key, value.ravel(), (None,))
    if len(numbers) not in (1, count):
        raise ValueError(f"{key} has shape {value.shape}: {cure}")
    return np.asarray(np.broadcast_to(numbers, (count,)))


def read_indices(key: str, value: Any, count: int) -> Indices:
    """Convert MATLAB indices from 1 to `count` to zero-based ones.

    `key` is the variable's name for messages. Raises ValueError.
    """
    if not isinstance(value, np.ndarray):
        raise ValueError(f"{key} is {format_value(value)}: give numbers from 1 to {count}")
    numbers = np.asarray(value, dtype=float).ravel()
    for wrong in numbers[~((numbers >= 1) & (numbers <= count) & (numbers % 1 == 0))][:1]:
        raise ValueError(f"{key} holds {wrong:g}: give whole numbers from 1 to {count}")
    return numbers.astype(np.intp) - 1


def read_pairs(key: str, value: Any, count: int) -> Indices:
    """Convert a connectivity matrix or list to zero-based node pairs.

    The result is (k, 2). `key` is the variable's name for messages, and `count` the number of
    nodes. A list counts from 1. Raises TypeError, ValueError.
    """
    if isinstance(value, np.ndarray) and value.size == 0:
        return np.zeros((0, 2), dtype=np.intp)
    if issparse(value):
        whole = value.tocoo()
        rows, columns, entries = whole.row, whole.col, np.asarray(whole.data, dtype=float)
    else:
        value = finite_array(key, value, (None, None))
        if value.shape[1] == 2 and value.min() >= 1.0:  # a matrix has a −1 in each row
            return read_indices(key, value, count).reshape(-1, 2)
        rows, columns = np.nonzero(value)
        entries = value[rows, columns]
    cure = "or pairs of nodes that count from 1"
    if value.shape[1] != count:
        message = f"{key} has shape {tuple(value.shape)}: give a column for each of the {count} nodes of N"
        raise ValueError(f"{message}, {cure}")
    order = np.lexsort((entries, rows))
    members = value.shape[0]
    if not np.array_equal(rows[order], np.repeat(np.arange(members), 2)) or not np.array_equal(
        entries[order], np.tile([-1.0, 1.0], members)
    ):
        message = f"{key} has a row other than zeros with one −1 and one +1: give that"
        raise ValueError(f"{message}, {cure}")
    return np.asarray(columns[order].astype(np.intp).reshape(-1, 2))


def pad_rows(rows: Sequence[Sequence[int]]) -> Array:
    """Convert lists of indices to a matrix for MATLAB.

    Each list is a row. Its indices count from 1 and its rows are padded with zeros.
    """
    table = np.zeros((len(rows), max(map(len, rows), default=0)))
    for own, row in zip(table, rows, strict=True):
        own[: len(row)] = np.array(row) + 1.0
    return table


def read_rows(key: str, value: Any, count: int) -> list[list[int]]:
    """Read the lists of indices that `pad_rows` converted.

    `key` is the variable's name for messages. MATLAB's indices are 1 to `count`. Raises TypeError,
    ValueError.
    """
    table = finite_array(key, value, (None, None))
    return [read_indices(key, row[row != 0], count).tolist() for row in table]


def is_filled(variables: Variables, key: str) -> bool:
    """Return whether a variable has nonzero numbers.

    `key` is its name.
    """
    value: Any = variables.get(key)
    if issparse(value):
        return bool(value.nnz)
    return isinstance(value, np.ndarray) and bool(np.any(value))

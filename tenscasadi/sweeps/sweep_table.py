"""Table of a sweep: a row for each case, a column for each thing that cases hold or return."""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import Array, real_array
from tenscasadi.util.whole_file import write_whole


@dataclass(frozen=True, eq=False)
class Sweep(ReadOnlyArrays):
    """Cases and their results, which `sweep` returns.

    ``len(table)`` is the number of cases, ``table["name"]`` the column of that name, see `columns`.

    Attributes
    ----------
    cases : tuple
        Cases in the order in which they were given.
    results : tuple of dict
        Numbers, text and arrays by name that each case returned; empty where it has none.
    errors : tuple of str
        Traceback of each case that failed; "" for others, also for those that were not computed.
    success : ndarray of bool, shape (n,)
        Whether each case has finished without error.
    seconds : ndarray, shape (n,)
        Wall time of each case, s; NaN where it is not known.
    message : str
        How many cases were computed, read and failed, and how the sweep ended.
    interrupted : bool
        Whether it was interrupted from the keyboard.

    See Also
    --------
    sweep : Compute one.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> table = tc.Sweep(({"k": 1.0}, {"k": 2.0}), ({"peak": 3.0}, {}), ("", "ValueError: no"), [0.1, 0.1], "by hand")
    >>> table["peak"]
    array([ 3., nan])
    >>> print(table.csv())
    k,peak,case_seconds,case_error
    1.0,3.0,0.1,
    2.0,,0.1,ValueError: no
    """

    cases: tuple[Any, ...]
    results: tuple[dict[str, Any], ...]
    errors: tuple[str, ...]
    seconds: Array
    message: str
    interrupted: bool = False
    success: Any = None

    def __post_init__(self) -> None:
        count = len(self.cases)
        for name in ("results", "errors"):
            if len(getattr(self, name)) != count:
                raise ValueError(
                    f"Sweep.{name} has {len(getattr(self, name))} entries: give one for each of {count} cases"
                )
        seconds = real_array("Sweep.seconds", self.seconds, f"{count} numbers")
        done = np.array(
            [not error for error in self.errors] if self.success is None else self.success,
            dtype=bool,
        )
        for name, array in {"seconds": seconds, "success": done}.items():
            if array.shape != (count,):
                raise ValueError(
                    f"Sweep.{name} has shape {array.shape}: give ({count},), one for each case"
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.cases)

    def __getitem__(self, name: str) -> Any:
        columns = self.columns
        if name not in columns:
            raise KeyError(f"there is no column {name!r}: give one of {', '.join(columns)}")
        return columns[name]

    def __repr__(self) -> str:
        return f"Sweep({self.message})"

    @property
    def columns(self) -> dict[str, Any]:
        """Columns by name, arrays (n, …): what cases hold, then what they return.

        Cases that are no dicts are the column ``case``; results that are named as what cases hold
        begin with ``result.``. Where a case has no value there is NaN, or "" for text. Arrays of
        different shapes, and what is neither number nor text, give columns of objects.
        """
        given = [case if isinstance(case, Mapping) else {"case": case} for case in self.cases]
        columns = {str(name): _column([case.get(name) for case in given]) for name in _names(given)}
        found = {
            name: _column([result.get(name) for result in self.results])
            for name in _names(self.results)
        }
        return columns | {
            f"result.{name}" if name in columns else name: column for name, column in found.items()
        }

    def csv(self, path: str | os.PathLike[str] | None = None) -> str:
        """Write the table as comma-separated values.

        Parameters
        ----------
        path : str or PathLike, optional
            File to write; by default none.

        Returns
        -------
        str
            The text: a line of names, then one for each case, with its seconds and the last line of
            its error. Arrays take a column for each entry, ``name[0]``, ``name[1]``, …; what is
            missing is empty.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        flat: dict[str, Sequence[Any]] = {}
        for name, column in self.columns.items():
            flat |= {name + index: entries for index, entries in _entries(column)}
        flat["case_seconds"] = self.seconds.tolist()
        flat["case_error"] = [(error.strip().splitlines() or [""])[-1] for error in self.errors]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(flat)
        writer.writerows(
            [_cell(value) for value in row] for row in zip(*flat.values(), strict=True)
        )
        if path is not None:
            write_whole(path, text.getvalue())
        return text.getvalue()


def _names(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(itertools.chain.from_iterable(rows)))


def _column(values: list[Any]) -> Any:
    """Return the values (n) as an array; None: missing."""
    arrays = [None if value is None else _array(value) for value in values]
    known = [array for array in arrays if array is not None]
    text = {array.dtype.kind == "U" for array in known}
    if (
        any(array.dtype.kind == "O" for array in known)
        or len({array.shape for array in known}) > 1
        or len(text) > 1
    ):
        column = np.empty(len(values), dtype=object)
        for k, value in enumerate(values):  # NumPy would take arrays apart
            column[k] = value
        return column
    if len(known) == len(values):
        return np.stack(known) if known else np.zeros(0)
    empty = np.full(known[0].shape if known else (), "" if True in text else np.nan)
    return np.stack([empty if array is None else array for array in arrays])


def _array(value: Any) -> Any:
    """Return numbers and text as an array, anything else as one entry of objects."""
    if isinstance(value, (bool, int, float, complex, str, list, tuple, np.ndarray, np.generic)):
        with contextlib.suppress(ValueError):  # lists of different lengths
            return np.asarray(value)
    entry = np.empty((), dtype=object)
    entry[()] = value
    return entry


def _entries(column: Any) -> list[tuple[str, list[Any]]]:
    """Return the columns of numbers or text that an array (n, …) is, with the index of each entry."""
    return [
        (
            "[" + ",".join(map(str, place)) + "]" if place else "",
            column[(slice(None), *place)].tolist(),
        )
        for place in np.ndindex(*column.shape[1:])
    ]


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and np.isnan(value)) else value

"""Table of a sweep with a row for each case."""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.validate import Array, FilePath, real_array
from tenscasadi.util.whole_file import write_whole


@dataclass(frozen=True, eq=False)
class Sweep(ReadOnlyArrays):
    """Table of a sweep's cases and their results.

    ``len(table)`` is the number of cases, ``table["name"]`` the column of that name, see `columns`.

    Attributes
    ----------
    cases : tuple
        Cases in the given order.
    results : tuple of dict
        Results of each case by name: numbers, text and arrays; empty if there are none.
    errors : tuple of str
        Traceback of each failed case; "" for others, also for those that were not computed.
    success : ndarray of bool, shape (n,)
        Whether each case has finished without error.
    seconds : ndarray, shape (n,)
        Wall time of each case [s]; NaN if it is unknown.
    message : str
        Number of computed, read and failed cases, and the end of the sweep.
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
    >>> print(table.to_csv())
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
            own = len(getattr(self, name))
            if own != count:
                cure = f"give one for each of {count} cases"
                raise ValueError(f"Sweep.{name} has {own} entries: {cure}")
        done = [not error for error in self.errors] if self.success is None else self.success
        seconds = real_array("Sweep.seconds", self.seconds, f"{count} numbers")
        for name, array in {"seconds": seconds, "success": np.array(done, dtype=bool)}.items():
            if array.shape != (count,):
                cure = f"give ({count},), one for each case"
                raise ValueError(f"Sweep.{name} has shape {array.shape}: {cure}")
            object.__setattr__(self, name, array)
        super().__post_init__()

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
        """Columns (n, …) by name.

        Entries of the cases come first, then those of the results.

        Cases other than dicts are the column ``case``. Results with the name of an entry of a case
        begin with ``result.``. Missing values are NaN, or "" for text. Arrays of different shapes
        and other values are columns of objects.
        """
        given = [case if isinstance(case, Mapping) else {"case": case} for case in self.cases]
        columns = {str(name): column for name, column in _build_columns(given).items()}
        found = _build_columns(self.results).items()
        return columns | {
            f"result.{name}" if name in columns else name: column for name, column in found
        }

    def to_csv(self, path: FilePath | None = None) -> str:
        """Format the table as comma-separated values.

        Parameters
        ----------
        path : str or PathLike, optional
            File to write; by default none.

        Returns
        -------
        str
            The text: a line of names, then one for each case, with its seconds and the last line of
            its error. Arrays take a column for each entry, ``name[0]``, ``name[1]``, …; missing
            values are empty.

        Raises
        ------
        OSError
            The file cannot be written.
        """
        flat: dict[str, list[Any]] = {}
        for name, column in self.columns.items():
            for place in np.ndindex(*column.shape[1:]):
                index = f"[{','.join(map(str, place))}]" if place else ""
                flat[name + index] = column[(slice(None), *place)].tolist()
        flat["case_seconds"] = self.seconds.tolist()
        flat["case_error"] = [(error.strip().splitlines() or [""])[-1] for error in self.errors]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(flat)
        for row in zip(*flat.values(), strict=True):
            writer.writerow(["" if value != value else value for value in row])  # NaN
        if path is not None:
            write_whole(path, text.getvalue())
        return text.getvalue()

    csv = RenamedAttribute("to_csv")


def _build_columns(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    names = dict.fromkeys(itertools.chain.from_iterable(rows))
    return {name: _build_column([row.get(name) for row in rows]) for name in names}


def _build_column(values: list[Any]) -> Any:
    """Build an array of values (n); None marks missing ones."""
    arrays = [None if value is None else _as_array(value) for value in values]
    known = [array for array in arrays if array is not None]
    kinds = {array.dtype.kind if array.dtype.kind in "OU" else "" for array in known}
    if "O" in kinds or len(kinds) > 1 or len({array.shape for array in known}) > 1:
        column = np.empty(len(values), dtype=object)
        for k, value in enumerate(values):  # NumPy would take arrays apart
            column[k] = value
        return column
    if not known:
        return np.zeros(0)
    empty = np.full(known[0].shape, "" if kinds == {"U"} else np.nan)
    complete = len(known) == len(values)
    return np.stack(known if complete else [empty if a is None else a for a in arrays])


def _as_array(value: Any) -> Any:
    """Convert numbers and text to an array.

    Other values become one entry of objects.
    """
    if isinstance(value, (bool, int, float, complex, str, list, tuple, np.ndarray, np.generic)):
        with contextlib.suppress(ValueError):  # lists of different lengths
            return np.asarray(value)
    entry = np.empty((), dtype=object)
    entry[()] = value
    return entry

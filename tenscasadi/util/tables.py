"""Tables of named columns, for CSV files and pandas."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.util.validate import Array, file_path
from tenscasadi.util.whole_file import whole_file

Columns = Mapping[str, Array]  # each (rows,), in order; the name ends in the unit, as in "time (s)"


def name_columns(template: str, values: Any) -> dict[str, Array]:
    """Name the columns of `values` (rows, items).

    The template has a place for the item, as in "string {} tension (N)".
    """
    return {template.format(k): column for k, column in enumerate(np.asarray(values).T)}


def name_coordinates(template: str, values: Any) -> dict[str, Array]:
    """Name the columns of vectors `values` (rows, items, 3).

    The template has places for item and axis.
    """
    rows, items = np.shape(values)[:2]
    names = [template.format(k, axis) for k in range(items) for axis in "xyz"]
    return dict(zip(names, np.reshape(values, (rows, 3 * items)).T, strict=True))


class Tabular:
    """Base of values with a table over time."""

    def _columns(self) -> Columns:
        """Return the columns, time first."""
        raise NotImplementedError

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write the table as comma-separated values.

        The first line has names with units. Numbers read back are equal to the last bit.

        Parameters
        ----------
        path : str or PathLike
            File to write; no ending is added.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            If the file cannot be written. An existing file then stays unchanged.
        """
        import csv  # takes a while to load

        columns = self._columns()
        with whole_file(path) as file:
            text = io.TextIOWrapper(file, encoding="utf-8", newline="")
            writer = csv.writer(text, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(
                zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
            )
            text.detach()  # flushes, and leaves the file open
        return file_path("path", path)

    def to_pandas(self) -> Any:
        """Convert the table to a ``pandas.DataFrame`` indexed by time.

        Returns
        -------
        pandas.DataFrame
            A copy of the numbers.

        Raises
        ------
        ImportError
            If pandas is not installed: ``pip install 'tenscasadi[exchange]'``.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise ImportError(
                "to_pandas requires pandas: pip install 'tenscasadi[exchange]', or call to_csv"
            ) from error
        columns = self._columns()
        return pd.DataFrame(dict(columns)).set_index(next(iter(columns)))

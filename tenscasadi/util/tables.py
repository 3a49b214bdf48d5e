"""Tables of named columns, for CSV files and pandas."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.util.validate import Array, FilePath, file_path
from tenscasadi.util.whole_file import whole_file

MOST_LISTED = 12  # entries of a legend, a panel or a summary; more are counted
Columns = Mapping[str, Array]  # each (rows,), in order; the name ends in the unit, as in "time (s)"


class Quantity(NamedTuple):
    """Quantity over time, with names for its columns.

    Attributes
    ----------
    name : str
        Name in labeled arrays, such as "tension".
    column : str
        Template of the names of columns, with places for the label of the item and the axis and the
        unit at the end, as in "node {} {} (m)".
    values : ndarray, shape (rows, ...)
        Values, whose further dimensions are `dims`.
    dims : tuple of str
        Names of the dimensions after the time: "node", "string", "input" or "axis".
    """

    name: str
    column: str
    values: Array
    dims: tuple[str, ...] = ()

    @property
    def unit(self) -> str:
        """Unit at the end of the column name; "" if there is none."""
        found = re.search(r"\(([^()]*)\)$", self.column)
        return found[1] if found else ""

    def label_items(self, names: Mapping[str, Sequence[str]]) -> list[list[Any]]:
        """List the labels of the items of each dimension.

        `names` are those of the items by dimension. Items have their name, or their index if they
        have none.
        """
        sizes = zip(self.dims, np.shape(self.values)[1:], strict=True)
        given = {"axis": "xyz", **names}
        return [
            [given[name][k] or str(k) for k in range(size)] if given.get(name) else [*range(size)]
            for name, size in sizes
        ]

    def columns(self, names: Mapping[str, Sequence[str]]) -> dict[str, Array]:
        """Split the values into columns (rows,) by title.

        `names` are those of the items by dimension, such as "node".
        """
        values = np.asarray(self.values)
        titles = [
            self.column.format(*items) for items in itertools.product(*self.label_items(names))
        ]
        return dict(zip(titles, values.reshape(len(values), len(titles)).T, strict=True))


class Tabular:
    """Base class of results that can be converted to a table over time."""

    def _quantities(self) -> Iterable[Quantity]:
        """List the quantities of the table, time first."""
        raise NotImplementedError

    def _labels(self) -> Mapping[str, Sequence[str]]:
        """Return the names of nodes and strings, if they have names.

        They are stored by the dimension of the table.
        """
        return {}

    def _columns(self) -> Columns:
        """Return the columns by name, time first."""
        return {
            name: column
            for quantity in self._quantities()
            for name, column in quantity.columns(self._labels()).items()
        }

    def to_csv(self, path: FilePath) -> Path:
        """Write the table as comma-separated values.

        The first line has names with units; nodes and strings have their names, or indices if they
        have none. Numbers read back are equal to the last bit.

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

    def to_xarray(self) -> Any:
        """Convert the table to an ``xarray.Dataset`` with the dimension time.

        Nodes and strings are labeled by their names, or by indices if they have none.

        Returns
        -------
        xarray.Dataset
            A copy of the numbers. The attribute ``units`` of each variable has its unit.

        Raises
        ------
        ImportError
            If xarray is not installed: ``pip install 'tenscasadi[exchange]'``.
        """
        try:
            import xarray as xr
        except ImportError as error:
            raise ImportError(
                "to_xarray requires xarray: pip install 'tenscasadi[exchange]', or call to_csv"
            ) from error
        time, *others = self._quantities()
        coordinates: dict[str, Any] = {
            time.name: (time.name, np.array(time.values), {"units": time.unit})
        }
        variables = {}
        for quantity in others:
            dims = (time.name, *quantity.dims)
            variables[quantity.name] = (dims, np.array(quantity.values), {"units": quantity.unit})
            labels = quantity.label_items(self._labels())
            coordinates |= dict(zip(quantity.dims, labels, strict=True))
        return xr.Dataset(variables, coordinates)

"""Rows that a motion without a known end leaves behind, in a memory that is bounded."""

from __future__ import annotations

import numpy as np

from tenscasadi.util.validate import Array, Indices

_BYTES = 2e8


class Recording:
    """Rows (width,), each at a tick, of which no more are kept than fit: then every other one goes, and so many fewer come.

    Parameters
    ----------
    width : int
        Numbers of a row.
    bytes_ : float
        Memory.
    """

    def __init__(self, width: int, bytes_: float = _BYTES) -> None:
        self.width = width
        self._most = max(16, int(bytes_ / (8 * (width + 1))))
        self._ticks: list[int] = []
        self._rows: list[Array] = []
        self.every = 1  # ticks from one row to the next

    def keep(self, tick: int, row: Array) -> None:
        """Keep a row, in place of the one of the same tick if there is one.

        Parameters
        ----------
        tick : int
            Its tick, not before the last one.
        row : ndarray, shape (width,)
            The numbers.
        """
        while (self._ticks and self._ticks[-1] >= tick) or (
            len(self._ticks) > 1 and self._ticks[-1] % self.every
        ):
            self._ticks.pop()
            self._rows.pop()
        self._ticks.append(tick)
        self._rows.append(row.copy())
        while len(self._rows) > self._most:
            self.every *= 2
            chosen = [
                k
                for k, at in enumerate(self._ticks)
                if at % self.every == 0 or k == len(self._ticks) - 1
            ]
            self._ticks, self._rows = (
                [self._ticks[k] for k in chosen],
                [self._rows[k] for k in chosen],
            )

    def rows(self) -> tuple[Indices, Array]:
        """Return the ticks (T,) and rows (T, width) that are kept.

        Returns
        -------
        tuple of ndarray
            Both, in order.
        """
        return np.array(self._ticks), np.array(self._rows)

"""Recording of an interactive simulation in bounded memory."""

from __future__ import annotations

import numpy as np

from tenscasadi.util.validate import Array, Indices


class Recording:
    """Recording of states at ticks in bounded memory.

    When the memory is full, every other row is removed, and from then on only every other one is
    recorded.

    Parameters
    ----------
    width : int
        Numbers per row.
    bytes_ : float
        Memory [bytes].
    """

    def __init__(self, width: int, bytes_: float = 2e8) -> None:
        self.width = width
        self._most = max(16, int(bytes_ / (8 * (width + 1))))
        self._ticks: list[int] = []
        self._rows: list[Array] = []
        self.every = 1  # ticks between kept rows

    def keep(self, tick: int, row: Array) -> None:
        """Record a row (width,), which replaces one of the same tick."""
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
        """Return the recorded ticks (T,) and rows (T, width).

        Ticks are numbered from the start.
        """
        return np.array(self._ticks), np.array(self._rows)

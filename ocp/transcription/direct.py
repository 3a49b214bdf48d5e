"""CasADi Functions on NumPy arrays in place: copies through CasADi's matrices cost several times what small functions take."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array


class Direct:
    """A Function with dense outputs: arrays in, whose memory holds each input column by column, and an array (columns, rows) for each output out."""

    def __init__(self, function: ca.Function) -> None:
        self._buffer: Any
        self._buffer, self._evaluate = function.buffer()
        self._shapes = [(function.size2_out(k), function.size1_out(k)) for k in range(function.n_out())]

    def __call__(self, *inputs: Array) -> list[Array]:
        """The outputs."""
        arrays = [np.ascontiguousarray(value, dtype=float) for value in inputs]
        results = [np.empty(shape) for shape in self._shapes]
        for k, array in enumerate(arrays):
            if array.size:
                self._buffer.set_arg(k, array.data)
        for k, result in enumerate(results):
            if result.size:
                self._buffer.set_res(k, result.data)
        self._evaluate()
        return results

"""Odd values to put in place of right input: numbers beyond reason, other kinds of things, arrays that are not what they seem."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from decimal import Decimal
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp
from hypothesis import strategies as st

import tenscasadi as tc


class Broken:
    """NumPy cannot read it."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("broken")

    def __repr__(self) -> str:
        return "Broken()"


def raising(*_: Any) -> Any:
    """Raise in place of what a user's function should return."""
    raise KeyError("lost")


ODD: list[Any] = [
    float("nan"), float("inf"), -float("inf"), -1, 0, 0.0, 1e-320, 1e200, 10**400, -(10**5000), 10**9, True, None, "x", "", b"x", 1j, 1 + 0j,
    np.complex128(2), np.array(3), np.array(3.0), np.array([]), np.zeros((0, 3)), np.zeros((2, 2, 2)), np.array([1 + 1j]), np.array(["a"]),
    np.array([None]), np.array([np.nan, 1.0]), np.float32("nan"), np.int64(-3), np.datetime64("2020-01-01"), np.ma.masked,
    np.ma.array([1.0, 2.0], mask=[True, False]), np.ma.array([[1.0, 2.0, 3.0]], mask=[[False, True, False]]), np.ma.array(1.0, mask=True),
    sp.csr_array(np.eye(3)), sp.coo_matrix(np.eye(2)), ca.SX.sym("x"), ca.MX.sym("x", 3), ca.DM(2), ca.DM.eye(3), ca.DM(3, 3), ca.DM(float("nan")),
    Broken(), [Broken()], object, object(), len, raising, lambda t: float("nan"), lambda *a: "x", Decimal("NaN"), Decimal(1), (), [], {}, set(), [[]],
    [1, [2]], {"a": 1}, {0: "x"}, {-1: 0.0}, {10**5000: 1}, [float("nan")] * 3, (None, None, None), [0, 0], [(0, 1)], range(3), slice(None), Ellipsis,
    NotImplemented, iter([1, 2]), "x" * 300, "\0", Path("/nonexistent/x"), memoryview(b"ab"), tc.RungeKutta4(), tc.Projection(), tc.RungeKutta4,
]  # fmt: skip


def altered(draw: Callable[[Any], Any], value: Any) -> Any:
    """An odd value in place of `value`, or of one of its entries, or the value in another container."""
    odd = ODD[draw(st.integers(0, len(ODD) - 1))]
    way = draw(st.integers(0, 5))
    if isinstance(value, (tuple, list)) and value and way < 3:
        k = draw(st.integers(0, len(value) - 1))
        changed = [*value[:k], *([altered(draw, value[k])] if way else []), *value[k + 1 :]]
        return changed if isinstance(value, list) else tuple(changed)
    if isinstance(value, dict) and value and way < 3:
        key = draw(st.sampled_from(list(value)))
        try:
            return {odd: value[key]} if way == 0 else {**value, key: altered(draw, value[key])}
        except Exception:  # noqa: BLE001  each kind of object refuses to be a key in its own way
            return odd
    if isinstance(value, np.ndarray) and value.ndim and value.size and way < 4:
        entries = np.array(value, dtype=float)
        place = np.unravel_index(draw(st.integers(0, value.size - 1)), value.shape)
        if way == 0:
            entries[place] = draw(st.sampled_from([np.nan, np.inf, -np.inf, 1e200, 1e-320]))
            return entries
        if way == 1:
            hidden = np.ma.array(entries, mask=np.zeros(value.shape, dtype=bool))
            hidden[place] = np.ma.masked
            return hidden
        return draw(
            st.sampled_from(
                [
                    entries.T,
                    entries[..., :-1],
                    entries[None],
                    entries * 1j,
                    entries.astype(str),
                    entries.astype(object),
                    sp.coo_array(entries),
                ]
            )
        )
    return odd


def list_odd(value: Any, depth: int = 2) -> Iterator[Any]:
    """List each odd value in place of `value`, of its first and last entries, and of its keys."""
    yield from ODD
    if isinstance(value, (tuple, list)) and value and depth:
        for k in sorted({0, len(value) - 1}):
            rows = [value[:k], value[k + 1 :]]
            for entries in ([], *([odd] for odd in list_odd(value[k], depth - 1))):
                yield type(value)([*rows[0], *entries, *rows[1]])
    if isinstance(value, dict) and depth:
        for key, entry in value.items():
            for odd in ODD:
                with suppress(Exception):  # each kind of object refuses to be a key in its own way
                    yield {odd: entry}
            for odd in list_odd(entry, depth - 1):
                yield {**value, key: odd}

"""Tableaux: coefficients that fit together."""

from __future__ import annotations

import pytest

from tenscasadi.integrators.tableaux import Tableau


def test_tableaux_are_checked() -> None:
    with pytest.raises(ValueError, match=r"errors\[0\]"):
        Tableau(a=((), (0.5,)), b=(0.5, 0.5), errors=((1.0,),))
    with pytest.raises(ValueError, match="a has rows"):
        Tableau(a=((), (0.5, 0.5)), b=(0.5, 0.5))
    with pytest.raises(ValueError, match=r"a\[1\]\[0\] is nan"):
        Tableau(a=((), (float("nan"),)), b=(0.5, 0.5))

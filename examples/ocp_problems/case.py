"""What a problem of the suite consists of."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import ocp


class Case(NamedTuple):
    """A problem by its kind and name, and the error, m, that its replay may have.

    quick: whether it is among the few that are solved where time is short.
    """

    kind: str
    name: str
    problem: Callable[[], ocp.Problem]
    tolerance: float
    quick: bool = False

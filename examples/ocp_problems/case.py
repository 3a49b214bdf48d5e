"""Definition of a problem of the suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import ocp


class Case(NamedTuple):
    """Problem with its kind, its name, and the permitted replay error [m].

    `quick` is whether it is solved in short runs of the suite.
    """

    kind: str
    name: str
    problem: Callable[[], ocp.Problem]
    tolerance: float
    quick: bool = False

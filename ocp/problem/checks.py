"""Checks of input that this package shares."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np


def dimensions(value: Any) -> int:
    """How deep `value` is nested: 0 for a number, 1 for a list; 1 also for ragged lists, which array checks then refuse by name."""
    try:
        return np.ndim(value)
    except ValueError:
        return 1


def called(field: str, function: Callable[[Any], Any], argument: Any, hint: str) -> Any:
    """function(argument) of a user's function; whatever it raises becomes a ValueError that names the field and ends with a hint."""
    try:
        return function(argument)
    except Exception as error:
        fault = re.sub(r"^\S+:\d+: ", "", (str(error).strip().splitlines() or [""])[-1])  # CasADi begins with its own files and lines
        cure = "give casadi.if_else(condition, a, b) in place of Python's if, max, and, or" if "truth value" in fault else hint
        raise ValueError(f"{field} fails with {type(error).__name__}: {fault.rstrip('.')}: {cure}") from error

"""Checks of input that this package shares."""

from __future__ import annotations

from typing import Any

import numpy as np


def dimensions(value: Any) -> int:
    """How deep `value` is nested: 0 for a number, 1 for a list; 1 also for ragged lists, which array checks then refuse by name."""
    try:
        return np.ndim(value)
    except ValueError:
        return 1

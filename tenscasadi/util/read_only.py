"""Values with read-only arrays, which copies and other processes get read-only, too."""

from __future__ import annotations

from typing import Any

import numpy as np


def read_only(value: Any) -> Any:
    """Return a view of an array that cannot be written, likewise of each in a tuple or dictionary. Not sparse ones: SciPy sorts them in place."""
    if isinstance(value, np.ndarray):
        value = value.view()
        value.flags.writeable = False
    elif type(value) is dict:
        return {key: read_only(part) for key, part in value.items()}
    elif isinstance(value, tuple):
        parts = [read_only(part) for part in value]
        return value._make(parts) if hasattr(value, "_make") else tuple(parts)
    return value


class ReadOnlyArrays:
    """Base of frozen values: their arrays cannot be written, nor those of copies, where NumPy drops the flag."""

    def __post_init__(self) -> None:
        """Take the right to write from all arrays, once the fields are there."""
        self.__setstate__(vars(self).copy())

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the attributes of the value that was copied."""
        for name, value in state.items():
            object.__setattr__(self, name, read_only(value))

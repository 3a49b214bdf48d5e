"""Values with read-only arrays, also in copies."""

from __future__ import annotations

from typing import Any

import numpy as np


def read_only(value: Any) -> Any:
    """Make a read-only view of an array.

    In tuples and dictionaries, all arrays become views. Sparse arrays are returned unchanged,
    because SciPy sorts them in place.
    """
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
    """Base of frozen values whose arrays and copies are read-only."""

    def __post_init__(self) -> None:
        """Make all arrays read-only."""
        self.__setstate__(vars(self).copy())

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes of a copied value."""
        for name, value in state.items():
            object.__setattr__(self, name, read_only(value))

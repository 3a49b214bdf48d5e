"""Values with read-only arrays, which copies and other processes get read-only, too."""

from __future__ import annotations

from typing import Any

import numpy as np


class ReadOnlyArrays:
    """Base of frozen values: arrays lose their flag where NumPy copies or unpickles them."""

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the attributes of the value that was copied."""
        self.__dict__.update(state)
        for value in self.__dict__.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

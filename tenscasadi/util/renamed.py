"""Names of earlier versions that still work, with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any


def find_renamed(package: str, names: Mapping[str, tuple[str, Any]]) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package whose `names` have new names and values."""

    def find(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        new, value = names[name]
        message = f"{package}.{name} is deprecated: use {package}.{new}"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return value

    return find

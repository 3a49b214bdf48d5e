"""Immutable objects: read-only arrays, and cached results."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np

Kept = TypeVar("Kept")
_PARTS = (np.ndarray, dict, tuple)  # types that can contain arrays


def read_only(value: Any) -> Any:
    """Build a read-only view of an array.

    If `value` is a tuple or dictionary, all arrays in it become views. Sparse arrays and other
    values are returned unchanged, because SciPy sorts sparse arrays in place.
    """
    if isinstance(value, np.ndarray):
        value = value.view()
        value.flags.writeable = False
    elif type(value) is dict:
        return {key: read_only(part) for key, part in value.items()}
    elif isinstance(value, tuple) and any(isinstance(part, _PARTS) for part in value):
        parts = [read_only(part) for part in value]
        return value._make(parts) if hasattr(value, "_make") else tuple(parts)
    return value


class ReadOnlyArrays:
    """Base class of immutable dataclasses with read-only arrays."""

    def __post_init__(self) -> None:
        """Make all arrays read-only."""
        self.__setstate__(vars(self).copy())

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the attributes of a copied object."""
        for name, value in state.items():
            object.__setattr__(self, name, read_only(value))


class _Store(dict[Hashable, Any]):
    """Cache of one object, which its copies do not share.

    It is an attribute of the owner, so that both are freed together: cached values refer to the
    owner.
    """

    def __init__(self, owner: Any = None) -> None:
        super().__init__()
        self.owner = weakref.ref(owner) if owner is not None else lambda: None

    def __reduce__(self) -> Any:
        return _Store, ()


def keep(owner: Any, key: Hashable, build: Callable[[], Kept]) -> Kept:
    """Return the cached value of a key, and build it at the first call.

    Parameters
    ----------
    owner : object
        Immutable value from which the stored one is derived.
    key : hashable
        Name of the stored value.
    build : callable
        Function without arguments that builds it.

    Returns
    -------
    object
        The value.
    """
    store = vars(owner).get("_kept")
    if store is None or store.owner() is not owner:
        store = vars(owner)["_kept"] = _Store(owner)
    if key not in store:
        store[key] = build()
    value: Kept = store[key]
    return value

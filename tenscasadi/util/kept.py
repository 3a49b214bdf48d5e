"""Values derived from another value and kept with it."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

Kept = TypeVar("Kept")

_STORES: dict[int, dict[Hashable, Any]] = {}  # by the identity of the owner


def keep(owner: Any, key: Hashable, build: Callable[[], Kept]) -> Kept:
    """Return the stored value of a key, building it once.

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
    store = _STORES.get(id(owner))
    if store is None:
        store = _STORES[id(owner)] = {}
        weakref.finalize(owner, _STORES.pop, id(owner), None)
    if key not in store:
        store[key] = build()
    value: Kept = store[key]
    return value

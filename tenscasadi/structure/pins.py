"""Pinned nodes: which of their coordinates are held."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from tenscasadi.util.validate import node_index, shown


def read_pins(pinned: Any, count: int) -> Mapping[int, str]:
    """Return {node: axes} in node order, axes in the order x, y, z. Raises TypeError, ValueError."""
    try:
        entries = list(pinned.items() if isinstance(pinned, Mapping) else ((node, "xyz") for node in pinned))
    except Exception as error:  # each kind of matrix refuses in its own way
        raise TypeError(f"pinned is {shown(pinned)}: give node indices, such as [0, 3], or a mapping such as {{0: 'xyz', 3: 'z'}}") from error
    pins: dict[int, str] = {}
    for key, axes in entries:
        node = node_index("pinned", key, count)
        if not isinstance(axes, str):
            raise TypeError(f"pinned of node {node} is {shown(axes)}: give the axes as text, such as 'xyz' or 'z'")
        if not axes or len(set(axes)) != len(axes) or not set(axes) <= set("xyz"):
            raise ValueError(f"pinned of node {node} is {shown(axes)}: give some of x, y, z, each once")
        if node in pins:
            raise ValueError(f"pinned: node {node} is given twice: leave one out")
        pins[node] = "".join(sorted(axes))
    return MappingProxyType(dict(sorted(pins.items())))

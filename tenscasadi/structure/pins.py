"""Pinned nodes and rollers."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from tenscasadi.schema.reading import Names
from tenscasadi.util.validate import (
    TOLERANCE,
    Array,
    as_tuple,
    finite_array,
    format_value,
    nesting,
)

Normals = tuple[tuple[float, float, float], ...]


def read_pins(pinned: Any, names: Names) -> Mapping[int, str]:
    """Read the pinned axes, such as "xz", by node.

    `pinned` is the argument of `Structure`, and `names` are those of its nodes. Nodes and axes are
    in order. Raises TypeError or ValueError.
    """
    pinned = names.resolve_keys("pinned", "node", names.resolve_all("pinned", "node", pinned))
    try:
        entries = list(
            pinned.items()
            if isinstance(pinned, Mapping)
            else ((node, "xyz") for node in as_tuple("pinned", pinned, "[0, 3]"))
        )
    except Exception as error:  # each kind of matrix raises its own error
        raise TypeError(
            f"pinned is {format_value(pinned)}: "
            "give node indices, such as [0, 3], or a mapping such as {0: 'xyz', 3: 'z'}"
        ) from error
    pins: dict[int, str] = {}
    for key, axes in entries:
        node = names.index("pinned", "node", key)
        if not isinstance(axes, str):
            raise TypeError(
                f"pinned of node {node} is {format_value(axes)}: give axes such as 'xyz' or 'z'"
            )
        if not axes or len(set(axes)) != len(axes) or not set(axes) <= set("xyz"):
            raise ValueError(
                f"pinned of node {node} is {format_value(axes)}: give some of x, y, z, each once"
            )
        if node in pins:
            raise ValueError(f"pinned: node {node} is given twice: remove one")
        pins[node] = "".join(sorted(axes))
    return MappingProxyType(dict(sorted(pins.items())))


def read_rollers(
    rollers: Any, pins: Mapping[int, str], names: Names
) -> tuple[Mapping[int, str], Mapping[int, Normals]]:
    """Separate rollers along axes from inclined ones.

    `rollers` is the argument of `Structure`, `pins` are the pinned axes by node, and `names` those
    of its nodes. Returns the pins, which include axis-aligned rollers, and by node one or two
    orthonormal normals of inclined rollers. Raises TypeError or ValueError.
    """
    if not isinstance(rollers, Mapping):
        raise TypeError(
            f"rollers is {format_value(rollers)}: "
            "give a mapping from nodes to normals, such as {3: (1, 0, 1)}"
        )
    held, found = dict(pins), {}
    for key, given in names.resolve_keys("rollers", "node", rollers).items():
        node = names.index("rollers", "node", key)
        if node in pins:
            raise ValueError(
                f"rollers: node {node} is pinned along {pins[node]}, too: "
                "give all its directions in rollers"
            )
        normals = _orthonormalize(f"rollers of node {node}", given)
        if np.count_nonzero(normals) == len(normals):
            held[node] = "".join(
                sorted("xyz"[int(np.argmax(np.abs(normal)))] for normal in normals)
            )
        else:
            found[node] = tuple((float(x), float(y), float(z)) for x, y, z in normals)
    return MappingProxyType(dict(sorted(held.items()))), MappingProxyType(
        dict(sorted(found.items()))
    )


def read_axes(
    pinned: Mapping[int, str], rollers: Mapping[int, Normals], count: int
) -> tuple[Any, Any]:
    """Find the constrained axes of each node.

    Returns the pinned axes (count, 3), and the axes with a component in a pin or roller (count, 3).
    """
    fixed = np.array([[axis in pinned.get(node, "") for axis in "xyz"] for node in range(count)])
    held = fixed.copy()
    for node, normals in rollers.items():
        held[node] = np.any(normals, axis=0)
    return fixed, held


def _orthonormalize(field: str, given: Any) -> Array:
    """Orthonormalize one or two directions.

    `given` is one vector (3,) or an array (k, 3); the result is (k, 3). Orthonormal input is
    returned unchanged. Messages name `field`.
    """
    directions = np.atleast_2d(
        finite_array(field, given, (3,) if nesting(given) < 2 else (None, 3))
    )
    if not 1 <= len(directions) <= 2:
        raise ValueError(
            f"{field} has {len(directions)} directions: give one or two, or pin the node"
        )
    sizes = np.linalg.norm(directions, axis=1)
    if not sizes.all():
        raise ValueError(f"{field} is {format_value(given)}: give directions other than 0")
    units = np.where(abs(sizes - 1) < 1e-15, 1.0, sizes)[:, None]
    normals = directions / units
    for k in range(1, len(normals)):
        along = float(normals[0] @ normals[k])
        if abs(along) > 1e-15:
            rest = normals[k] - along * normals[0]
            if np.linalg.norm(rest) < TOLERANCE:
                raise ValueError(
                    f"{field} is {format_value(given)}, parallel directions: give one of them"
                )
            normals[k] = rest / np.linalg.norm(rest)
    return np.asarray(normals)

"""Strings that can break: their strengths, internal states and overloads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.scene.internal_states import InternalStates

if TYPE_CHECKING:
    from tenscasadi.util.validate import Array, Indices

INTACT, TIME_INTACT = "intact", "time intact"  # internal states of strings that can break


def list_strengths(scene: Any) -> Array:
    """List the tensions (α,) of the scene's strings at which they break [N]."""
    strings = len(scene.structure.strings)
    if scene.strength is None:
        return np.full(strings, np.inf)
    return scene.strength.list_forces(strings)  # type: ignore[no-any-return]


def find_breakable(scene: Any) -> Indices:
    """Find the inputs, of cables and lone strings, that can break."""
    return np.unique(scene.structure.cable_of[np.isfinite(list_strengths(scene))])


def limit_tensions(scene: Any) -> Array:
    """Compute the tensions (m,) of inputs, of cables and lone strings, that plans stay below [N].

    They are inf for inputs that cannot break.
    """
    cable_of = scene.structure.cable_of
    found = np.full(int(cable_of.max(initial=-1)) + 1, np.inf)
    if scene.strength is not None:
        np.minimum.at(found, cable_of, (1 - scene.strength.margin) * list_strengths(scene))
    return found


def describe_overload(scene: Any, tension: Array) -> str:
    """Describe the first string whose tension reaches its strength; "" if there is none.

    `tension` (α,) [N] is that of the modeled strings.
    """
    parent = scene.modelled.string_parent
    strength = list_strengths(scene)[parent]
    share = tension / strength
    if not (share >= 1).any():
        return ""
    worst = int(np.argmax(share))
    return (
        f"string {parent[worst]} breaks, its tension of {tension[worst]:.4g} N reaches its "
        f"strength of {strength[worst]:.4g} N"
    )


def declare_strength(scene: Any) -> tuple[InternalStates, ...]:
    """Declare the internal states of strings that can break."""
    count = len(find_breakable(scene))
    if not count:
        return ()
    one = np.ones(count)
    return (
        InternalStates(INTACT, "", one, one),
        InternalStates(TIME_INTACT, "s", one, np.zeros(count)),
    )

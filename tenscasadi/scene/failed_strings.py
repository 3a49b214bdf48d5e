"""Strings that can fail: their names, overloads, and intactness."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.scene.internal_states import join_initial
from tenscasadi.scene.strength import declare_strength, find_limited, list_strengths
from tenscasadi.structure.cables import name_inputs
from tenscasadi.structure.names import label

if TYPE_CHECKING:
    from tenscasadi.util.validate import Array


def name_limited(scene: Any) -> list[str]:
    """Name the strings and cables that can break or yield."""
    s, names = scene.structure, name_inputs(scene.structure)
    for k, (input_, count) in enumerate(
        zip(*np.unique(s.cable_of, return_counts=True), strict=True)
    ):
        string = int(np.flatnonzero(s.cable_of == input_)[0])
        if count == 1 and s.string_names and s.string_names[string]:
            names[k] = f"string {label(s.string_names, string)!r}"
    return [names[k] for k in find_limited(scene)]


def describe_overload(scene: Any, tension: Array) -> str:
    """Describe the string whose tension exceeds its strength most.

    It can be a cable. Returns "" if there is none. `tension` (α,) [N] is that of the modeled
    strings.
    """
    strength = list_strengths(scene)[scene.modelled.string_parent]
    fraction = tension / strength
    if not (fraction >= 1).any():
        return ""
    worst = int(np.argmax(fraction))
    member = name_limited(scene)[int(np.searchsorted(find_limited(scene), scene.input_of[worst]))]
    return (
        f"{member} {scene.strength.verb}, its tension of {tension[worst]:.4g} N reaches its "
        f"strength of {strength[worst]:.4g} N"
    )


def find_failed(scene: Any, internal: Array) -> Any:
    """Find the strings and cables that have failed.

    There are m that can fail. `internal` (..., na) are internal states. Returns Booleans (..., m).
    """
    count, initial = len(find_limited(scene)), join_initial(declare_strength(scene))
    own = internal[..., internal.shape[-1] - len(initial) :]
    return own[..., :count] != initial[:count]


def require_intact(name: str, scene: Any, states: Array) -> None:
    """Raise ValueError if a string has broken or yielded.

    `states` (na,) are internal states, and `name` is that of the state in messages.
    """
    for k in np.flatnonzero(find_failed(scene, states))[:1]:
        kind, cure = "yielded", "give a structure with its new rest length"
        if scene.strength.breaks:
            kind, cure = "broken", "give a structure without it"
        raise ValueError(f"{name} has the {kind} {name_limited(scene)[k]}: {cure}")

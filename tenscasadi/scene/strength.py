"""Strings that can break or yield: their strengths and internal states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from tenscasadi.scene.internal_states import InternalStates, join_initial

if TYPE_CHECKING:
    from tenscasadi.util.validate import Array, Indices

# internal states of strings that can break, and of strings that can yield
INTACT, TIME_INTACT, PLASTIC = "intact", "time intact", "plastic elongation"
STATES = INTACT, TIME_INTACT, PLASTIC


def list_strengths(scene: Any) -> Array:
    """Return the tensions at which the scene's strings fail (α,) [N]."""
    strings = len(scene.structure.strings)
    if scene.strength is None:
        return np.full(strings, np.inf)
    return scene.strength.list_forces(strings)  # type: ignore[no-any-return]


def find_limited(scene: Any) -> Indices:
    """Find cables, and strings in no cable, that can break or yield."""
    return np.unique(scene.structure.cable_of[np.isfinite(list_strengths(scene))])


def limit_tensions(structure: Any, strength: Any) -> Array:
    """Compute tension limits (m,) [N] for plans from the strength.

    There is one for each cable and each string in no cable. It is inf for those without a strength.
    """
    cable_of = structure.cable_of
    found = np.full(int(cable_of.max(initial=-1)) + 1, np.inf)
    if strength is not None:
        forces = strength.list_forces(len(cable_of))
        np.minimum.at(found, cable_of, (1 - strength.margin) * forces)
    return found


def declare_strength(scene: Any) -> tuple[InternalStates, ...]:
    """List the internal states of strings that can break or yield.

    The result is empty without such strings.
    """
    inputs = find_limited(scene)
    one = np.ones(len(inputs))
    if not len(inputs):
        return ()
    if scene.strength.breaks:
        return (
            InternalStates(INTACT, "", one, one),
            InternalStates(TIME_INTACT, "s", one, np.zeros(len(inputs))),
        )
    s = scene.structure
    lengths = np.asarray(np.bincount(s.cable_of, weights=s.string_lengths), dtype=float)
    return (InternalStates(PLASTIC, "m", lengths[inputs], np.zeros(len(inputs))),)


def count_states(scene: Any) -> int:
    """Count the internal states of strings that can break or yield."""
    return len(join_initial(declare_strength(scene)))


def drop_states(scene: Any, state: Array) -> Array:
    """Remove the internal states of string failure from a state (nx,)."""
    end = len(state) - int(scene.has_clock)
    return np.delete(state, np.arange(end - count_states(scene), end))


def insert_states(scene: Any, state: Array) -> Array:
    """Insert the internal states of intact strings into a state.

    The state is that of a model without strength.
    """
    end = len(state) - int(scene.has_clock)
    return np.insert(state, end, join_initial(declare_strength(scene)))


def spread_states(scene: Any, own: Any, inputs: Indices, default: float) -> Any:
    """Select the failure states (1×m) of m cables.

    `own` has the states of all cables that can fail, as a column. `inputs` are the indices of the m
    cables, among cables and strings in no cable. Those that cannot fail have the value `default`.
    """
    limited = scene.limited_inputs
    place = np.minimum(np.searchsorted(limited, inputs), len(limited) - 1)
    place = np.where(limited[place] == inputs, place, len(limited))
    return ca.vertcat(own, default)[place.tolist(), :].T


def compute_reserves(scene: Any, tension: Any) -> Any:
    """Compute the smallest margin (1×m) to failure of each cable [N].

    It is strength minus tension, also for strings in no cable. `tension` (1×α) [N] is that of the
    modeled strings.
    """
    strength = list_strengths(scene)[scene.modelled.string_parent]
    left = ca.DM(strength).T - tension
    own = [scene.input_of == k for k in scene.limited_inputs]
    which = [np.flatnonzero(one & np.isfinite(strength)).tolist() for one in own]
    return ca.horzcat(*(ca.mmin(left[:, some]) for some in which))

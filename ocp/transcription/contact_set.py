"""Contact nodes of a phase and their ground reactions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.transcription.variables import Variables, name_states
from tenscasadi.util.validate import Array, Indices


@dataclass(frozen=True, eq=False)
class ContactSet:
    """Contact nodes of a phase with the indices of their variables.

    Attributes
    ----------
    stands : tuple of int
        Contact nodes, which keep their positions during the phase.
    lands : bool
        Whether some of them land at the start of the phase, in an inelastic impact.
    held : ndarray of int, shape (3s,)
        Free coordinates of the contact nodes, whose velocities are zero.
    reactions : ndarray of int, shape (K + 1, 3s)
        Indices of the ground reactions [N] among the variables.
    impulses : ndarray of int, shape (3s,) or (0,)
        Indices of the impulses of an impact [N·s].
    arriving : ndarray of int, shape (nq,) or (0,)
        Indices of the velocities before the impact [m/s].
    force : float
        Typical reaction [N].
    """

    stands: tuple[int, ...]
    lands: bool
    held: Indices
    reactions: Indices
    impulses: Indices
    arriving: Indices
    force: float


def add_contacts(v: Variables, stands: Sequence[int], lands: bool, reactions: Array) -> ContactSet:
    """Fix contact nodes and add their reactions as variables.

    `v` are the variables of the phase, and `stands` the s contact nodes. `lands` tells whether some
    of them land at the start of the phase. `reactions` (3s,) is the initial guess of the reactions
    [N].

    Fixed coordinates are the same variables at all mesh points, so that no constraint has to fix
    them.
    """
    nq = v.model.nq
    held = v.model.entries[list(stands)].ravel()
    force = v.scales.mass * v.scales.length / v.scales.time**2
    arriving = impulses = np.zeros(0, dtype=np.intp)
    v.entries.leave_out(v.states[1:, np.concatenate([held, nq + held])])
    v.states[1:, held] = v.states[0, held]
    if lands:
        velocities = slice(nq, 2 * nq)
        arriving = v.states[0, velocities].copy()
        names = [f"{name} after the impact" for name in name_states(v.model)[velocities]]
        v.states[0, velocities] = v.entries.unknowns(
            names, v.guess.states[0, velocities], v.scales.state[velocities]
        )
        v.entries.leave_out(v.states[0, nq + held])
        impulses = v.entries.unknowns(
            reaction_names("impulse", stands), np.zeros(len(held)), force * v.scales.time
        )
    v.states[:, nq + held] = v.entries.constants(np.zeros((v.count + 1, len(held))))
    pushes = v.add_at_nodes(
        reaction_names("reaction", stands), np.tile(reactions, (v.count + 1, 1)), force
    )
    return ContactSet(tuple(stands), lands, held, pushes, impulses, arriving, force)


def build_empty_set(v: Variables) -> ContactSet:
    """Build the contact set of a phase without contact.

    `v` are the variables of the phase.
    """
    return add_contacts(v, (), False, np.zeros(0))


def reaction_names(what: str, stands: Sequence[int]) -> list[str]:
    """Name the components of reactions or impulses on nodes.

    `what` is the quantity, such as "reaction"; `stands` are the nodes.
    """
    return [f"{what} on node {node} along {axis}" for node in stands for axis in "xyz"]

"""Nodes that stand on the ground in a phase of a plan, as unknowns of its program."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.transcription.variables import Variables, state_names
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices


@dataclass(frozen=True, eq=False)
class ContactSet:
    """Nodes that stand in a phase, and the entries that hold them.

    Attributes
    ----------
    stands : nodes that keep the places of the phase's start.
    lands : whether some of them come from a flight, in an impact without rebound.
    held : their coordinates (3s,), which have no velocities.
    reactions : entries (K + 1, 3s) of the forces of the ground, N.
    impulses : entries (3s,) of the impact, N·s, or none.
    arriving : entries (nq,) of the velocities before the impact, or none.
    force : typical reaction, N.
    """

    stands: tuple[int, ...]
    lands: bool
    held: Indices
    reactions: Indices
    impulses: Indices
    arriving: Indices
    force: float


def stand(v: Variables, stands: Sequence[int], lands: bool, reactions: Array) -> ContactSet:
    """Hold the coordinates of nodes that stand, and add what the ground does to them.

    Held coordinates are the same entries at all nodes of the mesh, so no row has to hold them.

    reactions (3s,): first guess of the reactions, N.
    """
    nq = v.model.nq
    held = node_coordinates(v.model)[list(stands)].ravel()
    force = v.scales.mass * v.scales.length / v.scales.time**2
    arriving = impulses = np.zeros(0, dtype=np.intp)
    v.entries.leave_out(v.states[1:, np.concatenate([held, nq + held])])
    v.states[1:, held] = v.states[0, held]
    if lands:
        velocities = slice(nq, 2 * nq)
        arriving = v.states[0, velocities].copy()
        names = [f"{name} after the impact" for name in state_names(v.model)[velocities]]
        v.states[0, velocities] = v.entries.unknowns(
            names, v.guess.states[0, velocities], v.scales.state[velocities]
        )
        v.entries.leave_out(v.states[0, nq + held])
        impulses = v.entries.unknowns(
            reaction_names("impulse", stands), np.zeros(len(held)), force * v.scales.time
        )
    v.states[:, nq + held] = v.entries.constants(np.zeros((v.count + 1, len(held))))
    pushes = v.unknowns_at_nodes(
        reaction_names("reaction", stands), np.tile(reactions, (v.count + 1, 1)), force
    )
    return ContactSet(tuple(stands), lands, held, pushes, impulses, arriving, force)


def no_contact(v: Variables) -> ContactSet:
    """Return the contact set of a motion in which no node stands."""
    return stand(v, (), False, np.zeros(0))


def reaction_names(what: str, stands: Sequence[int]) -> list[str]:
    """Name the components of what the ground does to nodes."""
    return [f"{what} on node {node} along {axis}" for node in stands for axis in "xyz"]


def node_coordinates(model: Model) -> Indices:
    """Find the coordinates of each node (n, 3) among the free ones; −1 of those that are pinned."""
    found = np.full(3 * len(model.mechanism.physical), -1, dtype=np.intp)
    found[model.mechanism.free_index] = np.arange(model.nq)
    return found.reshape(-1, 3)

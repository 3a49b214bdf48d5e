"""Division of a planned trajectory at changes of contact.

Each part has its own equation of motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.problem.phase import Phase
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices


class MotionSpan(NamedTuple):
    """Part of a trajectory with a single equation of motion.

    Attributes
    ----------
    model : Model
        Model of the span, in which contact nodes are pinned.
    entries : ndarray of int, shape (nx',)
        Entries of the motion's states that are those of this model.
    first, last : int
        Mesh points at which the span begins and ends.
    """

    model: Model
    entries: Indices
    first: int
    last: int


def split_motion(model: Model, states: Array, phases: Sequence[Phase]) -> list[MotionSpan]:
    """Split a trajectory into the spans of its phases.

    Contact nodes are pinned at their planned positions, and no ground acts. A compliant ground
    would have no contact force in the planned states, which do not sink into it. Without phases or
    ground, there is one span.

    Parameters
    ----------
    model : Model
        Model of the motion.
    states : ndarray, shape (K + 1, nx)
        States at the mesh points. Phases have equal numbers of intervals.
    phases : sequence of Phase
        Phases of the motion.

    Returns
    -------
    list of MotionSpan
        The spans in order.
    """
    scene, intervals = model.scene, len(states) - 1
    if not (phases and scene.grounds):
        return [MotionSpan(model, np.arange(model.nx), 0, intervals)]
    ends = np.linspace(0, intervals, len(phases) + 1).astype(int)
    coordinates = model.entries
    spans = []
    for phase, first, last in zip(phases, ends[:-1], ends[1:], strict=True):
        nodes = model.nodes(states[first])[: len(scene.structure.nodes)]
        pins = dict(scene.structure.pinned) | dict.fromkeys(phase.contact_nodes, "xyz")
        structure = scene.structure.replace(nodes=nodes, pinned=pins)
        held = coordinates[list(phase.contact_nodes)].ravel()
        held = held[held >= 0]
        entries = np.delete(np.arange(model.nx), np.concatenate([held, model.nq + held]))
        own = model.with_scene(replace(scene, structure=structure, ground=None))
        spans.append(MotionSpan(own, entries, int(first), int(last)))
    return spans

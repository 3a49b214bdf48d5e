"""A ground's law in numbers of MuJoCo's soft contacts, and back.

A contact of impedance d pushes with f = d (κ r/d − a)/A at depth r, for an acceleration a that the
other forces alone would give; A is the inverse mass that MuJoCo reckons for the body. With κ = k A
that is k r − d a/A: our push, as far as d is small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.hanging import (
    Hanging,
    free_directions,
    held_directions,
    inverse_weights,
)
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.util.validate import Array

# d: the share of other forces that a contact takes away, beside its push; MuJoCo takes no less
IMPEDANCE = 1e-4
_STANDING = 3  # nodes that a body stands on


class Weights(NamedTuple):
    """Scales of contacts: the inverse mass A of each node's body, 1/kg, and the weight on a node that a body stands on, N."""

    inverse: Array
    standing: float


def contact_weights(scene: Scene, hanging: Hanging) -> Weights:
    """Return the scales of the contacts of a scene's nodes; A is 0 at nodes that do not move."""
    s = scene.modelled
    held, bars = held_directions(s), inverse_weights(s, hanging) if len(s.bars) else np.zeros(0)
    inverse = np.zeros(len(s.nodes))
    for node in range(len(s.nodes)):
        if node in hanging.owner:
            inverse[node] = bars[hanging.owner[node]]
        elif s.node_mass[node] > 0:
            inverse[node] = (
                len(free_directions(held.get(node, np.zeros((0, 3))))) / 3 / s.node_mass[node]
            )
    down = (
        9.81
        if scene.gravity is None or scene.gravity.varies
        else float(np.linalg.norm(scene.gravity.acceleration)) or 9.81
    )
    moving = np.flatnonzero(inverse)
    return Weights(
        inverse, (s.bar_mass.sum() + s.node_mass.sum()) * down / max(min(_STANDING, len(moving)), 1)
    )


def touching(ground: Ground, inverse: Array) -> list[int]:
    """Return the nodes that a ground acts on, of those that move."""
    nodes = range(len(inverse)) if ground.nodes is None else ground.nodes
    return [node for node in nodes if inverse[node] > 0]


def contact_numbers(ground: Ground, inverse: float, standing: float) -> dict[str, list[float]]:
    """Return the attributes of the contact of a node with a ground: its stiffness, damping and friction, per mass."""
    impedance = [IMPEDANCE, IMPEDANCE, IMPEDANCE, 0.5, 2.0]
    found = {
        "solref": [-ground.stiffness * inverse, -ground.damping * inverse],
        "solimp": impedance,
    }
    if ground.friction is None:
        return {"condim": [1], **found}
    slip = (
        ground.friction * standing / ground.slip_speed * inverse
    )  # as ours, for slow slip under the weight of a body that stands
    sliding = [ground.friction, ground.friction, 0.005, 0.0001, 0.0001]
    return {"condim": [3], "friction": sliding, **found, "solreffriction": [0.0, -slip]}


def ground_numbers(
    solref: Array, solreffriction: Array, friction: float | None, inverse: float, standing: float
) -> dict[str, float | None]:
    """Return stiffness, damping, friction and slip speed of the ground whose contact has these numbers."""
    stiffness, damping = _direct(solref)
    found: dict[str, float | None] = {
        "stiffness": stiffness / inverse,
        "damping": damping / inverse,
        "friction": friction,
    }
    slip = _direct(solreffriction)[1] if np.any(solreffriction) else damping
    if friction is not None and slip > 0:
        found["slip_speed"] = friction * standing / slip * inverse
    return found


def _direct(solref: Array) -> tuple[float, float]:
    """Return stiffness, 1/s², and damping, 1/s, of MuJoCo's `solref`: both negated, or a time constant and a damping ratio."""
    first, second = (float(value) for value in solref)
    if first <= 0:
        return 0.0 - first, 0.0 - second
    return 1 / (first * second) ** 2, 2 / first

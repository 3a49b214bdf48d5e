"""Conversion between `Ground` and MuJoCo's soft contacts.

A contact of impedance d has the force f = d (κ r/d − a)/A at depth r. The acceleration a is that
of the other forces alone, and A is the inverse mass that MuJoCo computes for the body. With
κ = k A the force is k r − d a/A, the force of `Ground` if d is small.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.exchange.mjcf.body_tree import (
    BodyTree,
    find_free_directions,
    find_held_directions,
    inverse_weights,
)
from tenscasadi.scene.bar_contact import BarContact
from tenscasadi.scene.ground import Ground, Surface
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.structure import Structure
from tenscasadi.util.linear_algebra import null_space
from tenscasadi.util.validate import Array

# d: fraction of the other forces that a contact cancels; MuJoCo's minimum
IMPEDANCE = 1e-4


class ContactWeights(NamedTuple):
    """Inverse masses and loads that scale MuJoCo's contact parameters.

    Attributes
    ----------
    inverse : ndarray, shape (n,)
        Inverse mass A of each node's body [1/kg].
    standing : float
        Load on one supporting node of a standing body [N].
    bars : ndarray, shape (β,)
        Inverse mass A of each bar [1/kg].
    """

    inverse: Array
    standing: float
    bars: Array


def contact_weights(scene: Scene, tree: BodyTree) -> ContactWeights:
    """Compute inverse masses and loads for contact parameters.

    The inverse mass A [1/kg] is 0 at fixed nodes. `tree` is MuJoCo's tree of the scene's bars.
    """
    s = scene.modelled
    held, bars = find_held_directions(s), inverse_weights(s, tree) if len(s.bars) else np.zeros(0)
    bodies = body_weights(s, tree)
    inverse = np.zeros(len(s.nodes))
    for node in range(len(s.nodes)):
        if node in tree.owner:
            inverse[node] = bars[tree.owner[node]]
        elif node in bodies:
            inverse[node] = bodies[node]
        elif s.node_mass[node] > 0:
            inverse[node] = (
                len(find_free_directions(held.get(node, np.zeros((0, 3))))) / 3 / s.node_mass[node]
            )
    down = (
        9.81
        if scene.gravity is None or scene.gravity.varies
        else float(np.linalg.norm(scene.gravity.acceleration)) or 9.81
    )
    moving = np.flatnonzero(inverse)
    total = s.bar_mass.sum() + s.node_mass.sum() + sum(body.mass for body in s.bodies)
    standing = max(min(3, len(moving)), 1)  # a body stands on three of its nodes
    return ContactWeights(inverse, total * down / standing, bars)


def body_weights(s: Structure, tree: BodyTree) -> dict[int, float]:
    """Compute inverse effective masses of rigid bodies by node [1/kg].

    It is the acceleration of the center of mass per unit force, averaged over all directions. Nodes
    of bars, which belong to `tree`, and pinned nodes are omitted.
    """
    found: dict[int, float] = {}
    for body in s.bodies:
        own = body.mass_properties(s.nodes[list(body.nodes)])
        nodes = [node for node in body.nodes if s.pinned.get(node) != "xyz"]
        nodes = [node for node in nodes if node not in tree.owner and node not in found]
        inertia = np.trace(own.moments) * np.eye(3) - own.moments
        M = np.zeros((6, 6))  # of the velocity of the center, and the angular velocity
        M[:3, :3], M[3:, 3:] = own.mass * np.eye(3), inertia
        for node in nodes:
            J = _point_velocity(s.nodes[node] - own.center)
            M += s.node_mass[node] * J.T @ J
        pins = [node for node in body.nodes if s.pinned.get(node) == "xyz"]
        held = [_point_velocity(s.nodes[node] - own.center) for node in pins]
        free = null_space(np.concatenate([np.zeros((1, 6)), *held]), 1e-9)
        center = free[:3]
        weight = np.trace(center @ np.linalg.solve(free.T @ M @ free, center.T)) / 3
        found |= dict.fromkeys(nodes, float(weight))
    return found


def _point_velocity(arm: Array) -> Array:
    """Build the Jacobian (3, 6) of a point's velocity.

    It multiplies the velocity of the center and the angular velocity. `arm` (3,) is the vector from
    the center to the point [m].
    """
    return np.hstack([np.eye(3), -np.cross(np.eye(3), arm)])


def list_touching(ground: Ground, s: Structure, inverse: Array) -> list[int]:
    """List the moving nodes on which a ground acts.

    `inverse` (n,) are the nodes' inverse masses [1/kg], 0 for fixed nodes.
    """
    return [node for node in ground.select_nodes(s).tolist() if inverse[node] > 0]


def contact_numbers(
    ground: Surface | BarContact, inverse: float, standing: float
) -> dict[str, list[float]]:
    """Compute MuJoCo's contact attributes of a node or bar.

    They are stiffness, damping and friction, per mass, of its contact with a ground or another bar.
    `inverse` is the inverse mass [1/kg], and `standing` the load on one supporting node [N].
    """
    impedance = [IMPEDANCE, IMPEDANCE, IMPEDANCE, 0.5, 2.0]
    found = {
        "solref": [-ground.stiffness * inverse, -ground.damping * inverse],
        "solimp": impedance,
    }
    if ground.friction is None:
        return {"condim": [1], **found}
    slip = (
        ground.friction * standing / ground.slip_speed * inverse
    )  # matches `Ground` for slow slip under the weight of a standing body
    sliding = [ground.friction, ground.friction, 0.005, 0.0001, 0.0001]
    return {"condim": [3], "friction": sliding, **found, "solreffriction": [0.0, -slip]}


def ground_numbers(
    solref: Array, solreffriction: Array, friction: float | None, inverse: float, standing: float
) -> dict[str, float | None]:
    """Compute parameters of a `Ground` from MuJoCo's contact attributes.

    They are stiffness, damping, friction and slip speed. `solref` and `solreffriction` (2,) are
    MuJoCo's attributes in normal and tangential direction. `friction` is the coefficient, None
    without friction. `inverse` is the inverse mass of the contact [1/kg], by which MuJoCo turns
    accelerations into forces. The slip speed has MuJoCo's tangential damping under the load
    `standing` on one supporting node [N].
    """
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
    """Convert MuJoCo's `solref` to stiffness [1/s²] and damping [1/s].

    `solref` is both of them negated, or a time constant and a damping ratio.
    """
    first, second = (float(value) for value in solref)
    if first <= 0:
        return 0.0 - first, 0.0 - second
    return 1 / (first * second) ** 2, 2 / first

"""Contact constraints: ground clearance and friction cones."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ocp.transcription.contact_set import ContactSet
from ocp.transcription.sparse_nlp import Block, split_symbol
from ocp.transcription.variables import Variables
from tenscasadi.scene.ground import Surface

# number of sides of the friction pyramid inside the cone; its rows are linear, and have gradients
# also at zero reaction
SIDES = 8
# fraction of the friction coefficient that plans use; at the full coefficient, nodes creep on a
# ground whose friction is a smooth function of the slip velocity
SHARE = 0.8

# minimum normal reaction, relative to the node's share of the weight; smaller ones do not keep the
# contact on a compliant ground
PRESSED = 0.1


def cone_blocks(v: Variables, contact: ContactSet, ground: Surface, least: float) -> list[Block]:
    """Build the friction-cone constraints of reactions and impulses.

    `v` are the variables of a phase, `contact` its contact nodes. Cones are about the normal of the
    ground. `least` is the minimum normal reaction [N].
    """
    place = v.states[0, contact.held].reshape(-1, 3)
    blocks = []
    for what, pushes, size, tip in (
        ("reaction", contact.reactions, contact.force, least),
        ("impulse", contact.impulses, contact.force * v.scales.time, 0.0),
    ):
        cone = friction_cone(ground, tip)
        pushed = pushes.reshape(-1, len(contact.stands), 3)
        index = np.concatenate([np.broadcast_to(place, pushed.shape), pushed], axis=2)
        names = tuple(
            f"{what} on node {node} within the cone of friction, side {side}, interval {k}"
            for k in range(len(pushed))
            for node in contact.stands
            for side in range(SIDES)
        )
        if names:
            function, index = _scaled(cone, size), index.reshape(-1, 6)
            blocks.append(Block(function, index, names, 0.0, np.inf, size, kind="path"))
    return blocks


def height_blocks(
    v: Variables, contact: ContactSet, grounds: Sequence[Surface], landing: Sequence[int]
) -> list[Block]:
    """Build the ground clearance constraints of nodes without contact.

    `v` are the variables of a phase, `contact` its contact nodes. The nodes remain above all
    grounds that act on them. The nodes `landing`, which land at the end of the phase, are on the
    ground there.
    """
    size, coordinates = v.scales.length, v.model.entries
    blocks = []
    for ground in grounds:
        acts = ground.select_nodes(v.model.scene.structure).tolist()
        off = [k for k in acts if k not in contact.stands and (coordinates[k] >= 0).all()]
        down = [node for node in off if node in landing]
        z = ca.SX.sym("z", 3)
        height = ca.Function("height", [z], [-ground.depth(z) / size])
        above = [
            (k, node)
            for k in range(1, v.count + 1)
            for node in off
            if k < v.count or node not in down
        ]
        onto = [(v.count, node) for node in down]
        for pairs, upper, text in (
            (above, np.inf, "height of node {} above the ground, interval {}"),
            (onto, 0.0, "height of node {}, which lands"),
        ):
            if pairs:
                index = np.stack([v.states[k][coordinates[node]] for k, node in pairs])
                names = tuple(text.format(node, k) for k, node in pairs)
                blocks.append(Block(height, index, names, 0.0, upper, size, kind="path"))
    return blocks


def friction_cone(ground: Surface, least: float = 0.0) -> ca.Function:
    """Build the constraints of a friction pyramid inside the cone.

    The Function is (position, reaction) → values (SIDES,), which are nonnegative inside the
    pyramid. A value is friction coefficient × normal component − component along a tangent. `least`
    is the normal reaction at the apex of the pyramid [N].
    """
    z, (place, push) = split_symbol(ca.SX, 3, 3)
    outward = ca.densify(ground.contact(place).outward)
    normal = outward / ca.norm_2(outward)
    axis = ca.if_else(
        ca.fabs(normal[0]) < 0.8, ca.DM([1, 0, 0]), ca.DM([0, 1, 0])
    )  # an axis that is not parallel to the normal
    first = ca.cross(normal, axis)
    first = first / ca.norm_2(first)
    second = ca.cross(normal, first)
    angles = (2 * np.pi * np.arange(SIDES) / SIDES).tolist()
    along = [
        np.cos(angle) * ca.dot(first, push) + np.sin(angle) * ca.dot(second, push)
        for angle in angles
    ]
    steepest = SHARE * np.cos(np.pi / SIDES) * float(ground.friction or 0.0)
    return ca.Function(
        "cone", [z], [steepest * (ca.dot(normal, push) - least) - ca.vertcat(*along)]
    )


def _scaled(function: ca.Function, size: float) -> ca.Function:
    z = ca.SX.sym("z", function.size1_in(0))
    return ca.Function(function.name(), [z], [function(z) / size])

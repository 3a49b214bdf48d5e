"""Where nodes are to the ground in a phase, and the cone of friction that its pushes stay in."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ocp.phases.motion import PhaseMotion
from ocp.transcription.sparse_nlp import Block, split_symbol
from tenscasadi.scene.ground import Surface
from tenscasadi.util.validate import Indices

# of the pyramid inside the cone: its rows are linear, and have gradients also where nothing pushes
SIDES = 8
# of the friction there is: with all of it nodes creep on a ground whose friction is smooth in the
# speed
SHARE = 0.8


def cone_blocks(motion: PhaseMotion, ground: Surface) -> list[Block]:
    """Return the rows that keep reactions, and the impulses of an impact, in the cone of friction about the ground's normal."""
    nodes = motion.stands
    place = motion.v.states[0, motion.held].reshape(-1, 3)
    time, blocks = motion.v.scales.time, []
    for what, pushes, size, least in (
        ("reaction", motion.reactions, motion.weight, motion.least_push),
        ("impulse", motion.impulses, motion.weight * time, 0.0),
    ):
        cone = friction_cone(ground, least)
        pushed = pushes.reshape(-1, len(nodes), 3)
        index = np.concatenate([np.broadcast_to(place, pushed.shape), pushed], axis=2).reshape(
            -1, 6
        )
        names = [
            f"{what} on node {node} within the cone of friction, side {side}"
            for node in nodes
            for side in range(SIDES)
        ]
        every = tuple(f"{name}, interval {k}" for k in range(len(pushed)) for name in names)
        if len(index):
            blocks.append(Block(_scaled(cone, size), index, every, 0.0, np.inf, size, kind="path"))
    return blocks


def height_blocks(
    motion: PhaseMotion, grounds: Sequence[Surface], landing: Sequence[int]
) -> list[Block]:
    """Return the rows that keep nodes which do not stand above all grounds, and put those that are `landing` onto theirs at the end."""
    v, size = motion.v, motion.v.scales.length
    blocks = []
    for ground in grounds:
        acts = (
            range(len(motion.model.scene.structure.nodes)) if ground.nodes is None else ground.nodes
        )
        off = [
            node
            for node in acts
            if node not in motion.stands and (motion.coordinates[node] >= 0).all()
        ]
        down = [node for node in off if node in landing]
        height = _scaled(_height(ground), size)
        pairs = [
            (k, node)
            for k in range(1, v.count + 1)
            for node in off
            if k < v.count or node not in down
        ]
        if pairs:
            index = np.concatenate([_places(motion, k, [node]) for k, node in pairs])
            names = tuple(
                f"height of node {node} above the ground, interval {k}" for k, node in pairs
            )
            blocks.append(Block(height, index, names, 0.0, np.inf, size, kind="path"))
        if down:
            names = tuple(f"height of node {node}, which lands" for node in down)
            blocks.append(
                Block(height, _places(motion, v.count, down), names, scale=size, kind="path")
            )
    return blocks


def friction_cone(ground: Surface, least: float = 0.0) -> ca.Function:
    """Return the Function (place, push) → rows (SIDES,), positive in a pyramid inside the cone: friction · normal part − part along a side.

    least: N, the push at the pyramid's tip.
    """
    z, (place, push) = split_symbol(ca.SX, 3, 3)
    outward = ca.densify(ground.contact(place).outward)
    normal = outward / ca.norm_2(outward)
    axis = ca.if_else(
        ca.fabs(normal[0]) < 0.8, ca.DM([1, 0, 0]), ca.DM([0, 1, 0])
    )  # any that is not along the normal
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


def _places(motion: PhaseMotion, k: int, nodes: Sequence[int]) -> Indices:
    """Return the entries (·, 3) of the places of nodes at a node of the mesh."""
    found: Indices = motion.v.states[k][motion.coordinates[list(nodes)]]
    return found


def _height(ground: Surface) -> ca.Function:
    z = ca.SX.sym("z", 3)
    return ca.Function("height", [z], [-ground.depth(z)])


def _scaled(function: ca.Function, size: float) -> ca.Function:
    z = ca.SX.sym("z", function.size1_in(0))
    return ca.Function(function.name(), [z], [function(z) / size])

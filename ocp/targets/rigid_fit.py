"""Starting points of the target search by rigid-body fits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from ocp.targets.gauss_newton import STARTS
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


def fit_start(model: Model, goals: Iterable[Any], state: Array) -> Iterator[Array]:
    """Yield states that meet the goals better than `state`.

    The first states are rigid-body motions of the whole structure that fit the goals best. In the
    last one, each node is at its goal position, irrespective of bar lengths. `state` (nx,) is the
    given state.
    """
    structure, own = model.structure, list(goals)
    nodes, velocities = model.nodes(state), model.velocities(state)
    places = [place for goal in own for place in goal.places(model.scene.structure)]
    if places and np.count_nonzero(structure.fixed.all(axis=1)) <= 1:
        for center, turn, shift in _fit_turns(nodes, structure.fixed, places):
            moved = (nodes - center) @ turn.T + center + shift
            yield _join(model, moved, velocities @ turn.T, state)
    moved = nodes.copy()
    for goal in own:
        moved = goal.move(model.scene.structure, moved)
    if not np.array_equal(moved, nodes):
        yield _join(model, moved, velocities, state)


def _fit_turns(
    nodes: Array, fixed: Any, places: list[tuple[int, int, float]]
) -> list[tuple[Array, Array, Array]]:
    """Fit rigid-body motions of nodes (n, 3) to goal positions.

    `places` are node, axis and value [m] of each prescribed coordinate. `fixed` (n, 3) marks pinned
    coordinates. Returns center, rotation and translation of up to two different fits. A pinned node
    is the center, and there is no translation then.
    """
    held = np.flatnonzero(fixed.all(axis=1))
    center = nodes[held[0]] if held.size else nodes.mean(axis=0)
    node, axis, wanted = (np.array(column) for column in zip(*places, strict=True))
    arms = nodes - center

    def residual(p: Array) -> Array:
        moved = Rotation.from_rotvec(p[:3]).apply(arms) + center
        return np.asarray((moved + (0.0 if held.size else p[3:]))[node, axis] - wanted)

    shift = np.zeros(3)
    if not held.size:
        np.add.at(shift, axis, (wanted - nodes[node, axis]) / np.bincount(axis, minlength=3)[axis])
    drawn = np.random.default_rng(0)
    turns = [np.zeros(3), *(2.0 * drawn.normal(size=(STARTS - 1, 3)))]
    found = [
        scipy.optimize.least_squares(residual, np.append(turn, shift), method="trf")
        for turn in turns
    ]
    found.sort(key=lambda one: float(one.cost))
    fits: list[tuple[Array, Array, Array]] = []
    for one in found:
        turn = Rotation.from_rotvec(one.x[:3]).as_matrix()
        if all(np.abs(turn - other).max() > 0.1 for _, other, _ in fits):
            fits.append((center, turn, np.zeros(3) if held.size else one.x[3:]))
    return fits[:2]


def _join(model: Model, nodes: Array, velocities: Array, state: Array) -> Array:
    """Build a state from nodes and velocities.

    Pinned coordinates and the clock are those of the given state.
    """
    fixed = model.structure.fixed
    own = np.where(fixed, model.nodes(state), nodes)
    moves = np.where(fixed, 0.0, velocities)
    found = model.state(model.place_dependent(own), model.place_dependent(moves))
    model.split(found).internal[:] = model.split(state).internal
    model.split(found).clock[:] = model.split(state).clock
    return found

"""States that fit the positions that goals name, as starts of the target search."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array

STARTS = 8  # rotations from which the fit starts


def fit_start(model: Model, goals: Iterable[Any], state: Array) -> Iterator[Array]:
    """Yield states that fit the goals better than a given one.

    First the whole structure is turned onto the goals; then each node moves to its own goal,
    whatever the bars.
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
    """Find the center, rotation and shift that bring nodes (n, 3) nearest to the places.

    Returns up to two different fits. A pinned node stays where it is.
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
    """Build the state of nodes and velocities, but for pinned coordinates."""
    fixed = model.structure.fixed
    own = np.where(fixed, model.nodes(state), nodes)
    found = model.state(own, np.where(fixed, 0.0, velocities))
    model.split(found)[2][:] = model.split(state)[2]
    return found

"""A motion to be shown: nodes and forces at any time, of a structure, a trajectory or rollouts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from tenscasadi.scene.strings import StringLaw
from tenscasadi.simulation.motions import Rollouts, node_positions
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Indices

MOST_COPIES = 60  # motions of rollouts that are shown, spread evenly over all


@dataclass(frozen=True, eq=False)
class Motion:
    """Nodes (T, n, 3) at times (T,), who joins them, and the forces of the strings (T, α) where they are known.

    velocities: (T, n, 3), by which nodes are interpolated between the times; None: linearly.
    copies: motions of one structure side by side.
    """

    name: str
    time: Array
    nodes: Array
    bars: Indices
    strings: Indices
    pinned: Indices
    velocities: Array | None = None
    tension: Array | None = None
    force_density: Array | None = None
    copies: int = 1

    @property
    def start(self) -> float:
        """First time, s."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Last time, s."""
        return float(self.time[-1])

    def row_at(self, time: float) -> int:
        """Return the last row at or before a time."""
        return int(
            np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 1)
        )

    def nodes_at(self, time: float) -> Array:
        """Return the nodes (n, 3), m: at the times of rows exactly those, between them cubic by the velocities (Hermite), before and after still."""
        k = self.row_at(time)
        if k + 1 >= len(self.time) or time <= self.time[k]:
            return np.asarray(self.nodes[k])
        h = float(self.time[k + 1] - self.time[k])
        s = (time - float(self.time[k])) / h
        first, second = self.nodes[k], self.nodes[k + 1]
        with np.errstate(over="ignore", invalid="ignore"):
            if self.velocities is None:
                return np.asarray(first + s * (second - first))
            slope = s * (1 - s) ** 2 * self.velocities[k] - s**2 * (1 - s) * self.velocities[k + 1]
            return np.asarray(first + s**2 * (3 - 2 * s) * (second - first) + h * slope)


def of_structure(
    structure: Structure, name: str, laws: Iterable[tuple[StringLaw, Indices]] = ()
) -> Motion:
    """Return a structure that stands still, with the forces that its rest lengths give it; `laws`: those of its strings, if not `Clip`."""
    lengths, rest, stiffness = structure.string_lengths, structure.rest_length, structure.stiffness
    tension = np.maximum(stiffness * (lengths - rest), 0.0)
    for law, some in laws:
        if law.pushes:
            tension[some] = stiffness[some] * (lengths[some] - rest[some])
        elif not law.switches:
            found = law.force_density(
                lengths[some] ** 2, rest[some], stiffness[some], None, lengths[some]
            )
            tension[some] = lengths[some] * np.asarray(found).ravel()
    with np.errstate(divide="ignore", invalid="ignore"):
        density = np.where(lengths > 0, tension / lengths, 0.0)
    pinned = np.array(sorted({*structure.pinned, *structure.rollers}), dtype=np.intp)
    still = np.zeros(1), structure.nodes[None]
    return Motion(
        name,
        *still,
        structure.bars,
        structure.strings,
        pinned,
        tension=tension[None],
        force_density=density[None],
    )


def of_trajectory(trajectory: Trajectory, name: str) -> Motion:
    """Return the motion of a trajectory."""
    t = trajectory
    return Motion(
        name, t.time, t.nodes, t.bars, t.strings, t.pinned, t.velocities, t.tension, t.force_density
    )


def of_rollouts(rollouts: Rollouts, name: str) -> Motion:
    """Return at most `MOST_COPIES` of the motions, side by side as one with that many copies of each member."""
    chosen = np.unique(
        np.linspace(0, len(rollouts.states) - 1, min(len(rollouts.states), MOST_COPIES))
        .round()
        .astype(int)
    )
    count = len(rollouts.place)
    paths = node_positions(rollouts, slice(None), chosen).swapaxes(0, 1)  # (T, copies, n, 3)
    nodes = paths.reshape(len(rollouts.time), -1, 3)
    offsets = count * np.arange(len(chosen))

    def copied(indices: Indices) -> Indices:
        return np.concatenate([indices + offset for offset in offsets])

    told = (
        f"{name}: {len(chosen)} of {len(rollouts.states)} motions"
        if len(chosen) < len(rollouts.states)
        else f"{name}: {len(chosen)} motions"
    )
    bars, strings, pinned = rollouts.bars, rollouts.strings, rollouts.pinned
    return Motion(
        told,
        rollouts.time,
        nodes,
        copied(bars),
        copied(strings),
        copied(pinned),
        copies=len(chosen),
    )


def renamed(motion: Motion, name: str) -> Motion:
    """Return the motion under another name."""
    return replace(motion, name=name)

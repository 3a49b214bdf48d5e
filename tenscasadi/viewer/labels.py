"""Numbers of nodes and members on the canvas: of all of them, or with what they bear of those that are clicked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.util.validate import Array
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.motion import Motion

if TYPE_CHECKING:
    import viser

KINDS = ("nodes", "bars", "strings")
_MOST_CLICKED = 12  # labels of those that are clicked, of which the oldest goes
_MOST_NUMBERED = 1000  # labels that pages can be asked to draw

Item = tuple[int, str, int]  # which motion, one of KINDS, which of them


class Labels:
    """Labels of a canvas; `show` moves them to a time, with the numbers of then."""

    def __init__(self, server: viser.ViserServer, canvas: Canvas) -> None:
        self._scene, self._canvas = server.scene, canvas
        self.clicked: dict[Item, Any] = {}
        self._numbered: dict[str, list[Any]] = {kind: [] for kind in KINDS}

    def toggle(self, item: Item) -> None:
        """Add the label of what was clicked, or take it away. Items that are not there, which a page can name, are passed over."""
        k, kind, index = item
        motions = self._canvas.exhibit.motions
        if not (0 <= k < len(motions) and kind in KINDS and 0 <= index < count(motions[k], kind)):
            return
        if item in self.clicked:
            self.clicked.pop(item).remove()
            return
        if len(self.clicked) == _MOST_CLICKED:
            self.clicked.pop(next(iter(self.clicked))).remove()
        self.clicked[item] = self._scene.add_label(
            f"/shown/clicked/{k} {kind} {index}", "", anchor="bottom-left"
        )

    def number(self, kind: str, shown: bool) -> None:
        """Write its number beside each of the first motion's "nodes", "bars" or "strings", or take them away."""
        for label in self._numbered[kind]:
            label.remove()
        some = min(count(self._canvas.exhibit.motions[0], kind), _MOST_NUMBERED) if shown else 0
        self._numbered[kind] = [
            self._scene.add_label(
                f"/shown/number/{kind} {index}",
                str(index),
                anchor="center-center",
                font_screen_scale=0.8,
            )
            for index in range(some)
        ]

    def show(self, time: float) -> None:
        """Move all labels to where things are at a time."""
        motions = self._canvas.exhibit.motions
        if any(self._numbered.values()):
            nodes = motions[0].nodes_at(time)
            for kind, labels in self._numbered.items():
                for label, place in zip(labels, places(motions[0], kind, nodes), strict=False):
                    label.position = tuple(place)
        for (k, kind, index), label in self.clicked.items():
            nodes = motions[k].nodes_at(time)
            label.text = describe(motions[k], kind, index, time)
            label.position = tuple(places(motions[k], kind, nodes)[index])


def count(motion: Motion, kind: str) -> int:
    """Return how many nodes, bars or strings a motion has."""
    return motion.nodes.shape[1] if kind == "nodes" else len(getattr(motion, kind))


def places(motion: Motion, kind: str, nodes: Array) -> Array:
    """Return where nodes, or the middles of members, are when the nodes are at `nodes`; what is lost lies at the origin."""
    found = nodes if kind == "nodes" else nodes[getattr(motion, kind)].mean(axis=1)
    return np.asarray(np.nan_to_num(found, posinf=0.0, neginf=0.0))


def describe(motion: Motion, kind: str, index: int, time: float) -> str:
    """Return the number of a node or member, which nodes it joins, and what it bears at a time, with units."""
    nodes = motion.nodes_at(time)
    per_copy = count(motion, kind) // motion.copies
    whose = f" of motion {index // per_copy}" if motion.copies > 1 else ""
    if kind == "nodes":
        x, y, z = nodes[index]
        lines = [f"node {index % per_copy}{whose}", f"({x:.4g}, {y:.4g}, {z:.4g}) m"]
        if motion.velocities is not None:
            lines.append(
                f"speed {np.linalg.norm(motion.velocities[motion.row_at(time), index]):.3g} m/s"
            )
        return "\n".join(lines)
    first, second = getattr(motion, kind)[index]
    in_copy = motion.nodes.shape[1] // motion.copies
    lines = [f"{kind[:-1]} {index % per_copy}{whose}, nodes {first % in_copy} – {second % in_copy}"]
    lines.append(f"length {np.linalg.norm(nodes[second] - nodes[first]):.4g} m")
    if kind == "strings" and motion.tension is not None and motion.force_density is not None:
        row = motion.row_at(time)
        tension, density = motion.tension[row, index], motion.force_density[row, index]
        lines.append(
            "slack"
            if tension == 0 and density == 0
            else f"tension {tension:.4g} N, force density {density:.4g} N/m"
        )
    return "\n".join(lines)

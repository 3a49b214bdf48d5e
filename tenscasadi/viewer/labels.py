"""Labels of nodes and members in the viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.drawing.view_content import Frame, Motion
from tenscasadi.util.validate import Array
from tenscasadi.viewer.canvas import Canvas

if TYPE_CHECKING:
    import viser

KINDS = ("nodes", "bars", "strings")

Item = tuple[int, str, int]  # index of the motion, one of KINDS, index of the item


class Labels:
    """Labels of nodes and members on a canvas."""

    def __init__(self, server: viser.ViserServer, canvas: Canvas) -> None:
        self._scene, self._canvas = server.scene, canvas
        self.clicked: dict[Item, Any] = {}
        self.numbers: dict[str, list[Any]] = {kind: [] for kind in KINDS}
        self.hovered: Item | None = None
        self._hover: Any = None

    def has(self, item: Item) -> bool:
        """Return whether a node or member exists.

        `item` is the number of a trajectory, a kind such as "bars", and an index. A browser may
        send any index.
        """
        k, kind, index = item
        motions = self._canvas.content.motions
        if not (0 <= k < len(motions) and kind in KINDS):
            return False
        return 0 <= index < motions[k].count(kind) * motions[k].copies

    def hover(self, item: Item | None) -> None:
        """Show the name of the item under the pointer.

        None removes it.
        """
        self.hovered = item if item is not None and self.has(item) else None
        if self._hover is not None:
            self._hover.remove()
            self._hover = None
        if self.hovered is not None:
            self._hover = self._scene.add_label(
                "/shown/hovered", "", anchor="bottom-left", font_screen_scale=0.9
            )

    def toggle(self, item: Item) -> None:
        """Add or remove the label of a clicked item.

        Items that do not exist are ignored, because a browser may send any index. Of more than 12 labels the
        oldest is removed.
        """
        k, kind, index = item
        if not self.has(item):
            return
        if item in self.clicked:
            self.clicked.pop(item).remove()
            return
        if len(self.clicked) == 12:
            self.clicked.pop(next(iter(self.clicked))).remove()
        name = f"/shown/clicked/{k} {kind} {index}"
        self.clicked[item] = self._scene.add_label(name, "", anchor="bottom-left")

    def number(self, kind: str, shown: bool) -> None:
        """Show or hide the names or numbers of items of a kind.

        The kind is "nodes", "bars" or "strings". At most 1000 are shown.
        """
        for label in self.numbers[kind]:
            label.remove()
        names = self._canvas.content.motions[0].names[kind][:1000] if shown else ()
        self.numbers[kind] = [
            self._scene.add_label(
                f"/shown/number/{kind} {index}",
                name.removeprefix(f"{kind[:-1]} "),
                anchor="center-center",
                font_screen_scale=0.8,
            )
            for index, name in enumerate(names)
        ]

    def update(self) -> None:
        """Move all labels to the frame that the canvas shows."""
        layers = self._canvas.layers
        for kind, labels in self.numbers.items():
            if labels:
                places = find_places(layers[0].shapes.motion, kind, layers[0].frame.nodes)
                for label, place in zip(labels, places, strict=False):
                    label.position = tuple(place)
        for item, label in self.clicked.items():
            self._place(label, item, whole=True)
        if self.hovered is not None:
            self._place(self._hover, self.hovered, whole=False)

    def _place(self, label: Any, item: Item, whole: bool) -> None:
        """Move a label to its node or member, and write its text.

        `item` is the number of a trajectory, a kind such as "bars", and an index. The text is the
        name or, if `whole`, the whole description.
        """
        k, kind, index = item
        layer = self._canvas.layers[k]
        motion = layer.shapes.motion
        told = describe_item(motion, self._canvas.frames[k], kind, index)
        label.text = told if whole else told.splitlines()[0]
        place = find_places(motion, kind, layer.frame.nodes)[index]
        label.position = tuple(place + np.asarray(layer.root.position))


def find_places(motion: Motion, kind: str, nodes: Array) -> Array:
    """Find the positions of nodes, or of the midpoints of members.

    `kind` is "nodes", "bars" or "strings", and `nodes` (n, 3) are the positions of nodes [m].
    Positions that are not finite are replaced by the origin.
    """
    places = nodes if kind == "nodes" else nodes[getattr(motion, kind)].mean(axis=1)
    known = np.asarray(np.isfinite(places).all(axis=1))
    return np.where(known[:, None], places, 0.0)


def describe_item(motion: Motion, frame: Frame, kind: str, index: int) -> str:
    """Describe a node or member: name, nodes, and quantities.

    The quantities are those of a frame. `kind` is "nodes", "bars" or "strings", and `index` counts
    the items of all copies.
    """
    copy, own = divmod(index, motion.count(kind))
    name, number = motion.names[kind][own], f"{kind[:-1]} {own}"
    if name != number:
        name += f", {number}"
    if motion.copies > 1:
        name += f" of motion {copy}"
    if kind == "nodes":
        x, y, z = frame.nodes[index]
        lines = [name, f"({x:.4g}, {y:.4g}, {z:.4g}) m"]
        if frame.velocities is not None:
            lines.append(f"speed {np.linalg.norm(frame.velocities[index]):.3g} m/s")
        return "\n".join(lines)
    first, second = getattr(motion, kind)[index]
    ends = [motion.names["nodes"][node % motion.count("nodes")] for node in (first, second)]
    lines = [
        f"{name}, {ends[0]} – {ends[1].removeprefix('node ')}",
        f"length {np.linalg.norm(frame.nodes[second] - frame.nodes[first]):.4g} m",
    ]
    if kind == "strings" and frame.tension is not None and frame.force_density is not None:
        tension, density = frame.tension[index], frame.force_density[index]
        forces = f"tension {tension:.4g} N, force density {density:.4g} N/m"
        lines.append("broken" if np.isnan(tension) else forces if tension or density else "slack")
    return "\n".join(lines)

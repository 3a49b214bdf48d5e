"""A live motion on the canvas: the structure, the colours of its strings, and an arrow from a node that is pulled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.util.validate import Array
from tenscasadi.viewer.canvas import QUANTITIES, Canvas
from tenscasadi.viewer.colours import OBSTACLE, Scale, linear
from tenscasadi.viewer.exhibit import exhibit_of
from tenscasadi.viewer.legend import legend
from tenscasadi.viewer.live_mode.simulation import LiveSimulation

if TYPE_CHECKING:
    import viser

_FULL = 1.05  # beyond so much of its largest value a scale of colours grows


class Stage:
    """A simulation on the scene of a viser server: `show` brings it to the present state.

    Attributes
    ----------
    followed : bool
        Whether the middle of the structure stays where it is at the start: by default where nothing
        holds it against gravity.
    colour : str
        What the colour of strings tells.
    """

    def __init__(self, server: viser.ViserServer, simulation: LiveSimulation) -> None:
        self.simulation = simulation
        self.canvas = Canvas(server, exhibit_of(simulation.model.scene))
        self.layer = self.canvas.layers[0]
        scene = simulation.model.scene
        held = (
            bool(scene.grounds)
            or scene.gravity is None
            or bool(scene.structure.fixed.any())
            or bool(scene.structure.rollers)
        )
        self.followed, self.colour = (
            not held,
            "tension",
        )  # what falls without end would be out of sight
        self._root = self.canvas.root
        self._grounded, self._shift = bool(scene.grounds), np.zeros(3)
        self._middle = simulation.nodes.mean(axis=0)
        radius = self.canvas.radius
        self._arrow = server.scene.add_arrows(
            "/shown/pull",
            np.zeros((1, 2, 3)),
            linear(OBSTACLE),
            shaft_radius=0.6 * radius,
            head_radius=1.5 * radius,
            head_length=4.0 * radius,
            visible=False,
        )
        self.recolour("tension")
        self.show()

    def recolour(self, colour: str) -> None:
        """Colour strings by "tension" or "force density"; the scale begins anew."""
        self.colour = colour
        self.canvas.scale = None
        self._grow()

    def legend(self) -> str:
        """Return the legend, as HTML."""
        return legend(self.canvas)

    def show(self) -> bool:
        """Show the present state; tell whether the legend has changed."""
        simulation = self.simulation
        nodes, changed = simulation.nodes, self._grow()
        away = self._middle - nodes.mean(axis=0) if self.followed else np.zeros(3)
        # Pages move a frame and what is in it one picture apart, which shows in a fast fall: a
        # ground alone needs the frame.
        self._root.position = tuple(away) if self._grounded else (0.0, 0.0, 0.0)
        self._shift = np.zeros(3) if self._grounded else away
        nodes = nodes + self._shift
        values, scale = self._values(), self.canvas.scale
        if scale is None:
            self.layer.update(nodes)
        else:
            self.layer.update(nodes, scale.colours(values), values != 0)
        pull = simulation.pull
        self._arrow.visible = pull is not None
        if pull is not None:
            self._arrow.points = np.array(
                [nodes[pull.node], pull.target + self._shift], dtype=np.float32
            )[None]
        return changed

    def place(self, seen: Any) -> Array:
        """Return where a point that a page sees is in the coordinates of the structure."""
        return np.asarray(seen, dtype=float) - np.asarray(self._root.position) - self._shift

    def node_at(self, part: str, index: int, seen: Any) -> int:
        """Return the node of the structure nearest to a point of one of the "nodes", "bars" or "strings" that a page has got hold of."""
        structure = self.simulation.model.structure
        pullable = self.simulation.pullable
        ends = np.array([index]) if part == "nodes" else np.asarray(getattr(structure, part))[index]
        ends = ends[(ends < len(pullable)) & pullable[np.minimum(ends, len(pullable) - 1)]]
        if not len(ends):
            raise ValueError(f"nothing of {part}[{index}] can be pulled")
        away = self.simulation.nodes[ends] - self.place(seen)
        return int(ends[np.argmin(np.einsum("ij,ij->i", away, away))])

    def _values(self) -> Array:
        return np.nan_to_num(
            self.simulation.observed["tension" if self.colour == "tension" else "force_density"]
        )

    def _grow(self) -> bool:
        """Fit the scale to the largest force so far; tell whether it, or what there is besides, has changed."""
        values, scale = self._values(), self.canvas.scale
        label, unit = QUANTITIES[self.colour]
        if not values.size or (scale is None and not np.any(values)):
            return False
        now = Scale.of(label, unit, [values])
        if scale is None:
            self.canvas.scale = now
            return True
        larger = now.largest > _FULL * scale.largest
        if not larger and now.slack <= scale.slack and now.pushing <= scale.pushing:
            return False
        largest = now.largest if larger else scale.largest
        self.canvas.scale = Scale(
            label,
            unit,
            largest,
            scale.slack or now.slack,
            scale.pushing or now.pushing,
            min(scale.least, now.least),
        )
        return True

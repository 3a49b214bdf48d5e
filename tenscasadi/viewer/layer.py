"""One structure on the canvas: bars and strings as cylinders, joints as balls, pins as cones, moved by a few arrays a frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.util.validate import Array, Indices
from tenscasadi.viewer.colours import BAR, JOINT, NODE, PIN, SLACK, Bytes, Rgb, linear
from tenscasadi.viewer.poses import (
    Poses,
    ball,
    coarse,
    cone,
    cylinder,
    member_poses,
    node_places,
    octahedron,
)

if TYPE_CHECKING:
    import viser

_MANY = 400  # members beyond which they get fewer sides
_TURN = 2.0**-13  # what turns are rounded to where places are
_STILL = np.array([(1.0, 0.0, 0.0, 0.0)])


@dataclass(frozen=True)
class Look:
    """How thick bars are, m, and in which colour a motion is seen through, None: solid, bars dark, strings by what they bear."""

    radius: float
    ghost: Rgb | None = None
    opacity: float | None = None


class Layer:
    """Bars, strings, joints and pins under the name `name` of a scene's tree; `update` moves them.

    Each kind is one batch of copies of one mesh: a frame is a handful of arrays, whatever the
    number of members.

    Attributes
    ----------
    grain : float
        What places and lengths are rounded to, m; 0: not at all.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        nodes: Array,
        bars: Indices,
        strings: Indices,
        pinned: Indices,
        look: Look,
    ) -> None:
        self._bars, self._strings, self._pinned, self._look = bars, strings, pinned, look
        self.grain = 0.0
        self.root = scene.add_frame(name, show_axes=False)
        many = len(bars) + len(strings) > _MANY
        ends, meeting = np.unique(bars, return_counts=True)
        colours = np.tile(np.array(NODE, dtype=np.uint8), (len(nodes), 1))
        colours[ends[meeting > 1]] = JOINT
        sizes = np.full(len(nodes), 0.8 * look.radius)
        sizes[ends] = np.where(meeting > 1, 1.5, 1.15) * look.radius
        if look.ghost is not None:
            colours[:] = look.ghost
        add = self._batch
        self.bars = add(
            scene, f"{name}/bars", cylinder(4 if many else 12), len(bars), look.ghost or BAR
        )
        self.strings = add(
            scene, f"{name}/strings", cylinder(3 if many else 6), len(strings), look.ghost or SLACK
        )
        self.nodes = add(
            scene,
            f"{name}/nodes",
            octahedron() if many else ball(),
            len(nodes),
            colours,
            np.repeat(sizes[:, None], 3, axis=1),
        )
        self.pins = add(
            scene,
            f"{name}/pins",
            cone(),
            len(pinned),
            look.ghost or PIN,
            np.full((len(pinned), 3), 2.2 * look.radius),
        )
        self.update(nodes)

    def update(self, nodes: Array, string_colours: Bytes | None = None, taut: Any = True) -> None:
        """Move to nodes (n, 3), m. Strings take colours (α, 3), and are thin where they are not `taut` (α,)."""
        look = self._look
        self._turn(self.bars, member_poses(nodes, self._bars, look.radius))
        self._turn(
            self.strings, member_poses(nodes, self._strings, np.where(taut, 0.4, 0.2) * look.radius)
        )
        if self.strings is not None and string_colours is not None and look.ghost is None:
            self.strings.batched_colors = linear(string_colours)
        if self.nodes is not None:
            self.nodes.batched_positions = coarse(node_places(nodes), self.grain)
        if self.pins is not None:
            self.pins.batched_positions = coarse(node_places(nodes[self._pinned]), self.grain)

    def _turn(self, batch: Any, poses: Poses) -> None:
        """Bring the copies of a batch into poses."""
        if batch is not None:
            batch.batched_positions = coarse(poses.places, self.grain)
            batch.batched_wxyzs = coarse(poses.turns, _TURN if self.grain else 0.0)
            batch.batched_scales = coarse(poses.scales, self.grain)

    def _batch(
        self,
        scene: viser.SceneApi,
        name: str,
        mesh: Any,
        count: int,
        colour: Any,
        scales: Any = None,
    ) -> Any:
        """Add `count` copies of a mesh; None where there are none."""
        if not count:
            return None
        return scene.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            np.repeat(_STILL, count, axis=0),
            np.zeros((count, 3)),
            batched_scales=np.ones((count, 3)) if scales is None else scales,
            batched_colors=np.broadcast_to(linear(colour), (count, 3)),
            opacity=self._look.opacity,
            lod="off",
            material="toon5",
            cast_shadow=False,
            receive_shadow=False,
        )

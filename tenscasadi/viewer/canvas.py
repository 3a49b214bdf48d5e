"""Content of a picture on the scene of a server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.meshes import (
    Mesh,
    Poses,
    build_ball,
    build_cone,
    build_cylinder,
    place_balls,
    stretch_cylinders,
)
from tenscasadi.drawing.scenery import cut_ground, find_box_edges, find_view
from tenscasadi.drawing.shapes import MotionShapes, Shape, choose_tint
from tenscasadi.drawing.style import STYLE, Bytes, Rgb
from tenscasadi.drawing.view_content import Frame, ViewContent
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    import viser

PARTS = ("bars", "strings", "nodes", "supports")  # shapes of a motion, in their order
VIEW_MARGIN = 0.7  # of grounds around all motions, relative to their size
_FIELD_OF_VIEW = np.radians(40.0)


class Layer:
    """Shapes of one motion on a server's scene.

    Each part is one batch of copies of a mesh, so that a frame consists of a few arrays.

    Attributes
    ----------
    batches : dict of str to viser handle
        Batches by the name of the part.
    frame : Frame
        Last drawn frame.
    """

    def __init__(self, scene: viser.SceneApi, name: str, content: ViewContent, index: int) -> None:
        self.tint = choose_tint(content, index)
        self.shapes = MotionShapes(content, index, self.tint)
        motion = self.shapes.motion
        self.root = scene.add_frame(name, show_axes=False)
        many = len(motion.bars) + len(motion.strings) > 400
        self._meshes = {
            "bars": build_cylinder(4 if many else 12),
            "strings": build_cylinder(3 if many else 6),
            "nodes": build_ball(2, 4) if many else build_ball(),
            "supports": build_cone(),
        }
        opaque = self.tint is None
        self._opacity = None if opaque else 0.4 if motion.copies == 1 else 0.25
        self._scene, self.grain = scene, 0.0
        self.batches: dict[str, Any] = {}
        self.frame = motion.frame_at(motion.start)
        self.draw(self.frame, None, None)

    def draw(self, frame: Frame, values: Array | None, scale: ColorScale | None) -> None:
        """Draw a frame, with strings colored by their values."""
        self.frame = frame
        for part, shape in zip(PARTS, self.shapes.at_rest(frame.nodes, values, scale), strict=True):
            if len(shape.points):
                self._draw_part(part, shape)

    def _draw_part(self, part: str, shape: Shape) -> None:
        place = stretch_cylinders if shape.form == "member" else place_balls
        poses = place(shape.points, shape.radius).round(self.grain)
        colors = linearize_colors(shape.colors)
        batch = self.batches.get(part)
        if batch is None:
            name = f"{self.root.name}/{part}"
            self.batches[part] = add_batch(
                self._scene, name, self._meshes[part], poses, colors, self._opacity
            )
            return
        batch.batched_positions = poses.positions
        if shape.form == "member":
            batch.batched_wxyzs = poses.quaternions
            batch.batched_scales = poses.scales
        if part == "strings" and not np.array_equal(batch.batched_colors, colors):
            batch.batched_colors = colors


class Canvas:
    """Content of a picture on the scene of a viser server.

    All of it is below /shown, whose frame moves against the motion while it is followed.

    Parameters
    ----------
    server : viser.ViserServer
        Server.
    content : ViewContent
        Content.
    quantity : {"tension", "force density"}
        Quantity that colors the strings.
    """

    def __init__(
        self, server: viser.ViserServer, content: ViewContent, quantity: str = "tension"
    ) -> None:
        self.content, self.quantity = content, quantity
        self.frames = [motion.frame_at(motion.start) for motion in content.motions]
        self.followed = False
        scene = server.scene
        _add_lights(scene)
        self.root = scene.add_frame("/shown", show_axes=False)
        _add_surroundings(scene, content)
        self.layers = [
            Layer(scene, f"/shown/motion {k}", content, k) for k in range(len(content.motions))
        ]
        _place_camera(server, content)
        self.scale: ColorScale | None = None
        self.color_by(quantity)
        self._shift = np.zeros(3)
        self._start = self.layers[0].frame.nodes.mean(axis=0)
        # Pages move a frame and its children one picture apart, which is visible in a fast fall:
        # only surroundings require that the frame moves.
        self._moves_root = bool(
            content.grounds or content.obstacles or content.boxes or len(content.targets)
        )

    @property
    def has_joints(self) -> bool:
        """Whether bars of the first motion share nodes."""
        return bool(len(self.layers[0].shapes.joints))

    def color_by(self, quantity: str) -> None:
        """Color strings by a quantity, with one scale for all times."""
        self.quantity, first = quantity, self.content.motions[0]
        values = first.tension if quantity == "tension" else first.force_density
        has_forces = values is not None and np.any(np.nan_to_num(values))
        self.scale = ColorScale.of(quantity, values) if has_forces else None  # type: ignore[arg-type]

    def show(self, time: float) -> None:
        """Show all motions at a time [s], or at their nearest end."""
        self.draw([motion.frame_at(time) for motion in self.content.motions])

    def draw(self, frames: Sequence[Frame]) -> None:
        """Show a frame of each motion."""
        self.frames = list(frames)
        away = self._start - frames[0].nodes.mean(axis=0) if self.followed else np.zeros(3)
        away = away if np.isfinite(away).all() else np.zeros(3)
        self.root.position = tuple(away if self._moves_root else np.zeros(3))
        self._shift = np.zeros(3) if self._moves_root else away
        for frame, layer in zip(frames, self.layers, strict=True):
            if layer.root.visible:
                values = None if self.scale is None else frame.values(self.quantity)
                layer.draw(frame._replace(nodes=frame.nodes + self._shift), values, self.scale)

    def locate(self, seen: Any) -> Array:
        """Convert a position on the page to the coordinates of the motion [m]."""
        return np.asarray(seen, dtype=float) - np.asarray(self.root.position) - self._shift

    def shift(self, position: Any) -> Array:
        """Convert a position of the motion to the coordinates of the layers [m]."""
        return np.asarray(position, dtype=float) + self._shift


def add_batch(
    scene: viser.SceneApi,
    name: str,
    mesh: Mesh,
    poses: Poses,
    colors: Bytes,
    opacity: float | None,
) -> Any:
    """Add copies of a mesh with poses and colors."""
    return scene.add_batched_meshes_simple(
        name,
        mesh.vertices,
        mesh.faces,
        poses.quaternions,
        poses.positions,
        batched_scales=poses.scales,
        batched_colors=colors,
        opacity=opacity,
        lod="off",
        material="toon5",
        cast_shadow=False,
        receive_shadow=False,
    )


def linearize_colors(colors: Bytes | Rgb) -> Bytes:
    """Convert sRGB colors to linear light, which viser expects of copies."""
    fractions = np.asarray(colors, dtype=float) / 255
    linear = np.where(fractions <= 0.04045, fractions / 12.92, ((fractions + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255 * linear), dtype=np.uint8)


def _add_surroundings(scene: viser.SceneApi, content: ViewContent) -> None:
    low, high = find_view(content, VIEW_MARGIN)
    thin: dict[str, Any] = {"thickness_units": "screen"}
    lift = np.array([0.0, 0.0, 1e-3 * content.size])  # else the surface hides parts of the grid
    for k, ground in enumerate(content.grounds):
        patch = cut_ground(ground, low, high)
        if patch is None:
            continue
        scene.add_mesh_simple(
            f"/shown/ground/{k}",
            patch.vertices,
            patch.faces,
            color=STYLE.ground,
            opacity=0.85,
            side="double",
            material="toon5",
            cast_shadow=False,
            receive_shadow=False,
        )
        scene.add_line_segments(
            f"/shown/ground/{k}/grid", patch.lines + lift, STYLE.grid, thickness=1.0, **thin
        )
    for k, (center, radius) in enumerate(content.obstacles):
        scene.add_icosphere(
            f"/shown/obstacle/{k}",
            radius=float(radius),
            color=STYLE.obstacle,
            position=np.asarray(center, dtype=float),
            opacity=0.6,
            subdivisions=4,
            material="toon5",
            cast_shadow=False,
        )
    for k, box in enumerate(content.boxes):
        edges = find_box_edges(box, *content.corners)
        if len(edges):
            scene.add_line_segments(f"/shown/box/{k}", edges, STYLE.obstacle, thickness=2.0, **thin)
    if len(content.targets):
        sizes = np.full(len(content.targets), 2.5 * content.bar_radius)
        colors = np.tile(linearize_colors(STYLE.target), (len(sizes), 1))
        poses = place_balls(content.targets, sizes)
        add_batch(scene, "/shown/target", build_ball(), poses, colors, 0.45)


def _place_camera(server: viser.ViserServer, content: ViewContent) -> None:
    """Look at the middle from the front, slightly from above and the side.

    Flat content is seen from its broad side.
    """
    low, high = content.corners
    for center, radius in content.obstacles:
        low = np.minimum(low, np.asarray(center) - radius)
        high = np.maximum(high, np.asarray(center) + radius)
    extent = high - low
    size = float(np.linalg.norm(extent))
    broadside = [(1.0, -0.3, 0.2), (0.3, -1.0, 0.2), (0.2, -0.5, 1.0)]
    flat = extent.min() < 0.05 * extent.max()
    direction = broadside[int(np.argmin(extent))] if flat else (0.45, -1.0, 0.35)
    distance = 0.62 * size / np.tan(_FIELD_OF_VIEW / 2)
    aside = np.cross(direction, (0.0, 0.0, 1.0))  # the panel is at the right
    middle = (low + high) / 2 - 0.13 * size * aside / np.linalg.norm(aside)
    camera = server.initial_camera
    camera.fov = float(_FIELD_OF_VIEW)
    camera.look_at = middle
    camera.position = middle + distance * np.array(direction) / np.linalg.norm(direction)
    camera.near = float(0.01 * size)
    camera.far = float(100 * size)


def _add_lights(scene: viser.SceneApi) -> None:
    """Light the scene evenly, so that colors look as in the legend."""
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_light_ambient("/light/all", intensity=1.7)
    scene.add_light_directional("/light/front", intensity=1.6, position=(0.6, -1.0, 1.2))
    scene.add_light_directional("/light/back", intensity=0.6, position=(-0.8, 1.0, 0.6))

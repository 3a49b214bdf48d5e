"""3-D scene of the viewer: members, grounds, arrows, camera, lights."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.meshes import (
    Mesh,
    Poses,
    build_arrowhead,
    build_ball,
    build_cone,
    build_cylinder,
    place_balls,
    stretch_cylinders,
)
from tenscasadi.drawing.scenery import (
    cut_ground,
    find_box_edges,
    find_floor,
    find_view,
    grid_spacing,
)
from tenscasadi.drawing.shapes import PARTS, DrawnShape, MotionShapes, choose_tint
from tenscasadi.drawing.style import STYLE, Bytes, Rgb, linearize_colors
from tenscasadi.drawing.view_content import Frame, ViewContent
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.renamed import lazy_module
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    import viser

spatial = lazy_module("scipy.spatial")
_FIELD_OF_VIEW = np.radians(40.0)


class Layer:
    """Meshes of one trajectory in the viewer's 3-D scene.

    Each part is one batch of copies of a mesh, so that a frame consists of a few arrays.

    Attributes
    ----------
    batches : dict of str to viser handle
        Batches by the name of the part, such as "bars", "load shafts" and "load heads".
    frame : Frame
        Last drawn frame.
    """

    def __init__(self, scene: viser.SceneApi, name: str, content: ViewContent, index: int) -> None:
        self._content, self._index = content, index
        self.batches: dict[str, Any] = {}
        self.paint(choose_tint(content, index))
        motion = self.shapes.motion
        self.root = scene.add_frame(name, show_axes=False)
        many = len(motion.bars) + len(motion.strings) > 400
        self._meshes = {
            "bars": build_cylinder(4 if many else 12),
            "strings": build_cylinder(3 if many else 6),
            "nodes": build_ball(2, 4) if many else build_ball(),
            "supports": build_cone(),
        }
        self._scene, self.grain = scene, 0.0
        for forces in motion.forces:
            self._meshes[f"{forces.name} shafts"] = build_cylinder(8)
            self._meshes[f"{forces.name} heads"] = build_arrowhead()
        self.frame = motion.frame_at(motion.start)
        self.draw(self.frame, None)

    def paint(self, tint: Rgb | None) -> None:
        """Choose one color for all meshes; None restores their own.

        `tint` is this color. Meshes of one color are transparent.
        """
        self.tint = tint
        self.shapes = MotionShapes(self._content, self._index, tint)
        copies = self.shapes.motion.copies
        self._opacity = None if tint is None else 0.4 if copies == 1 else 0.25
        for name, batch in self.batches.items():
            if not name.startswith("body "):
                batch.opacity, batch.cast_shadow = self._opacity, tint is None

    def draw(self, frame: Frame, scale: ColorScale | None, kinds: Collection[str] = ()) -> None:
        """Draw a frame, with arrows for some kinds of forces.

        The color scale colors the strings, if it is given.
        """
        self.frame = frame
        shapes = self.shapes.build(frame, scale, kinds)
        for part, shape in zip(PARTS, shapes, strict=False):
            if len(shape.points):
                self._draw_part(part, shape)
        arrows = [shape for shape in shapes if shape.form == "arrow"]
        for forces, shape in zip(self.shapes.motion.forces, arrows, strict=True):
            self._draw_arrows(forces.name, shape)
        self._draw_hulls(frame.nodes)

    def _draw_part(self, part: str, shape: DrawnShape) -> None:
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
        if not np.array_equal(batch.batched_colors, colors):
            batch.batched_colors = colors

    def _draw_hulls(self, nodes: Array) -> None:
        """Move the hulls of rigid bodies with their nodes.

        The nodes are (n, 3) [m].
        """
        start = self.shapes.motion.nodes[0]
        for k, hull in enumerate(self.shapes.hulls):
            own = np.unique(hull)
            mean, center = start[own].mean(axis=0), nodes[own].mean(axis=0)
            name = f"body {k}"
            if name not in self.batches:
                self.batches[name] = self._scene.add_mesh_simple(
                    f"{self.root.name}/{name}",
                    start[own] - mean,
                    np.searchsorted(own, hull),
                    color=STYLE.body if self.tint is None else self.tint,
                    opacity=STYLE.body_opacity,
                    side="double",
                    material="toon5",
                    cast_shadow=False,
                    receive_shadow=False,
                )
            turn = fit_rotation(start[own] - mean, nodes[own] - center)
            x, y, z, w = spatial.transform.Rotation.from_matrix(turn).as_quat()
            self.batches[name].position, self.batches[name].wxyz = tuple(center), (w, x, y, z)

    def _draw_arrows(self, kind: str, shape: DrawnShape) -> None:
        """Draw arrows as a batch of shafts and one of heads.

        `shape` contains their ends, and `kind` is that of the forces. Nodes without an arrow have
        copies of no size. Arrows of viser take much more time on pages that draw in software.
        """
        count, shown = len(self.frame.nodes), len(shape.points)
        ends, radius = np.zeros((count, 2, 3)), np.zeros(count)
        ends[:shown], radius[:shown] = shape.points, shape.radius
        along = ends[:, 1] - ends[:, 0]
        lengths = np.linalg.norm(along, axis=1)
        heads = np.minimum(6 * radius, 0.5 * lengths) / np.where(lengths > 0, lengths, 1.0)
        necks = ends[:, 1] - heads[:, None] * along
        colors = np.tile(np.array(getattr(STYLE, kind), dtype=np.uint8), (count, 1))
        shafts = np.stack([ends[:, 0], necks], axis=1)
        tips = np.stack([necks, ends[:, 1]], axis=1)
        for part, members, size in (("shafts", shafts, radius), ("heads", tips, 2.5 * radius)):
            name = f"{kind} {part}"
            if shown or name not in self.batches:
                self._draw_part(name, DrawnShape("member", members, size, colors))
            if self.batches[name].visible != bool(shown):
                self.batches[name].visible = bool(shown)


class Canvas:
    """3-D scene of a viser server that shows trajectories.

    All of it is below the scene node /shown, whose frame moves against the trajectory to follow it.

    Parameters
    ----------
    server : viser.ViserServer
        Server.
    content : ViewContent
        Content.
    quantity : {"tension", "force density"}
        Quantity that colors the strings.
    apart : bool
        Whether the motions are side by side.

    Attributes
    ----------
    shaded : bool
        Whether opaque structures cast shadows on grounds.
    kinds : set of str
        Kinds of forces that are drawn as arrows.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        content: ViewContent,
        quantity: str = "tension",
        apart: bool = False,
    ) -> None:
        self.content, self.quantity, self.shaded = content, quantity, False
        self.frames = [motion.frame_at(motion.start) for motion in content.motions]
        self.followed, self.kinds = False, {"load", "contact"}
        scene = server.scene
        self._sun = _add_lights(scene)
        self.root = scene.add_frame("/shown", show_axes=False)
        self.layers = [
            Layer(scene, f"/shown/motion {k}", content, k) for k in range(len(content.motions))
        ]
        self._scene = scene
        self.arrange(apart)
        _place_camera(server, content, self._distance * (len(self.layers) - 1) if apart else 0.0)
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
    def margin(self) -> float:
        """Margin of grounds around all trajectories, relative to their size."""
        return 0.15 if self.apart else 0.7

    @property
    def _distance(self) -> float:
        """Distance between trajectories that are shown side by side [m]."""
        low, high = find_view(self.content, self.margin)
        return float(high[0] - low[0])

    def arrange(self, apart: bool) -> None:
        """Show trajectories side by side along x, or superimposed.

        `apart` selects side by side. Then each has its own grounds and obstacles.
        """
        self.apart, self._sun.cast_shadow = apart, self.shaded
        for k, layer in enumerate(self.layers):
            offset = np.array([k * self._distance if apart else 0.0, 0.0, 0.0])
            layer.root.position = tuple(offset)
            is_single = layer.shapes.motion.copies == 1
            layer.paint(None if apart and is_single else choose_tint(self.content, k))
            around = f"/shown/around {k}"
            if apart or k == 0:
                self._scene.add_frame(around, show_axes=False, position=tuple(offset))
                _add_surroundings(self._scene, around, self.content, self.margin, self.shaded)
            else:
                self._scene.remove_by_name(around)

    def cast_shadows(self, shaded: bool) -> None:
        """Show shadows on grounds if `shaded`, else hide them."""
        self.shaded = shaded
        self.arrange(self.apart)

    @property
    def has_joints(self) -> bool:
        """Whether bars of the first structure share nodes."""
        return bool(len(self.layers[0].shapes.joints))

    def color_by(self, quantity: str) -> None:
        """Color strings by a quantity, with one scale for all times.

        The quantity is "tension" or "force density".
        """
        self.quantity, first = quantity, self.content.motions[0]
        values = first.tension if quantity == "tension" else first.force_density
        has_forces = values is not None and np.any(np.nan_to_num(values))
        self.scale = ColorScale.of(quantity, values) if has_forces else None  # type: ignore[arg-type]

    def show(self, time: float) -> None:
        """Show all trajectories at a time [s], or at their nearest end."""
        self.draw([motion.frame_at(time) for motion in self.content.motions])

    def draw(self, frames: Sequence[Frame]) -> None:
        """Show one frame of each trajectory."""
        self.frames = list(frames)
        away = self._start - frames[0].nodes.mean(axis=0) if self.followed else np.zeros(3)
        away = away if np.isfinite(away).all() else np.zeros(3)
        self.root.position = tuple(away if self._moves_root else np.zeros(3))
        self._shift = np.zeros(3) if self._moves_root else away
        for frame, layer in zip(frames, self.layers, strict=True):
            if layer.root.visible:
                layer.draw(frame._replace(nodes=frame.nodes + self._shift), self.scale, self.kinds)

    def locate(self, seen: Any) -> Array:
        """Convert a position in the viewer to structure coordinates [m].

        `seen` (3,) is the position.
        """
        return np.asarray(seen, dtype=float) - np.asarray(self.root.position) - self._shift

    def shift(self, position: Any) -> Array:
        """Convert structure coordinates to those of the drawn meshes [m].

        Both are (…, 3).
        """
        return np.asarray(position, dtype=float) + self._shift


def add_batch(
    scene: viser.SceneApi,
    name: str,
    mesh: Mesh,
    poses: Poses,
    colors: Bytes,
    opacity: float | None,
) -> Any:
    """Add copies of a mesh with poses and colors.

    `name` is that of the batch. Without `opacity` (0 to 1) they are opaque. Returns viser's handle.
    """
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
        cast_shadow=opacity is None,
        receive_shadow=False,
    )


def _add_surroundings(
    scene: viser.SceneApi, root: str, content: ViewContent, margin: float, shaded: bool
) -> None:
    """Add grounds, obstacles and targets to the 3-D scene.

    `root` is the start of their names. `margin` is the width of the ground around the content,
    relative to its size. Grounds show shadows if `shaded`.
    """
    low, high = find_view(content, margin)
    thin: dict[str, Any] = {"thickness_units": "screen"}
    lift = np.array([0.0, 0.0, 1e-3 * content.size])  # else the surface hides parts of the grid
    for k, ground in enumerate(content.grounds or (find_floor(content),)):
        patch = cut_ground(ground, low, high)
        if patch is None:
            continue
        scene.add_mesh_simple(
            f"{root}/ground {k}",
            patch.vertices,
            patch.faces,
            color=STYLE.ground,
            opacity=0.85 if content.grounds else 0.0,
            side="double",
            material="toon5",
            cast_shadow=False,
            receive_shadow=STYLE.shadow if shaded else False,
        )
        scene.add_line_segments(
            f"{root}/ground {k}/grid", patch.lines + lift, STYLE.grid, thickness=1.0, **thin
        )
    _add_axes(scene, f"{root}/axes", content)
    for k, (center, radius) in enumerate(content.obstacles):
        scene.add_icosphere(
            f"{root}/obstacle {k}",
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
            scene.add_line_segments(f"{root}/box {k}", edges, STYLE.obstacle, thickness=2.0, **thin)
    if len(content.targets):
        sizes = np.full(len(content.targets), 2.5 * content.bar_radius)
        colors = np.tile(linearize_colors(STYLE.target), (len(sizes), 1))
        poses = place_balls(content.targets, sizes)
        add_batch(scene, f"{root}/target", build_ball(), poses, colors, 0.45)


def _add_axes(scene: viser.SceneApi, root: str, content: ViewContent) -> None:
    """Add labeled coordinate axes at the content's lower corner.

    `root` is the start of their names.
    """
    corner, length = content.corners[0], grid_spacing(content.size, 4)
    corner = corner + [0.0, 0.0, 0.02 * content.size]  # above a ground
    tips = corner + length * np.eye(3)
    ends = np.stack([np.tile(corner, (3, 1)), tips], axis=1)
    scene.add_line_segments(root, ends, STYLE.node, thickness=2.0, thickness_units="screen")
    for name, tip in zip("xyz", tips, strict=True):
        text = f"{name}, {length:g} m" if name == "x" else name
        scene.add_label(
            f"{root}/{name}",
            text,
            position=tuple(tip),
            font_screen_scale=0.8,
            anchor="bottom-left",
        )


def _place_camera(server: viser.ViserServer, content: ViewContent, more: float) -> None:
    """Place the camera in front of the content, slightly above and to the side.

    Flat structures are seen from their broad side. `more` is the width of further trajectories [m].
    Pages that are too narrow for this get a camera of their own.
    """
    low, high = content.corners
    for center, radius in content.obstacles:
        low = np.minimum(low, np.asarray(center) - radius)
        high = np.maximum(high, np.asarray(center) + radius)
    extent = high - low
    high = high + [more, 0.0, 0.0]
    size, middle = float(np.linalg.norm(high - low)), (low + high) / 2
    broadside = [(1.0, -0.3, 0.2), (0.3, -1.0, 0.2), (0.2, -0.5, 1.0)]
    flat = extent.min() < 0.05 * extent.max()
    direction = np.array(broadside[int(np.argmin(extent))] if flat else (0.45, -1.0, 0.35))
    direction /= np.linalg.norm(direction)
    aside = np.cross((0.0, 0.0, 1.0), direction)
    shift = 0.08 * size * aside / np.linalg.norm(aside)  # the panel is at the right
    camera = server.initial_camera
    camera.fov = float(_FIELD_OF_VIEW)
    camera.look_at = middle + shift
    camera.position = middle + shift + 0.7 * size / np.tan(_FIELD_OF_VIEW / 2) * direction
    camera.near = float(0.01 * size)
    camera.far = float(100 * size)

    def fit(client: viser.ClientHandle) -> None:
        width, height = client.camera.image_width, client.camera.image_height
        if 0 < width < 1.4 * height:
            look_at, position = fit_camera(middle, direction, size, width, height)
            with client.atomic():
                client.camera.position = position  # moves the point that it looks at, too
                client.camera.look_at = look_at

    server.on_client_connect(fit)


def fit_camera(
    middle: Array, direction: Array, size: float, width: float, height: float
) -> tuple[Array, Array]:
    """Find a camera that shows a sphere beside the page's panel.

    Parameters
    ----------
    middle : ndarray, shape (3,)
        Center of the ball [m].
    direction : ndarray, shape (3,)
        Unit vector towards the camera.
    size : float
        Diameter of the ball [m].
    width, height : float
        Size of the page, in pixels.

    Returns
    -------
    tuple of ndarray, shape (3,)
        Point that the camera looks at, and position of the camera [m].
    """
    # a panel of 335 pixels is at the right, on phones in the lower part of the page
    free = np.array([width, 0.4 * height] if width < 600 else [width - 335, height])
    scale = size / (0.8 * free.min())  # m per pixel
    right = np.cross((0.0, 0.0, 1.0), direction)
    right /= np.linalg.norm(right)
    x, y = scale * (np.array([width, height]) - free) / 2
    look_at = middle + x * right - y * np.cross(direction, right)
    return look_at, look_at + scale * height / 2 / np.tan(_FIELD_OF_VIEW / 2) * direction


def _add_lights(scene: viser.SceneApi) -> Any:
    """Light the scene evenly, so that colors look as in the legend.

    Returns the light that can cast shadows.
    """
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_light_ambient("/light/all", intensity=1.7)
    scene.add_light_directional("/light/back", intensity=0.6, position=(-0.8, 1.0, 0.6))
    return scene.add_light_directional("/light/front", intensity=1.6, position=(0.6, -1.0, 1.6))

"""The canvas: all motions of an exhibit and what stands beside them, at any one time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tenscasadi.util.validate import Array
from tenscasadi.viewer.colours import GHOSTS, Rgb, Scale
from tenscasadi.viewer.exhibit import Exhibit
from tenscasadi.viewer.layer import Layer, Look
from tenscasadi.viewer.motion import Motion
from tenscasadi.viewer.scenery import add_boxes, add_grounds, add_obstacles, add_targets

if TYPE_CHECKING:
    import viser

QUANTITIES = {"tension": ("tension", "N"), "force density": ("force density", "N/m")}
_FIELD_OF_VIEW = np.radians(40.0)


class Canvas:
    """An exhibit on the scene of a viser server: `show` moves it to a time.

    All of it hangs under /shown, whose frame moves against the motion while it is followed.
    """

    def __init__(
        self, server: viser.ViserServer, exhibit: Exhibit, colour: str = "tension"
    ) -> None:
        self.exhibit = exhibit
        self.low, self.high = exhibit.corners()
        self.radius = exhibit.bar_radius()
        self.followed = False
        self.layers: list[Layer] = []
        scene = server.scene
        _light(scene)
        self.root = scene.add_frame("/shown", show_axes=False)
        add_grounds(scene, "/shown/ground", exhibit.grounds, self.low, self.high)
        add_obstacles(scene, "/shown/obstacle", exhibit.obstacles)
        add_boxes(scene, "/shown/box", exhibit.boxes, self.low, self.high)
        add_targets(scene, "/shown/target", exhibit.targets, self.radius)
        for k, motion in enumerate(exhibit.motions):
            ghost = ghost_colour(exhibit, k)
            opacity = None if ghost is None else 0.4 if motion.copies == 1 else 0.25
            look = Look(self.radius * (1.0 if ghost is None else 0.9), ghost, opacity)
            name = f"/shown/motion {k}"
            self.layers.append(
                Layer(
                    scene, name, motion.nodes[0], motion.bars, motion.strings, motion.pinned, look
                )
            )
        self._place_camera(server)
        self.scale: Scale | None = None
        self.choose_colour(colour)
        self._centre = _centre(exhibit.motions[0].nodes[0])

    @property
    def has_joints(self) -> bool:
        """Whether bars of the first motion meet."""
        bars = self.exhibit.motions[0].bars
        return bool(np.any(np.unique(bars, return_counts=True)[1] > 1))

    def values(self, motion: Motion) -> Array | None:
        """Return what the strings of a motion are coloured by, (T, α), None where it is not known."""
        return motion.tension if self.colour == "tension" else motion.force_density

    def choose_colour(self, colour: str) -> None:
        """Colour strings by "tension" or "force density", in one scale over the whole of the first motion."""
        self.colour = colour
        label, unit = QUANTITIES[colour]
        values = self.values(self.exhibit.motions[0])
        self.scale = (
            None
            if values is None or not values.size or not np.any(np.nan_to_num(values))
            else Scale.of(label, unit, [values])
        )

    def show(self, time: float) -> None:
        """Show all motions at a time, s; those that have not begun, or have ended, as they begin or end."""
        if self.followed:
            centre = _centre(self.exhibit.motions[0].nodes_at(time))
            self.root.position = (
                tuple(self._centre - centre) if np.isfinite(centre).all() else (0.0, 0.0, 0.0)
            )
        for motion, layer in zip(self.exhibit.motions, self.layers, strict=True):
            if not layer.root.visible:
                continue
            values = self.values(motion) if self.scale is not None else None
            if values is None or self.scale is None:
                layer.update(motion.nodes_at(time))
            else:
                now = np.nan_to_num(values[motion.row_at(time)])
                layer.update(motion.nodes_at(time), self.scale.colours(now), now != 0)

    def follow(self, followed: bool) -> None:
        """Keep the first motion's middle where it is at the start, or not."""
        self.followed = followed
        if not followed:
            self.root.position = (0.0, 0.0, 0.0)

    def _place_camera(self, server: viser.ViserServer) -> None:
        """Look at the middle of it all from the front, a little from above and the side; at what is flat from its broad side."""
        low, high = self.low, self.high
        for centre, radius in self.exhibit.obstacles:
            low, high = (
                np.minimum(low, np.asarray(centre) - radius),
                np.maximum(high, np.asarray(centre) + radius),
            )
        extent = high - low
        size = float(np.linalg.norm(extent))
        thin = int(np.argmin(extent)) if extent.min() < 0.05 * extent.max() else -1
        direction = {
            -1: (0.45, -1.0, 0.35),
            0: (1.0, -0.3, 0.2),
            1: (0.3, -1.0, 0.2),
            2: (0.2, -0.5, 1.0),
        }[thin]
        away = (
            0.62
            * size
            / np.tan(_FIELD_OF_VIEW / 2)
            * np.array(direction)
            / np.linalg.norm(direction)
        )
        aside = np.cross(direction, (0.0, 0.0, 1.0))
        middle = (low + high) / 2 - 0.13 * size * aside / np.linalg.norm(
            aside
        )  # the panel is at the right
        camera = server.initial_camera
        camera.fov = float(_FIELD_OF_VIEW)
        camera.look_at = middle
        camera.position = middle + away
        camera.near = float(0.01 * size)
        camera.far = float(100 * size)


def ghost_colour(exhibit: Exhibit, k: int) -> Rgb | None:
    """Return the colour that the k-th motion is seen through in; None: it is solid, as the first one is unless it is many."""
    solid = exhibit.motions[0].copies == 1
    return None if k == 0 and solid else GHOSTS[(k - solid) % len(GHOSTS)]


def _light(scene: viser.SceneApi) -> None:
    """Light the scene evenly, without shadows and reflections: colours are numbers here, and look as in the legend."""
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_light_ambient("/light/all", intensity=1.7)
    scene.add_light_directional("/light/front", intensity=1.6, position=(0.6, -1.0, 1.2))
    scene.add_light_directional("/light/back", intensity=0.6, position=(-0.8, 1.0, 0.6))


def _centre(nodes: Array) -> Array:
    return np.asarray(nodes.mean(axis=0))

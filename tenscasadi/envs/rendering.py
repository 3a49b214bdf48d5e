"""Pictures of an episode, as an array or in a browser."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.view_content import Frame, ViewContent
from tenscasadi.dynamics.model import Model
from tenscasadi.plots.frame_pictures import FramePictures
from tenscasadi.simulation.trajectory import observe_states
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import Array, format_value
from tenscasadi.viewer.canvas import Canvas
from tenscasadi.viewer.web.server import address, start_server
from tenscasadi.viewer.web.serving import open_and_wait, stop


class Renderer(Protocol):
    """Interface of displays that draw one frame after another."""

    def draw(self, frame: Frame) -> Any:
        """Draw a frame.

        Returns its picture if there is one.
        """

    def close(self) -> None:
        """Release the resources of the display."""


class ArrayRenderer:
    """Display that returns pictures as arrays (400, 480, 3) of bytes.

    The camera is fixed. It shows a region half as large again as the structure around the start.
    """

    def __init__(self, model: Model) -> None:
        self._pictures = FramePictures(_describe_region(model))

    def draw(self, frame: Frame) -> Any:
        """Draw a frame and return its picture."""
        return self._pictures.draw(frame, _color_scale(frame))

    def close(self) -> None:
        """Do nothing, as pictures hold no resources."""


class BrowserRenderer:
    """Display in a browser, in real time; requires viser.

    Attributes
    ----------
    url : str
        Address of the page.
    """

    def __init__(self, model: Model, period: float) -> None:
        self._server = start_server()
        self._canvas = Canvas(self._server, _describe_region(model))
        self._period, self._due = period, 0.0
        self.url = address(self._server)
        open_and_wait(self.url, lambda: None, None, False)

    def draw(self, frame: Frame) -> None:
        """Show a frame, one control period after the previous one."""
        time.sleep(max(0.0, self._due - time.perf_counter()))
        self._due = time.perf_counter() + self._period
        with self._server.atomic():
            self._canvas.scale = _color_scale(frame)
            self._canvas.draw([frame])

    def close(self) -> None:
        """Stop the server."""
        stop(self._server)


RENDERERS: dict[str, Callable[[Model, float], Renderer]] = {
    "rgb_array": lambda model, period: ArrayRenderer(model),
    "human": BrowserRenderer,
}


def build_renderer(mode: str, model: Model, period: float) -> Renderer:
    """Build the display of a render mode.

    `period` is the time between frames [s]. Raises ValueError.
    """
    if mode not in RENDERERS:
        known = " or ".join(map(format_value, RENDERERS))
        raise ValueError(f"render_mode is {format_value(mode)}: give {known}, or None")
    return RENDERERS[mode](model, period)


def observe_frame(
    model: Model, state: Array, control: Array, parameters: Array, now: float
) -> Frame:
    """Build the frame of a state (nx,) at a time.

    The time `now` is in s. The control is (nu,), and the parameters are (np,).
    """
    seen = observe_states(model, state[None], np.concatenate([control, parameters])[None])
    return Frame(
        np.asarray(model.nodes(state)),
        seen["velocities"].reshape(-1, 3),
        seen["tension"][0],
        seen["force_density"][0],
        now,
    )


def _color_scale(frame: Frame) -> ColorScale | None:
    values = np.zeros(0) if frame.tension is None else np.nan_to_num(frame.tension)
    return ColorScale.of("tension", values) if np.any(values) else None


def _describe_region(model: Model) -> ViewContent:
    """Convert a model to picture content with space around it.

    The space is half the size of the structure at each side.
    """
    content = describe_content(model.scene)
    motion = content.motions[0]
    size = measure_extent(motion.nodes[0])
    shifts = 0.5 * size * np.array([[0, 0, 0], [1, 1, 1], [-1, -1, 0]])
    values: dict[str, Any] = {
        name: np.repeat(given, len(shifts), axis=0)
        for name in ("tension", "force_density")
        if (given := getattr(motion, name)) is not None
    }
    around = replace(motion, time=np.arange(3.0), nodes=motion.nodes[0] + shifts[:, None], **values)
    return replace(content, motions=(around,))

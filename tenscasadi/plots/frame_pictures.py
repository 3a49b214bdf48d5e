"""Pictures of single frames as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.shapes import MotionShapes
from tenscasadi.drawing.view_content import Frame, ViewContent
from tenscasadi.plots.canvas3d import Canvas3D


class FramePictures:
    """Pictures of a trajectory's frames, from one fixed camera.

    Parameters
    ----------
    content : ViewContent
        Content, whose motion sets the visible region.
    """

    def __init__(self, content: ViewContent) -> None:
        self._figure = Figure(figsize=(4.8, 4.0), dpi=100)
        self._backend: Any = FigureCanvasAgg(self._figure)
        self._canvas, self._shapes = Canvas3D(self._figure, content), MotionShapes(content)
        self._canvas.fit()

    def draw(self, frame: Frame, scale: ColorScale | None) -> Any:
        """Draw a frame as an array (400, 480, 3) of bytes.

        The color scale colors the strings, if it is given.
        """
        self._canvas.draw(self._shapes.build(frame, scale))
        self._figure.suptitle(f"t = {frame.time:.2f} s")
        self._backend.draw()
        return np.asarray(self._backend.buffer_rgba())[:, :, :3].copy()

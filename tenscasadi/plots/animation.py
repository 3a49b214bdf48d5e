"""Animations of trajectories as GIF or mp4 files."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from tqdm import tqdm

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.shapes import MotionShapes
from tenscasadi.drawing.view_content import choose_frame_times
from tenscasadi.plots.canvas3d import Canvas3D
from tenscasadi.scene.ground import Grounds
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import FilePath, file_path, flag, positive_number, text, whole_number
from tenscasadi.util.whole_file import whole_path

_COMPATIBLE = ["-pix_fmt", "yuv420p", "-movflags", "+faststart"]  # for browsers and slides


@rename_keywords(trajectory="data")
def animate(
    data: Any,
    path: FilePath,
    *,
    speed: float = 1.0,
    frames_per_second: int = 20,
    ground: Grounds = None,
    title: str = "",
    progress: bool = False,
) -> Path:
    """Write a trajectory as an animated GIF or an mp4 film.

    Strings are colored by tension, with one scale for the whole trajectory.

    Parameters
    ----------
    data : Trajectory or ocp.Plan
        The motion.
    path : path-like
        File to write. Its name ends in .gif, or in .mp4, which requires ``pip install
        'tenscasadi[video]'``.
    speed : float
        Simulated seconds per second of the film.
    frames_per_second : int
        Frames per second of the film. A GIF stores times in hundredths of a second, so that 10, 20,
        25 and 50 play at exactly `speed`.
    ground : Ground or Terrain or a sequence of them, optional
        Grounds besides those of the scene.
    title : str
        Text before the time in each frame.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type or value, or there would be more than 2000 frames.
    ImportError
        The film is an mp4 and imageio-ffmpeg is not installed.
    OSError
        The file cannot be written.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.animation import animate
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> animate(motion, "swing.gif", frames_per_second=10).name
    'swing.gif'
    """
    target = file_path("path", path)
    text("title", title)
    flag("progress", progress)
    if target.suffix.lower() not in (".gif", ".mp4"):
        raise ValueError(f"path is {os.fspath(path)!r}: give a file name that ends in .gif or .mp4")
    rate = whole_number("frames_per_second", frames_per_second, 1)
    content = describe_content(data, "data", ground)
    times = choose_frame_times(content, positive_number("speed", speed), rate)
    motion, shapes = content.motions[0], MotionShapes(content)
    values = np.zeros((1, 0)) if motion.tension is None else motion.tension
    scale = ColorScale.of("tension", values)
    figure = Figure(figsize=(5.4, 4.6))
    canvas = Canvas3D(figure, content)
    if np.any(values != 0):
        canvas.add_color_bar(scale)
    canvas.fit()
    with (
        whole_path(target) as part,
        _open_writer(part, rate) as writer,
        writer.saving(figure, str(part), dpi=100),
    ):
        for time in tqdm(times, unit=" frames", disable=not progress):
            canvas.draw(shapes.build(motion.frame_at(time), scale))
            figure.suptitle(f"{title}{', ' if title else ''}t = {time:.2f} s")
            writer.grab_frame()
    return target


@contextmanager
def _open_writer(target: Path, rate: int) -> Iterator[AbstractMovieWriter]:
    """Open the writer of the film file `target`.

    `rate` is in frames per second. Raises ImportError, OSError.
    """
    if target.suffix.lower() == ".gif":
        yield PillowWriter(fps=rate)
        return
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise ImportError(
            "a film in .mp4 needs imageio-ffmpeg: pip install 'tenscasadi[video]', or give a file name that ends in .gif"
        ) from error
    with mpl.rc_context({"animation.ffmpeg_path": get_ffmpeg_exe()}):
        try:
            yield FFMpegWriter(fps=rate, codec="libx264", extra_args=_COMPATIBLE)
        except CalledProcessError as error:
            raise OSError(
                errno.EIO,
                f"ffmpeg could not write the film ({error.returncode}), is the disk full?",
                str(target),
            ) from None

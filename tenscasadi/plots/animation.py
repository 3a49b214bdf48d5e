"""A motion as an animated GIF, or as an mp4 film."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import CalledProcessError

import matplotlib as mpl
import numpy as np
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.figure import Figure
from tqdm import tqdm

from tenscasadi.plots.scene3d import (
    Canvas,
    Layer,
    check_drawable,
    members_of,
    tension_colours,
    tension_label,
    tension_scale,
)
from tenscasadi.scene.ground import Grounds
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import file_path, flag, positive_number, text, whole_number
from tenscasadi.util.whole_file import whole_path

_MOST_FRAMES = 2000
_PLAYED_EVERYWHERE = [
    "-pix_fmt",
    "yuv420p",
    "-movflags",
    "+faststart",
]  # browsers and presentations refuse colours in full


def animate(
    trajectory: Trajectory,
    path: str | os.PathLike[str],
    *,
    speed: float = 1.0,
    frames_per_second: int = 20,
    ground: Grounds = None,
    title: str = "",
    progress: bool = False,
) -> Path:
    """Write a motion as an animated GIF, or as an mp4 film.

    Strings are coloured by tension, in one scale over the whole motion. Each frame shows the kept
    row next to its time.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    path : path-like
        File to write; its name ends in .gif or in .mp4, which takes ``pip install
        'tenscasadi[video]'``.
    speed : float
        Simulated seconds in each second shown.
    frames_per_second : int
        Frames in each second shown. A GIF tells times in hundredths of a second, so 10, 20, 25 and
        50 play at exactly `speed`.
    ground : Ground or Terrain or a sequence of them, optional
        The grounds to draw, such as ``scene.ground``.
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
        If an argument has a wrong type or value, or there would be more than 2000 frames.
    ImportError
        If the film is an mp4 and imageio-ffmpeg is not installed.
    OSError
        If the file cannot be written.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi.animation import animate
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> animate(motion, "swing.gif", frames_per_second=10).name
    'swing.gif'
    """
    check_drawable("trajectory", trajectory)
    target = file_path("path", path)
    text("title", title)
    flag("progress", progress)
    if target.suffix.lower() not in (".gif", ".mp4"):
        raise ValueError(f"path is {os.fspath(path)!r}: give a file name that ends in .gif or .mp4")
    rate = whole_number("frames_per_second", frames_per_second, 1)
    duration = float(trajectory.time[-1] - trajectory.time[0])
    count = 1 + round(duration / positive_number("speed", speed) * rate)
    if count > _MOST_FRAMES:
        raise ValueError(
            f"speed is {speed:g}: {duration:g} s would take {count} frames, give a speed of at least {speed * count / _MOST_FRAMES:.2g}"
        )
    times = np.linspace(trajectory.time[0], trajectory.time[-1], count)
    figure = Figure(figsize=(5.4, 4.6))
    canvas = Canvas(figure, members_of(trajectory), trajectory.nodes, ground)
    scale = tension_scale(float(trajectory.tension.max(initial=0.0)))
    if np.any(trajectory.tension != 0):
        canvas.colour_bar(scale, tension_label(trajectory.tension[trajectory.tension != 0]))
    canvas.fit()
    with (
        whole_path(target) as part,
        _writer(part, rate) as writer,
        writer.saving(figure, str(part), dpi=100),
    ):
        for time in tqdm(times, unit=" frames", disable=not progress):
            row = int(np.argmin(np.abs(trajectory.time - time)))
            colours = tension_colours(scale, trajectory.tension[row])
            canvas.draw(Layer(trajectory.nodes[row], string_colour=colours))
            figure.suptitle(f"{title}{', ' if title else ''}t = {trajectory.time[row]:.2f} s")
            writer.grab_frame()
    return target


@contextmanager
def _writer(target: Path, rate: int) -> Iterator[AbstractMovieWriter]:
    """Writer of frames for a file of this name. Raises ImportError where there is none, OSError where the file cannot be written."""
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
            yield FFMpegWriter(fps=rate, codec="libx264", extra_args=_PLAYED_EVERYWHERE)
        except CalledProcessError as error:
            raise OSError(
                errno.EIO,
                f"ffmpeg could not write the film ({error.returncode}), is the disk full?",
                str(target),
            ) from None

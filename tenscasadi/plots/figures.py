"""3-D figures of structures, scenes, trajectories and plans.

No window opens and no global state of matplotlib changes: pyplot is not used.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.shapes import MotionShapes
from tenscasadi.drawing.style import STYLE, interpolate_colors
from tenscasadi.drawing.view_content import Motion, ViewContent
from tenscasadi.plots.canvas3d import Canvas3D
from tenscasadi.plots.panels import save_figure
from tenscasadi.scene.ground import Grounds
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import (
    FilePath,
    Indices,
    flag,
    per_item,
    positive_number,
    text,
    whole_number,
)


@rename_keywords(what="data")
def structure(
    data: Any,
    tension: ArrayLike | None = None,
    *,
    time: float | None = None,
    labels: bool = False,
    ground: Grounds = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw a structure in 3-D with its surroundings.

    Strings are colored by tension, gray if they are slack and green in compression. Supports are
    triangles, and joints of bars are orange.

    Parameters
    ----------
    data : Structure, Scene, Model, Trajectory or ocp.Plan
        A structure, or a motion at one of its times.
    tension : array_like, shape (α,), optional
        Tensions of the strings [N]. Default: those of the rest lengths, or of the motion.
    time : float, optional
        Time of the motion [s], of which the nearest saved row is drawn. Default: its end.
    labels : bool
        Whether to write the names or numbers of the nodes.
    ground : Ground or Terrain or a sequence of them, optional
        Grounds besides those of the scene.
    title : str
        Title of the figure. Default: the time of a motion.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> figure = plots.structure(tc.shapes.prism(prestress=50.0), labels=True, title="a prism at rest")
    >>> figure.axes[1].get_ylabel()
    'tension (N)'
    """
    flag("labels", labels)
    text("title", title)
    content = describe_content(data, "data", ground)
    motion = content.motions[0]
    row = len(motion.time) - 1 if time is None else _find_row(motion, time)
    if len(motion.time) > 1:
        title = title or f"t = {motion.time[row]:.4g} s"
    content = _select_rows(content, np.array([row]))
    frame = content.motions[0].frame_at(motion.time[row])
    pull = np.zeros(len(motion.strings)) if frame.tension is None else frame.tension
    if tension is not None:
        pull = per_item("tension", tension, len(motion.strings))
    figure = Figure(figsize=(6.4, 5.2))
    canvas = Canvas3D(figure, content)
    scale = ColorScale.of("tension", pull)
    canvas.draw(MotionShapes(content).build(frame._replace(tension=pull), scale))
    if np.any(pull != 0):
        canvas.add_color_bar(scale)
    elif len(pull):
        figure.supxlabel("all strings slack", fontsize=9, color="0.35")
    if labels:
        names = motion.names["nodes"]
        canvas.label(frame.nodes, [name.removeprefix("node ") for name in names])
    figure.suptitle(title)
    canvas.fit()
    return save_figure(figure, path)


@rename_keywords(trajectory="data")
def time_lapse(
    data: Any,
    instants: int = 6,
    *,
    ground: Grounds = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw a trajectory at several times in one 3-D picture.

    The color shows the time, from pale at the start to dark at the end.

    Parameters
    ----------
    data : Trajectory or ocp.Plan
        The motion.
    instants : int
        Number of times, spread evenly over the motion.
    ground : Ground or Terrain or a sequence of them, optional
        Grounds besides those of the scene.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> plots.time_lapse(motion, instants=3).axes[1].get_ylabel()
    'time (s)'
    """
    count = whole_number("instants", instants, 2, 1000)
    text("title", title)
    content = describe_content(data, "data", ground)
    first = content.motions[0]
    times = np.linspace(first.start, first.end, count)
    content = _select_rows(content, np.unique([_find_row(first, time) for time in times]))
    motion = content.motions[0]
    rows = len(motion.time)
    colors = interpolate_colors(STYLE.time_ramp, np.linspace(0, 1, rows))
    figure = Figure(figsize=(7.0, 5.4))
    canvas = Canvas3D(figure, content)
    shapes = []
    for k, color in enumerate(colors):
        drawn = MotionShapes(content, tint=(color[0], color[1], color[2]))
        bars, strings, balls, supports, *others = drawn.build(motion.frame_at(motion.time[k]))
        # opaque: nothing shines through
        pale = (0.55 * strings.colors + 0.45 * 255).astype(np.uint8)
        faces = [shape for shape in others if shape.form == "face"]
        drawn_now = [bars, strings._replace(colors=pale), balls, *faces]
        shapes += [shape._replace(radius=0.6 * shape.radius) for shape in drawn_now]
    shapes.append(supports)
    canvas.draw(shapes)
    steps = BoundaryNorm(np.arange(rows + 1) - 0.5, rows)
    mapped = ScalarMappable(steps, ListedColormap(colors / 255))
    bar = canvas.add_bar(mapped, label="time (s)", ticks=np.arange(rows))
    bar.ax.set_yticklabels([f"{time:.3g}" for time in motion.time])
    figure.suptitle(title)
    canvas.fit()
    return save_figure(figure, path)


def _find_row(motion: Motion, time: float) -> int:
    """Find the saved row next to a time [s].

    It is the row of a trajectory, `motion`.
    """
    wanted = positive_number("time", time, zero=True)
    return int(np.argmin(np.abs(motion.time - wanted)))


def _select_rows(content: ViewContent, rows: Indices) -> ViewContent:
    """Select some times of the content's first trajectory, without others.

    `rows` are the indices of the times.
    """
    motion = content.motions[0]
    names = ("time", "nodes", "velocities", "tension", "force_density")
    given = {name: getattr(motion, name) for name in names}
    kept: dict[str, Any] = {
        name: values if values is None else values[rows] for name, values in given.items()
    }
    return replace(content, motions=(replace(motion, **kept),))

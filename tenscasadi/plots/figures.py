"""Pictures of structures and motions as matplotlib Figures.

No window opens and no global state of matplotlib changes: pyplot is not used.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.plots.panels import (
    MOST_NAMED,
    FilePath,
    curve_colour,
    curve_width,
    make_panels,
    name_curves,
    save_figure,
)
from tenscasadi.plots.scene3d import (
    Canvas,
    Layer,
    check_drawable,
    cut_colours,
    members_of,
    tension_colours,
    tension_label,
    tension_scale,
)
from tenscasadi.scene.ground import Grounds
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    Array,
    finite_array,
    flag,
    listed,
    node_index,
    per_item,
    positive_number,
    text,
    whole_number,
)

_MOST_INSTANTS = 1000


class ForceHistory(Protocol):
    """Force densities over time: a `Trajectory`, with a row for each time, or a plan, with a row for each interval between times.

    Attributes
    ----------
    time : ndarray (T,)
        Times, s.
    force_density : ndarray (T, α) or (T − 1, α)
        Force densities of the strings, N/m.
    """

    @property
    def time(self) -> Array:
        """Times (T,), s."""

    @property
    def force_density(self) -> Array:
        """Force densities (T, α) or (T − 1, α), N/m."""


def structure(
    what: Structure | Trajectory,
    tension: ArrayLike | None = None,
    *,
    time: float | None = None,
    labels: bool = False,
    ground: Grounds = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw a structure in 3-D, with one scale for all axes.

    Bars are thick; strings are thin and coloured by tension, grey where they are slack and green
    where they push; pinned nodes are triangles.

    Parameters
    ----------
    what : Structure or Trajectory
        A structure, or a motion at one of its times.
    tension : array_like (α,), optional
        Tensions of the strings, N; None: those of the structure's rest lengths, or of the
        trajectory.
    time : float, optional
        Time of the trajectory, s: the kept row next to it is drawn; None: the end.
    labels : bool
        Whether to number the nodes.
    ground : Ground or Terrain or a sequence of them, optional
        The grounds to draw below it, such as ``scene.ground``.
    title : str
        Title of the figure; of a trajectory its time unless given.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> figure = plots.structure(tc.shapes.prism(prestress=50.0), labels=True, title="a prism at rest")
    >>> figure.axes[1].get_ylabel()
    'tension (N)'
    """
    check_drawable("what", what, (Structure, Trajectory), "a tenscasadi.Structure or Trajectory")
    flag("labels", labels)
    text("title", title)
    if isinstance(what, Trajectory):
        row = len(what.time) - 1 if time is None else _nearest_row(what, time)
        nodes, pull = what.nodes[row], what.tension[row]
        title = title or f"t = {what.time[row]:.4g} s"
    else:
        nodes, pull = (
            what.nodes,
            what.stiffness * np.maximum(0.0, what.string_lengths - what.rest_length),
        )  # γ s, Eq. 99
    if tension is not None:
        pull = per_item("tension", tension, len(what.strings))
    figure = Figure(figsize=(6.4, 5.2))
    canvas = Canvas(figure, members_of(what), nodes, ground)
    scale = tension_scale(float(pull.max(initial=0.0)))
    canvas.draw(Layer(nodes, string_colour=tension_colours(scale, pull)))
    if np.any(pull != 0):
        canvas.colour_bar(scale, tension_label(pull))
    elif len(pull):
        figure.supxlabel("all strings slack", fontsize=9, color="0.35")
    if labels:
        canvas.number(nodes)
    figure.suptitle(title)
    canvas.fit()
    return save_figure(figure, path)


def time_lapse(
    trajectory: Trajectory,
    instants: int = 6,
    *,
    ground: Grounds = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw a motion in one 3-D picture: the structure at several times, pale at the start and dark at the end.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    instants : int
        Number of times, spread evenly over the motion.
    ground : Ground or Terrain or a sequence of them, optional
        The grounds to draw, such as ``scene.ground``.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> plots.time_lapse(motion, instants=3).axes[1].get_ylabel()
    'time (s)'
    """
    check_drawable("trajectory", trajectory)
    count = whole_number("instants", instants, 2, _MOST_INSTANTS)
    text("title", title)
    rows = np.unique(
        [
            _nearest_row(trajectory, t)
            for t in np.linspace(trajectory.time[0], trajectory.time[-1], count)
        ]
    )
    figure = Figure(figsize=(7.0, 5.4))
    canvas = Canvas(figure, members_of(trajectory), trajectory.nodes[rows], ground)
    ramp = cut_colours("viridis_r", 0.05, 1.0)
    scale = ScalarMappable(BoundaryNorm(np.arange(len(rows) + 1) - 0.5, ramp.N), ramp)
    colours = np.asarray(scale.to_rgba(np.arange(len(rows))))
    pale = 0.55 * colours + 0.45  # not transparent: nothing shines through
    widths = np.linspace(0.6, 1.0, len(rows))
    canvas.draw(
        *(
            Layer(trajectory.nodes[row], colours[k], pale[k], widths[k])
            for k, row in enumerate(rows)
        )
    )
    bar = canvas.colour_bar(scale, "time (s)", ticks=np.arange(len(rows)))
    bar.ax.set_yticklabels([f"{t:.3g}" for t in trajectory.time[rows]])
    figure.suptitle(title)
    canvas.fit()
    return save_figure(figure, path)


def node_histories(
    trajectory: Trajectory,
    nodes: Sequence[int] | None = None,
    *,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the coordinates x, y and z of nodes over time.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    nodes : sequence of int, optional
        Nodes to draw; None: those that move, at most the 12 that move furthest.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> [axes.get_ylabel() for axes in plots.node_histories(motion).axes]
    ['x (m)', 'y (m)', 'z (m)']
    """
    check_drawable("trajectory", trajectory)
    chosen = (
        _furthest_nodes(trajectory)
        if nodes is None
        else [
            node_index("nodes", node, trajectory.nodes.shape[1])
            for node in listed("nodes", nodes, "[0, 3]")
        ]
    )
    figure, axes = make_panels(3, "time (s)", title)
    for axis, (ax, name) in enumerate(zip(axes, "xyz", strict=True)):
        for k, node in enumerate(chosen):
            ax.plot(
                trajectory.time,
                trajectory.nodes[:, node, axis],
                color=curve_colour(k),
                label=f"node {node}",
                lw=curve_width(k, len(chosen)),
            )
        ax.set_ylabel(f"{name} (m)")
        _widen(ax)
    name_curves(figure, axes[0], len(chosen))
    return save_figure(figure, path)


def force_densities(
    history: ForceHistory,
    *,
    strings: Sequence[int] | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the force densities of strings over time: of a trajectory as curves, of a plan in steps.

    Parameters
    ----------
    history : ForceHistory
        A trajectory or a plan.
    strings : sequence of int, optional
        Strings to draw; None: all.
    lower : array_like () or (α,), optional
        Lower bounds, N/m, drawn as dashed lines unless far off.
    upper : array_like () or (α,), optional
        Upper bounds, N/m, drawn alike.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> motion = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), t_end=0.1, step=0.01, compiled=False)
    >>> figure = plots.force_densities(motion, strings=[0, 1], upper=80.0)
    >>> len(figure.axes[0].lines)
    3
    """
    if not (hasattr(history, "time") and hasattr(history, "force_density")):
        check_drawable("history", history, Trajectory, "a tenscasadi.Trajectory or an ocp.Plan")
    time = finite_array("history.time", history.time, (None,))
    gamma = finite_array("history.force_density", history.force_density, (None, None))
    rows, alpha = gamma.shape
    if rows not in (len(time), len(time) - 1):
        raise ValueError(
            f"history.force_density has {rows} rows: give one for each of the {len(time)} times, or for each of the intervals between"
        )
    chosen = (
        list(range(alpha))
        if strings is None
        else [_check_string(index, alpha) for index in listed("strings", strings, "[0, 3]")]
    )
    figure, (ax,) = make_panels(1, "time (s)", title)
    for k, i in enumerate(chosen):
        if rows == len(time):
            ax.plot(
                time,
                gamma[:, i],
                color=curve_colour(k),
                label=f"string {i}",
                lw=curve_width(k, len(chosen)),
            )
        else:
            ax.stairs(
                gamma[:, i],
                time,
                baseline=None,
                color=curve_colour(k),
                label=f"string {i}",
                lw=curve_width(k, len(chosen)),
            )
    for field, bound in (("lower", lower), ("upper", upper)):
        if bound is not None:
            per_item(field, _without_infinity(bound), alpha)
            _draw_bound(
                ax, field, np.broadcast_to(np.asarray(bound, dtype=float), (alpha,)), chosen, gamma
            )
    ax.set_ylabel("force density (N/m)")
    _widen(ax)
    name_curves(figure, ax, len(chosen))
    return save_figure(figure, path)


def errors(trajectory: Trajectory, *, title: str = "", path: FilePath | None = None) -> Figure:
    """Draw the errors of bar lengths, joints and energy over time on a logarithmic scale.

    Errors below 1e-18, and exact zeros, lie on the bottom edge. An error that was not computed has
    no curve.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError
        If `trajectory` is none.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> plots.errors(motion).axes[0].get_yscale()
    'log'
    """
    check_drawable("trajectory", trajectory)
    curves: list[tuple[str, Any]] = [("energy (J)", np.abs(trajectory.energy_error))]
    if len(trajectory.bars):
        curves += [
            ("bar length, relative", trajectory.bar_length_error),
            ("joint gap (m)", trajectory.joint_error),
        ]
    known = np.concatenate([values[np.isfinite(values)] for _, values in curves])
    positive = known[known > 0]
    bottom = max(1e-18, 10.0 ** np.floor(np.log10(positive.min())) / 3) if positive.size else 1e-18
    top = max(3 * positive.max(initial=0.0), 100 * bottom)
    figure, (ax,) = make_panels(1, "time (s)", title)
    for k, (name, values) in enumerate(curves):
        drawn = np.maximum(values, bottom)  # NaN stays NaN
        largest = np.nanmax(values, initial=0.0)
        note = (
            ": not computed"
            if not np.isfinite(values).any()
            else ""
            if largest > bottom
            else ": below 1e-18"
            if largest > 0
            else ": exactly 0"
        )
        ax.plot(
            trajectory.time, drawn, color=curve_colour(k), label=name + note, lw=1.3, clip_on=False
        )
    ax.set_yscale("log")
    ax.set_ylim(bottom, top)
    ax.set_ylabel("error")
    name_curves(figure, ax, len(curves))
    return save_figure(figure, path)


def _nearest_row(trajectory: Trajectory, time: float) -> int:
    """Return the kept row next to `time`."""
    wanted = positive_number("time", time, zero=True)
    return int(np.argmin(np.abs(trajectory.time - wanted)))


def _check_string(index: Any, count: int) -> int:
    if whole_number("strings", index, 0) >= count:
        raise ValueError(f"strings names string {index}: strings run from 0 to {count - 1}")
    return int(index)


def _furthest_nodes(trajectory: Trajectory) -> list[int]:
    """Return the nodes that move, at most the 12 that move furthest, in their order."""
    way = np.ptp(trajectory.nodes, axis=0).max(axis=1)
    order = np.argsort(-way, kind="stable")[:MOST_NAMED]
    return sorted(int(node) for node in order if way[node] > 0) or [int(order[0])]


def _without_infinity(bound: ArrayLike) -> Any:
    try:
        array = np.array(bound, dtype=float)
    except Exception:  # noqa: BLE001  an object's own __array__ may raise anything
        return bound  # refused next, by name
    return np.where(np.isinf(array), 0.0, array)


def _draw_bound(ax: Axes, field: str, bound: Array, chosen: list[int], gamma: Array) -> None:
    """Draw dashed lines; a single black one where all strings have the same bound. One far off is only told: it would flatten the curves."""
    low, high = (
        float(gamma[:, chosen].min(initial=np.inf)),
        float(gamma[:, chosen].max(initial=-np.inf)),
    )
    reach = max(high - low, 0.1 * abs(high))
    finite = [(k, float(bound[i])) for k, i in enumerate(chosen) if np.isfinite(bound[i])]
    common = len({value for _, value in finite}) == 1
    if common and not low - reach <= finite[0][1] <= high + reach:
        ax.plot([], [], " ", label=f"{field} bound {finite[0][1]:g}")
    elif common:
        ax.axhline(finite[0][1], color="black", ls=(0, (5, 3)), lw=0.9, label=f"{field} bound")
    else:
        for k, value in finite:
            if low - reach <= value <= high + reach:
                ax.axhline(value, color=curve_colour(k), ls=(0, (5, 3)), lw=0.9)


def _widen(ax: Axes) -> None:
    """Widen the vertical axis where rounding around a constant would look like motion."""
    low, high = ax.get_ylim()
    if high - low < 1e-6 * max(abs(low), abs(high), 1e-6):
        middle = (low + high) / 2
        reach = 0.05 * abs(middle) or 0.05
        ax.set_ylim(middle - reach, middle + reach)

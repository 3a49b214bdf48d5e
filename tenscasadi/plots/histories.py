"""Curves of a trajectory's quantities over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.drawing.view_content import Chart, list_names
from tenscasadi.plots.charts import draw_charts
from tenscasadi.plots.panels import (
    add_legend,
    css_color,
    make_panels,
    save_figure,
)
from tenscasadi.scene.binding import fix
from tenscasadi.simulation.string_breaks import hide_broken
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.names import names_of
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import (
    Array,
    FilePath,
    as_tuple,
    finite_array,
    format_value,
    instance,
    per_item,
)

EXAMPLE = "a tenscasadi.Trajectory, such as plan.trajectory or plan.replay()"


class ForceHistory(Protocol):
    """Interface of force densities over time.

    A `Trajectory` or a plan has them.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Times [s].
    force_density : ndarray, shape (T, α) or (T − 1, α)
        Force densities of the strings [N/m], at the times or in the intervals between them.
    """

    @property
    def time(self) -> Array:
        """Times (T,) [s]."""

    @property
    def force_density(self) -> Array:
        """Force densities (T, α) or (T − 1, α) [N/m]."""


def node_histories(
    trajectory: Trajectory,
    nodes: Sequence[int | str] | None = None,
    *,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the coordinates of nodes over time.

    Times with contact to a ground are shaded.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    nodes : sequence of int or str, optional
        Nodes to draw, by index or name. Default: those that move, at most the 12 that move
        furthest.
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
    >>> [axes.get_ylabel() for axes in plots.node_histories(motion).axes]
    ['x (m)', 'y (m)', 'z (m)']
    """
    instance("trajectory", trajectory, Trajectory, EXAMPLE)
    chosen, names = choose_nodes(trajectory, nodes)
    paths, contacts = trajectory.nodes[:, chosen], find_contact_intervals(trajectory)
    charts = [
        Chart(axis, "m", trajectory.time, paths[..., k], names, shaded=contacts)
        for k, axis in enumerate("xyz")
    ]
    return save_figure(draw_charts(charts, title), path)


def tensions(
    trajectory: Trajectory,
    *,
    strings: Sequence[int | str] | None = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the tensions of strings over time.

    Strings of equal tension share a color and a label. The curve of a string ends where it breaks.
    Times with contact to a ground are shaded.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    strings : sequence of int or str, optional
        Strings to draw, by index or name. Default: all.
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
        An argument has a wrong type or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> motion = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), t_end=0.1, step=0.01, compiled=False)
    >>> plots.tensions(motion, strings=["top[0]"]).axes[0].get_ylabel()
    'tension (N)'
    """
    instance("trajectory", trajectory, Trajectory, EXAMPLE)
    chosen, names = choose_items(trajectory, "string", strings, trajectory.tension.shape[1])
    contacts = find_contact_intervals(trajectory)
    values = hide_broken(trajectory.scene, trajectory.states, trajectory.tension)[:, chosen]
    chart = Chart("tension", "N", trajectory.time, values, names, shaded=contacts)
    return save_figure(draw_charts([chart], title), path)


def force_densities(
    history: ForceHistory,
    *,
    strings: Sequence[int | str] | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the force densities of strings over time.

    Strings of equal force density share a color and a label.

    Parameters
    ----------
    history : ForceHistory
        A trajectory or a plan.
    strings : sequence of int or str, optional
        Strings to draw, by index or name. Default: all.
    lower, upper : array_like, shape () or (α,), optional
        Limits [N/m], drawn as a band unless they are far off.
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
    >>> motion = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism(prestress=50.0))), t_end=0.1, step=0.01, compiled=False)
    >>> figure = plots.force_densities(motion, strings=[0, 1], upper=80.0)
    >>> figure.axes[0].get_ylabel()
    'force density (N/m)'
    """
    if not (hasattr(history, "time") and hasattr(history, "force_density")):
        raise TypeError(
            f"history is {format_value(history)}: give a tenscasadi.Trajectory or an ocp.Plan"
        )
    time = finite_array("history.time", history.time, (None,))
    values = finite_array("history.force_density", history.force_density, (None, None))
    rows, count = values.shape
    if rows not in (len(time), len(time) - 1):
        raise ValueError(
            f"history.force_density has {rows} rows: give one for each of the {len(time)} times, or for each of the intervals between"
        )
    chosen, names = choose_items(history, "string", strings, count)
    limits: dict[str, Any] = {}
    for field, limit in (("lower", lower), ("upper", upper)):
        if limit is not None:
            per_item(field, _drop_infinity(limit), count)
            all_limits = np.broadcast_to(np.asarray(limit, dtype=float), (count,))
            limits[field] = all_limits[chosen]
    chart = Chart("force density", "N/m", time, values[:, chosen], names, **limits)
    return save_figure(draw_charts([chart], title), path)


def errors(trajectory: Trajectory, *, title: str = "", path: FilePath | None = None) -> Figure:
    """Draw the errors of bar lengths, joints and energy.

    Errors below 1e-18, and exact zeros, lie on the bottom edge. An error that was not computed has
    no curve.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
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
    TypeError
        `trajectory` is no trajectory.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> plots.errors(motion).axes[0].get_yscale()
    'log'
    """
    instance("trajectory", trajectory, Trajectory, EXAMPLE)
    curves = {"energy (J)": np.abs(trajectory.energy_error)}
    if len(trajectory.bars):
        curves["bar length, relative"] = trajectory.bar_length_error
        curves["joint gap (m)"] = trajectory.joint_error
    known = np.concatenate([values[np.isfinite(values)] for values in curves.values()])
    positive = known[known > 0]
    bottom = max(1e-18, 10.0 ** np.floor(np.log10(positive.min())) / 3) if positive.size else 1e-18
    figure, (ax,) = make_panels(1, "time (s)", title)
    for k, (name, values) in enumerate(curves.items()):
        label = name + _describe_smallness(values, bottom)
        drawn = np.maximum(values, bottom)  # NaN stays NaN
        ax.plot(trajectory.time, drawn, color=css_color(k), label=label, lw=1.3, clip_on=False)
    ax.set_yscale("log")
    ax.set_ylim(bottom, max(3 * positive.max(initial=0.0), 100 * bottom))
    ax.set_ylabel("error")
    add_legend(figure, ax, len(curves))
    return save_figure(figure, path)


def find_contact_intervals(trajectory: Trajectory) -> tuple[tuple[float, float], ...]:
    """Find the intervals of time [s] in which nodes or bars touch a ground.

    They are those of a trajectory, and () if it has no scene.
    """
    if trajectory.scene is None:
        return ()
    scene, time = fix(trajectory.scene, trajectory.parameters), trajectory.time
    touching = np.zeros(len(time), dtype=bool)
    for ground in scene.grounds:
        depths, _ = ground.find_depths(scene.modelled, trajectory.nodes)
        touching |= (depths > 0).any(axis=1)
    edges = np.flatnonzero(np.diff(touching, prepend=False, append=False))
    ends = np.minimum(edges[1::2], len(time) - 1)
    return tuple((float(time[a]), float(time[b])) for a, b in zip(edges[::2], ends, strict=True))


def choose_nodes(
    trajectory: Trajectory, nodes: Sequence[int | str] | None
) -> tuple[list[int], tuple[str, ...]]:
    """Select nodes by index or name, with their names.

    They are nodes of a trajectory. By default they are the nodes that move most.
    """
    given = _find_moving_nodes(trajectory) if nodes is None else nodes
    return choose_items(trajectory, "node", given, trajectory.nodes.shape[1])


def choose_items(
    history: Any, kind: Literal["node", "string"], items: Sequence[int | str] | None, count: int
) -> tuple[list[int], tuple[str, ...]]:
    """Select nodes or strings (`kind`) by index or name, with their names.

    `history` has a scene with these names, and `count` is the number of all items. By default all
    are selected.
    """
    scene, field = getattr(history, "scene", None), f"{kind}s"
    structure = None if scene is None else scene.modelled
    names, known = list_names(structure, kind, count), names_of(structure, **{kind: count})
    given = range(count) if items is None else known.resolve_all(field, kind, items)
    chosen = [known.index(field, kind, item) for item in as_tuple(field, given, "[0, 3]")]
    return chosen, tuple(names[k] for k in chosen)


def _describe_smallness(values: Array, bottom: float) -> str:
    """Explain a curve that is missing or on the bottom edge.

    `values` are those of the curve, and `bottom` is the value at the edge. Returns "" if it is
    visible.
    """
    if not np.isfinite(values).any():
        return ": not computed"
    largest = np.nanmax(values, initial=0.0)
    if largest > bottom:
        return ""
    return ": below 1e-18" if largest > 0 else ": exactly 0"


def _find_moving_nodes(trajectory: Trajectory) -> list[int]:
    """Find up to 12 nodes with the largest displacements.

    They are nodes of a trajectory. They are in the order of their indices.
    """
    way = np.ptp(trajectory.nodes, axis=0).max(axis=1)
    order = np.argsort(-way, kind="stable")[:MOST_LISTED]
    return sorted(int(node) for node in order if way[node] > 0) or [int(order[0])]


def _drop_infinity(limit: ArrayLike) -> Any:
    """Replace infinite limits by zero, so that the rest can be checked."""
    try:
        array = np.array(limit, dtype=float)
    except Exception:  # noqa: BLE001  an object's own __array__ may raise anything
        return limit  # rejected next, by name
    return np.where(np.isinf(array), 0.0, array)

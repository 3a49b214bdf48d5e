"""Energies and phase portraits of a trajectory."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from tenscasadi.drawing.view_content import Chart
from tenscasadi.plots.charts import draw_charts
from tenscasadi.plots.histories import EXAMPLE, choose_nodes, find_contact_intervals
from tenscasadi.plots.panels import add_legend, css_color, make_panels, save_figure
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import FilePath, choice, instance

_PARTS = ("kinetic", "elastic", "gravitational")


def energies(trajectory: Trajectory, *, title: str = "", path: FilePath | None = None) -> Figure:
    """Draw kinetic, elastic, gravitational and total energy over time.

    Times with contact to a ground are shaded.

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
    >>> [line.get_label() for line in plots.energies(motion).axes[0].lines]
    ['kinetic', 'gravitational', 'total']
    """
    instance("trajectory", trajectory, Trajectory, EXAMPLE)
    shown = [k for k in range(len(_PARTS)) if trajectory.energy_parts[:, k].any()]
    columns = [trajectory.energy_parts[:, k] for k in shown] + [trajectory.energy]
    names = (*(_PARTS[k] for k in shown), "total")
    contacts = find_contact_intervals(trajectory)
    values = np.stack(columns, axis=1)
    chart = Chart("energy", "J", trajectory.time, values, names, shaded=contacts)
    return save_figure(draw_charts([chart], title), path)


def phase_portrait(
    trajectory: Trajectory,
    nodes: Sequence[int | str] | None = None,
    *,
    axis: str = "z",
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the velocity of nodes over their coordinate.

    Points mark the start.

    Parameters
    ----------
    trajectory : Trajectory
        The motion.
    nodes : sequence of int or str, optional
        Nodes to draw, by index or name. Default: those that move, at most the 12 that move
        furthest.
    axis : {"x", "y", "z"}
        Coordinate.
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
    >>> model = tc.Model(tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity()))
    >>> motion = tc.simulate(model, t_end=0.2, step=0.01, compiled=False)
    >>> plots.phase_portrait(motion, axis="x").axes[0].get_xlabel()
    'x (m)'
    """
    instance("trajectory", trajectory, Trajectory, EXAMPLE)
    choice("axis", axis, "x", "y", "z")
    column = "xyz".index(axis)
    chosen, names = choose_nodes(trajectory, nodes)
    figure, (ax,) = make_panels(1, f"{axis} (m)", title, margin=0.05)
    for k, (node, name) in enumerate(zip(chosen, names, strict=True)):
        places, rates = trajectory.nodes[:, node, column], trajectory.velocities[:, node, column]
        ax.plot(places, rates, color=css_color(k), label=name, lw=1.3)
        ax.plot(places[:1], rates[:1], "o", color=css_color(k), ms=4)
    ax.set_ylabel(f"velocity along {axis} (m/s)")
    add_legend(figure, ax, len(chosen))
    return save_figure(figure, path)

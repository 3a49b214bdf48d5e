"""Figures of load paths: load factor over displacement."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tenscasadi.plots.panels import css_color, make_panels, save_figure
from tenscasadi.statics.load_path import LoadPath
from tenscasadi.util.validate import Array, FilePath, instance


def load_path(load_path: LoadPath, *, title: str = "", path: FilePath | None = None) -> Figure:
    """Draw load factor and member forces over the largest displacement.

    Stable equilibria are solid, unstable ones dotted. Marks show limit points and bifurcations.

    Parameters
    ----------
    load_path : LoadPath
        The path.
    title : str
        Title of the diagram.
    path : path-like, optional
        File to save the diagram to, whose suffix selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The diagram.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> rope = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    >>> path = tc.load_path(tc.Scene(rope), load=[(0, 0, 0), (0, 0, -1)], factors=(0, 10))
    >>> plots.load_path(path).axes[0].get_ylabel()
    'load factor'
    """
    instance("load_path", load_path, LoadPath, "a tenscasadi.LoadPath")
    node, axis = _largest_motion(load_path.nodes)
    moved = load_path.nodes[:, node, axis]
    moved = moved - moved[0] if len(moved) else moved
    back = bool(len(moved)) and abs(moved.min()) > abs(moved.max())
    moved = -moved if back else moved
    label = f"displacement of node {node} along {'−' if back else ''}{'xyz'[axis]} (m)"
    figure, (top, bottom) = make_panels(2, label, title, margin=0.02)
    top.set_ylabel("load factor")
    bottom.set_ylabel("force (N)")
    solid = np.array(load_path.stable)
    solid[[*load_path.limit_points, *load_path.bifurcations]] = True  # ends of stable parts
    _draw(top, moved, load_path.factor, solid, css_color(0), "")
    for k, (name, forces) in enumerate(
        {"strings": load_path.tension, "bars": load_path.bar_force}.items()
    ):
        for j, force in enumerate(forces.T):
            _draw(bottom, moved, force, solid, css_color(k), "" if j else name)
    marks = (
        ("limit point", "o", load_path.limit_points),
        ("bifurcation", "s", load_path.bifurcations),
    )
    for name, mark, rows in marks:
        if len(rows):
            style: dict[str, Any] = {"mfc": "white", "mec": "0.2", "ls": "", "zorder": 3}
            top.plot(moved[rows], load_path.factor[rows], mark, label=name, **style)
    for ax in (top, bottom):
        if ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize=8, frameon=False)
    return save_figure(figure, path)


def _largest_motion(nodes: Array) -> tuple[int, int]:
    """Find the coordinate with the largest displacement along a path.

    The nodes are (T, n, 3). Returns node and axis.
    """
    if not len(nodes):
        return 0, 0
    extent = np.ptp(nodes, axis=0)
    node, axis = np.unravel_index(int(np.argmax(extent)), extent.shape)
    return int(node), int(axis)


def _draw(ax: Any, x: Array, y: Array, stable: Any, color: str, label: str) -> None:
    """Draw a curve y(x), dotted where it is not `stable`.

    `stable` is a mask of its points. Without a `label`, "", it is not in the legend.
    """
    ax.plot(x, y, ":", color=color, lw=1.1)
    solid = np.where(stable, y, np.nan)
    ax.plot(x, solid, "-", color=color, lw=1.5, label=label or None)

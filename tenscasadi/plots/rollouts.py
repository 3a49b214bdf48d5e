"""Pictures of many motions at once: the fan of a node's path, the histogram of an outcome."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.plots.panels import FilePath, make_panels, save_figure
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.util.validate import (
    Array,
    finite_array,
    instance,
    real_array,
    shown,
    text,
    whole_number,
)

_SHARES = (0.05, 0.25)  # of the motions below a band, and above it
_DRAWN = 200  # motions drawn one by one beneath the bands


def fan(
    rollouts: Rollouts,
    node: int,
    axes: str = "xyz",
    *,
    bands: ArrayLike = _SHARES,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the coordinates of a node over time in all motions that succeeded: the median, and bands that hold most of them.

    Parameters
    ----------
    rollouts : Rollouts
        Motions with rows kept on the way (`save_every`).
    node : int
        Node to draw.
    axes : str
        Coordinates, one panel each, such as "z" or "xy".
    bands : array_like (k,)
        Shares of the motions that lie below each band, and above it: 0.05 draws the band from the 5
        % to the 95 % quantile.
    title : str
        Title of the figure; how many motions are drawn unless given.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type or value, or no motion succeeded.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0)), parameters=tc.Parameters(scale=["gravity"])))
    >>> many = tc.rollouts(model, 0.5, 0.01, parameters=np.linspace(0.8, 1.2, 50)[:, None], save_every=1)
    >>> figure = plots.fan(many, node=2, axes="xy")
    >>> [ax.get_ylabel() for ax in figure.axes]
    ['x of node 2 (m)', 'y of node 2 (m)']
    """
    good = _succeeded(rollouts)
    if not text("axes", axes) or sorted(set(axes) & set("xyz")) != sorted(axes):
        raise ValueError(f"axes is {shown(axes)}: give some of x, y and z, each once, such as 'xz'")
    shares = np.sort(finite_array("bands", bands, (None,)))
    if np.any((shares < 0) | (shares >= 0.5)):
        raise ValueError(f"bands is {shares}: give shares of 0 or more, less than 0.5")
    places = rollouts.path(node)[good]
    figure, panels = make_panels(
        len(axes), "time (s)", text("title", title) or f"{len(places)} of {len(good)} motions"
    )
    for ax, axis in zip(panels, axes, strict=True):
        values = places[:, :, "xyz".index(axis)]
        drawn = values[np.linspace(0, len(values) - 1, min(len(values), _DRAWN)).astype(int)]
        ax.plot(rollouts.time, drawn.T, color="0.6", linewidth=0.4, alpha=0.35, zorder=1)
        for k, share in enumerate(shares):
            low, high = np.quantile(values, [share, 1 - share], axis=0)
            label = f"{share:.0%} … {1 - share:.0%}"
            ax.fill_between(
                rollouts.time,
                low,
                high,
                color="C0",
                alpha=0.18 + 0.5 * (k + 1) / (len(shares) + 1),
                linewidth=0,
                zorder=2 + k,
                label=label,
            )
        ax.plot(
            rollouts.time,
            np.median(values, axis=0),
            color="C1",
            linewidth=1.6,
            zorder=9,
            label="median",
        )
        ax.set_ylabel(f"{axis} of node {node} (m)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, frameon=False, loc="outside right upper")
    return save_figure(figure, path)


def histogram(
    rollouts: Rollouts,
    outcome: ArrayLike,
    label: str = "outcome",
    *,
    bins: int | None = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw how an outcome is distributed over the motions that succeeded, with its median and its 5 % and 95 % quantiles.

    Parameters
    ----------
    rollouts : Rollouts
        Motions.
    outcome : array_like (n,)
        What came out of each motion, such as a coordinate of `rollouts.final`; what failed may be
        NaN.
    label : str
        What it is, with its unit.
    bins : int, optional
        Number of bars. Default: by the number of motions and their spread.
    title : str
        Title of the figure; how many motions are counted unless given.
    path : path-like, optional
        File to save the figure to; its suffix (.png, .pdf, .svg ...) says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        If an argument has a wrong type, shape or value, or no motion succeeded.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0)), parameters=tc.Parameters(scale=["gravity"])))
    >>> many = tc.rollouts(model, 0.5, 0.01, parameters=np.linspace(0.8, 1.2, 50)[:, None])
    >>> figure = plots.histogram(many, many.path(2)[:, -1, 1], "height of the tip (m)")
    >>> figure.axes[0].get_xlabel()
    'height of the tip (m)'
    """
    good = _succeeded(rollouts)
    values = real_array("outcome", outcome, f"an array of shape ({len(good)},)")
    if values.shape != good.shape:
        raise ValueError(
            f"outcome has shape {values.shape}: give one number for each of the {len(good)} motions"
        )
    values = finite_array("outcome", values[good], (None,))
    text("label", label)
    count: Any = "auto" if bins is None else whole_number("bins", bins, 1, 10_000)
    figure, (ax,) = make_panels(
        1, label, text("title", title) or f"{len(values)} of {len(good)} motions"
    )
    ax.hist(values, bins=count if np.ptp(values) > _smallest(values) else 1, color="C0", alpha=0.75)
    for share, style in ((0.05, ":"), (0.5, "-"), (0.95, ":")):
        place = float(np.quantile(values, share))
        ax.axvline(
            place,
            color="C1",
            linestyle=style,
            label=f"{'median' if share == 0.5 else f'{share:.0%}'}: {place:.4g}",
        )
    ax.set_ylabel("motions")
    ax.set_axisbelow(True)
    figure.legend(
        *ax.get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside right upper"
    )
    return save_figure(figure, path)


def _succeeded(rollouts: Rollouts) -> Any:
    instance("rollouts", rollouts, Rollouts, "what tenscasadi.rollouts returns")
    if not rollouts.success.any():
        raise ValueError("rollouts: no motion succeeded, there is nothing to draw")
    return rollouts.success


def _smallest(values: Array) -> float:
    """Return the spread below which rounding alone makes values differ: bars could not be told apart."""
    return 1e-9 * float(np.abs(values).max())

"""Statistics of rollouts: quantiles over time, and histograms."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.plots.histories import choose_items
from tenscasadi.plots.panels import css_color, make_panels, save_figure
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.util.validate import (
    FilePath,
    finite_array,
    format_value,
    instance,
    real_array,
    text,
    whole_number,
)


def fan(
    rollouts: Rollouts,
    node: int | str,
    axes: str = "xyz",
    *,
    bands: ArrayLike = (0.05, 0.25),
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the coordinates of a node over time in all successful rollouts.

    Bands between quantiles surround the median.

    Parameters
    ----------
    rollouts : Rollouts
        Rollouts with saved rows (`save_every`).
    node : int or str
        Node to draw.
    axes : str
        Coordinates, one panel each, such as "z" or "xy".
    bands : array_like (k,)
        Fractions of the motions below and above each band: 0.05 draws the band from the 5 % to the
        95 % quantile.
    title : str
        Title of the figure. Default: the number of drawn motions.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type or value, or no motion succeeded.

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
    good = _find_successful(rollouts)
    if not text("axes", axes) or sorted(set(axes) & set("xyz")) != sorted(axes):
        raise ValueError(
            f"axes is {format_value(axes)}: give some of x, y and z, each once, such as 'xz'"
        )
    fractions = np.sort(finite_array("bands", bands, (None,)))
    if np.any((fractions < 0) | (fractions >= 0.5)):
        raise ValueError(f"bands is {fractions}: give fractions of at least 0 and less than 0.5")
    places = rollouts.path(node)[good]
    name = choose_items(rollouts, "node", [node], len(rollouts.place))[1][0]
    figure, panels = make_panels(
        len(axes), "time (s)", text("title", title) or f"{len(places)} of {len(good)} motions"
    )
    for ax, axis in zip(panels, axes, strict=True):
        values = places[:, :, "xyz".index(axis)]
        drawn = values[np.linspace(0, len(values) - 1, min(len(values), 200)).astype(int)]
        ax.plot(rollouts.time, drawn.T, color="0.6", linewidth=0.4, alpha=0.35, zorder=1)
        for k, fraction in enumerate(fractions):
            low, high = np.quantile(values, [fraction, 1 - fraction], axis=0)
            label = f"{fraction:.0%} … {1 - fraction:.0%}"
            ax.fill_between(
                rollouts.time,
                low,
                high,
                color=css_color(0),
                alpha=0.18 + 0.5 * (k + 1) / (len(fractions) + 1),
                linewidth=0,
                zorder=2 + k,
                label=label,
            )
        ax.plot(
            rollouts.time,
            np.median(values, axis=0),
            color=css_color(1),
            linewidth=1.6,
            zorder=9,
            label="median",
        )
        ax.set_ylabel(f"{axis} of {name} (m)")
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
    """Draw the histogram of a quantity over all successful rollouts.

    Lines mark its median and its 5 % and 95 % quantiles.

    Parameters
    ----------
    rollouts : Rollouts
        Rollouts.
    outcome : array_like (n,)
        Quantity of each motion, such as a coordinate of `rollouts.final`; NaN is allowed for failed
        ones.
    label : str
        Name of the quantity, with its unit.
    bins : int, optional
        Number of bars. Default: by the number of motions and their spread.
    title : str
        Title of the figure. Default: the number of counted motions.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type, shape or value, or no motion succeeded.

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
    good = _find_successful(rollouts)
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
    rounding = 1e-9 * float(np.abs(values).max())  # equal values are one bar
    ax.hist(values, bins=count if np.ptp(values) > rounding else 1, color=css_color(0), alpha=0.75)
    for fraction, style in ((0.05, ":"), (0.5, "-"), (0.95, ":")):
        place = float(np.quantile(values, fraction))
        ax.axvline(
            place,
            color=css_color(1),
            linestyle=style,
            label=f"{'median' if fraction == 0.5 else f'{fraction:.0%}'}: {place:.4g}",
        )
    ax.set_ylabel("motions")
    ax.set_axisbelow(True)
    figure.legend(
        *ax.get_legend_handles_labels(), fontsize=8, frameon=False, loc="outside right upper"
    )
    return save_figure(figure, path)


def _find_successful(rollouts: Rollouts) -> Any:
    instance("rollouts", rollouts, Rollouts, "the result of tenscasadi.rollouts")
    if not rollouts.success.any():
        raise ValueError("rollouts: no motion succeeded, there is nothing to draw")
    return rollouts.success

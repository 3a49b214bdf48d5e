"""Robustness of plans: errors of many replays, and their causes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from tenscasadi.plots.panels import css_color, save_figure, style_axes
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import Array, FilePath, format_value, text


class ReplayErrors(Protocol):
    """Interface of errors of many replays, as in `ocp.Robustness`.

    Attributes
    ----------
    worst_error : ndarray, shape (n,)
        Error of each replay [m], inf if it diverges.
    tolerance : float
        Largest accepted error [m].
    importance : mapping of str to float
        Fraction of the variance of the errors that is due to each varied quantity.
    """

    @property
    def worst_error(self) -> Array:
        """Errors (n,) [m]."""

    @property
    def tolerance(self) -> float:
        """Largest accepted error [m]."""

    @property
    def importance(self) -> Mapping[str, float]:
        """Fractions of the variance by name."""


@rename_keywords(what="data")
def robustness(
    data: ReplayErrors | Mapping[str, ReplayErrors],
    *,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the distribution of replay errors, and their causes.

    Parameters
    ----------
    data : Robustness, or mapping of str to Robustness
        Result of `Plan.robustness`, or several by name, such as open loop and tracked.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to, whose suffix selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong.

    Examples
    --------
    >>> from types import SimpleNamespace
    >>> import numpy as np
    >>> from tenscasadi import plots
    >>> found = SimpleNamespace(worst_error=np.linspace(0.01, 0.1, 50), tolerance=0.05, importance={"bar_mass": 0.9, "start": 0.1})
    >>> len(plots.robustness(found).axes)
    2
    """
    several = _read_errors(data)
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    style_axes(left)
    style_axes(right, grid="x")
    for k, (name, one) in enumerate(several.items()):
        ended = np.sort(one.worst_error[np.isfinite(one.worst_error)])
        percent = 100 * np.arange(1, len(ended) + 1) / len(one.worst_error)
        left.step(ended, percent, where="post", color=css_color(k), label=name or None)
        left.axvline(
            one.tolerance,
            color=css_color(k)
            if len({other.tolerance for other in several.values()}) > 1
            else "0.4",
            ls="--",
            lw=1.0,
        )
        met = 100 * float(np.mean(one.worst_error <= one.tolerance))
        left.annotate(
            f"{met:.3g} %",
            (one.tolerance, met),
            xytext=(4, -10),
            textcoords="offset points",
            color=css_color(k),
            fontsize=9,
        )
    _draw_importance(right, several)
    left.set_xscale("log")
    left.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set(
        ylim=(0, 102),
        xlabel="final error (m); dashed: tolerance",
        ylabel="replays within this error (%)",
    )
    if len(several) > 1:
        left.legend(frameon=False, fontsize=9)
    figure.suptitle(text("title", title))
    return save_figure(figure, path)


def _read_errors(data: Any) -> dict[str, ReplayErrors]:
    """Check the results to draw, and return them by name.

    `data` is one result, or a mapping of names to results. Raises TypeError, ValueError.
    """
    several = dict(data) if isinstance(data, Mapping) else {"": data}
    if not several:
        raise ValueError("data is empty: give the result of plan.robustness(...)")
    for name, one in several.items():
        text("data: a name", name)
        if not all(hasattr(one, field) for field in ("worst_error", "tolerance", "importance")):
            raise TypeError(
                f"data is {format_value(one)}: give the result of plan.robustness(...), or several of them by name"
            )
    return several


def _draw_importance(ax: Axes, several: Mapping[str, ReplayErrors]) -> None:
    names = list(dict.fromkeys(name for one in several.values() for name in one.importance))
    height = 0.8 / len(several)
    for k, one in enumerate(several.values()):
        places = np.arange(len(names)) + (k - (len(several) - 1) / 2) * height
        ax.barh(
            places,
            [100 * np.nan_to_num(one.importance.get(name, 0.0)) for name in names],
            height,
            color=css_color(k),
        )
    ax.set(
        yticks=np.arange(len(names)),
        yticklabels=names,
        xlim=(0, 100),
        xlabel="fraction of the variance of the errors (%)",
    )
    ax.invert_yaxis()

"""Pictures of how robust a plan is: how many of its replays end how near to the goals, and what matters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from tenscasadi.plots.panels import FilePath, curve_colour, save_figure
from tenscasadi.util.validate import Array, shown, text


class ReplayErrors(Protocol):
    """Errors of many replays: a `Robustness` of `ocp`.

    Attributes
    ----------
    worst_error : ndarray, shape (n,)
        Error of each replay, m; inf where it diverges.
    tolerance : float
        What it may be, m.
    importance : mapping of str to float
        The share of the errors that each thing which varies brings about.
    """

    @property
    def worst_error(self) -> Array:
        """Errors (n,), m."""

    @property
    def tolerance(self) -> float:
        """The largest that is accepted, m."""

    @property
    def importance(self) -> Mapping[str, float]:
        """Shares by name."""


def robustness(
    what: ReplayErrors | Mapping[str, ReplayErrors],
    *,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the share of replays that end within an error, and what brings the errors about.

    Parameters
    ----------
    what : Robustness, or mapping of str to Robustness
        What `Plan.robustness` returns; several by name, such as open loop and tracked.
    title : str
        Title of the picture.
    path : path-like, optional
        File to save it to; its suffix says the format.

    Returns
    -------
    matplotlib.figure.Figure
        The picture.

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
    several = _read(what)
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    for ax in (left, right):
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(visible=True, color="0.9", axis="both" if ax is left else "x")
        ax.set_axisbelow(True)
    for k, (name, one) in enumerate(several.items()):
        ended = np.sort(one.worst_error[np.isfinite(one.worst_error)])
        shares = 100 * np.arange(1, len(ended) + 1) / len(one.worst_error)
        left.step(ended, shares, where="post", color=curve_colour(k), label=name or None)
        left.axvline(
            one.tolerance,
            color=curve_colour(k)
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
            color=curve_colour(k),
            fontsize=9,
        )
    _draw_importance(right, several)
    left.set_xscale("log")
    left.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    left.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    left.xaxis.set_minor_formatter(NullFormatter())
    left.set(
        ylim=(0, 102),
        xlabel="error at the end (m); dashed: tolerance",
        ylabel="replays that end within it (%)",
    )
    if len(several) > 1:
        left.legend(frameon=False, fontsize=9)
    figure.suptitle(text("title", title))
    return save_figure(figure, path)


def _read(what: Any) -> dict[str, ReplayErrors]:
    """Return what is drawn by name. Raises TypeError, ValueError."""
    several = dict(what) if isinstance(what, Mapping) else {"": what}
    if not several:
        raise ValueError("what is empty: give what plan.robustness(...) returns")
    for name, one in several.items():
        text("what: a name", name)
        if not all(hasattr(one, field) for field in ("worst_error", "tolerance", "importance")):
            raise TypeError(
                f"what is {shown(one)}: give what plan.robustness(...) returns, or several of them by name"
            )
    return several


def _draw_importance(ax: Axes, several: Mapping[str, ReplayErrors]) -> None:
    names: Sequence[str] = list(
        dict.fromkeys(name for one in several.values() for name in one.importance)
    )
    height = 0.8 / len(several)
    for k, one in enumerate(several.values()):
        places = np.arange(len(names)) + (k - (len(several) - 1) / 2) * height
        ax.barh(
            places,
            [100 * np.nan_to_num(one.importance.get(name, 0.0)) for name in names],
            height,
            color=curve_colour(k),
        )
    ax.set(
        yticks=np.arange(len(names)),
        yticklabels=names,
        xlim=(0, 100),
        xlabel="share of the variance of the misses (%)",
    )
    ax.invert_yaxis()

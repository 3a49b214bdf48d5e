"""Panels of curves: axes in one style, a legend beside them, and figures saved where a path is given."""

from __future__ import annotations

import os
from io import BytesIO
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tenscasadi.util.validate import file_path, text
from tenscasadi.util.whole_file import whole_file

FilePath = str | os.PathLike[str]
LONG_NAME = 40  # characters: more beside the panels would leave them no room
MOST_NAMED = (
    12  # curves that one column of the legend names; beyond two columns only their number is told
)


def make_panels(
    count: int,
    xlabel: str,
    title: str = "",
    size: tuple[float, float] | None = None,
    margin: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Return a figure of `count` panels, one below the other, that share their horizontal axis.

    `size` is in inches; `margin` is the share of the horizontal axis that is left free at both of
    its ends.
    """
    figure = Figure(
        figsize=size or (7.2, 3.6 if count == 1 else 1.0 + 1.8 * count), layout="constrained"
    )
    axes = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for ax in axes:
        ax.grid(visible=True, color="0.9")
        ax.spines[["top", "right"]].set_visible(False)
        ax.margins(x=margin)
    figure.align_ylabels(axes)
    axes[-1].set_xlabel(xlabel)
    axes[0].set_title(text("title", title))
    return figure, axes


def curve_colour(k: int) -> Any:
    """Return the colour of curve `k`; after ten they repeat."""
    return f"C{k % 10}"


def curve_width(k: int, count: int) -> float:
    """Return the width of curve `k` of `count`: later curves are thinner, so that earlier ones that they cover stay visible."""
    return 2.6 - 1.6 * k / max(1, count - 1)


def name_curves(figure: Figure, ax: Axes, count: int) -> None:
    """Add a legend of the curves of `ax` beside the panels, or below them where names are long; too many curves are told as a number."""
    if count > 2 * MOST_NAMED:
        ax.annotate(
            f"{count} curves",
            (1, 1),
            xycoords="axes fraction",
            ha="right",
            va="top",
            fontsize=8,
            color="0.35",
        )
    elif count:
        handles, labels = ax.get_legend_handles_labels()
        below = max(map(len, labels), default=0) > LONG_NAME
        options: dict[str, Any] = {
            "loc": "outside lower center" if below else "outside right upper",
            "ncols": 2 if below or count > MOST_NAMED else 1,
        }
        figure.legend(handles, labels, fontsize=8, frameon=False, **options)


def save_figure(figure: Figure, path: FilePath | None) -> Figure:
    """Save `figure` where `path` is given, and return it."""
    if path is not None:
        target, known = file_path("path", path), figure.canvas.get_supported_filetypes()
        if target.suffix and target.suffix[1:].lower() not in known:
            raise ValueError(
                f"path is {os.fspath(path)!r}: give a name that ends in .{', .'.join(known)}"
            )
        form, drawn = target.suffix[1:].lower() or figure.canvas.get_default_filetype(), BytesIO()
        figure.savefig(
            drawn, format=form, dpi=150
        )  # not into the file: some formats fail in their own ways where the disk is full
        with whole_file(target if target.suffix else f"{target}.{form}") as file:
            file.write(drawn.getvalue())
    return figure

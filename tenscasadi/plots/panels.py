"""Panels of curves in a common style, and figure files."""

from __future__ import annotations

import os
from io import BytesIO
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tenscasadi.drawing.style import curve_color, format_css
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import FilePath, file_path, text
from tenscasadi.util.whole_file import whole_file


def make_panels(
    count: int,
    xlabel: str,
    title: str = "",
    size: tuple[float, float] | None = None,
    margin: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Make `count` panels one below the other, with a common horizontal axis.

    `xlabel` is the label of this axis. `size` is in inches; `margin` is the free fraction of the
    horizontal axis at both ends.
    """
    default = (7.2, 3.6 if count == 1 else 1.0 + 1.8 * count)
    figure = Figure(figsize=size or default, layout="constrained")
    axes = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for ax in axes:
        style_axes(ax)
        ax.margins(x=margin)
    figure.align_ylabels(axes)
    axes[-1].set_xlabel(xlabel)
    axes[0].set_title(text("title", title))
    return figure, axes


def style_axes(ax: Axes, grid: str = "both") -> None:
    """Add grid lines, and remove the upper and the right border of a panel.

    `grid` is "x", "y" or "both".
    """
    ax.grid(visible=True, color="0.9", axis=grid)  # type: ignore[arg-type]
    ax.spines[["top", "right"]].set_visible(False)
    ax.set_axisbelow(True)


def css_color(k: int) -> str:
    """Select the color of curve `k` for matplotlib."""
    return format_css(curve_color(k))


def add_legend(figure: Figure, ax: Axes, count: int) -> None:
    """Add a legend of `count` curves beside the panels.

    The curves are in the panel `ax`. The legend is below the panels if names are long. If it needed
    more than two columns, only the number is written.
    """
    if count > 2 * MOST_LISTED:
        place: dict[str, Any] = {"xycoords": "axes fraction", "ha": "right", "va": "top"}
        ax.annotate(f"{count} curves", (1, 1), fontsize=8, color="0.35", **place)
    elif count:
        handles, labels = ax.get_legend_handles_labels()
        below = max(map(len, labels), default=0) > 40
        figure.legend(
            handles,
            labels,
            fontsize=8,
            frameon=False,
            loc="outside lower center" if below else "outside right upper",
            ncols=2 if below or count > MOST_LISTED else 1,
        )


def save_figure(figure: Figure, path: FilePath | None) -> Figure:
    """Save a figure if a path is given, and return it."""
    if path is not None:
        target, known = file_path("path", path), figure.canvas.get_supported_filetypes()
        form = target.suffix[1:].lower() or figure.canvas.get_default_filetype()
        if form not in known:
            raise ValueError(
                f"path is {os.fspath(path)!r}: give a name that ends in .{', .'.join(known)}"
            )
        drawn = BytesIO()  # some formats fail in their own ways if the disk is full
        figure.savefig(drawn, format=form, dpi=150)
        with whole_file(target if target.suffix else f"{target}.{form}") as file:
            file.write(drawn.getvalue())
    return figure

"""Charts of curves over time, with labels, limits and shaded intervals."""

from __future__ import annotations

import re
from dataclasses import replace
from io import StringIO
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tenscasadi.drawing.style import STYLE
from tenscasadi.drawing.view_content import Chart
from tenscasadi.plots.panels import css_color, make_panels
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import Array

Groups = list[list[int]]


def draw_charts(charts: list[Chart], title: str = "") -> Figure:
    """Draw charts one below the other, with a common time axis and a title."""
    figure, axes = make_panels(len(charts), "time (s)", title)
    for ax, chart in zip(axes, charts, strict=True):
        draw_chart(ax, chart)
    return figure


def draw_chart(ax: Axes, chart: Chart) -> None:
    """Draw a chart in axes.

    Curves that coincide share a color and a label.
    """
    for start, end in chart.shaded:
        ax.axvspan(start, end, color="0.92", lw=0, zorder=0)
    groups = group_curves(chart.values)
    held = len(chart.values) == len(chart.time) - 1
    colors = _choose_colors(chart, groups)
    for color, members in zip(colors, groups, strict=True):
        for curve in members:
            style: dict[str, Any] = {"color": color, "lw": 1.3, "label": chart.names[curve]}
            if held:
                ax.stairs(chart.values[:, curve], chart.time, baseline=None, **style)
            else:
                ax.plot(chart.time, chart.values[:, curve], **style)
    ax.set_ylabel(f"{chart.title} ({chart.unit})")
    _draw_limits(ax, chart, groups, colors)
    _widen(ax)
    if len(groups) <= MOST_LISTED:
        _label_curves(ax, chart, groups, colors)
    else:
        ax.annotate(f"{chart.values.shape[1]} curves", (1, 1), None, "axes fraction", ha="right")


def draw_svg(chart: Chart, width: float, height: float) -> tuple[str, tuple[float, float]]:
    """Draw a chart as SVG text.

    `width` and `height` are in inches. Also returns the positions of the first and the last time as
    fractions of its width.
    """
    with mpl.rc_context({"svg.fonttype": "none", "font.size": 7.0, "path.simplify": True}):
        figure = Figure(figsize=(width, height), layout="constrained")
        ax = figure.subplots()
        draw_chart(ax, _reduce(chart))
        ax.margins(x=0)
        ax.set_xlabel("time (s)")
        file = StringIO()
        figure.savefig(file, format="svg")
    text = file.getvalue()
    ends = ax.get_position().intervalx
    return text[text.index("<svg") :], (float(ends[0]), float(ends[1]))


def _reduce(chart: Chart, curves: int = 40, rows: int = 300) -> Chart:
    """Reduce a chart to few rows and the largest curves.

    This keeps files small.
    """
    count = chart.values.shape[1]
    reach = np.abs(np.nan_to_num(chart.values)).max(axis=0, initial=0.0)
    chosen = np.sort(np.argsort(-reach, kind="stable")[:curves])
    kept = np.unique(np.linspace(0, len(chart.time) - 1, rows).astype(int))
    is_held = len(chart.values) == len(chart.time) - 1
    return replace(
        chart,
        title=chart.title if count <= curves else f"{chart.title}, {curves} of {count}",
        time=chart.time[kept],
        values=chart.values[kept[:-1] if is_held else kept][:, chosen],
        names=tuple(chart.names[k] for k in chosen),
        lower=None if chart.lower is None else chart.lower[chosen],
        upper=None if chart.upper is None else chart.upper[chosen],
    )


def group_curves(values: Array) -> Groups:
    """Group columns of values (T, m) that nearly coincide.

    The tolerance is 0.5 % of their range. Members of a symmetric structure with equal curves are in
    one group.
    """
    rows = np.unique(np.linspace(0, len(values) - 1, min(len(values), 200)).astype(int))
    some = np.nan_to_num(values[rows])
    near = 0.005 * float(np.ptp(some)) if some.size else 0.0
    groups: Groups = []
    for curve in range(values.shape[1]):
        for members in groups:
            if np.abs(some[:, members[0]] - some[:, curve]).max() <= near:
                members.append(curve)
                break
        else:
            groups.append([curve])
    return groups


def _choose_colors(chart: Chart, groups: Groups) -> list[str]:
    """Choose the color of each group of nearly equal curves.

    It is that of its first curve if there are few curves.
    """
    few = chart.values.shape[1] <= len(STYLE.curves)
    return [css_color(members[0] if few else k) for k, members in enumerate(groups)]


def _draw_limits(ax: Axes, chart: Chart, groups: Groups, colors: list[str]) -> None:
    """Draw limits of a chart as dashed lines, or as a band between common ones.

    They have the colors of their groups of curves. Limits far away are only written, as they would
    flatten the curves.
    """
    known = chart.values[np.isfinite(chart.values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    reach = max(high - low, 0.1 * abs(high))
    view, band, words = ax.get_ylim(), [low - 2 * reach, high + 2 * reach], []
    for side, (sign, limits) in enumerate((("≥", chart.lower), ("≤", chart.upper))):
        if limits is None:
            continue
        group_limits = [float(limits[members[0]]) for members in groups]
        common = len(set(limits.tolist())) == 1
        for limit, color in dict(zip(group_limits, colors, strict=True)).items():
            if low - reach <= limit <= high + reach:
                ax.axhline(limit, color="black" if common else color, ls=(0, (5, 3)), lw=0.9)
                view = min(view[0], limit - 0.05 * reach), max(view[1], limit + 0.05 * reach)
        if common and np.isfinite(group_limits[0]):
            band[side] = min(max(group_limits[0], band[0]), band[1])
            words.append(f"{sign} {group_limits[0]:.4g}")
    if words:
        ax.axhspan(*band, color="0.5", alpha=0.08, zorder=0)
        text = f"limits: {' and '.join(words)} {chart.unit}"
        ax.set_title(text, fontsize="small", loc="right")
    ax.set_ylim(view)


def _label_curves(ax: Axes, chart: Chart, groups: Groups, colors: list[str]) -> None:
    """Write the names of curves at their right ends, without overlap.

    Groups of curves have common names and `colors`.
    """
    if chart.values.shape[1] < 2:
        return
    low, high = ax.get_ylim()
    last = np.nan_to_num(chart.values)[-1]
    heights = np.array([(last[group[0]] - low) / (high - low) for group in groups])
    size = 0.7 * mpl.rcParams["font.size"]  # points
    gap = 1.25 * size / (72 * ax.get_window_extent().height / ax.figure.dpi)
    for k, height in zip(*_spread(heights, gap), strict=True):
        name = _join_names([chart.names[i] for i in groups[k]])
        ax.annotate(
            name,
            (1, height),
            (4, 0),
            "axes fraction",
            textcoords="offset points",
            color=colors[k],
            fontsize=size,
            va="center",
            annotation_clip=False,
        )


def _spread(heights: Array, gap: float) -> tuple[list[int], list[float]]:
    """Move heights apart until neighbors are separated by a gap.

    Returns their order from below, and the new heights in that order.
    """
    order = np.argsort(heights, kind="stable")
    found = np.clip(heights[order], 0.0, 1.0)
    for k in range(1, len(found)):
        found[k] = max(found[k], found[k - 1] + gap)
    found = np.minimum(found, 1.0 + gap * np.arange(1 - len(found), 1))
    return order.tolist(), found.tolist()


def _join_names(names: list[str]) -> str:
    """Join names that differ by numbers.

    "string 0" and "string 1" become "string 0, 1"; "top[0]" and "top[1]" become "top[0, 1]".
    """
    stems: dict[tuple[str, str], list[str]] = {}
    for name in names[:4]:
        stem, number, end = re.findall(r"^(.*?)(\d*)(\]?)$", name)[0]
        stems.setdefault((stem, end), []).append(number)
    joined = [f"{stem}{', '.join(numbers)}{end}" for (stem, end), numbers in stems.items()]
    return ", ".join(joined + ["…"] * (len(names) > 4))


def _widen(ax: Axes) -> None:
    """Widen the vertical axis of a constant curve.

    Otherwise its rounding errors would fill the chart. `ax` is the panel of the curve.
    """
    low, high = ax.get_ylim()
    if high - low < 1e-6 * max(abs(low), abs(high), 1e-6):
        middle = (low + high) / 2
        reach = 0.05 * abs(middle) or 0.05
        ax.set_ylim(middle - reach, middle + reach)

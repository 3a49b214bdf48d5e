"""Curves over time as SVG: light enough for the panel of a page, the same live and saved."""

from __future__ import annotations

from html import escape

import numpy as np

from tenscasadi.util.validate import Array
from tenscasadi.viewer.exhibit import Chart, Exhibit
from tenscasadi.viewer.scenery import grid_spacing

_WIDTH, _HEIGHT = 280, 150
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 6, 18, 26
_MOST_CURVES = 40
_MOST_NAMED = 14  # that fit below the axis
_MOST_POINTS = 300
_CURSOR = "#c0392b"
_COLOURS = (
    "#1f77b4",
    "#ff7f0e",
    "#2ca02c",
    "#d62728",
    "#9467bd",
    "#8c564b",
    "#e377c2",
    "#7f7f7f",
    "#bcbd22",
    "#17becf",
)


def charts(exhibit: Exhibit, marked: bool) -> str:
    """Return all curves of an exhibit; `marked`: with a line of class "cursor" each that a script moves."""
    return "".join(chart_svg(chart, marked) for chart in exhibit.charts)


def cursors(exhibit: Exhibit, time: float) -> str:
    """Return lines that mark a time in the charts, drawn over those that `charts` gave just before."""
    lines = []
    for chart in exhibit.charts:
        first, last = float(chart.time[0]), float(chart.time[-1])
        x = _LEFT + (min(max(time, first), last) - first) * (_WIDTH - _LEFT - _RIGHT) / (
            last - first or 1.0
        )
        line = f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{_HEIGHT - _BOTTOM}" stroke="{_CURSOR}"/>'
        lines.append(
            f'<svg class="marks" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" style="display:block">{line}</svg>'
        )
    up = 100 * len(exhibit.charts) * _HEIGHT / _WIDTH  # percentages of a margin are of the width
    return f'<div style="margin-top:-{up:.3f}%;position:relative;pointer-events:none">{"".join(lines)}</div>'


def chart_svg(chart: Chart, marked: bool = False) -> str:
    """Return one chart: curves, dashed limits, numbers at the axes, and a line of class "cursor" that can mark a time."""
    shown = _chosen(chart)
    values = chart.values[:, shown]
    bounds = [
        limit[shown][np.isfinite(limit[shown])]
        for limit in (chart.lower, chart.upper)
        if limit is not None
    ]
    low, high = _range(values, bounds)
    first, last = float(chart.time[0]), float(chart.time[-1])
    wide, tall = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    per_second = wide / (last - first or 1.0)

    def x(time: Array) -> Array:
        return _LEFT + (time - first) * per_second

    def y(value: Array) -> Array:
        return _TOP + tall * (high - value) / (high - low)

    drawn = [_axes(chart, len(shown), low, high), _names(chart, shown)]
    held = len(values) == len(chart.time) - 1
    times = np.repeat(chart.time, 2)[1:-1] if held else chart.time
    for k, member in enumerate(shown):
        curve = np.repeat(values[:, k], 2) if held else values[:, k]
        colour = _COLOURS[k % len(_COLOURS)]
        drawn.append(_line(x(times), y(curve), f'stroke="{colour}"', chart.names[member]))
    for level in sorted(
        {round(float(bound), 12) for limit in bounds for bound in limit if low <= bound <= high}
    )[:12]:
        at = float(y(np.array(level)))
        drawn.append(
            f'<path d="M{_LEFT} {at:.1f}h{wide}" stroke="#000" stroke-dasharray="5 3" fill="none"><title>limit {level:.4g}</title></path>'
        )
    cursor = f'data-left="{_LEFT}" data-first="{first!r}" data-scale="{per_second!r}"'
    if marked:
        drawn.append(
            f'<line class="cursor" {cursor} x1="{_LEFT}" x2="{_LEFT}" y1="{_TOP}" y2="{_TOP + tall}" stroke="{_CURSOR}"/>'
        )
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" style="display:block;font:9px system-ui,sans-serif">{"".join(drawn)}</svg>'


def _chosen(chart: Chart) -> list[int]:
    """Return the curves that are drawn: all, or those that reach furthest from 0, in their order."""
    count = chart.values.shape[1]
    reach = np.abs(np.nan_to_num(chart.values)).max(axis=0, initial=0.0)
    return sorted(int(k) for k in np.argsort(-reach, kind="stable")[: min(count, _MOST_CURVES)])


def _range(values: Array, bounds: list[Array]) -> tuple[float, float]:
    """Return the values at the bottom and the top: limits that are far off are not made room for."""
    known = values[np.isfinite(values)]
    low, high = float(known.min(initial=0.0)), float(known.max(initial=0.0))
    reach = (high - low) or 1.0
    for bound in np.concatenate(bounds) if bounds else ():
        if low - reach <= bound <= high + reach:
            low, high = min(low, float(bound)), max(high, float(bound))
    return low - 0.04 * (high - low or 1.0), high + 0.04 * (high - low or 1.0)


def _axes(chart: Chart, drawn: int, low: float, high: float) -> str:
    wide, tall = _WIDTH - _LEFT - _RIGHT, _HEIGHT - _TOP - _BOTTOM
    count = chart.values.shape[1]
    some = f", {drawn} of {count}" if drawn < count else ""
    right = _WIDTH - _RIGHT
    ticks = "".join(
        _tick(value, _TOP + tall * (high - value) / (high - low), wide)
        for value in _ticks(low, high)
    )
    return (
        f'<text x="{_LEFT}" y="12"><tspan font-weight="600">{escape(chart.title)} ({escape(chart.unit)}){some}</tspan>{_limits(chart)}</text>'
        f'{ticks}<rect x="{_LEFT}" y="{_TOP}" width="{wide}" height="{tall}" fill="none" stroke="#ccc"/>'
        f'<text x="{_LEFT}" y="{_HEIGHT - 14}">{chart.time[0]:.3g}</text>'
        f'<text x="{right}" y="{_HEIGHT - 14}" text-anchor="end">{chart.time[-1]:.3g}</text>'
        f'<text x="{(_LEFT + right) / 2}" y="{_HEIGHT - 14}" text-anchor="middle">time (s)</text>'
    )


def _ticks(low: float, high: float) -> list[float]:
    """Return 3 to 8 round values between two."""
    step = grid_spacing(2.5 * (high - low))
    return [
        float(step * k) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)
    ]


def _tick(value: float, y: float, wide: float) -> str:
    line = f'<path d="M{_LEFT} {y:.1f}h{wide}" stroke="#eee"/>'
    return f'{line}<text x="{_LEFT - 3}" y="{y + 3:.1f}" text-anchor="end">{value:.6g}</text>'


def _names(chart: Chart, shown: list[int]) -> str:
    """Return the numbers of the curves in their colours, where there is room for them."""
    if len(shown) > _MOST_NAMED:
        return ""
    names = [chart.names[k] for k in shown]
    words = [names[0], *(name.rpartition(" ")[2] for name in names[1:])]
    spans = "".join(
        f'<tspan fill="{_COLOURS[k % len(_COLOURS)]}" dx="4">{escape(word)}</tspan>'
        for k, word in enumerate(words)
    )
    return f'<text x="{_LEFT}" y="{_HEIGHT - 3}">{spans}</text>'


def _limits(chart: Chart) -> str:
    """Return what the limits are, in words, where all curves have the same."""
    told = []
    for word, limit in (("≥", chart.lower), ("≤", chart.upper)):
        if limit is not None and len(set(limit.tolist())) == 1 and np.isfinite(limit[0]):
            told.append(f"{word} {limit[0]:.4g}")
    return f", limits {', '.join(told)}" if told else ""


def _line(x: Array, y: Array, stroke: str, name: str) -> str:
    """Return one curve with its name; of many points some, where it is not finite nothing."""
    every = max(1, len(x) // _MOST_POINTS)
    keep = np.isfinite(y)
    keep &= (np.arange(len(x)) % every == 0) | (np.arange(len(x)) == len(x) - 1)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[keep], y[keep], strict=True))
    return f'<polyline points="{points}" fill="none" {stroke} stroke-width="1.1"><title>{escape(name)}</title></polyline>'

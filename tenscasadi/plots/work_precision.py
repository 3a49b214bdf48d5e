"""The work-precision diagram: cost over error, one curve for each way to compute, both axes logarithmic."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

Points = Sequence[tuple[float, float]]
# Variants of one scheme (what stands before the comma) share its colour.
_MARKERS = "osD^vPX"
_NEAR = 100.0  # times the error of the reference: where no curve comes as close, it need not be seen
_DASHES = ("-", "--", ":", "-.")


def work_precision(
    curves: Mapping[str, Points],
    front: Points = (),
    reference_error: float | None = None,
    *,
    title: str = "",
    cost: str = "seconds per simulated second",
    path: str | os.PathLike[str] | None = None,
) -> Figure:
    """Curves of (position error m, cost) points; `front` is underlaid, errors below that of the reference are shaded where a curve
    comes near them. Saved where `path` is given."""
    figure = Figure(figsize=(8.4, 4.8), layout="constrained")
    ax = figure.subplots()
    ax.set_xscale("log")
    ax.set_yscale("log")
    smallest = reference_error or 1e-16  # a run that hits the reference exactly is still drawn
    if front:
        drawn = [point for point in front if point[0] > smallest] or front
        ax.plot(*zip(*drawn, strict=True), color="0.82", lw=7, solid_capstyle="round", solid_joinstyle="round", zorder=1)
    heads = list(dict.fromkeys(name.partition(",")[0] for name in curves))
    seen: dict[str, int] = {}
    for name, points in curves.items():
        head = name.partition(",")[0]
        variant = seen[head] = seen.get(head, -1) + 1
        if points:
            resolved = sorted((point for point in points if point[0] > smallest), key=lambda point: point[1])  # errors may rise again: rounding
            beyond = sorted((value, smallest) for error, value in points if error <= smallest)[:1]  # more say nothing: they are not resolved
            shown = [*resolved, *((error, value) for value, error in beyond)]
            colour = heads.index(head) if len(heads) > 1 else variant
            style: dict[str, Any] = {"marker": _MARKERS[variant % len(_MARKERS)], "ls": _DASHES[variant % len(_DASHES)]}
            ax.plot(*zip(*shown, strict=True), ms=4.5, lw=1.3, color=f"C{colour % 10}", label=name, zorder=2, **style)
    if reference_error and any(error < _NEAR * reference_error for points in curves.values() for error, _ in points):
        ax.axvspan(reference_error / 5, reference_error, color="0.93", zorder=0, lw=0)
        ax.set_xlim(left=reference_error / 5)
    ax.invert_xaxis()  # more accurate to the right
    ax.set_xlabel("largest position error at the end (m), more accurate to the right")
    ax.set_ylabel(cost)
    ax.xaxis.set_major_locator(LogLocator(numticks=9))
    ax.grid(visible=True, color="0.9")
    ax.spines[["top", "right"]].set_visible(False)
    if title:
        ax.set_title(title)
    if curves:
        figure.legend(*ax.get_legend_handles_labels(), loc="outside right upper", fontsize=8, frameon=False)
    if path is not None:
        figure.savefig(path, dpi=150)
    return figure

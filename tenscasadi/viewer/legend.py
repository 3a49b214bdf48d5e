"""Legends: the meaning of colours and sizes, with numbers and units, as HTML: the same in the live panel and in saved pages."""

from __future__ import annotations

from html import escape

from tenscasadi.viewer.canvas import Canvas, ghost_colour
from tenscasadi.viewer.colours import (
    BAR,
    JOINT,
    OBSTACLE,
    PIN,
    PUSHING,
    RAMP,
    SLACK,
    TARGET,
    Rgb,
    Scale,
    css,
)
from tenscasadi.viewer.exhibit import Exhibit
from tenscasadi.viewer.scenery import grid_spacing


def legend(canvas: Canvas) -> str:
    """Return the legend of what a canvas shows."""
    exhibit = canvas.exhibit
    parts = [_ramp(canvas.scale)] if canvas.scale is not None else []
    rows = [_row(colour, told) for colour, told in _kinds(canvas)]
    parts.append(f'<div style="margin-top:6px">{"".join(rows)}</div>')
    parts += [
        f'<div style="margin-top:4px;color:#666">{escape(told)}</div>' for told in _told(exhibit)
    ]
    return (
        f'<div style="font:12px/1.45 system-ui,sans-serif;padding:4px 8px">{"".join(parts)}</div>'
    )


def _ramp(scale: Scale) -> str:
    """Return the bar of colours with numbers from 0 to the largest value."""
    stops = ",".join(css(colour) for colour in RAMP)
    numbers = (
        "".join(f"<span>{share * scale.largest:.3g}</span>" for share in (0, 0.5, 1))
        if scale.largest > 0
        else "<span>0</span>"
    )
    bar = (
        f'<div style="height:10px;border-radius:2px;background:linear-gradient(90deg,{stops})"></div>'
        if scale.largest > 0
        else ""
    )
    told = f"<div>{escape(scale.label)} of strings ({escape(scale.unit)})</div>"
    return f'{told}{bar}<div style="display:flex;justify-content:space-between">{numbers}</div>'


def _kinds(canvas: Canvas) -> list[tuple[Rgb, str]]:
    """Return the colours that are there, with what they mean."""
    exhibit, first, scale = canvas.exhibit, canvas.exhibit.motions[0], canvas.scale
    rows: list[tuple[Rgb, str]] = []
    if len(exhibit.motions) > 1 or first.copies > 1:
        rows += [
            (ghost_colour(exhibit, k) or BAR, motion.name)
            for k, motion in enumerate(exhibit.motions)
        ]
    elif len(first.bars):
        rows.append((BAR, "bars"))
    if scale is None and len(first.strings) and first.copies == 1:
        rows.append((SLACK, "strings"))
    if scale is not None and scale.slack:
        rows.append((SLACK, "slack strings, thin"))
    if scale is not None and scale.pushing:
        rows.append((PUSHING, f"strings that push, up to {-scale.least:.3g} {scale.unit}"))
    if canvas.has_joints:
        rows.append((JOINT, "joints of bars"))
    if first.copies == 1 and len(first.pinned):
        rows.append((PIN, "pinned nodes and rollers"))
    if exhibit.obstacles or exhibit.boxes:
        rows.append((OBSTACLE, "obstacles, and boxes to stay in"))
    if len(exhibit.targets):
        rows.append((TARGET, "targets of nodes"))
    return rows


def _told(exhibit: Exhibit) -> list[str]:
    low, high = exhibit.corners()
    size = f"size {' × '.join(f'{extent:.3g}' for extent in high - low)} m"
    grid = (
        f"; lines of the ground {grid_spacing(1.2 * float((high - low).max())):g} m apart"
        if exhibit.grounds
        else ""
    )
    return [size + grid, *exhibit.notes]


def _row(colour: Rgb, told: str) -> str:
    dot = f'<span style="display:inline-block;width:10px;height:10px;border-radius:5px;margin-right:6px;background:{css(colour)}"></span>'
    return f"<div>{dot}{escape(told)}</div>"

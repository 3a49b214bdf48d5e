"""Legend as HTML, for the viewer and for saved pages."""

from __future__ import annotations

from html import escape

from tenscasadi.drawing.color_scale import ColorScale
from tenscasadi.drawing.scenery import find_view, grid_spacing
from tenscasadi.drawing.shapes import FORCES
from tenscasadi.drawing.style import STYLE, Rgb, format_css
from tenscasadi.viewer.canvas import Canvas


def build_legend(canvas: Canvas) -> str:
    """Build the HTML legend of a canvas."""
    scale = "" if canvas.scale is None else _build_scale(canvas.scale)
    rows = "".join(_build_row(color, text) for color, text in _list_colors(canvas))
    notes = "".join(f'<div class="note">{escape(note)}</div>' for note in _list_notes(canvas))
    style = "font:12px/1.45 system-ui,sans-serif;padding:4px 8px"
    return f'<div style="{style}">{scale}<div style="margin-top:6px">{rows}</div>{notes}</div>'


def _build_scale(scale: ColorScale) -> str:
    """Build the HTML color bar with its numbers.

    `scale` is the color scale.
    """
    title = f"<div>{escape(scale.quantity)} of strings ({escape(scale.unit)})</div>"
    if scale.largest <= 0:
        return title
    stops = ",".join(format_css(color) for color in STYLE.ramp)
    style = f"height:10px;border-radius:2px;background:linear-gradient(90deg,{stops})"
    end = "≥ " if scale.highest > scale.largest else ""
    numbers = ("0", f"{scale.largest / 2:.3g}", f"{end}{scale.largest:.3g}")
    spans = "".join(f"<span>{number}</span>" for number in numbers)
    row = f'<div style="display:flex;justify-content:space-between">{spans}</div>'
    return f'{title}<div style="{style}"></div>{row}'


def _list_colors(canvas: Canvas) -> list[tuple[Rgb, str]]:
    """List the colors in the picture with their meaning.

    The picture is that of a canvas.
    """
    content, first, scale = canvas.content, canvas.content.motions[0], canvas.scale
    single = first.copies == 1
    rows: list[tuple[Rgb, str]] = []
    if len(content.motions) > 1 or not single:
        rows += [(layer.tint or STYLE.bar, layer.shapes.motion.name) for layer in canvas.layers]
    elif len(first.bars):
        rows.append((STYLE.bar, "bars"))
    if scale is None and len(first.strings) and single:
        rows.append((STYLE.slack, "strings"))
    if scale is not None and scale.slack:
        rows.append((STYLE.slack, "slack strings, thin"))
    if scale is not None and scale.lowest < 0:
        text = f"strings in compression, up to {-scale.lowest:.3g} {scale.unit}"
        rows.append((STYLE.compression, text))
    if canvas.layers[0].shapes.hulls and single:
        rows.append((STYLE.body, "rigid bodies"))
    if canvas.has_joints:
        rows.append((STYLE.joint, "joints of bars"))
    if single and len(first.pinned):
        rows.append((STYLE.support, "supports"))
    shapes = canvas.layers[0].shapes
    for forces in first.forces:
        force = shapes.force_scale(forces) if forces.name in canvas.kinds else 0.0
        if force > 0:
            text = f"{FORCES[forces.name]}, {force:.3g} N as {shapes.reach:.3g} m"
            rows.append((getattr(STYLE, forces.name), text))
    if content.obstacles or content.boxes:
        rows.append((STYLE.obstacle, "obstacles and limits of the space"))
    if len(content.targets):
        rows.append((STYLE.target, "targets of nodes"))
    return rows


def _list_notes(canvas: Canvas) -> list[str]:
    content = canvas.content
    low, high = content.corners
    size = f"size {' × '.join(f'{extent:.3g}' for extent in high - low)} m"
    least, most = find_view(content, canvas.margin)
    size += f"; grid lines {grid_spacing(float((most - least).max())):g} m apart"
    return [size, *content.notes]


def _build_row(color: Rgb, text: str) -> str:
    style = f"display:inline-block;width:10px;height:10px;border-radius:5px;margin-right:6px;background:{format_css(color)}"
    return f'<div><span style="{style}"></span>{escape(text)}</div>'

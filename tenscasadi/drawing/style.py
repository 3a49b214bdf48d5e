"""Colors and sizes of all pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tenscasadi.util.validate import Array

Bytes = NDArray[np.uint8]
Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class Style:
    """Colors and sizes of plots, animations and the viewer.

    Colors are sRGB values. Kinds of items have the colors of Okabe and Ito, which color-blind
    readers distinguish. The brightness of `ramp` increases throughout, so that it survives
    printing in gray; `time_ramp` does so in reverse.

    Attributes
    ----------
    curves : tuple of Rgb
        Colors of curves and of compared motions, in this order.
    body_opacity : float
        Opacity of the faces of rigid bodies.
    bar_radius : float
        Radius of a bar, relative to the median bar length.
    string_radius : float
        Radius of a taut string, relative to that of a bar; a slack one has half of it.
    min_radius : float
        Smallest radius of a member, relative to the whole picture: half a pixel.
    arrow_length : float
        Length of an arrow of a large force, relative to the structure.
    grid_lines : int
        Number of grid lines along the ground.
    saturation : float
        Quantile of the values at the end of a color scale.
    shadow : float
        Opacity of shadows on grounds.
    ground_margin : float
        Margin of grounds around the structure in a 3-D file, relative to its size.
    mode_amplitude : float
        Largest displacement of a mode, relative to the structure.
    """

    bar: Rgb = (57, 66, 78)
    node: Rgb = (90, 98, 110)
    joint: Rgb = (230, 159, 0)
    support: Rgb = (0, 114, 178)
    slack: Rgb = (185, 190, 197)
    compression: Rgb = (0, 158, 115)
    body: Rgb = (86, 180, 233)
    ground: Rgb = (219, 212, 194)
    grid: Rgb = (180, 174, 159)
    obstacle: Rgb = (213, 94, 0)
    target: Rgb = (0, 158, 115)
    load: Rgb = (213, 94, 0)
    reaction: Rgb = (0, 114, 178)
    contact: Rgb = (204, 121, 167)
    ramp: tuple[Rgb, ...] = (  # plasma, without its end, which is hard to see on white
        *((13, 8, 135), (70, 3, 159), (114, 1, 168), (156, 23, 158), (189, 55, 134)),
        *((216, 87, 107), (237, 121, 83), (251, 159, 58), (253, 190, 43)),
    )
    time_ramp: tuple[Rgb, ...] = (  # viridis in reverse, without its end
        *((223, 227, 24), (159, 218, 58), (94, 201, 98), (44, 177, 126), (33, 145, 140)),
        *((44, 113, 142), (59, 82, 139), (71, 44, 122), (68, 1, 84)),
    )
    curves: tuple[Rgb, ...] = (
        *((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0)),
        *((86, 180, 233), (57, 66, 78), (146, 94, 20)),
    )
    body_opacity: float = 0.35
    bar_radius: float = 0.014
    string_radius: float = 0.4
    min_radius: float = 0.001
    arrow_length: float = 0.25
    grid_lines: int = 20
    saturation: float = 0.99
    shadow: float = 0.25
    ground_margin: float = 0.7
    mode_amplitude: float = 0.12


STYLE = Style()


def interpolate_colors(ramp: tuple[Rgb, ...], fractions: Array) -> Bytes:
    """Interpolate colors (m, 3) of a color ramp at fractions (m,)."""
    steps = np.linspace(0.0, 1.0, len(ramp))
    channels = np.array(ramp, dtype=float).T
    return np.stack(
        [np.round(np.interp(fractions, steps, channel)) for channel in channels], axis=-1
    ).astype(np.uint8)


def curve_color(index: int) -> Rgb:
    """Select the color of the curve `index`; colors repeat after all are used."""
    return STYLE.curves[index % len(STYLE.curves)]


def format_css(color: Rgb | Bytes) -> str:
    """Format a color for HTML and matplotlib."""
    return "#" + "".join(f"{int(part):02x}" for part in color)


def linearize_colors(colors: Bytes | Rgb) -> Bytes:
    """Convert sRGB colors to linear light, which shaded pictures expect."""
    fractions = np.asarray(colors, dtype=float) / 255
    linear = np.where(fractions <= 0.04045, fractions / 12.92, ((fractions + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255 * linear), dtype=np.uint8)

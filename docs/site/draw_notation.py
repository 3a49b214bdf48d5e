"""Draws docs/pictures/notation.png: a bar, a string and the forces on a node.

Run it from anywhere: python docs/site/draw_notation.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

PICTURE = Path(__file__).resolve().parents[1] / "pictures" / "notation.png"
BAR, STRING, FORCE = "#36454f", "#d55e00", "#0072b2"
NODES = np.array([(0.0, 0.0), (2.2, 1.3), (3.6, 0.1)])


def draw_arrow(axes: Any, start: Any, end: Any, color: str, text: str, beside: Any) -> None:
    """Draw an arrow with a text beside its middle."""
    style = {"arrowstyle": "-|>", "color": color, "lw": 1.6, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)
    middle = (np.asarray(start) + end) / 2 + beside
    axes.text(*middle, text, color=color, ha="center", va="center", fontsize=13)


def main() -> None:
    """Draw the picture."""
    figure = Figure(figsize=(6.4, 3.0))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    one, two, three = NODES
    axes.plot(*np.array([one, two]).T, color=BAR, lw=9, alpha=0.25, solid_capstyle="round")
    axes.plot(*np.array([two, three]).T, color=STRING, lw=1.0, alpha=0.6)
    along, pull = (two - one) / np.hypot(*(two - one)), (three - two) / np.hypot(*(three - two))
    across = np.array([-along[1], along[0]])
    draw_arrow(axes, one, two, BAR, "$b = n_2 - n_1$", 0.4 * across - 0.7 * along)
    aside = 0.16 * np.array([-pull[1], pull[0]])
    draw_arrow(axes, two + aside, three + aside, STRING, "$s$", (0.15, 0.15))
    draw_arrow(axes, two, two + 0.8 * pull, FORCE, r"$\gamma\, s$", (-0.16, -0.24))
    draw_arrow(axes, two, two + 0.8 * along, FORCE, r"$\lambda\, b$", (-0.22, 0.12))
    for k, node in enumerate(NODES):
        axes.plot(*node, "o", color=BAR, ms=7)
        axes.text(*(node - (0.0, 0.26)), f"$n_{k + 1}$", ha="center", va="center", fontsize=13)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-0.5, 4.2)
    axes.set_ylim(-0.5, 2.2)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()

"""Draws docs/architecture.png: the folders, and the path that data takes through them.

Run it from anywhere: python docs/draw_architecture.py
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

TENSCASADI, OCP = "#d8e6f3", "#f7e2cc"
WIDTH, HEIGHT = 1.62, 0.92
BOTTOM = 4.2  # the row of ocp

# folder: (column, row, what is inside); rows from the top
ROOMS = {
    "structure": (0, 0, "nodes, bars,\nstrings, shapes"),
    "scene": (1, 0, "drive, loads,\nsupports"),
    "dynamics": (2, 0, "equations of\nmotion"),
    "integrators": (3, 0, "steps in time"),
    "simulation": (4, 0, "loop in C,\nerrors, export"),
    "plots": (5, 0, "figures,\nanimations"),
    "drawing": (4, 1, "content and style\nof pictures"),
    "analysis": (5, 1, "modes, trade-off"),
    "cli": (6, 0, "command line"),
    "envs": (6, 1, "environments\nfor learning"),
    "io": (4, 2, "scenes in TOML"),
    "sweeps": (4, 3, "independent cases\non many cores"),
    "exchange": (5, 2, "MuJoCo, MATLAB,\nNTRT, ParaView"),
    "viewer": (6, 2, "motions in\na browser, live"),
    "statics": (3, 1, "equilibrium,\nself-stress"),
    "design": (3, 2, "form, prestress,\nsections"),
    "schema": (1, 1, "fields of values,\nin files"),
    "util": (0, 1, "input, files,\ncompilation:\nused by all"),
}
PLANNING = {
    "problem": (1, BOTTOM, "goals, bounds,\ncosts"),
    "targets": (2, BOTTOM, "start and end\nthat say\nsomething new"),
    "transcription": (3, BOTTOM, "sparse nonlinear\nprogram"),
    "solvers": (4, BOTTOM, "IPOPT,\ncondensed Newton"),
    "results": (5, BOTTOM, "replay, verdict,\nreport"),
    "search": (6, BOTTOM, "policy,\nattempts"),
    "plan": (7, BOTTOM, "refinement,\nrobustness"),
    "guess": (4, BOTTOM + 1, "paths, inverse\ndynamics"),
    "sampling": (3, BOTTOM + 1, "random motions,\nthrough contact"),
    "phases": (5, BOTTOM + 1, "take-off,\nlanding"),
    "control": (6, BOTTOM + 1, "LQR, MPC,\nMPPI"),
    "io": (7, BOTTOM + 1, "problems\nin TOML"),
}
# from, to, the value that is handed on
FLOW = [
    ("structure", "scene", "Structure"),
    ("scene", "dynamics", "Scene"),
    ("dynamics", "integrators", "Model"),
    ("integrators", "simulation", "step"),
    ("simulation", "plots", "Trajectory"),
    ("plots", "cli", "Figure"),
    ("problem", "targets", "Problem"),
    ("targets", "transcription", "Target"),
    ("transcription", "solvers", "Program"),
    ("solvers", "results", "Solution"),
    ("results", "search", "PlanResult"),
    ("search", "plan", "PlanResult"),
]


def place(column: float, row: float) -> tuple[float, float]:
    """Centre of a box."""
    return 2.35 * column, -1.55 * row


def draw_room(ax: Axes, name: str, column: float, row: float, text: str, colour: str) -> None:
    """One folder."""
    x, y = place(column, row)
    corner = (x - WIDTH / 2, y - HEIGHT / 2)
    ax.add_patch(
        FancyBboxPatch(
            corner,
            WIDTH,
            HEIGHT,
            boxstyle="round,pad=0.02,rounding_size=0.1",
            facecolor=colour,
            edgecolor="#555555",
        )
    )
    ax.text(x, y + 0.27, name, ha="center", va="center", fontsize=10.5, fontweight="bold")
    ax.text(x, y - 0.13, text, ha="center", va="center", fontsize=7.8, linespacing=1.15)


def draw_arrow(
    ax: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    label: str = "",
    dashed: bool = False,
) -> None:
    """The path of a value."""
    style = {
        "arrowstyle": "-|>",
        "color": "#333333",
        "lw": 1.3,
        "linestyle": "--" if dashed else "-",
    }
    ax.annotate("", end, start, arrowprops=style)
    ax.text(
        (start[0] + end[0]) / 2,
        (start[1] + end[1]) / 2 + 0.12,
        label,
        ha="center",
        va="bottom",
        fontsize=8,
        style="italic",
    )


def main(path: Path = Path(__file__).with_name("architecture.png")) -> None:
    """Draw the picture and save it as `path`."""
    figure = Figure(figsize=(15, 9.6), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    for rooms, colour in ((ROOMS, TENSCASADI), (PLANNING, OCP)):
        for name, (column, row, text) in rooms.items():
            draw_room(ax, name, column, row, text, colour)
    every = ROOMS | PLANNING
    for source, target, label in FLOW:
        (x0, y0), (x1, y1) = (place(*every[name][:2]) for name in (source, target))
        draw_arrow(ax, (x0 + WIDTH / 2, y0), (x1 - WIDTH / 2, y1), label)
    below, above = -HEIGHT / 2, HEIGHT / 2
    x, y = place(*every["dynamics"][:2])
    x1, y1 = place(*every["problem"][:2])
    draw_arrow(ax, (x - 0.5, y + below), (x1 + 0.5, y1 + above))
    ax.text(x - 1.2, (y + y1) / 2 - 0.75, "Model", fontsize=8, style="italic", ha="right")
    x, y = place(*every["simulation"][:2])
    x1, y1 = place(*every["analysis"][:2])
    draw_arrow(ax, (x + WIDTH / 2, y - 0.3), (x1 - WIDTH / 2, y1 + 0.1))
    left = place(-0.62, 0)[0]
    ax.text(
        left,
        place(0, 1.0)[1],
        "tenscasadi",
        rotation=90,
        fontsize=13,
        fontweight="bold",
        va="center",
        ha="center",
    )
    ax.text(
        left,
        place(0, BOTTOM + 0.5)[1],
        "ocp",
        rotation=90,
        fontsize=13,
        fontweight="bold",
        va="center",
        ha="center",
    )
    ax.set(xlim=(left - 0.4, place(7, 0)[0] + 1.1), ylim=(place(0, BOTTOM + 1)[1] - 0.9, 1.0))
    ax.set_title("Folders, and the values that they hand on, from left to right")
    ax.axis("off")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()

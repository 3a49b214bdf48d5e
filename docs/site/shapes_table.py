"""Table and picture of all shapes: counts, self-stresses, mechanisms, stability, softest motion.

Run it to write docs/shapes.md and docs/gallery/shapes.png again: python docs/site/shapes_table.py
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import tenscasadi as tc
from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.shapes import MotionShapes
from tenscasadi.drawing.style import STYLE
from tenscasadi.drawing.view_content import Frame
from tenscasadi.plots.canvas3d import Canvas3D
from tenscasadi.structure.shapes import ShapeFamily

DOCS = Path(__file__).resolve().parents[1]
STIFFNESS, PRESTRESS = 1e4, 10.0  # N/m, of each string, and the least force density
OTHERS = {  # more rows: a shape with other arguments, by the text in the table
    "`prism(6)`": ("prism", {"bars": 6}),
    "`prism(diagonals=True)`": ("prism", {"diagonals": True}),
    "`prism_tower(4)`": ("prism_tower", {"stages": 4}),
    "`prism_tower(4, joint_class=1)`": ("prism_tower", {"stages": 4, "joint_class": 1}),
    "`d_bar(iterations=2)`": ("d_bar", {"iterations": 2}),
    "`t_bar(iterations=2)`": ("t_bar", {"iterations": 2}),
}
HEADER = (
    "shape",
    "nodes",
    "bars",
    "strings",
    "class",
    "self-stresses",
    "mechanisms",
    "stable",
    "super-stable",
    "softest, N/m",
)


def build_shapes() -> Iterator[tuple[str, tc.Structure]]:
    """Yield the text and the structure of each row, prestressed where the shape can be."""
    rows = {f"`{name}`": (name, {}) for name in sorted(ShapeFamily.members)} | OTHERS
    for text, (name, arguments) in sorted(rows.items()):
        make = ShapeFamily.members[name]
        given = dict(arguments)
        if "prestress" in inspect.signature(make).parameters:
            given["prestress"] = PRESTRESS
        yield text, make(stiffness=STIFFNESS, **given)


def shapes_table() -> str:
    """Build the table in Markdown."""
    lines = [f"| {' | '.join(HEADER)} |", "|---" * len(HEADER) + "|"]
    for text, s in build_shapes():
        st = tc.stability(s)
        words = {True: "yes", False: "no"}
        joint = int(np.bincount(s.bars.ravel()).max(initial=0)) if len(s.bars) else 0
        soft = f"{_round(st.eigenvalues[0]):.4g}" if len(st.eigenvalues) else "–"
        cells = [text, len(s.nodes), len(s.bars), len(s.strings), joint, len(st.self_stress)]
        cells += [len(st.mechanisms), words[st.stable], words[st.super_stable], soft]
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return "\n".join(lines)


def _round(stiffness: float) -> float:
    """Round the stiffness of free motions to zero [N/m]."""
    return 0.0 if abs(stiffness) < 1e-6 else float(stiffness)


def draw_shapes(path: Path) -> None:
    """Draw all shapes side by side."""
    rows = [(text, s) for text, s in build_shapes() if "(" not in text]
    columns = 6
    lines = -(-len(rows) // columns)
    figure = Figure(figsize=(2.3 * columns, 2.4 * lines))
    for k, (text, s) in enumerate(rows):
        line, column = divmod(k, columns)
        place = ((column + 0.02) / columns, 1 - (line + 0.97) / lines, 0.96 / columns, 0.86 / lines)
        content = describe_content(s)
        canvas = Canvas3D(figure, content, place)
        shapes = MotionShapes(content).build(Frame(s.nodes))
        shapes[1] = shapes[1]._replace(colors=np.full_like(shapes[1].colors, STYLE.load))
        canvas.draw(shapes)
        canvas.axes.set_title(text.strip("`").replace("_", " "), fontsize=9, y=1.1)
        canvas.axes.set_axis_off()
        canvas.axes.set_box_aspect(canvas.axes._box_aspect, zoom=1.1)
    figure.savefig(path, dpi=70)


def main() -> None:
    """Write the picture, and the table into the page."""
    draw_shapes(DOCS / "gallery" / "shapes.png")
    page = DOCS / "shapes.md"
    before, after = page.read_text(encoding="utf-8").split("<!-- table -->\n")[::2]
    marked = f"<!-- table -->\n{shapes_table()}\n<!-- table -->\n"
    page.write_text(f"{before}{marked}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()

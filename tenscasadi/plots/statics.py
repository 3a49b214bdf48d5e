"""Figures of forces in equilibrium and of displacement modes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from tenscasadi.drawing.describe import describe_content
from tenscasadi.drawing.shapes import DrawnShape, MotionShapes
from tenscasadi.drawing.style import STYLE, Rgb, interpolate_colors
from tenscasadi.drawing.view_content import Frame, NodeForces, ViewContent
from tenscasadi.plots.canvas3d import Canvas3D
from tenscasadi.plots.panels import save_figure
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, FilePath, finite_array, instance, per_item, text

_SIGNS: tuple[Rgb, ...] = (STYLE.reaction, STYLE.slack, STYLE.load)  # push, none, pull
# radii relative to the structure: of members without and with the largest force, and in modes
_THINNEST, _WIDEST, _LINE = 0.001, 0.007, 0.002
_ZOOM = 1.5  # of modes, which have no axes around them


def forces(
    structure: Structure,
    tension: ArrayLike,
    bar_force: ArrayLike,
    *,
    reactions: ArrayLike | None = None,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw the forces of all members by color and width.

    Members in tension are orange, members in compression blue. Their width grows with the force.
    Reactions are arrows.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    tension : array_like, shape (α,)
        Tensions of strings [N].
    bar_force : array_like, shape (β,)
        Forces of bars [N], positive in tension.
    reactions : array_like, shape (n, 3), optional
        Forces of supports on the nodes [N].
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type, shape or value.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> eq = tc.find_equilibrium(tc.Scene(tc.shapes.prism(prestress=50.0)))
    >>> figure = plots.forces(eq.structure, eq.tension, eq.bar_force)
    >>> figure.axes[1].get_ylabel()
    'force (N), compression below 0'
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    pulls = per_item("tension", tension, len(structure.strings))
    pushes = per_item("bar_force", bar_force, len(structure.bars))
    content = describe_content(structure, "structure")
    if reactions is not None:
        content = _add_reactions(
            content, finite_array("reactions", reactions, structure.nodes.shape)
        )
    figure = Figure(figsize=(6.4, 5.2))
    canvas = Canvas3D(figure, content)
    largest = float(np.abs(np.concatenate([pulls, pushes])).max(initial=0.0)) or 1.0
    rest = Frame(structure.nodes)
    bars, strings, *others = MotionShapes(content).build(rest, kinds=("reaction",))
    size = measure_extent(structure.nodes)
    members = (bars, pushes), (strings, pulls)
    canvas.draw([*(_color(shape, size, force / largest) for shape, force in members), *others])
    ramp = interpolate_colors(_SIGNS, np.linspace(0.0, 1.0, 256)) / 255
    mapped = ScalarMappable(Normalize(-largest, largest), ListedColormap(ramp))
    canvas.add_bar(mapped, label="force (N), compression below 0")
    figure.suptitle(text("title", title))
    canvas.fit()
    return save_figure(figure, path)


def mode_shapes(
    structure: Structure,
    modes: ArrayLike,
    labels: Any = (),
    *,
    title: str = "",
    path: FilePath | None = None,
) -> Figure:
    """Draw displacement modes of a structure side by side.

    The undisplaced structure is gray.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    modes : array_like, shape (k, n, 3)
        Displacements of any scale; the largest is drawn as an eighth of the structure.
    labels : sequence of str, shape (k,)
        Titles of the panels.
    title : str
        Title of the figure.
    path : path-like, optional
        File to save the figure to, whose suffix (.png, .pdf, .svg ...) selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError, ValueError
        An argument has a wrong type, shape or value, or there are no modes.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> from tenscasadi import plots
    >>> st = tc.stability(tc.shapes.prism(prestress=10.0))
    >>> figure = plots.mode_shapes(st.structure, st.modes[:2], ["softest", "next"])
    >>> [ax.get_title() for ax in figure.axes]
    ['softest', 'next']
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    shown = finite_array("modes", modes, (None, *structure.nodes.shape))
    if not len(shown):
        raise ValueError("modes is empty: give at least one mode")
    names = [str(label) for label in labels] or [f"mode {k}" for k in range(len(shown))]
    if len(names) != len(shown):
        raise ValueError(f"labels has {len(names)} entries: give {len(shown)}, one for each mode")
    columns = int(np.ceil(np.sqrt(len(shown))))
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(3.4 * columns, 3.2 * rows + 0.4))
    content = describe_content(structure, "structure")
    size = measure_extent(structure.nodes)
    for k, (mode, name) in enumerate(zip(shown, names, strict=True)):
        row, column = divmod(k, columns)
        place = (
            (column + 0.06) / columns,
            1.0 - (row + 0.96) * 3.2 / (3.2 * rows + 0.4) - 0.4 / (3.2 * rows + 0.4),
            0.88 / columns,
            0.84 * 3.2 / (3.2 * rows + 0.4),
        )
        canvas = Canvas3D(figure, content, place)
        largest = float(np.linalg.norm(mode, axis=1).max()) or 1.0
        moved = structure.nodes + mode * (STYLE.mode_amplitude * size / largest)
        still, moving = (MotionShapes(content, tint=tint) for tint in (STYLE.slack, STYLE.load))
        gray = still.build(Frame(structure.nodes))[:2]
        dark = MotionShapes(content).build(Frame(moved))[:1]
        bright = moving.build(Frame(moved))[1:2]
        canvas.draw(
            [
                *_thin(gray, 0.5 * _LINE * size),
                *_thin(bright, _LINE * size),
                *_thin(dark, 2 * _LINE * size),
            ]
        )
        canvas.axes.set_title(name, fontsize=10, y=1.16)
        canvas.axes.set_axis_off()
        canvas.axes.set_box_aspect(canvas.axes._box_aspect, zoom=_ZOOM)
    figure.suptitle(text("title", title))
    return save_figure(figure, path)


def _add_reactions(content: ViewContent, forces: Array) -> ViewContent:
    """Add reactions (n, 3) [N] as arrows to the picture.

    `forces` are the reactions.
    """
    arrows = NodeForces("reaction", lambda _: forces)
    return replace(content, motions=(replace(content.motions[0], forces=(arrows,)),))


def _color(members: DrawnShape, size: float, share: Array) -> DrawnShape:
    """Color members by fractions (m,) of the largest force.

    The fractions (`share`) are −1 to 1. The width of members is scaled, too: `size` is its unit.
    """
    radius = size * (_THINNEST + (_WIDEST - _THINNEST) * np.sqrt(np.abs(share)))
    return members._replace(colors=interpolate_colors(_SIGNS, 0.5 + 0.5 * share), radius=radius)


def _thin(shapes: list[DrawnShape], radius: float) -> list[DrawnShape]:
    """Set the same radius [m] for all members (`shapes`)."""
    return [shape._replace(radius=np.full(len(shape.points), radius)) for shape in shapes]

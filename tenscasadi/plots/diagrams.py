"""Work-precision diagrams, and the convergence of solvers."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tenscasadi.plots.panels import add_legend, css_color, make_panels, save_figure
from tenscasadi.util.validate import (
    FilePath,
    as_tuple,
    file_path,
    format_value,
    instance,
    positive_number,
    real_array,
    text,
)
from tenscasadi.util.viewable import in_notebook

Points = Sequence[tuple[float, float]]
_MARKERS = "osD^vPX"
_DASHES = ("-", "--", ":", "-.")


def work_precision(
    curves: Mapping[str, Points],
    front: Points = (),
    reference_error: float | None = None,
    *,
    title: str = "",
    cost: str = "seconds per simulated second",
    path: FilePath | None = None,
) -> Figure:
    """Draw a work-precision diagram, the cost over the position error.

    Both axes are logarithmic, and more accurate results lie to the right. Names that agree up to
    the first comma are variants of one scheme and share its color.

    Parameters
    ----------
    curves : mapping of str to sequence of (float, float)
        Points (position error [m], cost) of each scheme, by name.
    front : sequence of (float, float)
        Pareto-optimal points, which are underlaid in gray.
    reference_error : float, optional
        Error of the reference [m]. Smaller errors are drawn there. Its range is shaded if a curve
        comes within a factor of 100.
    title : str
        Title of the diagram.
    cost : str
        Label of the vertical axis, with its unit.
    path : path-like, optional
        File to save the diagram to, whose suffix selects the format.

    Returns
    -------
    matplotlib.figure.Figure
        The diagram.

    Examples
    --------
    >>> from tenscasadi import plots
    >>> figure = plots.work_precision({"RungeKutta4": [(1e-3, 0.1), (1e-6, 0.6)]}, title="a prism")
    >>> figure.axes[0].get_xscale()
    'log'
    """
    curves, front = _label_points(curves), _points("front", front)
    reference_error = _find_error(reference_error)
    figure, (ax,) = make_panels(
        1,
        "largest position error at the end (m), more accurate to the right",
        title,
        (8.4, 4.8),
        margin=0.05,
    )
    ax.set(xscale="log", yscale="log", ylabel=text("cost", cost))
    smallest = reference_error or 1e-16  # a run that hits the reference exactly is still drawn
    if front:
        drawn = [point for point in front if point[0] > smallest] or front
        ax.plot(
            *zip(*drawn, strict=True),
            color="0.82",
            lw=7,
            solid_capstyle="round",
            solid_joinstyle="round",
            zorder=1,
        )
    heads = list(dict.fromkeys(name.partition(",")[0] for name in curves))
    seen: dict[str, int] = {}
    for name, points in curves.items():
        head = name.partition(",")[0]
        variant = seen[head] = seen.get(head, -1) + 1
        if points:
            color = css_color(heads.index(head) if len(heads) > 1 else variant)
            style: dict[str, Any] = {
                "marker": _MARKERS[variant % len(_MARKERS)],
                "ls": _DASHES[variant % len(_DASHES)],
            }
            ax.plot(
                *zip(*_find_resolved(points, smallest), strict=True),
                ms=4.5,
                lw=1.3,
                color=color,
                label=name,
                zorder=2,
                **style,
            )
    if reference_error and any(
        error < 100 * reference_error for points in curves.values() for error, _ in points
    ):
        ax.axvspan(reference_error / 5, reference_error, color="0.93", zorder=0, lw=0)
        ax.set_xlim(left=reference_error / 5)
    ax.invert_xaxis()
    ax.xaxis.set_major_locator(LogLocator(numticks=9))
    add_legend(figure, ax, len(curves))
    return save_figure(figure, path)


def _find_error(value: Any) -> float | None:
    """Check the error `value` of a reference; None if it is infinite."""
    return (
        None
        if value is None or (isinstance(value, float) and value == float("inf"))
        else positive_number("reference_error", value, zero=True)
    )


def _label_points(curves: Any) -> dict[str, Points]:
    instance("curves", curves, Mapping, "points (error, cost) by name")
    return {
        text("curves: name", name): _points(f"curves[{name!r}]", points)
        for name, points in curves.items()
    }


def _points(field: str, points: Any) -> Points:
    """Check a list of points (error, cost), the argument `field`.

    Raises TypeError, ValueError.
    """
    pairs = as_tuple(field, points, "[(1e-3, 0.1)]")
    if not pairs:
        return []
    array = real_array(field, pairs, "pairs (error, cost)")
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{field} has shape {array.shape}: give pairs (error, cost)")
    return [(error, cost) for error, cost in array.tolist()]


def _find_resolved(points: Points, smallest: float) -> list[tuple[float, float]]:
    """Sort points (error, cost) by cost.

    Of those with errors up to `smallest` only the cheapest is used, with this error.
    """
    beyond = sorted((cost, smallest) for error, cost in points if error <= smallest)[:1]
    return [
        *sorted((point for point in points if point[0] > smallest), key=lambda point: point[1]),
        *((error, cost) for cost, error in beyond),
    ]


class Iteration(Protocol):
    """Interface of a solver's iteration, such as `ocp.Progress`."""

    @property
    def iteration(self) -> int:
        """Number of the iteration."""

    @property
    def objective(self) -> float:
        """Value of the objective."""

    @property
    def infeasibility(self) -> float:
        """Largest violation of a constraint, scaled."""


class Convergence:
    """Chart of objective and violation over the iterations of a solver.

    Give it to `ocp.solve`: ``ocp.solve(problem, progress=plots.Convergence())``. In a notebook, the
    chart appears below the cell and follows the solver. Several attempts of a search follow one
    another.

    Parameters
    ----------
    path : path-like, optional
        File that is written again and again during the solution. Default: no file.
    every : float
        Shortest time between two drawings [s].

    Raises
    ------
    ValueError
        `every` is not positive.

    Examples
    --------
    >>> import ocp
    >>> from tenscasadi import plots
    >>> convergence = plots.Convergence()
    >>> convergence(ocp.Progress(iteration=0, objective=2.5, infeasibility=1e-3))
    >>> convergence.figure().axes[0].get_title()
    'iteration 0: objective 2.5, largest violation 0.001'
    """

    def __init__(self, path: FilePath | None = None, every: float = 2.0) -> None:
        self._path = None if path is None else file_path("path", path)
        self._every = positive_number("every", every)
        self._iterations: list[Iteration] = []
        self._drawn = -float("inf")
        self._display: Any = None  # the chart's place in a notebook

    def __call__(self, now: Iteration) -> None:
        """Record an iteration, and redraw the chart from time to time."""
        if not all(hasattr(now, name) for name in ("iteration", "objective", "infeasibility")):
            raise TypeError(f"now is {format_value(now)}: give an ocp.Progress")
        self._iterations.append(now)
        if time.monotonic() - self._drawn > self._every and (self._path or in_notebook()):
            self._draw()
            self._drawn = time.monotonic()

    def _draw(self) -> None:
        """Write the file, or replace the chart in the notebook."""
        figure = self.figure()
        if self._path is not None:
            save_figure(figure, self._path)
        elif self._display is None:
            self._display = sys.modules["IPython"].display.display(figure, display_id=True)
        else:
            self._display.update(figure)

    def figure(self) -> Figure:
        """Draw the objective and the largest violation so far.

        Returns
        -------
        matplotlib.figure.Figure
            Two panels over the iterations.
        """
        title = "no iteration yet"
        if self._iterations:
            last = self._iterations[-1]
            title = f"iteration {last.iteration}: objective {last.objective:.4g}, largest violation {last.infeasibility:.2g}"
        figure, (above, below) = make_panels(2, "iteration", title, margin=0.05)
        count = range(len(self._iterations))
        above.plot(count, [one.objective for one in self._iterations], ".-", lw=1.2)
        below.plot(count, [one.infeasibility for one in self._iterations], ".-", lw=1.2)
        above.set_ylabel("objective")
        below.set_ylabel("largest violation, scaled")
        if any(one.infeasibility > 0 for one in self._iterations):
            below.set_yscale("log")
        return figure

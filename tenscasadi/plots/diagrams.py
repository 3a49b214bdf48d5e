"""Diagrams of how well something was computed: cost over error of simulations, and the convergence of a solver."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from tenscasadi.plots.panels import FilePath, curve_colour, make_panels, name_curves, save_figure
from tenscasadi.util.validate import (
    file_path,
    instance,
    listed,
    positive_number,
    real_array,
    shown,
    text,
)

Points = Sequence[tuple[float, float]]
_MARKERS = "osD^vPX"
_DASHES = ("-", "--", ":", "-.")
_NEAR = (
    100.0  # times the reference's error: where no curve comes as close, that error need not be seen
)


def work_precision(
    curves: Mapping[str, Points],
    front: Points = (),
    reference_error: float | None = None,
    *,
    title: str = "",
    cost: str = "seconds per simulated second",
    path: FilePath | None = None,
) -> Figure:
    """Draw a work-precision diagram: cost over position error, one curve for each way to compute.

    Both axes are logarithmic, and more accurate lies to the right. Names that are alike up to the
    first comma are variants of one scheme and share its colour.

    Parameters
    ----------
    curves : mapping of str to sequence of (float, float)
        Points (position error in m, cost) of each way to compute, by name.
    front : sequence of (float, float)
        Points that no other beats in both; they are underlaid in grey.
    reference_error : float, optional
        Error of the reference, m. Smaller errors are drawn there, and shaded where a curve comes
        near.
    title : str
        Title of the diagram.
    cost : str
        Label of the vertical axis, with its unit.
    path : path-like, optional
        File to save the diagram to; its suffix says the format.

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
    curves, front = _named_points(curves), _points("front", front)
    reference_error = _known_error(reference_error)
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
            colour = curve_colour(heads.index(head) if len(heads) > 1 else variant)
            style: dict[str, Any] = {
                "marker": _MARKERS[variant % len(_MARKERS)],
                "ls": _DASHES[variant % len(_DASHES)],
            }
            ax.plot(
                *zip(*_resolved(points, smallest), strict=True),
                ms=4.5,
                lw=1.3,
                color=colour,
                label=name,
                zorder=2,
                **style,
            )
    if reference_error and any(
        error < _NEAR * reference_error for points in curves.values() for error, _ in points
    ):
        ax.axvspan(reference_error / 5, reference_error, color="0.93", zorder=0, lw=0)
        ax.set_xlim(left=reference_error / 5)
    ax.invert_xaxis()
    ax.xaxis.set_major_locator(LogLocator(numticks=9))
    name_curves(figure, ax, len(curves))
    return save_figure(figure, path)


def _known_error(value: Any) -> float | None:
    """Return the error of a reference, None where it is infinite. Raises TypeError, ValueError."""
    return (
        None
        if value is None or (isinstance(value, float) and value == float("inf"))
        else positive_number("reference_error", value, zero=True)
    )


def _named_points(curves: Any) -> dict[str, Points]:
    instance("curves", curves, Mapping, "points (error, cost) by name")
    return {
        text("curves: name", name): _points(f"curves[{name!r}]", points)
        for name, points in curves.items()
    }


def _points(field: str, points: Any) -> Points:
    """Return points as pairs. Raises TypeError, ValueError."""
    pairs = listed(field, points, "[(1e-3, 0.1)]")
    if not pairs:
        return []
    array = real_array(field, pairs, "pairs (error, cost)")
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{field} has shape {array.shape}: give pairs (error, cost)")
    return [(error, cost) for error, cost in array.tolist()]


def _resolved(points: Points, smallest: float) -> list[tuple[float, float]]:
    """Return the points in order of cost (errors may rise again: rounding); of those not above `smallest` only the cheapest, drawn there."""
    beyond = sorted((cost, smallest) for error, cost in points if error <= smallest)[:1]
    return [
        *sorted((point for point in points if point[0] > smallest), key=lambda point: point[1]),
        *((error, cost) for cost, error in beyond),
    ]


class Iteration(Protocol):
    """An iteration as a solver tells of it, such as an `ocp.Progress`."""

    @property
    def iteration(self) -> int:
        """Its number."""

    @property
    def objective(self) -> float:
        """The sum of the costs."""

    @property
    def infeasibility(self) -> float:
        """The largest violation of a constraint, scaled."""


class Convergence:
    """Objective and violated constraints over the iterations of a solver, drawn while it works.

    Give it to a solver: ``ocp.Ipopt(watch=plots.Convergence("solver.png"))``.

    Parameters
    ----------
    path : path-like, optional
        File that is written anew while the solver works, for a viewer that shows files as they
        change; None: no file.
    every : float
        Least wall time between two drawings, s.

    Raises
    ------
    ValueError
        If `every` is not positive.

    Examples
    --------
    >>> import ocp
    >>> from tenscasadi import plots
    >>> watch = plots.Convergence()
    >>> watch(ocp.Progress(iteration=0, objective=2.5, infeasibility=1e-3))
    >>> watch.figure().axes[0].get_title()
    'iteration 0: objective 2.5, largest violation 0.001'
    """

    def __init__(self, path: FilePath | None = None, every: float = 2.0) -> None:
        self._path = None if path is None else file_path("path", path)
        self._every = positive_number("every", every)
        self._told: list[Iteration] = []
        self._drawn = -float("inf")

    def __call__(self, now: Iteration) -> None:
        """Take down an iteration, and draw all where it is time."""
        if not all(hasattr(now, name) for name in ("iteration", "objective", "infeasibility")):
            raise TypeError(
                f"now is {shown(now)}: give an ocp.Progress, or what has iteration, objective and infeasibility"
            )
        self._told.append(now)
        if self._path is not None and time.monotonic() - self._drawn > self._every:
            save_figure(self.figure(), self._path)
            self._drawn = time.monotonic()

    def figure(self) -> Figure:
        """Draw all iterations so far: the objective, and the largest violation on a logarithmic scale.

        Returns
        -------
        matplotlib.figure.Figure
            Two panels over the iterations.
        """
        title = "no iteration yet"
        if self._told:
            last = self._told[-1]
            title = f"iteration {last.iteration}: objective {last.objective:.4g}, largest violation {last.infeasibility:.2g}"
        figure, (above, below) = make_panels(2, "iteration", title, margin=0.05)
        count = [one.iteration for one in self._told]
        above.plot(count, [one.objective for one in self._told], ".-", lw=1.2)
        below.plot(count, [one.infeasibility for one in self._told], ".-", lw=1.2)
        above.set_ylabel("objective")
        below.set_ylabel("largest violation, scaled")
        if any(one.infeasibility > 0 for one in self._told):
            below.set_yscale("log")
        return figure

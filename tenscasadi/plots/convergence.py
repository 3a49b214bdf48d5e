"""A picture of a solver at work, drawn anew as it goes on."""

from __future__ import annotations

import os
import time
from typing import Any, Protocol

from matplotlib.figure import Figure

from tenscasadi.util.validate import positive_number


class Iteration(Protocol):
    """What a solver tells of an iteration, such as an `ocp.Progress`."""

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
    """Objective and violated constraints over the iterations of a solver: `ocp.Ipopt(watch=Convergence("solver.png"))`.

    path: a file that is written anew while the solver works, at most every `every` s of wall time, for a viewer that shows files as they
    change; None: no file. `figure()` draws all that was told so far. Raises ValueError.
    """

    def __init__(self, path: str | os.PathLike[str] | None = None, every: float = 2.0) -> None:
        self._path, self._every = path, positive_number("every", every)
        self._told: list[Iteration] = []
        self._drawn = -float("inf")

    def __call__(self, now: Iteration) -> None:
        """Takes down an iteration, and draws where it is time."""
        self._told.append(now)
        if self._path is not None and time.monotonic() - self._drawn > self._every:
            self.figure().savefig(self._path, dpi=150)
            self._drawn = time.monotonic()

    def figure(self) -> Figure:
        """Two panels over the iterations: the objective, and on a logarithmic scale the largest violation."""
        figure = Figure(figsize=(7.2, 4.6), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True)
        count = [one.iteration for one in self._told]
        panels: list[tuple[Any, str, list[float]]] = [
            (above, "objective", [one.objective for one in self._told]),
            (below, "largest violation, scaled", [one.infeasibility for one in self._told]),
        ]
        for ax, label, values in panels:
            ax.plot(count, values, ".-", color="C0", lw=1.2)
            ax.set_ylabel(label)
            ax.grid(visible=True, color="0.9")
            ax.spines[["top", "right"]].set_visible(False)
        if any(one.infeasibility > 0 for one in self._told):
            below.set_yscale("log")
        below.set_xlabel("iteration")
        return figure

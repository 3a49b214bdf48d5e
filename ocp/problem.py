"""What is asked of a plan: a model, how long, from where, to where, within which limits, at the least of which costs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ocp.bounds import Bound, ForceDensityLimits, TensionLimits
from ocp.checks import dimensions
from ocp.costs import Cost, Effort, Smoothness
from ocp.goals import AtRest, Goal, NodePositions, StringLengths
from tenscasadi.correction import projection
from tenscasadi.model import Model
from tenscasadi.strings import ForceDensity
from tenscasadi.validate import Array, finite_array, instance, positive_number

BAR_TOLERANCE = 1e-3  # relative: rounded nodes are put right without a word, a start with other bars is refused


@dataclass(frozen=True, eq=False)
class Problem:
    """A plan to be found for `model`, whose control is `ForceDensity()`.

    duration: seconds, or (shortest, longest) to let the solver choose. start: nodes (n, 3) at rest, m, or a state (nx,); None: the
    model's initial state; rounded numbers are put right. goals: `StringLengths`, `NodePositions`, `AtRest`, all met at the end.
    bounds: `ForceDensityLimits`, `TensionLimits`, along the way. costs: `Effort`, `Smoothness`, summed.
    Raises TypeError, ValueError that name the field.
    """

    model: Model
    duration: float | tuple[float, float] = 1.0
    start: ArrayLike | None = None
    goals: Iterable[Goal] = ()
    bounds: Iterable[Bound] = ()
    costs: Iterable[Cost] = ()

    def __post_init__(self) -> None:
        instance("Problem.model", self.model, Model, "a tenscasadi.Model")
        if not isinstance(self.model.scene.control, ForceDensity):
            raise ValueError(f"Problem.model has the control {self.model.scene.control}: give a model of Scene(..., control=ForceDensity())")
        if self.model.nu == 0:
            raise ValueError("Problem.model has no strings: there is nothing to plan")
        if self.model.nq == 0:
            raise ValueError("Problem.model has all nodes pinned: there is nothing to move")
        own = self.__dict__
        own["duration"] = _duration(self.duration)
        own["start"] = self._start()
        for field, kinds, example in _KINDS:
            values = getattr(self, field)
            if isinstance(values, kinds) or not isinstance(values, Iterable):
                raise TypeError(f"Problem.{field} is {values!r}: give a list of them, such as {example}")
            own[field] = tuple(values)
            for k, value in enumerate(own[field]):
                instance(f"Problem.{field}[{k}]", value, kinds, f"one of {', '.join(kind.__name__ for kind in kinds)}")
        structure = self.model.scene.structure
        for item in (*own["goals"], *own["bounds"]):
            item.check(structure)
        self._check_limits()

    @property
    def shortest(self) -> float:
        """The least duration, s."""
        return self.duration[0] if isinstance(self.duration, tuple) else self.duration

    @property
    def longest(self) -> float:
        """The greatest duration, s."""
        return self.duration[1] if isinstance(self.duration, tuple) else self.duration

    def limits(self, kind: type) -> tuple[Array, Array]:
        """Lower and upper limits (α,) that all bounds of one kind leave; −inf and inf where there is none."""
        structure = self.model.scene.structure
        given = [bound.limits(structure) for bound in self.bounds if isinstance(bound, kind)]
        count = len(structure.strings)
        lower = np.max([np.full(count, -np.inf), *(low for low, _ in given)], axis=0)
        upper = np.min([np.full(count, np.inf), *(up for _, up in given)], axis=0)
        return lower, upper

    @property
    def force_density_limits(self) -> tuple[Array, Array]:
        """Lower and upper limits of γ (α,), N/m: at least 0, as strings do not push."""
        lower, upper = self.limits(ForceDensityLimits)
        return np.maximum(lower, 0.0), upper

    def _start(self) -> Array:
        if self.start is None:
            return self.model.initial_state
        if dimensions(self.start) == 1:
            state = finite_array("Problem.start", self.start, (self.model.nx,))
        else:
            nodes = finite_array("Problem.start", self.start, (len(self.model.structure.nodes), 3))
            try:
                state = self.model.state(nodes)
            except ValueError as error:
                raise ValueError(f"Problem.start: {error}") from None
        s = self.model.structure
        bars, rates = (Z[s.bars[:, 1]] - Z[s.bars[:, 0]] for Z in (self.model.nodes(state), self.model.velocities(state)))
        actual = np.linalg.norm(bars, axis=1)
        bad = np.flatnonzero(abs(actual / s.bar_lengths - 1) > BAR_TOLERANCE)
        if bad.size:
            i = int(bad[0])
            raise ValueError(f"Problem.start makes bar {i} {actual[i]:g} m long, not {s.bar_lengths[i]:g} m: give nodes that keep the bars' lengths")
        stretch = abs(np.sum(bars * rates, axis=1)) / s.bar_lengths
        bad = np.flatnonzero(stretch > BAR_TOLERANCE * np.linalg.norm(self.model.velocities(state), axis=1).max())
        if bad.size:
            i = int(bad[0])
            raise ValueError(f"Problem.start stretches bar {i} by {stretch[i]:g} m/s: give velocities that keep the bars' lengths")
        return np.asarray(projection(self.model, 10)(state).full()).ravel()

    def _check_limits(self) -> None:
        for kind in (ForceDensityLimits, TensionLimits):
            lower, upper = self.limits(kind)
            crossed = np.flatnonzero(lower > upper)
            if crossed.size:
                i = int(crossed[0])
                raise ValueError(f"Problem.bounds: {kind.__name__} leave string {i} nothing, lower {lower[i]:g} and upper {upper[i]:g}: widen one")


def _duration(value: Any) -> float | tuple[float, float]:
    if dimensions(value) == 0:
        return positive_number("Problem.duration", value)
    pair = finite_array("Problem.duration", value, (2,))
    shortest = positive_number("Problem.duration[0]", pair[0])
    if pair[1] < shortest:
        raise ValueError(f"Problem.duration is ({shortest:g}, {pair[1]:g}): give (shortest, longest)")
    return shortest if pair[1] == shortest else (shortest, float(pair[1]))


_KINDS: tuple[tuple[str, tuple[type, ...], str], ...] = (
    ("goals", (StringLengths, NodePositions, AtRest), "[AtRest()]"),
    ("bounds", (ForceDensityLimits, TensionLimits), "[ForceDensityLimits(0, 200)]"),
    ("costs", (Effort, Smoothness), "[Effort()]"),
)

"""Limits over the horizon of a controller, linearised in all its force densities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.bounds import PathBound, RateBound
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from tenscasadi.util.validate import Array

# What rows of interval 0 depend on: which entry of (states, force densities). Both lists begin with those of the last decision; then come the
# states at the ends of the intervals, from now on, and the force densities of the intervals.
_AT_END = ((0, 2), (1, 1))
_BETWEEN = ((0, 0), (1, 0), (0, 1), (1, 1))
FREE = 1e6  # scaled: no limit, where it must be finite


class HorizonRows:
    """A bound in each of `count` intervals of `period` s, one-sided rows: a ΔU ≤ b, where ΔU (count · nu) are changes of all force densities.

    Of instants: at the end of each interval. `between` instants: from the start of the interval before to that of each interval, first from
    the last decision to now.
    """

    def __init__(self, bound: ScaledRows, count: int, period: float, between: bool) -> None:
        inputs = [ca.MX.sym("z", bound.function.size1_in(k)) for k in range(bound.function.n_in())]
        value = bound.function(*inputs)
        sides = [(sign, k, sign * limit[k]) for sign, limit in ((1.0, bound.upper), (-1.0, bound.lower)) for k in range(len(limit))]
        kept = [side for side in sides if np.isfinite(side[2])]
        chosen = ca.vertcat(*(sign * value[k] for sign, k, _ in kept))
        self.limit, self.count, self.between, self._period = np.array([limit for _, _, limit in kept]), count, between, period
        self._places = _BETWEEN if between else _AT_END
        self._one = ca.Function("rows", inputs, [chosen, *(ca.densify(ca.jacobian(chosen, z)) for z in inputs[:-1])])
        self._all = self._one.map(count)

    @property
    def rows(self) -> int:
        """How many, of all intervals."""
        return len(self.limit) * self.count

    def __call__(self, points: Sequence[Array], effects: Sequence[Array], time: float, begun: bool) -> tuple[Array, Array]:
        """a (rows, count · nu) and b (rows,).

        points: states (count + 2, nx) and force densities (count + 1, nu); effects: their derivatives by ΔU; begun: whether there was a last
        decision.
        """
        given = [points[kind][first : first + self.count].T for kind, first in self._places]
        value, *slopes = (np.asarray(part.full()).T for part in self._all(*given, self._last_input(np.arange(self.count), time)[None]))
        size = (self.count, -1, len(self.limit))
        a = sum(
            J.reshape(size).transpose(0, 2, 1) @ effects[kind][first : first + self.count]
            for J, (kind, first) in zip(slopes, self._places, strict=True)
        )
        b = self.limit - value
        if self.between and not begun:
            b[0] = np.inf
        return np.asarray(a).reshape(self.rows, -1), b.ravel()

    def symbolic(self, points: Sequence[Sequence[Any]], effects: Sequence[Sequence[Any]], time: Any, begun: Any) -> tuple[Any, Any]:
        """The same of lists of expressions."""
        a: list[Any] = []
        b: list[Any] = []
        for k in range(self.count):
            value, *slopes = self._one(*(points[kind][first + k] for kind, first in self._places), self._last_input(k, time))
            a.append(sum(ca.mtimes(J, effects[kind][first + k]) for J, (kind, first) in zip(slopes, self._places, strict=True)))
            room = self.limit - value
            b.append(ca.if_else(begun, room, FREE) if self.between and not k else room)
        return ca.vertcat(*a), ca.vertcat(*b)

    def _last_input(self, k: Any, time: Any) -> Any:
        """What rows of interval k take beside states and force densities: the time at its end, or the length of intervals."""
        return self._period + 0.0 * k if self.between else time + (k + 1) * self._period


def horizon_rows(problem: Problem, scales: Scales, strength: float, count: int, period: float) -> list[HorizonRows]:
    """All bounds of a problem but those of γ itself. strength: a typical γ, N/m."""
    kinds: dict[bool, type[PathBound] | type[RateBound]] = {False: PathBound, True: RateBound}
    return [HorizonRows(bound, count, period, between) for between, kind in kinds.items() for bound in scaled_rows(problem, kind, scales, strength)]

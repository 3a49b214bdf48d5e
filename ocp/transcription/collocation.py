"""Collocation: on each interval the motion is a polynomial that satisfies the equations of motion at Gauss's points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.transcription.assemble import Defects
from ocp.transcription.base import ReducedOnly, bar_multipliers, end_names, end_rows, split_symbol, unrolled
from ocp.transcription.sparse_nlp import Block
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.util.validate import Array, Indices, whole_number


@dataclass(frozen=True)
class ImplicitMidpoint(ReducedOnly):
    """x⁺ = x + h f((x + x⁺)/2, γ) as a constraint: order 2, one evaluation of f, stable for any interval.

    The rule itself keeps bᵀḃ, but lets bar lengths drift by O(h²): multipliers along the bars, two for each bar and interval, put lengths and
    rates right at the end of every interval, in the sense of Gear, Gupta, Leimkuhler (1985, J. Comput. Appl. Math. 12, 77). They vanish
    with h, and the order stays.
    """

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the rule, and the bars' lengths and rates, at the end of each interval."""
        v, model = variables, variables.model
        multipliers = bar_multipliers(v)
        z, (x, c, after, m, duration, share) = split_symbol(model.nx, v.interval_controls.shape[1], model.nx, multipliers.shape[1], 1, 1)
        end = x + duration * share * model.ode((x + after) / 2, v.gamma(c, 0.5))
        function = unrolled(model, ca.Function("midpoint", [z], [end_rows(v, end, after, m)]))
        index = np.hstack([v.states[:-1], v.interval_controls, v.states[1:], multipliers, v.repeated(v.duration), v.share])
        return Defects([Block(function, index, interval_names(v.count, (*state_names(model), *end_names(model))))])


@dataclass(frozen=True)
class Collocation(ReducedOnly):
    """A polynomial of `degree` for the state on each interval: order 2·degree, `degree` evaluations of f, stable for any interval.

    Gauss's points (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.7). As in `ImplicitMidpoint`, which is degree
    1 with its inner state eliminated, multipliers keep bars at the ends of intervals. Force densities are constant or linear within them.
    """

    degree: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if whole_number("Collocation.degree", self.degree, 1) > 9:
            raise ValueError(f"Collocation.degree is {self.degree}: give at most 9, and more intervals")

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the equations of motion at the points of each interval, its end, and the bars' lengths and rates there."""
        v, model, d, nx = variables, variables.model, self.degree, variables.model.nx
        points = np.array(ca.collocation_points(d, "legendre"))
        C, D, _ = ca.collocation_coeff(points.tolist())
        inner = self._inner_states(v, points)
        multipliers = bar_multipliers(v)
        z, (x, c, stages, after, m, duration, share) = split_symbol(nx, v.interval_controls.shape[1], d * nx, nx, multipliers.shape[1], 1, 1)
        X = ca.horzcat(x, ca.reshape(stages, nx, d))
        slopes = ca.horzcat(*(model.ode(X[:, j + 1], v.gamma(c, point)) for j, point in enumerate(points.tolist())))
        defects = (duration * share * slopes - ca.mtimes(X, C)) / ca.repmat(ca.DM(v.scales.state), 1, d)
        rows = ca.vertcat(ca.vec(defects), end_rows(v, ca.mtimes(X, D), after, m))
        function = unrolled(model, ca.Function("collocation", [z], [rows]))
        index = np.hstack([v.states[:-1], v.interval_controls, inner, v.states[1:], multipliers, v.repeated(v.duration), v.share])
        at_points = tuple(f"point {j}, {name}" for j in range(d) for name in state_names(model))
        return Defects([Block(function, index, interval_names(v.count, (*at_points, *state_names(model), *end_names(model))))])

    def _inner_states(self, v: Variables, points: Array) -> Indices:
        """Add the states (K, degree·nx) at the points of each interval, at first on the line between its ends."""
        names = [f"{name}, point {j} of interval {k}" for k in range(v.count) for j in range(self.degree) for name in state_names(v.model)]
        before, after = v.guess.states[:-1, None], v.guess.states[1:, None]
        first = (1 - points[:, None]) * before + points[:, None] * after
        return v.entries.unknowns(names, first.reshape(v.count, -1), np.tile(v.scales.state, self.degree), interval=np.arange(v.count)[:, None])

"""Collocation: on each interval the motion is a polynomial that satisfies the equations of motion at Gauss's points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.assemble import Defects
from ocp.transcription.base import ReducedOnly, bar_multipliers, end_names, end_rows, unrolled
from ocp.transcription.sparse_nlp import Block, split_symbol
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.util.validate import Array, Indices, whole_number


class GaussPoints(ReducedOnly):
    """Transcriptions in which states at the Gauss points of an interval satisfy the equations of motion."""

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Build the equations at the points, and those of the bars at the ends of intervals."""
        v, model = variables, variables.model
        inner = self._inner_states(v)
        multipliers = bar_multipliers(v)
        columns = [
            v.states[:-1],
            v.interval_controls,
            inner,
            v.states[1:],
            multipliers,
            v.repeated(v.duration),
            v.share,
        ]
        z, (x, c, points, after, m, duration, share) = split_symbol(
            ca.MX, *(column.shape[1] for column in columns)
        )
        rows, end = self._equations(v, x, points, after, c, duration * share)
        rows = ca.vertcat(rows, end_rows(v, end, after, m))
        function = unrolled(model, ca.Function("collocation", [z], [rows]))
        names = (
            *(
                f"point {j}, {name}"
                for j in range(inner.shape[1] // model.nx)
                for name in state_names(model)
            ),
            *state_names(model),
            *end_names(model),
        )
        return Defects([Block(function, np.hstack(columns), interval_names(v.count, names))])

    def _inner_states(self, v: Variables) -> Indices:
        """Add the states (K, points·nx) within intervals, at first on the line between the ends."""
        raise NotImplementedError

    def _equations(
        self, v: Variables, x: Any, inner: Any, after: Any, c: Any, interval: Any
    ) -> tuple[Any, Any]:
        """Return the rows at the points, and the state at the end before its bars are corrected."""
        raise NotImplementedError


@dataclass(frozen=True)
class ImplicitMidpoint(GaussPoints, kind="ImplicitMidpoint"):
    """The implicit midpoint rule as a constraint of each interval: order 2, stable for any interval.

    It evaluates the equations of motion once for an interval. Multipliers along the bars keep these
    at the end of every interval.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    control : PiecewiseConstant or PiecewiseLinear
        How force densities run over the intervals.
    accuracy : float, optional
        How near the motion shall be to that of fine steps, m (speeds: m per duration): `solve` then
        solves again, with `Ipopt`, until it is. By default the motion is as the intervals make it.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; from `solve`, if the model has full coordinates and redundant
        constraints.

    Notes
    -----
    The rule x⁺ = x + h f((x + x⁺)/2, γ) itself keeps bᵀḃ, but lets bar lengths drift by O(h²). Two
    multipliers for each bar and interval put lengths and rates right, in the sense of Gear, Gupta
    and Leimkuhler [1]_. They vanish with h, and the order stays.

    References
    ----------
    .. [1] C. W. Gear, B. Leimkuhler, G. K. Gupta, Journal of Computational and Applied Mathematics
    12-13, 1985, 77-90.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.ImplicitMidpoint(6))
    >>> plan.success, plan.force_density.shape
    (True, (6, 2))
    """

    def _inner_states(self, v: Variables) -> Indices:
        return np.zeros((v.count, 0), dtype=np.intp)  # the point is the middle of both ends

    def _equations(
        self, v: Variables, x: Any, inner: Any, after: Any, c: Any, interval: Any
    ) -> tuple[Any, Any]:
        end = x + interval * v.model.ode((x + after) / 2, v.gamma(c, 0.5))
        return type(x)(0, 1), end


@dataclass(frozen=True)
class Collocation(GaussPoints, kind="Collocation"):
    """Collocation at Gauss's points: the state is a polynomial on each interval, of order 2·degree, stable for any interval.

    It evaluates the equations of motion `degree` times for an interval. As in `ImplicitMidpoint`,
    which is degree 1 with its inner state eliminated, multipliers keep bars at the ends of
    intervals.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    degree : int
        Degree of the polynomials, 1 to 9.
    control : PiecewiseConstant or PiecewiseLinear
        How force densities run over the intervals.
    accuracy : float, optional
        How near the motion shall be to that of fine steps, m (speeds: m per duration): `solve` then
        solves again, with `Ipopt`, until it is. By default the motion is as the intervals make it.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; from `solve`, if the model has full coordinates and redundant
        constraints.

    References
    ----------
    E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, Springer 1993,
    section II.7.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.Collocation(4, degree=2))
    >>> plan.success, plan.force_density.shape
    (True, (4, 2))
    """

    degree: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if whole_number("Collocation.degree", self.degree, 1) > 9:
            raise ValueError(
                f"Collocation.degree is {self.degree}: give at most 9, and more intervals"
            )

    def _inner_states(self, v: Variables) -> Indices:
        points = np.array(ca.collocation_points(self.degree, "legendre"))
        names = [
            f"{name}, point {j} of interval {k}"
            for k in range(v.count)
            for j in range(self.degree)
            for name in state_names(v.model)
        ]
        before, after = v.guess.states[:-1, None], v.guess.states[1:, None]
        first = (1 - points[:, None]) * before + points[:, None] * after
        return v.entries.unknowns(
            names,
            first.reshape(v.count, -1),
            np.tile(v.scales.state, self.degree),
            interval=np.arange(v.count)[:, None],
        )

    def _equations(
        self, v: Variables, x: Any, inner: Any, after: Any, c: Any, interval: Any
    ) -> tuple[Any, Any]:
        points = ca.collocation_points(self.degree, "legendre")
        C, D, _ = ca.collocation_coeff(points)
        X = ca.horzcat(x, ca.reshape(inner, v.model.nx, self.degree))
        slopes = ca.horzcat(
            *(v.model.ode(X[:, j + 1], v.gamma(c, point)) for j, point in enumerate(points))
        )
        scale = ca.repmat(ca.DM(v.scales.state), 1, self.degree)
        return ca.vec((interval * slopes - ca.mtimes(X, C)) / scale), ca.mtimes(X, D)

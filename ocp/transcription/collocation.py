"""Collocation: on each interval the motion is a polynomial that satisfies the equations of motion at Gauss's points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.transcription.assemble import Defects
from ocp.transcription.base import ReducedOnly, bar_multipliers, end_names, end_rows, unrolled
from ocp.transcription.sparse_nlp import Block, split_symbol
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.util.validate import Array, Indices, whole_number


@dataclass(frozen=True)
class ImplicitMidpoint(ReducedOnly):
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

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the blocks of rows that vanish on a motion: the rule and the bars at the end of each interval.

        Parameters
        ----------
        variables : Variables
            States at the nodes of the mesh, force densities and duration; further unknowns are
            added to them.
        used : ndarray of bool
            Which of their entries bounds, costs and goals depend on.

        Returns
        -------
        Defects
            The blocks, and how states follow from unknowns where not all are.
        """
        v, model = variables, variables.model
        multipliers = bar_multipliers(v)
        z, (x, c, after, m, duration, share) = split_symbol(
            ca.MX, model.nx, v.interval_controls.shape[1], model.nx, multipliers.shape[1], 1, 1
        )
        end = x + duration * share * model.ode((x + after) / 2, v.gamma(c, 0.5))
        function = unrolled(model, ca.Function("midpoint", [z], [end_rows(v, end, after, m)]))
        index = np.hstack(
            [
                v.states[:-1],
                v.interval_controls,
                v.states[1:],
                multipliers,
                v.repeated(v.duration),
                v.share,
            ]
        )
        return Defects(
            [
                Block(
                    function,
                    index,
                    interval_names(v.count, (*state_names(model), *end_names(model))),
                )
            ]
        )


@dataclass(frozen=True)
class Collocation(ReducedOnly):
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

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the blocks of rows that vanish on a motion: the equations of motion at Gauss's points, and bars at the end of each interval.

        Parameters
        ----------
        variables : Variables
            States at the nodes of the mesh, force densities and duration; further unknowns are
            added to them.
        used : ndarray of bool
            Which of their entries bounds, costs and goals depend on.

        Returns
        -------
        Defects
            The blocks, and how states follow from unknowns where not all are.
        """
        v, model, d, nx = variables, variables.model, self.degree, variables.model.nx
        points = np.array(ca.collocation_points(d, "legendre"))
        C, D, _ = ca.collocation_coeff(points.tolist())
        inner = self._inner_states(v, points)
        multipliers = bar_multipliers(v)
        z, (x, c, stages, after, m, duration, share) = split_symbol(
            ca.MX, nx, v.interval_controls.shape[1], d * nx, nx, multipliers.shape[1], 1, 1
        )
        X = ca.horzcat(x, ca.reshape(stages, nx, d))
        slopes = ca.horzcat(
            *(model.ode(X[:, j + 1], v.gamma(c, point)) for j, point in enumerate(points.tolist()))
        )
        defects = (duration * share * slopes - ca.mtimes(X, C)) / ca.repmat(
            ca.DM(v.scales.state), 1, d
        )
        rows = ca.vertcat(ca.vec(defects), end_rows(v, ca.mtimes(X, D), after, m))
        function = unrolled(model, ca.Function("collocation", [z], [rows]))
        index = np.hstack(
            [
                v.states[:-1],
                v.interval_controls,
                inner,
                v.states[1:],
                multipliers,
                v.repeated(v.duration),
                v.share,
            ]
        )
        at_points = tuple(f"point {j}, {name}" for j in range(d) for name in state_names(model))
        return Defects(
            [
                Block(
                    function,
                    index,
                    interval_names(v.count, (*at_points, *state_names(model), *end_names(model))),
                )
            ]
        )

    def _inner_states(self, v: Variables, points: Array) -> Indices:
        """Add the states (K, degree·nx) at the points of each interval, at first on the line between its ends."""
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

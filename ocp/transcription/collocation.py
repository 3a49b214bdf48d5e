"""Collocation: on each interval the motion is a polynomial that satisfies the equations of motion at Gauss's points."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.transcription.base import Closing, OnGrid, check_reduced, parts, unrolled
from ocp.transcription.initial_guess import Guess
from ocp.transcription.sparse_nlp import Block, Program
from ocp.transcription.variables import interval_names, state_names
from tenscasadi.util.validate import whole_number


@dataclass(frozen=True)
class ImplicitMidpoint(OnGrid):
    """x⁺ = x + h f((x + x⁺)/2, γ) as a constraint: order 2, one evaluation of f, stable for any interval.

    The rule itself keeps bᵀḃ, but lets bar lengths drift by O(h²): multipliers along the bars, two for each bar and interval, put lengths and
    rates right at the end of every interval, in the sense of Gear, Gupta, Leimkuhler (1985, J. Comput. Appl. Math. 12, 77). They vanish
    with h, and the order stays.
    """

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess. ValueError for full coordinates and moved supports."""
        model = problem.model
        check_reduced("ImplicitMidpoint", model)
        a = self.assembly(problem, target, scales, guess)
        closing = Closing(a)
        for k in range(a.count):
            a.add_control(k)
            closing.add(k)
            a.add_state(k + 1)
        if self.control.linear:
            a.add_control(a.count)
        a.add_duration()
        z, (x, c, after, m, duration, share) = parts(model.nx, a.interval_controls.shape[1], model.nx, closing.size, 1, 1)
        end = x + duration * share * model.ode((x + after) / 2, a.gamma(c, 0.5))
        function = unrolled(model, ca.Function("midpoint", [z], [closing.rows(end, after, m)]))
        index = np.hstack([a.states[:-1], a.interval_controls, a.states[1:], closing.index, a.repeated(a.duration), a.share])
        a.rows.append(Block(function, index, interval_names(a.count, (*state_names(model), *closing.names))))
        return a.finish()


@dataclass(frozen=True)
class Collocation(OnGrid):
    """A polynomial of `degree` for the state on each interval: order 2·degree, `degree` evaluations of f, stable for any interval.

    Gauss's points (Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, II.7). As in `ImplicitMidpoint`, which is degree
    1 with its inner state eliminated, multipliers keep bars at the ends of intervals. Force densities are constant or linear within them.
    """

    degree: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if whole_number("Collocation.degree", self.degree, 1) > 9:
            raise ValueError(f"Collocation.degree is {self.degree}: give at most 9, and more intervals")

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess. ValueError for full coordinates and moved supports."""
        model, d = problem.model, self.degree
        check_reduced("Collocation", model)
        a = self.assembly(problem, target, scales, guess)
        closing = Closing(a)
        points = ca.collocation_points(d, "legendre")
        C, D, _ = ca.collocation_coeff(points)
        names = state_names(model)
        inner = np.zeros((a.count, d * model.nx), dtype=np.intp)
        for k in range(a.count):
            a.add_control(k)
            before, after = a.guess.states[k : k + 2]
            first = np.concatenate([(1 - point) * before + point * after for point in points])
            inside = [f"{name}, point {j} of interval {k}" for j in range(d) for name in names]
            inner[k] = a.unknowns.add(inside, first, np.tile(a.scales.state, d), stage=k)
            closing.add(k)
            a.add_state(k + 1)
        if self.control.linear:
            a.add_control(a.count)
        a.add_duration()
        nx = model.nx
        z, (x, c, stages, after, m, duration, share) = parts(nx, a.interval_controls.shape[1], d * nx, nx, closing.size, 1, 1)
        X = ca.horzcat(x, ca.reshape(stages, nx, d))
        slopes = ca.horzcat(*(model.ode(X[:, j + 1], a.gamma(c, point)) for j, point in enumerate(points)))
        defects = (duration * share * slopes - ca.mtimes(X, C)) / ca.repmat(ca.DM(a.scales.state), 1, d)
        rows = ca.vertcat(ca.vec(defects), closing.rows(ca.mtimes(X, D), after, m))
        function = unrolled(model, ca.Function("collocation", [z], [rows]))
        index = np.hstack([a.states[:-1], a.interval_controls, inner, a.states[1:], closing.index, a.repeated(a.duration), a.share])
        at_points = tuple(f"point {j}, {name}" for j in range(d) for name in names)
        a.rows.append(Block(function, index, interval_names(a.count, (*at_points, *names, *closing.names))))
        return a.finish()

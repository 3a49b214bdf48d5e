"""From a problem to a nonlinear program: multiple shooting."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ocp.bounds import TensionLimits
from ocp.guess import Guess
from ocp.problem import Problem
from ocp.target import Scales, Target
from tenscasadi.correction import projection
from tenscasadi.model import Model
from tenscasadi.schemes import RungeKutta4, Scheme, check_scheme
from tenscasadi.validate import Array, whole_number


@dataclass(frozen=True, eq=False)
class Program:
    """minimise f(w) subject to lower ≤ g(w) ≤ upper and w_lower ≤ w ≤ w_upper, all in scaled numbers of order one.

    problem: {"x": w, "f": f, "g": g} as `casadi.nlpsol` takes it. first: w to start from. names: one for each row of g, and w_names for each of w.
    objective: what f is multiplied by to be the cost. unpack: Function w → states (nx, intervals + 1), force densities (α, intervals), duration.
    """

    problem: dict[str, Any]
    w_lower: Array
    w_upper: Array
    lower: Array
    upper: Array
    first: Array
    names: tuple[str, ...]
    w_names: tuple[str, ...]
    objective: float
    unpack: ca.Function


class Transcription(Protocol):
    """A way to turn a problem into a program."""

    @property
    def intervals(self) -> int:
        """Intervals of constant force density."""

    def step(self, model: Model) -> ca.Function:
        """The motion over one interval of length h: Function (x, u, h) → x_next."""

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess."""


@dataclass(frozen=True)
class MultipleShooting:
    """γ constant on each of `intervals` equal parts; the states between them are unknowns too, and continuity is a constraint.

    Each part takes `substeps` steps of `scheme`, followed by a projection onto bars and joints: without it they drift, and imposed as
    constraints they would repeat the dynamics.
    """

    intervals: int = 40
    scheme: Scheme = field(default_factory=RungeKutta4)
    substeps: int = 1

    def __post_init__(self) -> None:
        whole_number("MultipleShooting.intervals", self.intervals, 1)
        whole_number("MultipleShooting.substeps", self.substeps, 1)
        check_scheme(self.scheme)

    def step(self, model: Model) -> ca.Function:
        """The motion over one interval of length h: Function (x, u, h) → x_next."""
        advance = self.scheme.step(model.ode)
        x, u, h = (ca.MX.sym(name, size) for name, size in (("x", model.nx), ("u", model.nu), ("h", 1)))
        end: Any = x
        for _ in range(self.substeps):
            end = advance(end, u, h / self.substeps)
        if model.mechanism.constrained:
            end = projection(model, 1)(end)
        return ca.Function("interval", [x, u, h], [end], ["x", "u", "h"], ["x_next"])

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess."""
        model, count = problem.model, self.intervals
        # Ordered interval by interval, so that the matrices of the solver are banded: u₀ x₁ u₁ x₂ …
        w = ca.MX.sym("w", count * (model.nu + model.nx) + (problem.shortest < problem.longest))
        stages = ca.reshape(w[: count * (model.nu + model.nx)], model.nu + model.nx, count)
        strength = _strength(problem, scales, guess)
        controls = strength * stages[: model.nu, :]
        states = ca.repmat(ca.DM(scales.state), 1, count) * stages[model.nu :, :]
        duration = scales.time * w[-1] if problem.shortest < problem.longest else ca.DM(problem.longest)
        before = ca.horzcat(ca.DM(target.start), states[:, :-1])
        interval = duration / count

        rows = [_Rows.of_gaps(model, self.step(model).map(count)(before, controls, ca.repmat(interval, 1, count)), states, scales)]
        rows += _tension_rows(problem, before, states, controls, strength * scales.length)
        if target.count:
            names = tuple(f"goal, combination {k}" for k in range(target.count))
            rows.append(_Rows(target.rows(states[:, -1]), np.zeros(target.count), np.zeros(target.count), names))
        g = ca.vertcat(*(ca.vec(part.value) for part in rows))

        cost = sum((term.expression(controls, interval) for term in problem.costs), start=ca.MX(0))
        unpack = ca.Function("unpack", [w], [ca.horzcat(ca.DM(target.start), states), controls, duration])
        first, lower, upper = _bounds(problem, scales, strength, guess)
        objective = _typical_cost(problem, strength, guess)
        return Program(
            {"x": w, "f": cost / objective, "g": g},
            lower,
            upper,
            np.concatenate([part.lower for part in rows]),
            np.concatenate([part.upper for part in rows]),
            first,
            tuple(name for part in rows for name in part.names),
            _unknowns(model, count) + (("duration",) if problem.shortest < problem.longest else ()),
            objective,
            unpack,
        )


@dataclass(frozen=True, eq=False)
class _Rows:
    value: Any
    lower: Array
    upper: Array
    names: tuple[str, ...]

    @staticmethod
    def of_gaps(model: Model, ends: Any, states: Any, scales: Scales) -> _Rows:
        count = states.shape[1]
        value = (states - ends) / ca.repmat(ca.DM(scales.state), 1, count)
        names = tuple(f"dynamics of interval {k}, {name}" for k in range(count) for name in state_names(model))
        return _Rows(value, np.zeros(len(names)), np.zeros(len(names)), names)


def state_names(model: Model) -> tuple[str, ...]:
    """What each entry of the state is, such as "node 2 z velocity"."""
    mech = model.mechanism
    places = [f"node {mech.physical[k // 3]} {'xyz'[k % 3]}" for k in np.flatnonzero(mech.free.ravel())]
    return (*places, *(f"{place} velocity" for place in places), *["clock"] * (model.nx - 2 * len(places)))


def _unknowns(model: Model, count: int) -> tuple[str, ...]:
    stage = (*(f"force density of string {i}" for i in range(model.nu)), *state_names(model))
    return tuple(f"{name}, interval {k}" for k in range(count) for name in stage)


def _strength(problem: Problem, scales: Scales, guess: Guess) -> float:
    """A typical force density, N/m: of the guess, or what moves the structure's mass by its size within the duration."""
    mass = float(problem.model.structure.mass_matrix().sum())
    return max(float(np.sqrt(np.mean(guess.force_density**2))), mass / scales.time**2)


def _typical_cost(problem: Problem, strength: float, guess: Guess) -> float:
    """The costs of force densities that alternate about the typical one: what makes the objective of order one."""
    pattern = strength * (1 + 0.5 * (-1.0) ** np.indices(guess.force_density.T.shape).sum(axis=0))
    interval = guess.duration / len(guess.force_density)
    return float(sum((ca.DM(term.expression(ca.DM(pattern), interval)) for term in problem.costs), start=ca.DM(0))) or 1.0


def _tension_rows(problem: Problem, before: Any, after: Any, controls: Any, force: float) -> list[_Rows]:
    """Tensions at both ends of every interval, of the strings that have a limit."""
    model = problem.model
    parent = model.structure.string_parent
    lower, upper = (limit[parent] for limit in problem.limits(TensionLimits))
    lower = np.where(lower > 0, lower, -np.inf)  # γ ≥ 0 says so already
    chosen = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
    if not chosen.size:
        return []
    kind: Any = ca.SX if model.observe.is_a("SXFunction") else ca.MX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    tension = ca.Function("tension", [x, u], [model.tension(x, u)[chosen.tolist()] / force]).map(controls.shape[1])
    return [
        _Rows(
            tension(states, controls),
            np.tile(lower[chosen] / force, controls.shape[1]),
            np.tile(upper[chosen] / force, controls.shape[1]),
            tuple(f"tension of string {parent[k]}, {end} of interval {i}" for i in range(controls.shape[1]) for k in chosen),
        )
        for states, end in ((before, "start"), (after, "end"))
    ]


def _bounds(problem: Problem, scales: Scales, strength: float, guess: Guess) -> tuple[Array, Array, Array]:
    """The first w, and its lower and upper limits."""
    count, nx = len(guess.force_density), problem.model.nx
    least, most = problem.force_density_limits
    lower, upper = (np.tile(np.append(limit / strength, np.full(nx, bound)), count) for limit, bound in ((least, -np.inf), (most, np.inf)))
    first = np.concatenate([guess.force_density / strength, guess.states[1:] / scales.state], axis=1).ravel()
    if problem.shortest < problem.longest:
        pairs = ((first, guess.duration), (lower, problem.shortest), (upper, problem.longest))
        first, lower, upper = (np.append(values, last / scales.time) for values, last in pairs)
    return first, lower, upper

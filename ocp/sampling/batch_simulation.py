"""Batches of simulations, with their costs and constraint violations."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.bounds.bound import PathBound, RateBound
from ocp.problem.costs import cost_terms
from ocp.problem.instant import symbolic
from ocp.problem.path_constraints import ScaledRows, scaled_rows
from ocp.problem.problem import Problem
from ocp.problem.rows import goal_rows
from ocp.problem.scaling import Scales, typical_cost
from ocp.sampling.horizon_costs import build_control_cost, build_rate_cost, build_running_cost
from ocp.transcription.mesh import Profile, group_matrix, hermite_state, locate_share, spans
from tenscasadi.integrators.runge_kutta import RungeKutta4
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.request import STOPPED, Intervals, Rolled
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.processes import count_processors
from tenscasadi.util.validate import Array

Watcher = Callable[[str], bool]  # function of a line of progress; returns whether to stop
# changes (n, α) of force densities [N/m] in an interval, from the states (n, nx) at its start
Feedback = Callable[[int, Array], Array]

PROBE = 1e-6  # change of finite differences, in units of the directions and of scaled states
COST_SHARE = 0.1  # weight of the costs against a goal that is off by its tolerance


class InstantGoals(NamedTuple):
    """Goals at one instant of a plan.

    Attributes
    ----------
    interval : int
        Mesh interval that contains the instant.
    rows : casadi.Function
        (x, x⁺, h) → residuals of the goals, from the states at both ends of the interval of length h [s].
    speeds : ndarray of bool
        Which residuals are velocities.
    names : tuple of str
        Names of the residuals.
    """

    interval: int
    rows: ca.Function
    speeds: Array
    names: tuple[str, ...]


class BatchSimulation:
    """Simulation of a batch of control sequences on a mesh.

    Parameters
    ----------
    fractions : ndarray, shape (K,)
        Interval lengths relative to the duration.
    profile : Profile
        Groups of strings, and the numbers of intervals with equal control.
    steps : int
        Steps of `RungeKutta4` in each interval.
    strength : float
        Typical force density [N/m].
    place : float
        Tolerance of goals [m].
    threads : int, optional
        Number of threads; one for each processor by default.
    """

    def __init__(
        self,
        problem: Problem,
        scales: Scales,
        fractions: Array,
        profile: Profile,
        steps: int,
        strength: float,
        place: float,
        threads: int | None,
    ) -> None:
        self.problem, self.fractions, self.steps, self.place = problem, fractions, steps, place
        self.scales, self._strength, self._cached = (
            scales,
            strength,
            dict[tuple[str, int], ArrayFunction](),
        )
        self._threads = count_processors() if threads is None else threads
        count, longest = len(fractions), problem.longest
        held = (
            np.tile(problem.initial_state, (count + 1, 1)),
            np.full((count, problem.model.nu), strength),
        )
        self._weight = (
            COST_SHARE / typical_cost(problem, strength, *held, longest) if problem.costs else 0.0
        )
        self.kernel = build_kernel(
            problem.model,
            RungeKutta4(),
            stage=build_running_cost(problem, scales, longest, strength, self._weight),
        )
        self._lower, self._upper = problem.force_density_limits
        together = group_matrix(profile, problem.model.nu)
        # the mean of strings that share a force density
        self._shared = together @ (together / together.sum(axis=0)).T
        self._spans = spans(profile, fractions)
        self.count = 0  # simulated motions
        self._control_cost = build_control_cost(problem, longest / count, count)
        self._rate_cost = build_rate_cost(problem, scales, longest / count, count, strength)

    @property
    def legs(self) -> list[tuple[int, int]]:
        """Ranges of intervals between successive instants with goals."""
        ends = sorted({0, len(self.fractions), *(one.interval + 1 for one in self.asked)})
        return list(pairwise(ends))

    @cached_property
    def asked(self) -> list[InstantGoals]:
        """Goals in the order of their instants."""
        problem, model = self.problem, self.problem.model
        found = []
        for share, goals in [
            *problem.waypoints,
            (1.0, problem.terminal_goals),
        ]:
            x, before, after, h = (
                ca.SX.sym(name, size)
                for name, size in (
                    ("x", model.nx),
                    ("before", model.nx),
                    ("after", model.nx),
                    ("h", 1),
                )
            )
            rows = goal_rows(goals, model, x)
            if not rows.names:
                continue
            k, part = locate_share(self.fractions, share)
            state = hermite_state(model, before, after, h, part)
            value = ca.Function("rows", [x], [ca.densify(rows.value)])
            between = ca.Function("rows", [before, after, h], [value(state)])
            found.append(
                InstantGoals(
                    k, between, np.array([unit == "m/s" for unit in rows.units]), rows.names
                )
            )
        return found

    def roll(
        self,
        starts: Array,
        wanted: Array,
        duration: float,
        first: int = 0,
        finer: int = 1,
        law: Feedback | None = None,
    ) -> tuple[Array, Array, Array]:
        """Simulate n control sequences over k intervals.

        `starts` (n, nx) are the states at the start of interval `first`. `duration` is that of the
        whole plan [s]. Returns the force densities (n, k, α), the states (n, k + 1, nx) at the ends
        of the intervals from `first` on, and the running costs (n,). `wanted` (n, k, α) are the
        force densities without the feedback `law`, and `finer` multiplies the number of steps.
        Costs are inf and states NaN if a simulation diverges. Ctrl-C raises KeyboardInterrupt.
        """
        n, count, nu = wanted.shape
        controls, states = np.empty((n, count, nu)), np.empty((n, count + 1, self.problem.model.nx))
        states[:, 0], cost = starts, np.zeros(n)
        for k in range(count):
            if k and self._spans[first + k] == self._spans[first + k - 1]:
                controls[:, k] = controls[:, k - 1]
            else:
                answer = 0.0 if law is None else law(first + k, states[:, k])
                controls[:, k] = np.clip(
                    np.nan_to_num(wanted[:, k] + answer) @ self._shared, self._lower, self._upper
                )
            rolled = self._advance(first + k, states[:, k], controls[:, k], duration, finer)
            states[:, k + 1] = rolled.states
            cost += rolled.cost
        self.count += n
        cost = np.where(
            np.isfinite(states[:, -1]).all(axis=1), np.nan_to_num(cost, nan=np.inf), np.inf
        )
        return controls, states, cost + self._other_costs(states, controls, first)

    def _advance(
        self, k: int, states: Array, controls: Array, duration: float, finer: int
    ) -> Rolled:
        """Simulate interval k from n states (n, nx) with controls (n, α)."""
        n, steps = len(states), self.steps * finer
        inputs = np.column_stack([controls, np.full(n, duration * self.fractions[: k + 1].sum())])
        length = np.full(1, duration * self.fractions[k] / steps)
        # to start a thread costs as much as some thousand steps
        threads = max(1, min(self._threads, n * steps // 4000))
        intervals = Intervals(np.zeros(1, int), np.full(1, steps), length)
        rolled = self.kernel.run(states, inputs[:, None], intervals, threads=threads)
        if np.any(rolled.status == STOPPED):
            raise KeyboardInterrupt
        return rolled

    def linearize(
        self, states: Array, controls: Array, duration: float, directions: Array, finer: int
    ) -> Array:
        """Compute the derivatives (K, nx, nx + 1 + g) of a motion over each of its intervals.

        They are those of the state at the end with respect to the state at the start, to the
        duration relative to itself, and to changes along `directions` (g, α). The motion has states
        (K + 1, nx) and controls (K, α). Derivatives are 0 if a simulation diverges.
        """
        nx, g = states.shape[1], len(directions)
        probes, changes = PROBE * np.diag(self.scales.state), PROBE * directions
        by = np.concatenate([PROBE * self.scales.state, np.full(1 + g, PROBE)])
        found = np.empty((len(controls), nx, nx + 1 + g))
        for k, (x, u) in enumerate(zip(states[:-1], controls, strict=True)):
            ends = self._advance(
                k,
                np.concatenate([x + probes, np.tile(x, (g + 1, 1))]),
                np.concatenate([np.tile(u, (nx + 1, 1)), u + changes]),
                duration,
                finer,
            ).states
            same = ends[nx].copy()
            ends[nx] = self._advance(k, x[None], u[None], duration * (1 + PROBE), finer).states[0]
            found[k] = (ends - same).T / by
        return np.where(np.isfinite(found), found, 0.0)

    def gather_spans(self, slopes: Array) -> Array:
        """Sum derivatives (m, K, g) over intervals with equal control, at the first of them."""
        first = np.flatnonzero(np.diff(self._spans, prepend=-1))
        found = np.zeros_like(slopes)
        found[:, first] = np.add.reduceat(slopes, first, axis=1)
        return found

    @cached_property
    def row_intervals(self) -> Array:
        """Interval (m,) of each row of `misses`, then of `excess`."""
        count = len(self.fractions)
        found = [np.full(len(one.names), one.interval) for one in self.asked]
        for rows in self._limits:
            for end in rows.ends:
                own = [count - 1] if end == "last" else np.arange(count)
                found.append(np.repeat(own, len(rows.upper)))
        for rows in self._rate_limits if count > 1 else ():
            found.append(np.repeat(np.arange(count - 1), len(rows.upper)))
        return np.concatenate(found or [np.zeros(0, int)])

    def misses(self, states: Array, duration: float, first: int = 0, speed: float = 1.0) -> Array:
        """Compute goal residuals (n, m) in units of their tolerances.

        The tolerance of velocities is `speed` times that of positions per duration. States (n, k +
        1, nx) begin at interval `first`.
        """
        n, last = len(states), first + states.shape[1] - 1
        rows = [np.zeros((n, 0))]
        for number, one in enumerate(self.asked):
            if first <= one.interval < last:
                k = one.interval - first
                h = np.full(n, duration * self.fractions[one.interval])
                sizes = np.where(one.speeds, speed * self.place / self.problem.longest, self.place)
                rows.append(
                    self.evaluate(f"asked {number}", one.rows, states[:, k], states[:, k + 1], h)
                    / sizes
                )
        return np.concatenate(rows, axis=1)

    def excess(
        self, states: Array, controls: Array, duration: float, last_only: bool = False
    ) -> Array:
        """Compute the scaled violations (n, m) of limits.

        The n trajectories have states (n, K + 1, nx) and controls (n, K, nu). With `last_only`,
        only terminal limits count. `duration` is in seconds.
        """
        n, count, nu = controls.shape
        ends, found = duration * np.append(0.0, np.cumsum(self.fractions)), [np.zeros((n, 0))]
        places = {
            "start": slice(0, count),
            "end": slice(1, count + 1),
            "last": slice(count, count + 1),
        }
        for number, rows in enumerate(self._limits):
            for end in rows.ends if not last_only or rows.ends == ("last",) else ():
                x, u = states[:, places[end]], controls[:, -1:] if end == "last" else controls
                t = np.broadcast_to(
                    ends[-x.shape[1] :] if end != "start" else ends[:-1], x.shape[:2]
                )
                found.append(
                    self._beyond(
                        f"limit {number}",
                        rows,
                        n,
                        x.reshape(-1, x.shape[2]),
                        u.reshape(-1, nu),
                        t.ravel(),
                    )
                )
        for number, rows in enumerate(self._rate_limits if count > 1 and not last_only else ()):
            h = np.broadcast_to(np.diff(ends)[:-1], (n, count - 1))
            given = (
                part.reshape(n * (count - 1), -1)
                for part in (states[:, :-2], controls[:, :-1], states[:, 1:-1], controls[:, 1:])
            )
            found.append(self._beyond(f"rate {number}", rows, n, *given, h.ravel()))
        return np.concatenate(found, axis=1)

    def _beyond(self, name: str, rows: ScaledRows, n: int, *given: Array) -> Array:
        value = self.evaluate(name, rows.function, *given)
        return np.maximum(np.maximum(value - rows.upper, rows.lower - value), 0.0).reshape(n, -1)

    def describe_worst(self, states: Array, controls: Array, duration: float) -> str:
        """Describe the largest constraint violation of one trajectory.

        States are (K + 1, nx), controls (K, nu), and the duration is in seconds.
        """
        missed = np.abs(self.misses(states[None], duration)[0])
        over = self.excess(states[None], controls[None], duration)[0]
        if not (np.all(np.isfinite(missed)) and np.all(np.isfinite(over))):
            return "the best motion diverges"
        names = [name for one in self.asked for name in one.names]
        speeds = np.concatenate([one.speeds for one in self.asked] or [np.zeros(0, bool)])
        if len(missed) and missed.max() > 1:
            k = int(np.argmax(missed))
            size, unit = (
                (self.place / self.problem.longest, "m/s") if speeds[k] else (self.place, "m")
            )
            return f"{names[k]} misses its goal by {missed[k] * size:.2g} {unit}"
        return f"a path constraint is violated by {over.max(initial=0.0):.2g} of its scale"

    def objective(self, states: Array, controls: Array, duration: float) -> float:
        """Compute the objective of one trajectory.

        States are (K + 1, nx), controls (K, nu), and the duration is in seconds. Running costs are
        integrated by the trapezoid rule.
        """
        h, now = duration * self.fractions, symbolic(self.problem.model)
        ends, terms = (
            np.append(0.0, np.cumsum(h)),
            cost_terms(self.problem.costs).express(self.problem.model),
        )
        spacing = (h[1:] + h[:-1]) / 2
        total = 0.0
        for expression in terms.control:
            held = zip(map(ca.DM, controls), h.tolist(), strict=True)
            total += sum(float(ca.DM(expression(gamma, step))) for gamma, step in held)
        for expression in terms.changes:
            pairs = (ca.DM(controls[k : k + 2].T) for k in range(len(spacing)))
            held = zip(pairs, spacing.tolist(), strict=True)
            total += sum(float(ca.DM(expression(pair, step))) for pair, step in held)
        for running in terms.running:
            rate = ca.Function("rate", list(now.symbols), [running(now)]).map(len(h))
            sides = [
                rate(states[k : k + len(h)].T, controls.T, ends[None, k : k + len(h)])
                .full()
                .ravel()
                for k in (0, 1)
            ]
            total += float(h @ (sides[0] + sides[1])) / 2
        return total + sum(
            float(cost(states[k + 1], controls[k])) for k, cost in self._instant_costs
        )

    @cached_property
    def _limits(self) -> list[Any]:
        return scaled_rows(self.problem, PathBound, self.scales, self._strength)

    @cached_property
    def _rate_limits(self) -> list[Any]:
        return scaled_rows(self.problem, RateBound, self.scales, self._strength)

    def _other_costs(self, states: Array, controls: Array, first: int) -> Array:
        """Compute the costs (n,) other than running costs.

        They are functions of the controls, of their rates, and of single instants. States (n, k +
        1, nx) and controls (n, k, nu) begin at interval `first`.
        """
        n, count, _ = controls.shape
        whole, total = count == len(self.fractions), np.zeros(n)
        if self._control_cost is not None:
            padded = (
                controls
                if whole
                else np.concatenate(
                    [controls, np.repeat(controls[:, -1:], len(self.fractions) - count, axis=1)],
                    axis=1,
                )
            )
            total += (
                self._weight
                * count
                / len(self.fractions)
                * self.evaluate("control", self._control_cost, padded).ravel()
            )
        if self._rate_cost is not None and count > 1:
            given = (
                part.reshape(n * (count - 1), -1)
                for part in (states[:, :-2], controls[:, :-1], states[:, 1:-1], controls[:, 1:])
            )
            total += self.evaluate("rates", self._rate_cost, *given).reshape(n, -1).sum(axis=1)
        for number, (k, cost) in enumerate(self._instant_costs):
            if first <= k < first + count:
                at = states[:, k - first + 1], controls[:, k - first]
                total += self._weight * self.evaluate(f"cost {number}", cost, *at).ravel()
        return total

    @cached_property
    def _instant_costs(self) -> list[tuple[int, ca.Function]]:
        """Costs of single instants, as Functions (x, u).

        Each has the number of the interval before it.
        """
        now, found = symbolic(self.problem.model), []
        x, u, _ = now.symbols
        for share, expression in cost_terms(self.problem.costs).instants:
            value = ca.Function("cost", list(now.symbols), [ca.densify(expression(now))])(
                x, u, share * self.problem.longest
            )
            found.append(
                (locate_share(self.fractions, share)[0], ca.Function("cost", [x, u], [value]))
            )
        return found

    def evaluate(self, name: str, function: ca.Function, *inputs: Array) -> Array:
        """Evaluate a Function for n rows of inputs in one call.

        `name` is the key under which its map is cached.
        """
        n = len(inputs[0])
        if (name, n) not in self._cached:
            self._cached[name, n] = ArrayFunction(function.map(n))
        return self._cached[name, n](*inputs)[0]

"""Interior-point method for a program with the states eliminated."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from ocp.solvers.condensed_newton.bounds import BoundDuals, WorkingSet
from ocp.solvers.condensed_newton.condensed_program import CondensedProgram, Expansion
from ocp.solvers.condensed_newton.iterate import Iterate, Linearization, evaluate, move
from ocp.solvers.condensed_newton.metric import Metric, Projector
from ocp.solvers.condensed_newton.step import QuadraticModel, TrialStep
from tenscasadi.util.validate import Array

WIDE = 0.1  # scaled rows: width of the funnel while barriers are high
NEARLY_MET = 1e-3  # scaled rows: smaller violations are not corrected within an iteration
SETTLED = 1e-4  # relative: smaller changes of the cost, and barriers per curvature, do not count


class InteriorPoint:
    """Interior-point method with a trust region.

    A funnel, a decreasing bound on the violation, replaces a filter. Step lengths, duals and
    barrier parameters are in units of `unit`, the mean curvature of the cost. Where the cost has
    none, a small constant replaces it. The iteration begins at (u, s), and ends at the optimality
    error `tolerance`. `of` is the program.
    """

    def __init__(self, of: CondensedProgram, u: Array, s: Array, tolerance: float) -> None:
        self.of, self.tolerance = of, tolerance
        self.base, self.rest = self._curvature_of_cost(u, s)
        self.unit = float(self.base.mean())
        self.others: Array | float = 0.0
        u = self._lift(u, s)
        slope = of.slope(u, s)[of.u]
        pull = np.abs(slope) * np.minimum(np.minimum(*of.bounds.gaps(u)), 1.0)
        self.mu = 0.5 * max(float(pull.mean()), 0.01 * self.unit)
        slack = of.path_bounds.inside(of.values(u, s)[3], 1e-3, 0.2)
        self.of_bounds = BoundDuals(of.bounds, u, self.mu)
        self.of_paths = BoundDuals(of.path_bounds, slack, self.mu)
        self.working = WorkingSet()
        size = np.maximum(u @ (self.base * u), len(u) * self.unit)
        self.radius = 1e3 * float(np.sqrt(size))
        self.stiffened, self.iterations, self.lowered, self.known = 0.0, 0, 0, np.inf
        self.history: list[tuple[float, float]] = []
        self.duals = np.zeros(of.goals)
        self.last: tuple[TrialStep, float] | None = None
        self._stand(evaluate(of, u, s, slack))
        self.prices = self.duals, self.of_paths.net, self.of_bounds.net
        self.funnel = max(1.0, 2 * self.point.worst)

    # --- the start ---

    def _curvature_of_cost(self, u: Array, s: Array) -> tuple[Array, sp.csr_array | None]:
        """Split the cost's Hessian into a positive diagonal and the rest.

        The rest is dropped if it dominates the diagonal. The Hessian is that with respect to u, at
        (u, s). Returns the diagonal and the rest or None.
        """
        of = self.of
        H = of.hessian(u, s).matrix[len(s) :, len(s) :]
        falls = 2 * np.abs(of.slope(u, s)[of.u]) / np.maximum(np.abs(u), 1e-3)
        own = np.where(H.diagonal() > 0, H.diagonal(), falls)
        base = np.maximum(own, 1e-3 * own.mean() if own.any() else 1 / max(len(u), 1))
        alone = sp.diags_array(np.where(of.everywhere, 0.0, 1.0))
        rest = sp.csr_array(alone @ (H - sp.diags_array(H.diagonal())) @ alone)
        rest.eliminate_zeros()
        if rest.nnz and (np.abs(rest).sum(axis=1) <= base * (1 + 1e-9)).all():
            return 1.001 * base, rest
        return base, None

    def _lift(self, u: Array, s: Array) -> Array:
        """Move the initial u to the interior of its bounds.

        The distance is about the length of the first step. Fixed noise breaks symmetries, along
        which the method may end at a saddle.
        """
        of = self.of
        u = of.bounds.inside(u, 0.05, 0.05)
        self.expansion, self.chosen = Expansion(of, u, s), np.zeros(0, dtype=np.intp)
        self.rows, self.give = self.expansion.jacobian, np.zeros(of.goals)
        point = evaluate(of, u, s, np.zeros(len(of.path_rows)))
        first = self._linearize(self._project(0.0)).step_back(point)
        level = 0.3 * float(np.sqrt(np.mean(first**2)))
        noise = 0.1 * level * np.random.default_rng(0).uniform(size=len(u))
        lifted = of.bounds.inside(of.bounds.inside(u, level, 0.2) + noise, 0.05, 0.05)
        return np.where(of.everywhere, u, lifted)

    # --- the point ---

    def _project(self, stiffness: Array | float) -> Projector:
        diagonal = np.where(self.of.bounds.free, self.base + self.others + stiffness, 1e300)
        return Projector(self.rows, self.give, Metric(diagonal, self.rest))

    def _linearize(self, projector: Projector) -> Linearization:
        return Linearization(self.expansion, projector, self.chosen)

    def _stand(self, point: Iterate) -> None:
        """Move to an iterate and evaluate its derivatives."""
        of, free = self.of, self.of.bounds.free
        self.point, self.expansion = point, Expansion(of, point.u, point.s)
        self.slope = self.expansion.slope * free
        self.history.append((point.cost, point.worst))
        self.stiffness = self.of_bounds.stiffness(point.u) * free
        self._stand_between(point)
        self.gradient = self._gradient()
        self.projector = self._project(self.stiffness)
        self.working.learn(self.projector.sizes[of.goals :])
        if self.iterations:
            nearest, largest = (
                self.projector.duals(self.gradient),
                np.abs(self.duals).max(initial=0),
            )
            if self.iterations < 3 or np.abs(nearest).max(initial=0.0) < 3 * largest:
                self.duals = nearest

    def _stand_between(self, point: Iterate) -> None:
        """Evaluate the contributions of path constraints at an iterate.

        It computes their working set, the gradients of their barriers and the diagonal of the
        Hessian that they add.
        """
        bounds, left, free = self.of.path_bounds, point.left.paths, self.of.bounds.free
        self.path_stiffness = self.of_paths.stiffness(point.slack)
        self.chosen = self.working.choose(self.path_stiffness, left)
        weights = np.zeros((len(left), 3 + len(self.chosen)))
        weights[:, 0] = bounds.barrier_slope(point.slack)
        weights[:, 1] = self.path_stiffness * left
        weights[:, 2] = self.of_paths.net
        weights[self.chosen, 3 + np.arange(len(self.chosen))] = 1.0
        found = self.expansion.of_paths(weights)
        self.path_slope, self.path_pull, self.path_force = found[:3] * free
        self.rows = self.expansion.stack(found[3:])
        # compliance 0 is of equations: an infinite barrier leaves a little
        give = np.maximum(1 / self.path_stiffness[self.chosen], 1e-300)
        self.give = np.append(np.zeros(self.of.goals), give)
        outside = self.path_stiffness.copy()
        outside[self.chosen] = 0.0
        self.others = self.expansion.stiffness(outside)

    def _gradient(self) -> Array:
        """Compute the gradient (n,) of the cost with barrier terms.

        The gradient is that with respect to u.
        """
        barriers = self.of.bounds.barrier_slope(self.point.u) + self.path_slope
        return np.asarray(self.slope + self.mu * barriers + self.path_pull)

    def error(self, mu: float) -> float:
        """Compute the optimality error at barrier parameter μ.

        It is the largest entry of the Lagrangian's gradient or of the complementarity errors, in
        units of `unit`. `mu` is μ.
        """
        duals, count = self.of_bounds, self.of.goals
        gap = self.slope + self.duals @ self.rows[:count] + self.path_force + duals.net
        scale = max(1.0, float(duals.lower.mean() + duals.upper.mean()) / self.unit / 100)
        unmet = max(duals.error(self.point.u, mu), self.of_paths.error(self.point.slack, mu))
        largest = float(np.abs(gap * self.of.bounds.free).max(initial=0.0))
        return max(largest, unmet) / self.unit / scale

    # --- the end ---

    def check_end(self) -> str:
        """Return the reason why the method ends here.

        It is "" if the method goes on.
        """
        if self.error(0.0) < self.tolerance and self.point.worst < self.tolerance:
            return "optimal"
        if self.is_still(20, 0.02):
            return "nearly settled"
        low = self.mu <= SETTLED * self.unit
        # with high barriers, a slow descent of large programs is not worth its time
        long = 36 if len(self.point.u) > 10_000 else 100
        if self.iterations >= long and not low and self.is_still(20, 0.25, WIDE):
            return "unsettled"
        if self.is_still(3, SETTLED) and (low or not self.of.program.parts.costs):
            return "settled"
        return "stuck" if self._is_stuck() else ""

    def is_still(self, most: int, share: float, near: float = 2 * NEARLY_MET) -> bool:
        """Return whether recent iterations hardly changed the cost.

        They are the last `most` ones, with violations below `near`. The relative change is at most
        `share`.
        """
        costs = [cost for cost, worst in self.history[-most:] if worst < near]
        return len(costs) == most and max(costs) - min(costs) <= share * abs(self.point.cost)

    def _is_stuck(self) -> bool:
        """Return whether goals remain violated because of path constraints."""
        unmet = [worst for _, worst in self.history[-40:]]
        if not len(self.of.path_rows) or len(unmet) < 40:
            return False
        return min(unmet) > max(WIDE, 0.8 * unmet[0])

    # --- steps ---

    def advance(self) -> bool:
        """Do one iteration; return whether it found a step.

        There is none if no step improves the iterate, or if a matrix is singular.
        """
        try:
            return self._advance()
        except np.linalg.LinAlgError:  # a matrix became infinite or singular
            return False

    def _advance(self) -> bool:
        self._lower_barrier()
        more = self.stiffened / 3 if self.stiffened > 0.1 * self.unit else 0.0
        self.stiffened = more
        # far from the goals, duals lead astray
        exact = self.iterations > 0 and self.point.worst < WIDE
        if exact:
            self.expansion.weigh(self.duals, self.of_paths.net, self.path_stiffness)
        while more <= 1e4 * self.unit:
            stiffness = self.stiffness + more
            projector = self._project(stiffness) if more else self.projector
            given = (projector, self.chosen, self.gradient, exact)
            step = QuadraticModel(self.expansion, stiffness, *given).step(
                self.point.left, self.radius
            )
            if step.negative_curvature and more < 100 * self.unit:
                more = max(4 * more, 0.05 * self.unit)
                self.stiffened = more
                continue
            reached = self._search(step, projector)
            if reached is not None:
                self._accept(step, *reached)
                return True
            more = max(8 * more, 0.1 * self.unit)
        return False

    def _lower_barrier(self) -> None:
        """Reduce the barrier parameter if this barrier problem is solved.

        It is also reduced if the iterations hardly improve.
        """
        error, sluggish = max(self.error(self.mu), 10 * self.point.worst), 8
        if (
            error < 10 * self.mu / self.unit
            or self.is_still(2, SETTLED)
            or (self.iterations >= self.lowered + sluggish and self.is_still(sluggish, 0.03))
        ):
            self.lowered = self.iterations
            self.mu = max(1e-5 * self.unit, 0.2 * self.mu)
            self.gradient = self._gradient()

    def _search(self, step: TrialStep, projector: Projector) -> tuple[Iterate, float] | None:
        """Find the first better iterate by backtracking along a step.

        `projector` is that of the step. Also returns the fraction of the step. Returns None if no
        fraction is better. The iterate is better in the sense of `_is_better`.
        """
        of, point, share = self.of, self.point, 1.0
        slope = self.slope + self.mu * of.bounds.barrier_slope(point.u)
        of_slacks = of.path_bounds.barrier_slope(point.slack) @ step.slack
        falling = float(slope @ step.d + self.mu * of_slacks)
        for _ in range(10):
            tried = self._move(point, share * step.d, share)
            for _ in range(3):  # corrections
                better = self._is_better(tried, share, falling)
                if better and self._is_close(tried):
                    break
                if not tried.total < 10 * max(point.total, 100.0):
                    break
                back = self._linearize(projector).step_back(tried)
                corrected = self._move(tried, back, 1.0)
                worse = better and not self._is_better(corrected, share, falling)
                if not corrected.total < tried.total or worse:
                    break
                tried = corrected
            if self._is_better(tried, share, falling):
                return tried, share
            share /= 2
        return None

    def _move(self, point: Iterate, d: Array, share: float) -> Iterate:
        return move(
            self.of, self.expansion, point, d, share, self._most(), 1e-2 * self.mu / self.unit
        )

    def _most(self) -> float:
        """Compute the fraction-to-the-boundary parameter of the step.

        A step covers at most this fraction of the distance to a bound.
        """
        return max(0.99, 1 - self.mu / self.unit)

    def _is_close(self, point: Iterate) -> bool:
        nearly = min(NEARLY_MET, max(1e-6, 0.1 * self.mu / self.unit))
        halved = point.total < 0.5 * self.point.total
        return point.worst < nearly or (halved and self.point.worst > 10 * nearly)

    def _is_better(self, point: Iterate, share: float, falling: float) -> bool:
        """Return whether an iterate has lower cost or violation.

        `share` is the fraction of the step that leads to it, `falling` the derivative of the cost
        with barriers along the full step.
        """
        if not np.isfinite(point.total) or point.worst > self.funnel:
            return False
        if (falling < 0 and self.point.worst < 0.1 * self.funnel) or self.point.worst < 1e-7:
            before, after = (self._with_barriers(one) for one in (self.point, point))
            return bool(after <= before + 1e-4 * share * falling + 1e-10 * abs(before))
        return point.total <= (1 - 0.1 * share) * self.point.total

    def _with_barriers(self, point: Iterate) -> float:
        barriers = self.of.bounds.barrier(point.u) + self.of.path_bounds.barrier(point.slack)
        return point.cost + self.mu * barriers

    def _accept(self, step: TrialStep, point: Iterate, share: float) -> None:
        """Move to an iterate, and update trust region and funnel.

        `point` is the iterate after the fraction `share` of `step`.
        """
        before, most = self.point, self._most()
        if share > 0.9:
            self.radius = max(self.radius, 3 * step.tangential)
        elif share < 0.3 and (step.tangential > 0.5 * step.normal or step.at_boundary):
            least = 1e-3 * float(np.sqrt(len(point.u) * self.unit))
            self.radius = max(2 * share * step.tangential, least)
        if point.worst < 0.9 * before.worst or point.worst < 0.1 * self.funnel:
            least = min(WIDE, self.mu / self.unit)
            self.funnel = min(self.funnel, max(0.5 * self.funnel, 10 * point.worst, least))
        self.of_bounds.follow(before.u, point.u, step.d, self.mu, most)
        self.of_paths.follow(before.slack, point.slack, step.slack, self.mu, most)
        self.duals = self.duals + share * (step.duals - self.duals)
        self.iterations += 1
        self.last = step, share
        self._stand(point)
        error = self.error(0.0)
        # steps that hardly change the cost may spoil duals
        if not error > self.known or self.mu > SETTLED * self.unit:
            self.known = error
            self.prices = self.duals, self.of_paths.net, self.of_bounds.net

    def describe(self) -> str:
        """Describe the last iteration in one line."""
        point, ends = self.point, ""
        if self.last is not None:
            step, share = self.last
            exits = "-" * step.negative_curvature + "|" * step.at_boundary
            ends = f"  products {step.products}{exits}  step {share:.2g}"
        return (
            f"{self.iterations:4d}  cost {point.cost * self.of.program.objective:.6g}  "
            f"violation {point.worst:.1e}  error {self.error(0.0):.1e}  "
            f"barrier {self.mu / self.unit:.0e}{ends}"
        )

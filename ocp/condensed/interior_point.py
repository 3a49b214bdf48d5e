"""An interior-point method for the reduced problem, with a trust region for its steps and a funnel for what they leave unmet."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from ocp.condensed.chain import Motion, Rows
from ocp.condensed.limits import LimitDuals, Limits
from ocp.condensed.metric import Metric, Projector
from ocp.condensed.path_rows import WorkingRows
from ocp.condensed.reduced import Expansion, Leftover, ReducedProblem
from ocp.condensed.tangential import Model, Step
from tenscasadi.util.validate import Array, Indices

TIME = "time"  # how it ended: the time was over
DAMPING = 1e-12  # of J D⁻¹ Jᵀ, relative to its mean diagonal: rows that nothing moves stay harmless
ROOM, UNEVEN = (
    0.3,
    0.1,
)  # of the first step: distance of the start from limits; of that: noise on it
PATH_ROOM = 1e-3  # in order-one rows: how far slacks begin from limits along the way
# the share of the way to such a limit that a step may take: more makes slacks vanish before motions
# follow them
SLACK_MOST = 0.6
NEAR_LIMIT = 0.99  # the share of the way to a limit that a step may take
LEAST_ROOM = 1e-2  # before limits, times μ in units of the costs' curvature
SPREAD = 100.0  # how far multipliers of limits may be from μ over the distance
FEWER = 0.2  # factor of μ from one barrier problem to the next
LEAST_BARRIER = 1e-5  # μ, in units of the costs' curvature
CENTRED = 10.0  # times μ: a smaller error ends a barrier problem
CORRECTIONS = 3  # of a trial point, towards goals and motion
WIDE = 0.1  # of order-one rows: the funnel's width while barriers are high
NEARLY_MET = 1e-3  # of order-one rows: is not corrected further
# most that is added to the metric against negative curvature, in units of the costs' curvature
STIFFENING = 100.0
GIVEN_UP = 1e4  # the same where no step is accepted
SLOW = (
    20,
    0.02,
)  # iterations and relative change of costs: they fall so slowly that it leads nowhere
LONG, UNSETTLED = (
    (100, 36),
    0.25,
)  # after so many iterations, with high barriers, so little a change in SLOW[0] of them is not worth their time
LARGE = 10_000  # unknowns, from which on the second number of iterations counts
LEAST_GIVE = 1e-300  # of rows whose barrier is infinite: 0 is for rows that are met
HOPELESS = (
    40,
    0.8,
)  # iterations, and what they leave at least of what is unmet where limits along the way leave no way
SLUGGISH = (
    8,
    0.03,
)  # iterations and relative change of costs: barriers that are in the way are lowered before their optimum
NEARLY_SETTLED, NEARLY_WITHIN = 1e-2, 5  # the same where no step is found any more
POLISHES = 12  # steps of `polish`, at most
LEAST_POLISHED = 1e-5  # distance from limits
POLISHED_NEAR = (
    0.02  # in order-one rows: distance from limits along the way, from which on they have no say
)
QUICKLY = 0.1  # what a step leaves at most where the next one may do with its expansion
SETTLED_BARRIER, SETTLED, WITHIN = (
    1e-4,
    1e-4,
    3,
)  # μ, relative change of costs, iterations: then costs are settled


class Point(NamedTuple):
    """Unknowns, motion, slacks (p,): what is limited along the way as it is to be; what is not met: its sum θ and its largest entry; and J."""

    w: Array
    motion: Motion
    slack: Array
    left: Leftover
    theta: float
    worst: float
    cost: float


@dataclass(frozen=True, eq=False)
class Found:
    """Where the method ended: a point, multipliers of goals, of limits along the way and of others, iterations.

    status: `Search.converged`, or why not.
    """

    point: Point
    multipliers: Array
    of_paths: Array
    of_limits: Array
    iterations: int
    status: str
    error: float


def point_at(of: ReducedProblem, w: Array, motion: Motion, slack: Array) -> Point:
    """Evaluate a point."""
    with np.errstate(all="ignore"):
        motion = of.chain.placed(motion, of.split(w)[1])
        left = of.leftover(w, motion, slack)
        return Point(w, motion, slack, left, *of.size_of(left), of.cost(w))


def solve(
    of: ReducedProblem,
    w: Array,
    motion: Motion,
    tolerance: float,
    most: int,
    deadline: float | None,
    verbose: bool,
) -> Found:
    """Minimise, from force densities and a motion that need not fit each other."""
    search = Search(of, w, motion, tolerance)
    status = ""
    while not status:
        if search.iterations == most:
            status = "unsettled" if search.still(SLOW[0], np.finfo(float).max) else "iterations"
        elif deadline is not None and time.perf_counter() > deadline:
            status = TIME
        elif search.converged():
            status = search.converged()
        elif search.hopeless():
            status = "stuck"
        elif not search.advance():
            status = "nearly settled" if search.still(NEARLY_WITHIN, NEARLY_SETTLED) else "stuck"
        if verbose and not status:
            sys.stdout.write(search.line() + "\n")
    return Found(search.point, *search.prices, search.iterations, status, search.error(0.0))


class Search:
    """The state of the method."""

    def __init__(self, of: ReducedProblem, w: Array, motion: Motion, tolerance: float) -> None:
        self.of, self.tolerance, self.limits = of, tolerance, Limits(of.lower, of.upper)
        self.base, self.coupling = of.curvature_scale(w)
        self.unit = float(self.base.mean())
        w = self._start(w, motion)
        low, high = self.limits.gaps(w)
        pull = np.abs(of.slope(w)) * np.minimum(np.minimum(low, high), 1.0)
        self.mu = 0.5 * max(float(pull.mean()), 0.01 * self.unit)
        self.duals = LimitDuals(self.limits, w, self.mu)
        c, duration = of.split(w)
        slack = of.paths.limits.inside(of.paths.value(c, duration, motion), PATH_ROOM, 0.2)
        self.of_paths = LimitDuals(of.paths.limits, slack, self.mu)
        self.working = WorkingRows(of.paths)
        self.radius = 1e3 * float(np.sqrt(np.maximum(w @ (self.base * w), len(w) * self.unit)))
        self.stiffened, self.iterations, self.lowered = 0.0, 0, 0
        self.history: list[tuple[float, float]] = []
        self.multipliers = np.zeros(of.goals.count + len(self.working.met))
        self.known = np.inf
        self._stand(point_at(of, w, motion, slack))
        self.prices = *self.split(), self.duals.net
        self.funnel = max(1.0, 2 * self.point.worst)
        self.last: Step | None = None

    def _start(self, w: Array, motion: Motion) -> Array:
        """Return w as far inside the limits as the first step towards the goals is long: from near limits, steps are short.

        Noise takes symmetries from it, always in the same way: what a symmetric start leads to is
        often no minimum, but a saddle.
        """
        of = self.of
        w = self.limits.inside(w, 0.05, 0.05)
        expansion, goals = of.about(w, motion), of.goals.value(motion, of.split(w)[1])
        drift = expansion.change(expansion.follow(None, of.rows_of(w, motion)))
        metric = Metric(np.where(self.limits.free, self.base, 1e300), self.coupling)
        first = Projector(expansion.jacobian, np.zeros(len(goals)), metric, DAMPING).shortest(
            goals + drift
        )
        level = ROOM * float(np.sqrt(np.mean(first**2)))
        inside = self.limits.inside(w, level, 0.2)
        inside = self.limits.inside(
            inside + UNEVEN * level * np.random.default_rng(0).uniform(size=len(w)), 0.05, 0.05
        )
        if of.free_duration:
            inside[-1] = w[-1]
        return inside

    def _projector(self, stiffness: Array) -> Projector:
        metric = Metric(np.where(self.limits.free, self.base + stiffness, 1e300), self.coupling)
        return Projector(self.rows, self.give, metric, DAMPING)

    def _stand(self, point: Point) -> None:
        """Move to a point."""
        self.point = point
        self.expansion = self.of.about(point.w, point.motion)
        self.slope = self.of.slope(point.w) * self.limits.free
        self.history.append((point.cost, point.worst))
        self.stiffness = self.duals.stiffness(point.w) * self.limits.free
        self._stand_between(point)
        self.gradient = self._gradient()
        self.projector = self._projector(self.stiffness)
        self.working.learn(self.projector.sizes[len(self.multipliers) :])
        if self.iterations:
            nearest = self.projector.multipliers(self.gradient)
            if self.iterations < 3 or np.abs(nearest).max(initial=0.0) < 3 * np.abs(
                self.multipliers
            ).max(initial=0.0):
                self.multipliers = nearest

    def _stand_between(self, point: Point) -> None:
        """Take up what limits along the way do to force densities."""
        limits, left, expansion = self.of.paths.limits, point.left.paths, self.expansion
        self.path_stiffness = self.of_paths.stiffness(point.slack)
        self.chosen = self.working.choose(self.path_stiffness, left)
        pulls = np.array(
            [limits.barrier_slope(point.slack), self.path_stiffness * left, self.of_paths.net]
        )
        every = sp.csr_array(
            (np.ones(len(self.chosen)), (self.chosen, np.arange(len(self.chosen)))),
            shape=(len(left), len(self.chosen)),
        )
        found = expansion.of_paths(np.hstack([pulls.T, every.toarray()]))
        self.path_slope, self.path_pull, self.path_force = found[:3] * self.limits.free
        self.rows = np.vstack([expansion.jacobian, found[3:]])
        give = 1 / self.path_stiffness[self.chosen[len(self.working.met) :]]
        self.give = np.append(np.zeros(len(self.multipliers)), np.maximum(give, LEAST_GIVE))

    def split(self) -> tuple[Array, Array]:
        """Return multipliers of goals, and of limits along the way."""
        goals, of_paths = self.multipliers[: self.of.goals.count], self.of_paths.net
        of_paths[self.working.met] = self.multipliers[self.of.goals.count :]
        return goals, of_paths

    def _gradient(self) -> Array:
        """Return the slope of the cost with barriers, whose slacks make up for what they lack."""
        return np.asarray(
            self.slope
            + self.mu * (self.limits.barrier_slope(self.point.w) + self.path_slope)
            + self.path_pull
        )

    def error(self, mu: float) -> float:
        """Return how far the point is from the optimum with barriers μ, in units of the costs' curvature."""
        duals = self.duals
        gap = (
            self.slope
            + self.multipliers @ self.rows[: len(self.multipliers)]
            + self.path_force
            - duals.lower
            + duals.upper
        ) * self.limits.free
        scale = max(1.0, float(duals.lower.mean() + duals.upper.mean()) / self.unit / 100)
        unmet = max(duals.error(self.point.w, mu), self.of_paths.error(self.point.slack, mu))
        return max(float(np.abs(gap).max(initial=0.0)), unmet) / self.unit / scale

    def converged(self) -> str:
        """Return "optimal", "settled" where costs no longer fall, "nearly settled" where they hardly do, "unsettled" where slowly, or ""."""
        if self.error(0.0) < self.tolerance and self.point.worst < self.tolerance:
            return "optimal"
        if self.still(*SLOW):
            return "nearly settled"
        low = self.mu <= SETTLED_BARRIER * self.unit
        if (
            self.iterations >= LONG[self.of.size > LARGE]
            and not low
            and self.still(SLOW[0], UNSETTLED, WIDE)
        ):
            return "unsettled"
        return (
            "settled"
            if self.still(WITHIN, SETTLED) and (low or not self.of.objective.given)
            else ""
        )

    def still(self, most: int, share: float, near: float = 2 * NEARLY_MET) -> bool:
        """Tell whether costs have not changed by more than a share in the last iterations, all of them near the goals."""
        recent = self.history[-most:]
        costs = [cost for cost, worst in recent if worst < near]
        return len(costs) == most and max(costs) - min(costs) <= share * abs(self.point.cost)

    def hopeless(self) -> bool:
        """Tell whether limits along the way have kept the goals far off for long."""
        unmet = [worst for _, worst in self.history[-HOPELESS[0] :]]
        return (
            bool(self.of.paths.count)
            and len(unmet) == HOPELESS[0]
            and min(unmet) > max(WIDE, HOPELESS[1] * unmet[0])
        )

    def advance(self) -> bool:
        """Take a step; False where there is none."""
        try:
            return self._advance()
        except np.linalg.LinAlgError:  # something became infinite
            return False

    def _advance(self) -> bool:
        centred = (
            max(self.error(self.mu), CENTRED * self.point.worst) < CENTRED * self.mu / self.unit
        )
        if (
            centred
            or self.still(2, SETTLED)
            or (self.iterations >= self.lowered + SLUGGISH[0] and self.still(*SLUGGISH))
        ):
            self.lowered = self.iterations
            self.mu = max(LEAST_BARRIER * self.unit, FEWER * self.mu)
            self.gradient = self._gradient()
        stiffness, more = (
            self.stiffness,
            self.stiffened / 3 if self.stiffened > 0.1 * self.unit else 0.0,
        )
        self.stiffened = more
        exact = (
            self.iterations > 0 and self.point.worst < WIDE
        )  # far from the goals, multipliers lead astray
        if exact:
            self.expansion.weigh(*self.split(), self.path_stiffness)
        while more <= GIVEN_UP * self.unit:
            projector = self._projector(stiffness + more) if more else self.projector
            model = Model(
                self.expansion, stiffness + more, projector, self.chosen, self.gradient, exact
            )
            step = model.step(self.point.left, self.radius)
            if step.bent and more < STIFFENING * self.unit:
                more = max(4 * more, 0.05 * self.unit)
                self.stiffened = more
                continue
            reached = self._tried(step, projector)
            if reached is not None:
                self._move(step, *reached)
                return True
            more = max(8 * more, 0.1 * self.unit)
        return False

    def _tried(self, step: Step, projector: Projector) -> tuple[Point, float] | None:
        """Return the first point along a step, cut at the limits and corrected, that is better, and the share of the step taken."""
        share = 1.0
        self.falling = float(
            (self.slope + self.mu * self.limits.barrier_slope(self.point.w)) @ step.d
        )
        self.falling += self.mu * float(
            self.of.paths.limits.barrier_slope(self.point.slack) @ step.slack
        )
        for _ in range(10):
            point = self._moved(self.point, share * step.d, share)
            for _ in range(CORRECTIONS):
                if (
                    self._better(point, share) and self._close(point)
                ) or not point.theta < 10 * max(self.point.theta, 100.0):
                    break
                drift = self.expansion.follow(None, point.left.rows)
                paths = (point.left.paths + self.expansion.path_change(drift, None))[self.chosen]
                back = -projector.shortest(
                    np.append(point.left.goals + self.expansion.change(drift), paths)
                )
                corrected = self._moved(point, back, 1.0)
                if not corrected.theta < point.theta or (
                    self._better(point, share) and not self._better(corrected, share)
                ):
                    break
                point = corrected
            if self._better(point, share):
                return point, share
            share /= 2
        return None

    def _moved(self, point: Point, d: Array, share: float) -> Point:
        most, room = self._most(), LEAST_ROOM * self.mu / self.unit
        return moved_point(
            self.of,
            self.expansion,
            point,
            self.limits.cut(point.w, d, most, room),
            share,
            most,
            room,
        )

    def _most(self) -> float:
        return max(NEAR_LIMIT, 1 - self.mu / self.unit)

    def _close(self, point: Point) -> bool:
        nearly = min(NEARLY_MET, max(1e-6, 0.1 * self.mu / self.unit))
        return point.worst < nearly or (
            point.theta < 0.5 * self.point.theta and self.point.worst > 10 * nearly
        )

    def _better(self, point: Point, share: float) -> bool:
        """Tell whether a point lies in the funnel and costs less, or, where goals are far from met, meets them better."""
        if not np.isfinite(point.theta) or point.worst > self.funnel:
            return False
        if (self.falling < 0 and self.point.worst < 0.1 * self.funnel) or self.point.worst < 1e-7:
            before, after = (self._with_barriers(one) for one in (self.point, point))
            return bool(after <= before + 1e-4 * share * self.falling + 1e-10 * abs(before))
        return point.theta <= (1 - 0.1 * share) * self.point.theta

    def _with_barriers(self, point: Point) -> float:
        return point.cost + self.mu * (
            self.limits.barrier(point.w) + self.of.paths.limits.barrier(point.slack)
        )

    def _move(self, step: Step, point: Point, share: float) -> None:
        before = self.point
        if share > 0.9:
            self.radius = max(self.radius, 3 * step.tangential)
        elif share < 0.3 and (step.tangential > 0.5 * step.normal or step.hit):
            self.radius = max(
                2 * share * step.tangential, 1e-3 * float(np.sqrt(len(point.w) * self.unit))
            )
        if point.worst < 0.9 * before.worst or point.worst < 0.1 * self.funnel:
            least = min(WIDE, self.mu / self.unit)
            self.funnel = min(self.funnel, max(0.5 * self.funnel, 10 * point.worst, least))
        self.duals.follow(before.w, point.w, step.d, self.mu, self._most(), SPREAD)
        self.of_paths.follow(before.slack, point.slack, step.slack, self.mu, self._most(), SPREAD)
        self.multipliers = self.multipliers + share * (step.multipliers - self.multipliers)
        self.iterations += 1
        self.last, self.share = step, share
        self._stand(point)
        error = self.error(0.0)
        if (
            not error > self.known or self.mu > SETTLED_BARRIER * self.unit
        ):  # steps that hardly change costs may spoil multipliers
            self.known, self.prices = error, (*self.split(), self.duals.net)

    def line(self) -> str:
        """Describe the last iteration."""
        point, step = self.point, self.last
        ends = (
            ""
            if step is None
            else f"  products {step.products}{'-' * step.bent}{'|' * step.hit}  step {self.share:.2g}"
        )
        return (
            f"{self.iterations:4d}  cost {point.cost * self.of.cost_scale:.6g}  unmet {point.worst:.1e}  error {self.error(0.0):.1e}  "
            f"barrier {self.mu / self.unit:.0e}{ends}"
        )


def polish(of: ReducedProblem, point: Point, tolerance: float) -> Point:
    """Return the nearest point, relative to the distances from limits, that meets goals and motion exactly."""
    limits, working = Limits(of.lower, of.upper), WorkingRows(of.paths)
    for _ in range(POLISHES):
        if not point.worst > tolerance:
            break
        expansion = of.about(point.w, point.motion)
        low, high = limits.gaps(point.w)
        room = np.clip(np.minimum(low, high), LEAST_POLISHED, 0.5)
        near = np.clip(np.minimum(*of.paths.limits.gaps(point.slack)), LEAST_POLISHED, 0.5)
        met = working.met
        chosen = np.append(
            met, working.stiffest(1 / near, (near < POLISHED_NEAR) | (point.left.paths != 0))
        )
        every = np.eye(of.paths.count)[:, chosen]
        rows = np.vstack([expansion.jacobian, expansion.of_paths(every)])
        give = np.append(
            np.zeros(len(expansion.jacobian) + len(met)), near[chosen[len(met) :]] ** 2
        )
        projector = Projector(
            rows, give, Metric(np.where(limits.free, 1 / room, 1e300), None), DAMPING
        )
        steps = (
            _towards(of, expansion, projector, chosen, point, share)
            for share in (1.0, 0.5, 0.25, 0.1)
        )
        moved = next(
            (one for one in steps if one.theta < point.theta or one.worst < point.worst), None
        )
        if moved is None:
            break
        before, point = point, moved
        while (
            point.worst > tolerance and point.theta < QUICKLY * before.theta
        ):  # the same expansion will do
            before, point = point, _towards(of, expansion, projector, chosen, point, 1.0)
        if not point.theta < before.theta:
            point = before
    return point


def _towards(
    of: ReducedProblem,
    expansion: Expansion,
    projector: Projector,
    chosen: Indices,
    point: Point,
    share: float,
) -> Point:
    """Return the point after a share of the shortest step that, by an expansion, meets goals and motion."""
    drift = expansion.follow(None, point.left.rows)
    paths = (point.left.paths + expansion.path_change(drift, None))[chosen]
    whole = -projector.shortest(np.append(point.left.goals + expansion.change(drift), paths))
    d = Limits(of.lower, of.upper).cut(point.w, share * whole, 0.999, 0.0)
    return moved_point(of, expansion, point, d, share, 0.999, 0.0)


def moved_point(
    of: ReducedProblem,
    expansion: Expansion,
    point: Point,
    d: Array,
    share: float,
    most: float,
    room: float,
) -> Point:
    """Return the point after a step d of w, which the motion follows, by the expansion, while it takes away a share of its rows.

    Slacks follow as far as limits let them (`Limits.cut`), and then are what they stand for, where
    that is farther from limits.
    """
    left = point.left
    rows = Rows(share * left.rows.impulses, share * left.rows.lengths)
    step = expansion.follow(d, rows)
    shaped = Motion(
        *(one.reshape(other.shape) for one, other in zip(step, point.motion, strict=True))
    )
    w, motion, slack, paths = point.w + d, point.motion.moved(shaped), point.slack, of.paths
    if paths.count:
        with np.errstate(all="ignore"):
            true = paths.value(*of.split(w), motion)
        slack = paths.limits.followed(
            slack,
            expansion.path_change(step, d) + share * left.paths,
            true,
            min(most, SLACK_MOST),
            room,
        )
    return point_at(of, w, motion, slack)

"""Random search for force densities, from one waypoint to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from ocp.sampling.batch_simulation import BatchSimulation, Feedback, Watcher
from ocp.sampling.spline_noise import SplineNoise
from tenscasadi.util.validate import Array

LINEAGES = 4  # parallel searches; the worse half ends half-way


@dataclass(frozen=True, eq=False)
class Lineage:
    """Best trajectory so far of one of the parallel searches.

    A leg is the part of a plan between two instants with goals.

    Attributes
    ----------
    start, end : ndarray, shape (nx,)
        States at the start and at the end of the leg.
    past, wanted : ndarray, shape (k, α)
        Force densities before the leg and in it, without the feedback law [N/m].
    knots : ndarray, shape (knots, α)
        Knot values of the spline of the leg [N/m].
    cost : float
        Cost with penalties of goals and limits.
    miss : float
        Largest residual of a goal, in units of its tolerance.
    duration : float
        Duration of the plan [s].
    """

    start: Array
    past: Array
    knots: Array
    wanted: Array
    end: Array
    cost: float
    miss: float
    duration: float

    @property
    def whole(self) -> Array:
        """Force densities from the start of the plan to the end of the leg."""
        return np.concatenate([self.past, self.wanted])


class Search:
    """Random search for the force densities of a plan.

    Parameters
    ----------
    nominal : ndarray, shape (α,)
        Center of the search [N/m].
    directions : ndarray, shape (g, α)
        Largest changes of force densities [N/m], for each of g groups of strings.
    knots : int
        Number of knots of the splines in each leg.
    samples, rounds : int
        Number of simulations in a round, and of rounds in a leg.
    law : Feedback
        Feedback that stabilizes the simulations.
    """

    def __init__(
        self,
        motions: BatchSimulation,
        nominal: Array,
        directions: Array,
        knots: int,
        samples: int,
        rounds: int,
        random: np.random.Generator,
        law: Feedback,
    ) -> None:
        self._motions, self._nominal, self._directions = motions, nominal, directions
        self._random, self._law = random, law
        # 1 if the limits leave no room
        self._room = float((directions**2).sum() / directions.shape[1]) or 1.0
        self._knots, self._samples, self._rounds = knots, max(4, samples // LINEAGES), rounds

    def run(self, over: Watcher) -> list[Lineage]:
        """Search leg by leg, from one instant with goals to the next.

        `over` reports progress and returns whether to stop. Returns the best trajectories of all
        parallel searches, the best first.
        """
        problem, none = self._motions.problem, np.zeros((0, len(self._nominal)))
        span = problem.shortest, problem.longest
        start = problem.initial_state
        found = [
            Lineage(start, none, none, none, start, 0.0, np.inf, duration)
            for duration in np.linspace(*span, 2 * LINEAGES + 1)[1::2].tolist()
        ]
        for first, last in self._motions.legs:
            found = self._leg(found, first, last, over)
        return found

    def _leg(self, lineages: list[Lineage], first: int, last: int, over: Watcher) -> list[Lineage]:
        """Search a leg that begins at the ends of given trajectories.

        The leg is from interval `first` to `last`; `lineages` are the trajectories up to it. `over`
        reports progress and returns whether to stop.
        """
        basis = SplineNoise(1.0, self._knots).basis(last - first)
        knots, wanted = (
            np.zeros((basis.shape[1], len(self._nominal))),
            np.tile(self._nominal, (last - first, 1)),
        )
        found = [
            replace(
                one,
                start=one.end,
                past=one.whole,
                knots=knots,
                wanted=wanted,
                cost=np.inf,
                miss=np.inf,
            )
            for one in lineages
        ]
        costs: list[float] = []
        for k in range(self._rounds):
            scale = 0.05 ** (k / self._rounds)
            # those of equal durations are simulated together
            found = sorted(
                (
                    better
                    for _, same in groupby(
                        sorted(found, key=lambda one: one.duration), key=lambda one: one.duration
                    )
                    for better in self._improve(list(same), first, basis, scale)
                ),
                key=lambda one: one.cost,
            )
            costs.append(found[0].cost)
            if over(
                f"sampling, round {k + 1}: residual of the goals {found[0].miss * self._motions.place:.2g} m"
            ):
                break
            if k >= 6 and costs[-1] > 0.99 * costs[k - 6]:
                break
            if k == self._rounds // 2 and last == len(self._motions.fractions):
                found = found[: len(found) // 2]
        return found

    def _improve(
        self, lineages: list[Lineage], first: int, basis: Array, scale: float
    ) -> list[Lineage]:
        """Try random changes of the leg of each trajectory.

        `lineages` are the trajectories. Returns the best change of each, or the trajectory itself
        if none is better. All have the same duration [s]. The leg begins at the interval `first`.
        `basis` maps spline knots to intervals, and `scale` multiplies the changes.
        """
        motions, duration, size = self._motions, lineages[0].duration, self._samples
        sizes = scale * SplineNoise(1.0, min_scale=0.03).sizes(size)[:, None, None]
        shape = size, basis.shape[1], len(self._directions)
        noise = [self._random.standard_normal(shape) @ self._directions for _ in lineages]
        tried = np.concatenate(
            [one.knots + sizes * own for one, own in zip(lineages, noise, strict=True)]
        )
        wanted = np.clip(self._nominal + basis @ tried, *motions.problem.force_density_limits)
        starts = np.repeat([one.start for one in lineages], size, axis=0)
        gamma, states, costs = motions.roll(starts, wanted, duration, first, law=self._law)
        # positions first: velocities count little
        missed = motions.misses(states, duration, first, 50.0)
        if first + wanted.shape[1] == len(motions.fractions):
            over = motions.excess(states, gamma, duration, last_only=True)
            missed = np.concatenate([missed, 3.0 * over], axis=1)
        # of motions that meet the goals, calm ones are better
        change = ((wanted - self._nominal) ** 2).mean(axis=(1, 2)) / self._room
        costs = np.nan_to_num(costs + (missed**2).sum(axis=1) + 3.0 * change, nan=np.inf)
        best = np.argmin(costs.reshape(-1, size), axis=1) + size * np.arange(len(lineages))
        return [
            one
            if not costs[k] < one.cost
            else replace(
                one,
                knots=tried[k],
                wanted=wanted[k],
                end=states[k, -1],
                cost=float(costs[k]),
                miss=float(np.abs(missed[k]).max(initial=0.0)),
            )
            for one, k in zip(lineages, best.tolist(), strict=True)
        ]

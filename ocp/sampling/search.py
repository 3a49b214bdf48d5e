"""Random search for force densities: smooth noise about the best so far, from one waypoint to the next."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ocp.sampling.motions import Motions, Watcher
from ocp.sampling.spline_noise import SplineNoise
from tenscasadi.util.validate import Array

SPEED = 50.0  # times their tolerance by which speeds may be off while places are looked for
# tolerances squared that changes as large as the spread cost: of motions that meet the goals the
# calmer are better
CALM = 3.0
LIMITS = 3.0  # tolerances of a goal that a limit of the end overstepped by its scale counts
LINEAGES = 4  # searches side by side, of which the worse half ends half-way
DECAY = 0.05  # of the spread, in the last round
FINEST = 0.03  # of the spread: the smallest changes
STILL, ROUNDS_STILL = 0.99, 6  # of the cost so many rounds before: what falls less has ended


@dataclass(frozen=True, eq=False)
class Lineage:
    """One line of a search: where its leg starts (nx,), γ that is wanted before it (k, α) and in it, where it ends, its cost, and its duration, s."""

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
        """γ that is wanted from the start on."""
        return np.concatenate([self.past, self.wanted])


class Search:
    """Random search on motions.

    nominal (α,): the force densities about which is searched. directions (g, α): the largest
    changes. knots: of splines, in each leg.
    """

    def __init__(
        self,
        motions: Motions,
        nominal: Array,
        directions: Array,
        knots: int,
        samples: int,
        rounds: int,
        random: np.random.Generator,
    ) -> None:
        self._motions, self._nominal, self._directions, self._random = (
            motions,
            nominal,
            directions,
            random,
        )
        self._room = (
            float((directions**2).sum() / directions.shape[1]) or 1.0
        )  # no room: limits leave one force density
        self._knots, self._samples, self._rounds = knots, max(4, samples // LINEAGES), rounds

    def run(self, over: Watcher) -> list[Lineage]:
        """Return the best lineages at the end of the plan, the best first."""
        problem, none = self._motions.problem, np.zeros((0, len(self._nominal)))
        span = problem.shortest, problem.longest
        start = problem.first_state
        found = [
            Lineage(start, none, none, none, start, 0.0, np.inf, duration)
            for duration in np.linspace(*span, 2 * LINEAGES + 1)[1::2].tolist()
        ]
        for first, last in self._motions.legs:
            found = self._leg(found, first, last, over)
        return found

    def _leg(self, lineages: list[Lineage], first: int, last: int, over: Watcher) -> list[Lineage]:
        """Return the lineages at the end of a leg that begins where these end."""
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
            scale = DECAY ** (k / self._rounds)
            found = sorted(
                (self._improved(one, first, basis, scale) for one in found),
                key=lambda one: one.cost,
            )
            costs.append(found[0].cost)
            if over(
                f"sampling, round {k + 1}: misses its goals by {found[0].miss * self._motions.place:.2g} m"
            ):
                break
            if k >= ROUNDS_STILL and costs[-1] > STILL * costs[-1 - ROUNDS_STILL]:
                break
            if k == self._rounds // 2 and last == len(self._motions.fractions):
                found = found[: len(found) // 2]
        return found

    def _improved(self, one: Lineage, first: int, basis: Array, scale: float) -> Lineage:
        """Return a lineage with the best of samples about it: itself, and changes of all sizes."""
        sizes = scale * SplineNoise(1.0, finest=FINEST).sizes(self._samples)
        noise = self._random.standard_normal((self._samples, basis.shape[1], len(self._directions)))
        tried = one.knots + sizes[:, None, None] * (noise @ self._directions)
        wanted = np.clip(self._nominal + basis @ tried, *self._motions.problem.force_density_limits)
        gamma, states, costs = self._motions.roll(
            np.tile(one.start, (len(tried), 1)), wanted, one.duration, first
        )
        missed = self._motions.misses(states, one.duration, first, SPEED)
        if first + wanted.shape[1] == len(self._motions.fractions):
            missed = np.concatenate(
                [
                    missed,
                    LIMITS * self._motions.excess(states, gamma, one.duration, last_only=True),
                ],
                axis=1,
            )
        change = ((wanted - self._nominal) ** 2).mean(axis=(1, 2)) / self._room
        costs = np.nan_to_num(costs + (missed**2).sum(axis=1) + CALM * change, nan=np.inf)
        k = int(np.argmin(costs))
        if not costs[k] < one.cost:
            return one
        worst = float(np.abs(missed[k]).max(initial=0.0))
        return replace(
            one,
            knots=tried[k],
            wanted=wanted[k],
            end=states[k, -1],
            cost=float(costs[k]),
            miss=worst,
        )

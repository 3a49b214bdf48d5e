"""The method of `Sampling`: search, Gauss-Newton, and what came of it."""

from __future__ import annotations

import sys

import numpy as np

from ocp.problem.control import refuse_wound
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.defaults import Usual, alike, usual
from ocp.sampling.descent import Descent, Point
from ocp.sampling.elastic_law import elastic_law
from ocp.sampling.motions import Motions
from ocp.sampling.search import Search
from ocp.sampling.solver import Sampling
from ocp.sampling.spline_noise import SplineNoise
from ocp.solvers.base import Outcome
from ocp.solvers.monitor import STOPPED, TIME_UP, Monitor, Progress
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Guess, held_values
from tenscasadi.integrators.stability import contact_rate, contact_step
from tenscasadi.util.validate import Array

COARSE = 0.5  # radians of the fastest swing in a step of the search
MOST_STEPS = 2000  # of an interval
FAST = 10.0  # times their tolerance that speeds may be off by at first in Gauss-Newton
FINER = 2  # times the steps that contact needs: whether the motion is theirs
FAR = 10.0  # tolerances, beyond which a search has not found the way
HOPELESS, NEARLY = (
    30.0,
    2.0,
)  # tolerances, beyond which the steps that contact needs, and finer ones, are not tried
_STOPS = {
    TIME_UP: "stopped at the time limit, with the best so far: increase time_limit",
    STOPPED: "stopped from the keyboard, with the best so far",
}
CERTAIN = 0.5  # of the tolerance: plans that miss by more are tried again
POLISHED = 2  # lineages of a search that are


def default_intervals(problem: Problem) -> int:
    """Return how many intervals a plan by sampling gets where no transcription says so."""
    return usual(problem).intervals(problem)


def check_sampling(problem: Problem, transcription: Transcription, solver: Sampling) -> None:
    """Raise ValueError, saying the cure, for what no sampled motion does."""
    refuse_wound(problem.model, "Sampling")
    if problem.free_start:
        raise ValueError(
            "Problem.start is free, and sampled motions begin somewhere: give Problem(start=...), or another solver than Sampling"
        )
    if transcription.control.linear:
        name = type(transcription).__name__
        raise ValueError(
            f"{name}.control is PiecewiseLinear, and Sampling holds force densities in intervals: give PiecewiseConstant()"
        )
    for string in (string for group in solver.groups or () for string in group):
        if string >= problem.model.nu:
            raise ValueError(
                f"Sampling.groups names string {string}: strings run from 0 to {problem.model.nu - 1}"
            )


def solve_sampled(
    problem: Problem,
    transcription: Transcription,
    guess: Guess | None,
    solver: Sampling,
    monitor: Monitor,
    tolerance: float,
) -> Outcome:
    """Return what sampling finds; the best so far if the monitor stops it.

    transcription: its intervals, and which strings share a force density. guess: where Gauss-Newton
    begins; a search follows where that fails. tolerance: m, what goals may be missed by, and in m
    per duration speeds.
    """
    check_sampling(problem, transcription, solver)
    return _Method(problem, transcription, solver, monitor, tolerance).run(guess)


class _Method:
    """One run."""

    def __init__(
        self,
        problem: Problem,
        transcription: Transcription,
        solver: Sampling,
        monitor: Monitor,
        tolerance: float,
    ) -> None:
        self._problem, self._solver, self._monitor = problem, solver, monitor
        self._usual, scales = usual(problem), Scales.of(problem)
        self._shared = transcription.control.groups
        interval = problem.longest * float(transcription.fractions.max())
        rate = max(contact_rate(problem.model), _swing(self._usual, problem))
        steps = int(np.clip(np.ceil(interval * rate / COARSE), 1, MOST_STEPS))
        self._finer = max(
            1, int(np.ceil(min(interval / steps / contact_step(problem.model), 20.0)))
        )
        self._motions = Motions(
            problem,
            scales,
            transcription.fractions,
            transcription.control,
            steps,
            self._usual.strength,
            tolerance,
            solver.threads,
        )
        self._law = elastic_law(problem, self._usual.strength, self._usual.mass, interval)
        self._best: Point | None = None
        self._miss = np.inf  # of the best, in tolerances
        self._stopped = ""
        self._iterations = 0

    def run(self, guess: Guess | None) -> Outcome:
        """Search, and go on from the best, until the goals are met."""
        try:
            if guess is not None:
                self._polish(
                    held_values(guess.force_density, len(self._motions.fractions)),
                    guess.duration,
                    self._levels()[-1],
                )
            if not self._stopped and self._miss > 1.0:
                self._motions.law = self._law
                self._try_all()
        except KeyboardInterrupt:
            self._stopped = "stopped from the keyboard, with the best so far"
        return self._outcome()

    def _try_all(self) -> None:
        """Search for groups of strings, then for each string, with other samples each time."""
        motions, solver, levels = self._motions, self._solver, self._levels()
        knots = (
            self._usual.knots(self._problem.longest / len(motions.legs))
            if solver.knots is None
            else solver.knots
        )
        for attempt in range(solver.attempts):
            random = np.random.default_rng([solver.seed, attempt])
            for directions in list(levels):
                search = Search(
                    motions,
                    self._usual.force_density,
                    directions,
                    knots,
                    solver.samples,
                    solver.rounds,
                    random,
                )
                found = search.run(self._over)
                if found[0].miss > FAR and len(levels) > 1 and not self._stopped:
                    levels.pop(0)  # these groups do not lead there
                    continue
                for one in found[:POLISHED]:
                    self._polish(one.whole, one.duration, directions)
                    if self._stopped or self._miss <= CERTAIN:
                        return

    def _polish(self, wanted: Array, duration: float, directions: Array) -> None:
        """Remove the last misses: in coarse steps with fast ends, in the steps that contact needs, and in finer ones."""
        misses = []
        for finer, speed in ((1, FAST), (self._finer, 1.0), (FINER * self._finer, 1.0)):
            descent = Descent(self._motions, directions, finer)
            point, iterations = descent.run(
                wanted, duration, speed, self._solver.iterations, self._over
            )
            self._iterations += iterations
            wanted, duration = point.wanted, point.duration
            misses.append(point.worst)
            if not point.worst < (HOPELESS if len(misses) == 1 else NEARLY):
                break
        # Where errors of steps grow along the motion, steps of another length end elsewhere.
        miss = max(point.worst, descent.again(point, self._finer) if len(misses) == 3 else np.inf)
        if self._best is None or (miss, point.worst) < (self._miss, self._best.worst):
            self._best, self._miss = point, miss

    def _levels(self) -> list[Array]:
        """Return the directions (g, α) in which γ is changed: those of groups, and those of each string."""
        count, spread = self._problem.model.nu, self._usual.spread
        alone = (
            tuple(
                (string,)
                for string in range(count)
                if not any(string in group for group in self._shared)
            )
            + self._shared
        )
        given = self._solver.groups
        levels = (
            [given]
            if given is not None
            else [alike(self._problem), alone]
            if not self._shared
            else [alone]
        )
        return [SplineNoise(spread, groups=groups).directions(count) for groups in levels]

    def _over(self, line: str) -> bool:
        """Tell how it goes, and whether to stop."""
        if self._solver.verbose:
            sys.stdout.write(line + "\n")
        if self._solver.watch is not None and self._solver.watch(line) is False:
            self._stopped = "stopped on request, by Sampling(watch=...), with the best so far"
        status = self._monitor.follow(Progress(self._iterations, np.nan, self._miss))
        self._stopped = self._stopped or _STOPS.get(status, "")
        return bool(self._stopped)

    def _outcome(self) -> Outcome:
        motions, best, solver = self._motions, self._best, self._solver
        if best is None or not np.isfinite(best.merit):
            best = motions_at_rest(motions, self._usual)
        success = self._miss <= 1.0
        lanes = (
            f"{motions.kernel.lanes} at once"
            if motions.kernel.lanes
            else f"one by one, {motions.kernel.note}"
        )
        why = ""
        if not success:
            cure = (
                "give a longer duration, wider limits, more samples, other groups or another seed"
            )
            unsteady = (
                best.worst <= 1.0
                and "the motion is so unstable that steps of another length end elsewhere"
            )
            why = f"no plan: {self._stopped or cure}; {unsteady or motions.worst(best.states, best.force_density, best.duration)}"
        return Outcome(
            states=best.states,
            force_density=best.force_density,
            duration=best.duration,
            objective=motions.objective(best.states, best.force_density, best.duration),
            success=success,
            status=f"sampled {motions.count} motions, {lanes}",
            iterations=self._iterations,
            why=why,
            imposed=f"seed {solver.seed}",
        )


def motions_at_rest(motions: Motions, given: Usual) -> Point:
    """Return what comes of force densities to begin with, where nothing better is known."""
    problem = motions.problem
    wanted = np.tile(given.force_density, (len(motions.fractions), 1))
    gamma, states, _ = motions.roll(problem.first_state[None], wanted[None], problem.longest)
    return Point(wanted, problem.longest, gamma[0], states[0], np.full(1, np.inf))


def _swing(given: Usual, problem: Problem) -> float:
    """Return how fast strings let nodes swing, rad/s, under the largest force densities that are tried."""
    structure = problem.model.scene.structure
    ends = max(1.0, 2 * len(structure.strings) / len(structure.nodes))
    return float(np.sqrt(ends * (given.strength + 2 * given.spread.mean()) / given.mass))

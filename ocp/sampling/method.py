"""Solution by `Sampling`: random search, then Gauss-Newton."""

from __future__ import annotations

import sys

import numpy as np

from ocp.problem.control import require_force_densities
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.batch_simulation import BatchSimulation, Feedback
from ocp.sampling.defaults import (
    SamplingDefaults,
    choose_defaults,
    count_strings_per_node,
    find_symmetry_groups,
)
from ocp.sampling.descent import Candidate, Descent
from ocp.sampling.elastic_law import elastic_law
from ocp.sampling.search import Search
from ocp.sampling.solver import Sampling
from ocp.sampling.spline_noise import SplineNoise
from ocp.solvers.base import Outcome
from ocp.solvers.early_stop import stop_early
from ocp.solvers.monitor import STOPPED, TIME_UP, Monitor, Progress
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import Guess, held_values, list_groups
from tenscasadi.integrators.stability import contact_rate, contact_step
from tenscasadi.util.validate import Array, check_indices

_STOPS = {
    TIME_UP: "stopped at the time limit, with the best so far: increase time_limit",
    STOPPED: "stopped from the keyboard, with the best so far",
}


def default_intervals(problem: Problem) -> int:
    """Choose the number of intervals of a sampled plan."""
    return choose_defaults(problem).intervals(problem)


def check_sampling(problem: Problem, transcription: Transcription, solver: Sampling) -> None:
    """Raise ValueError if `Sampling` cannot solve a problem.

    The problem, or the control profile, is then unsupported.
    """
    require_force_densities(problem.model, "Sampling")
    if problem.free_start:
        raise ValueError(
            "Problem.start is free, which Sampling does not support: give Problem(start=...), or another solver"
        )
    if transcription.control.linear:
        name = type(transcription).__name__
        raise ValueError(
            f"{name}.control is PiecewiseLinear, and Sampling needs piecewise-constant force densities: give PiecewiseConstant()"
        )
    for k, group in enumerate(solver.groups or ()):
        check_indices(f"Sampling.groups[{k}]", group, problem.model.nu, "string")


def solve_sampled(
    problem: Problem,
    transcription: Transcription,
    target: Target,
    guess: Guess | None,
    solver: Sampling,
    monitor: Monitor,
    tolerance: float,
) -> Outcome:
    """Solve a problem by random sampling.

    Parameters
    ----------
    transcription : Transcription
        Its intervals and groups of strings are used.
    target : Target
        Target of the goals.
    guess : Guess or None
        Start of Gauss-Newton. A search follows if that fails.
    tolerance : float
        Tolerance of goals [m], and of velocities [m per duration].
    """
    check_sampling(problem, transcription, solver)

    def build() -> _Method | None:
        return _Method(problem, transcription, target, solver, monitor, tolerance)

    def stop() -> Outcome:
        best = None if method is None else method.best
        if method is None or best is None or not np.isfinite(best.merit):
            return stop_early(problem, transcription, monitor.status())
        return method.stop()

    method = monitor.run(build, lambda: None)
    return stop() if method is None else monitor.run(lambda: method.run(guess), stop)


class _Method:
    """One run of the sampling method on a problem.

    The fields of `solver` are its options. The other arguments are those of `solve_sampled`.
    """

    def __init__(
        self,
        problem: Problem,
        transcription: Transcription,
        target: Target,
        solver: Sampling,
        monitor: Monitor,
        tolerance: float,
    ) -> None:
        self._end = problem.initial_state if target.state is None else target.state
        self._problem, self._solver, self._monitor = problem, solver, monitor
        self._defaults, scales = choose_defaults(problem), Scales.of(problem)
        self._profile = transcription.control
        interval = problem.longest * float(transcription.fractions.max())
        rate = max(contact_rate(problem.model), _swing(self._defaults, problem))
        # steps of half a radian of the fastest vibration
        steps = int(np.clip(np.ceil(interval * rate / 0.5), 1, 2000))
        self._finer = max(
            1, int(np.ceil(min(interval / steps / contact_step(problem.model), 20.0)))
        )
        self._motions = BatchSimulation(
            problem,
            scales,
            transcription.fractions,
            transcription.control,
            steps,
            self._defaults.strength,
            tolerance,
            solver.threads,
        )
        law = elastic_law(problem, self._defaults.strength, self._defaults.mass, interval)
        self._law: Feedback = lambda _, states: self._motions.evaluate("law", law, states)
        self.best: Candidate | None = None
        self._miss = np.inf  # residual of the best, in units of the tolerance
        self._stopped = ""
        self._iterations = 0

    def run(self, guess: Guess | None) -> Outcome:
        """Improve the guess, then search until the goals are met.

        Without a guess (None), the search follows at once.
        """
        try:
            if guess is not None:
                self._polish(
                    held_values(guess.force_density, len(self._motions.fractions)),
                    guess.duration,
                    self._levels()[-1],
                )
            if not self._stopped and self._miss > 1.0:
                self._try_all()
        except KeyboardInterrupt:
            self._stopped = _STOPS[STOPPED]
        return self._outcome()

    def _try_all(self) -> None:
        """Search for controls of groups of strings, then of each string."""
        motions, solver, levels = self._motions, self._solver, self._levels()
        knots = (
            self._defaults.knots(self._problem.longest / len(motions.legs))
            if solver.knots is None
            else solver.knots
        )
        for attempt in range(solver.attempts):
            random = np.random.default_rng([solver.seed, attempt])
            for directions in list(levels):
                search = Search(
                    motions,
                    self._defaults.force_density,
                    directions,
                    knots,
                    solver.samples,
                    solver.rounds,
                    random,
                    self._law,
                )
                found = search.run(self._over)
                if found[0].miss > 10.0 and len(levels) > 1 and not self._stopped:
                    levels.pop(0)  # these groups do not lead there
                    continue
                for one in found[:2]:
                    self._polish(one.whole, one.duration, directions, self._law)
                    if self._stopped or self._miss <= 0.5:
                        return

    def _polish(
        self, wanted: Array, duration: float, directions: Array, law: Feedback | None = None
    ) -> None:
        """Improve force densities by Gauss-Newton, and check them with finer steps.

        They are `wanted` (K, α) for a duration [s], to which the feedback `law` adds, and change
        along `directions` (g, α) [N/m].
        """
        for finer in (self._finer, 2 * self._finer):
            descent = Descent(self._motions, directions, finer)
            point = descent.simulate(wanted[None], duration, law)[0]
            self._keep(point, np.inf)
            point, iterations = descent.run(point, self._solver.iterations, self._over)
            self._iterations += iterations
            self._keep(point, np.inf)
            wanted, duration, law = point.force_density, point.duration, None
            if not point.worst < 2.0:
                break
        else:
            # Along unstable motions, steps of another length end elsewhere.
            self._keep(point, max(point.worst, descent.measure_finer(point, self._finer)))

    def _keep(self, point: Candidate, miss: float) -> None:
        """Keep a candidate if it is the best so far.

        `miss` is its largest residual, in units of the tolerance.
        """
        if self.best is None or (miss, point.worst) < (self._miss, self.best.worst):
            self.best, self._miss = point, miss

    def _levels(self) -> list[Array]:
        """Build directions (g, α) of changes of force densities.

        The first change groups of strings together, the last each string separately.
        """
        count, spread = self._problem.model.nu, self._defaults.spread
        alone = tuple(tuple(group.tolist()) for group in list_groups(self._profile, count))
        given = self._solver.groups
        levels = (
            [given]
            if given is not None
            else [find_symmetry_groups(self._problem, self._end, self._motions.place), alone]
            if not self._profile.groups
            else [alone]
        )
        return [SplineNoise(spread, groups=groups).directions(count) for groups in levels]

    def _over(self, line: str) -> bool:
        """Report progress, and return whether to stop.

        `line` describes the progress.
        """
        if self._solver.verbose:
            sys.stdout.write(line + "\n")
        watch = self._solver.callback
        if watch is not None and self._monitor.ask(lambda: watch(line)) is False:
            self._stopped = "stopped on request, by Sampling(callback=...), with the best so far"
        status = self._monitor.follow(Progress(self._iterations, np.nan, self._miss))
        self._stopped = self._stopped or _STOPS.get(status, "")
        return bool(self._stopped)

    def stop(self) -> Outcome:
        """Build the result of a run that was stopped, its best candidate."""
        self._stopped = _STOPS.get(self._monitor.status(), "")
        return self._outcome()

    def _outcome(self) -> Outcome:
        motions, best, solver = self._motions, self.best, self._solver
        if best is None or not np.isfinite(best.merit):
            best = simulate_defaults(motions, self._defaults)
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
            why = f"{self._stopped or cure}; {unsteady or motions.describe_worst(best.states, best.force_density, best.duration)}"
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


def simulate_defaults(motions: BatchSimulation, given: SamplingDefaults) -> Candidate:
    """Simulate the default initial force densities.

    They are those of `given`, constant over the longest duration.
    """
    problem = motions.problem
    wanted = np.tile(given.force_density, (len(motions.fractions), 1))
    gamma, states, _ = motions.roll(problem.initial_state[None], wanted[None], problem.longest)
    return Candidate(problem.longest, gamma[0], states[0], np.full(1, np.inf))


def _swing(given: SamplingDefaults, problem: Problem) -> float:
    """Estimate the fastest angular frequency of nodes [rad/s].

    `given` has the force densities and the effective mass.
    """
    ends = count_strings_per_node(problem)
    return float(np.sqrt(ends * (given.strength + 2 * given.spread.mean()) / given.mass))

"""Which transcription, intervals and solver suit a problem: the first choice, and what follows where it fails."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.condensed.method import applies, limited_on_the_way
from ocp.problem.control import winds
from ocp.problem.costs import Duration, Effort
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.sampling.method import default_intervals
from ocp.sampling.solver import Sampling
from ocp.solvers.base import Solver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess, InitialGuess, InverseDynamics, evaluate_guess
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.variational import Variational
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.stability import fastest_rate

FEWEST, MOST = 30, 400  # intervals to begin with
FOR_A_RADIAN = 3.0  # intervals for each radian of the fastest vibration
# intervals times √bars: forces add up along rows of bars, so γ grows beyond the guess as bars do,
# vibrations as its root
FOR_BARS = 6.0
EXACT = 0.3  # of the tolerance: how near motions come to those of fine steps,
# and of the structure's size, at most: plans that end further from their goals than thrice this
# count as missing them
MISSED = 1e-4
NOISES = (
    2.0,
    1.0,
)  # of guesses from which the condensed method tries again, of their force densities
NEAR = (
    0.02  # of the structure's size: nodes that come nearer to a ground along the guess may touch it
)
CONDENSED_BARS, LIMITED_BARS = (
    5,
    9,
)  # from here on the condensed method is the faster one: without and with limits along the way

Method = Solver | CondensedNewton | Sampling


class Choice(NamedTuple):
    """A transcription and a solver.

    finer: whether it is for plans that were found, whose replay misses; guess: on its intervals, if
    known; noise: of that guess, 0 for the usual; again: whether it is for where IPOPT has stopped
    at a saddle.
    """

    transcription: Transcription
    solver: Method
    finer: bool = False
    guess: Guess | None = None
    noise: float = 0.0
    again: bool = False

    def describe(self) -> str:
        """Return such as "Variational of 30 intervals by Ipopt"."""
        from_noise = (
            f" from a guess with noise {self.noise:g}"
            if self.noise
            else " from noise"
            if self.again
            else ""
        )
        return f"{type(self.transcription).__name__} of {self.transcription.count} intervals by {type(self.solver).__name__}{from_noise}"


def choose(
    problem: Problem, target: Target, guess: InitialGuess | None, tolerance: float
) -> Iterator[Choice]:
    """Yield what suits a problem without phases best, then what may do where that has failed.

    tolerance: how far replays may end from the goals, m.
    """
    model, ipopt = problem.model, Ipopt()
    first = evaluate_guess(guess, problem, target, FEWEST)
    sampled = model.scene.grounds and not problem.free_start and not winds(model)
    near = sampled and nears_ground(problem, first)
    if near:
        yield Choice(matching(Sampling(), problem), Sampling())
    count = choose_intervals(problem, first.disturbed(problem))
    known = first if count == FEWEST else None
    bars = model.mechanism.bars
    accuracy = min(EXACT * tolerance, MISSED * Scales.of(problem).length)
    corrected, finer = (
        Variational(count, accuracy=accuracy),
        Variational(2 * count, accuracy=accuracy),
    )
    condensed = not applies(problem)
    first_condensed = bars >= (LIMITED_BARS if limited_on_the_way(problem) else CONDENSED_BARS)
    if condensed and first_condensed:
        yield Choice(corrected, CondensedNewton(), guess=known)
        yield Choice(finer, CondensedNewton())
        yield from _noisy(problem, target, guess, corrected)
    follows = condensed and not first_condensed
    # leaves saddles in half the iterations that IPOPT takes; with other costs it has led to worse
    # optima
    leaves = follows and all(isinstance(cost, (Effort, Duration)) for cost in problem.costs)
    if not corrected.refusal(model):
        yield Choice(corrected, replace(ipopt, restart=not leaves), guess=known)
        yield Choice(finer, ipopt, finer=True)
    if follows:
        yield Choice(corrected, CondensedNewton(), guess=known)
        even = evaluate_guess(guess, problem, target, count) if known is None else known
        yield Choice(corrected, ipopt, guess=even.disturbed(problem), again=True)
        yield from _noisy(problem, target, guess, corrected)
    yield Choice(MultipleShooting(count), ipopt, guess=known)
    yield Choice(MultipleShooting(count, scheme=DormandPrince853(), substeps=2), ipopt, finer=True)
    if sampled and not near:
        yield Choice(matching(Sampling(), problem), Sampling())


def _noisy(
    problem: Problem, target: Target, guess: InitialGuess | None, transcription: Transcription
) -> Iterator[Choice]:
    """Yield starts far from the usual guess, along which solvers may come to rest without a force, and far from goals."""
    if guess is None:
        for noise in NOISES:
            own = evaluate_guess(
                InverseDynamics(noise=noise, seed=1), problem, target, transcription.count
            )
            yield Choice(transcription, CondensedNewton(), guess=own, noise=noise)


def matching(solver: Method | None, problem: Problem) -> Transcription:
    """Return the transcription that goes with a solver where none is given."""
    if isinstance(solver, Sampling):
        return MultipleShooting(default_intervals(problem))
    return Variational() if isinstance(solver, CondensedNewton) else MultipleShooting()


def nears_ground(problem: Problem, guess: Guess) -> bool:
    """Tell whether nodes that move touch a ground along the guess, or nearly; also where no pinned node keeps the structure from falling."""
    model, structure = problem.model, problem.model.scene.structure
    held = np.flatnonzero(structure.fixed.all(axis=1))
    if not len(held):
        return True
    margin = NEAR * Scales.of(problem).length
    for ground in model.scene.grounds:
        moving = np.setdiff1d(
            np.arange(len(model.structure.nodes))
            if ground.nodes is None
            else np.array(list(ground.nodes)),
            held,
        )
        if len(moving) and any(
            float(ca.mmax(ground.depth(model.nodes(x)[moving].T))) > -margin for x in guess.states
        ):
            return True
    return False


def choose_intervals(problem: Problem, guess: Guess) -> int:
    """Return how many intervals follow the fastest vibration: under the guess, and of many bars."""
    middle = len(guess.force_density) // 2
    rate = fastest_rate(problem.model, guess.states[middle], guess.force_density[middle])
    each = (
        1.0 if winds(problem.model) else FOR_A_RADIAN
    )  # elastic strings hardly vibrate along their plans, and corrections do the rest
    wanted = np.ceil(each * rate * guess.duration) if np.isfinite(rate) else FEWEST
    return int(
        np.clip(
            max(wanted, np.ceil(FOR_BARS * np.sqrt(problem.model.mechanism.bars))), FEWEST, MOST
        )
    )

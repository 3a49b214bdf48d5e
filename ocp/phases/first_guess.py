"""Initial guess of the nonlinear program of all phases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ocp.guess.initial_guess import NOISE
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.results.result import PlanResult
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, held_values
from tenscasadi.util.validate import Array, format_value

TYPICAL_FORCE_DENSITY = 3.0  # force density of the guess, in units of weight / size


def guess_phases(
    parts: Sequence[Problem], targets: Sequence[Target], count: int, scales: Scales, weight: float
) -> list[Guess]:
    """Build the initial guess of each phase.

    States move smoothly from one phase's final state to the next, with zero velocity at both. In
    phases without goals they are constant. Force densities are random about a typical value, so
    that they differ between strings, and within their limits. `count` is the number of intervals of
    a phase, and `weight` the weight of the structure [N]. `parts` are the problems of the phases,
    `targets` their final states.
    """
    typical = TYPICAL_FORCE_DENSITY * weight / scales.length or scales.mass / scales.time**2
    drawn, nq, at = np.random.default_rng(0), parts[0].model.nq, targets[0].start
    found = []
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    for part, target in zip(parts, targets, strict=True):
        end = at if target.state is None else target.state
        states = at + share**2 * (3 - 2 * share) * (end - at)
        states[:, nq : 2 * nq] = 0.0
        lower, upper = part.force_density_limits
        pull = np.clip(typical, 1.5 * lower, np.maximum(0.5 * upper, lower))
        gamma = np.clip(
            pull * (1 + NOISE * drawn.uniform(-1.0, 1.0, (count, len(pull)))), lower, upper
        )
        found.append(Guess(states, gamma, (part.shortest + part.longest) / 2))
        at = states[-1]
    return found


def split_plan(plan: PlanResult, parts: Sequence[Problem], count: int) -> list[Guess]:
    """Split a plan into the initial guesses of its phases.

    Raises ValueError for a plan of another structure or number of phases. `parts` are the problems
    of the phases, and `count` the number of intervals of each guess.
    """
    phases = len(parts)
    nx, nu = parts[0].model.nx, parts[0].model.nu
    before, remainder = divmod(len(plan.time) - 1, phases)
    asked = 0 if plan.problem is None else len(plan.problem.phases)
    if (
        asked != phases
        or remainder
        or (plan.trajectory.states.shape[1], plan.force_density.shape[1]) != (nx, nu)
    ):
        raise ValueError(
            f"guess is {format_value(plan)}: give a plan of the same structure with {phases} phases, or None"
        )
    gamma = held_values(plan.force_density, len(plan.time) - 1)
    own, wanted = np.linspace(0.0, 1.0, before + 1), np.linspace(0.0, 1.0, count + 1)
    middle = np.minimum(((wanted[1:] + wanted[:-1]) / 2 * before).astype(int), before - 1)
    found = []
    for k, part in enumerate(parts):
        instants = slice(k * before, (k + 1) * before + 1)
        states: Array = np.column_stack(
            [np.interp(wanted, own, column) for column in plan.trajectory.states[instants].T]
        )
        duration = float(plan.time[instants][-1] - plan.time[instants][0])
        found.append(
            Guess(
                states,
                gamma[k * before + middle],
                float(np.clip(duration, part.shortest, part.longest)),
            )
        )
    return found

"""From a problem to what the condensed Newton method finds for it: what it takes, where it starts, and what it says."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from ocp.condensed.correction import Corrected, correct
from ocp.condensed.interior_point import TIME, Found, Point, polish, solve
from ocp.condensed.motions import first_motion, states_of
from ocp.condensed.objective import foreign_costs
from ocp.condensed.path_rows import Limited, PathRows
from ocp.condensed.reduced import ReducedProblem
from ocp.problem.bounds.string_bounds import ForceDensityLimits
from ocp.problem.control import winds
from ocp.problem.costs import Smoothness
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, typical_cost
from ocp.results.explanation import StateAt, goals_met, measure_misses, state_function, units_of
from ocp.solvers.base import Outcome
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.deferred_correction import TOO_COARSE
from ocp.solvers.multipliers import Duals
from ocp.targets.control_sensitivities import REACHED
from ocp.targets.target import Target
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess
from ocp.transcription.mesh import node_values
from ocp.transcription.variables import control_names
from ocp.transcription.variational import Variational
from tenscasadi.util.linear_algebra import independent_rows
from tenscasadi.util.validate import Array

MET = 1e-9  # in order-one rows: the motion and the goals that are imposed are met
POLISHED = 1e-11  # what is aimed at
SPARED = 0.3  # of the time that is left: for corrections
NOT_SETTLED = "unsettled"
SOLVED = ("optimal", "settled", "nearly settled", NOT_SETTLED)
NOT_QUITE = {
    "nearly settled": "; the cost is nearly settled, a little less may be possible",
    "unsettled": "; the cost is not settled: it still fell, but slowly, and less is possible",
}
_PASSES = "give a goal that the motion passes"
WHY = {
    "iterations": "stopped at the iteration limit: raise max_iterations of the solver",
    TIME: "stopped at the time limit, with the best so far: raise seconds",
    "stuck": "the solver could not go on: give a longer duration, wider limits, or a nearer goal, or more intervals",
}


def applies(problem: Problem) -> str:
    """Return why the method does not take a problem, in words; "" where it does."""
    model, scene = problem.model, problem.model.scene
    if problem.phases:
        return "it has phases"
    if winds(model):
        return "rest lengths are decided"
    if scene.ground is not None:
        return "its scene has a ground"
    if scene.pressure is not None:
        return "its scene has a pressure"
    if model.mechanism.joints:
        return "its model has full coordinates"
    if model.redundancy:
        return "some of its bars depend on each other"
    if problem.free_start:
        return "its start is free"
    if problem.costs and all(isinstance(cost, Smoothness) for cost in problem.costs):
        return "its cost, Smoothness alone, leaves open how large force densities are"
    costs = foreign_costs(problem.costs)
    return (
        f"it has the cost {' and '.join(costs)}, of more than force densities and the duration"
        if costs
        else ""
    )


def limited_on_the_way(problem: Problem) -> bool:
    """Tell whether anything but force densities is limited."""
    return any(type(bound) is not ForceDensityLimits for bound in problem.bounds)


def solve_condensed(
    problem: Problem,
    transcription: Transcription,
    target: Target,
    scales: Scales,
    guess: Guess,
    solver: CondensedNewton,
    deadline: float | None,
) -> Outcome:
    """Solve a problem that the method takes (`applies`). deadline: of `time.perf_counter`, s; None: no limit. Raises ValueError."""
    against = applies(problem)
    if against:
        raise ValueError(
            f"solver is CondensedNewton, which does not take this problem: {against}; give ocp.Ipopt()"
        )
    if not isinstance(transcription, Variational):
        raise ValueError(
            f"solver is CondensedNewton, and transcription is {type(transcription).__name__}: give ocp.Variational(...)"
        )
    with np.errstate(all="ignore"):
        try:
            return _solved(problem, transcription, target, scales, guess, solver, deadline)
        except np.linalg.LinAlgError:  # bars or rows depend on each other where it stands
            held = (
                node_values(guess.force_density, transcription.fractions)
                if transcription.control.linear
                else guess.force_density
            )
            return Outcome(
                guess.states,
                held,
                guess.duration,
                np.nan,
                False,
                "stuck",
                0,
                why=f"no plan: {WHY['stuck']}",
            )


def _solved(
    problem: Problem,
    transcription: Variational,
    target: Target,
    scales: Scales,
    guess: Guess,
    solver: CondensedNewton,
    deadline: float | None,
) -> Outcome:
    reduced, w, imposed = _reduced(problem, transcription, target, scales, guess)
    motion = first_motion(reduced.chain, reduced.strings(w), reduced.split(w)[1], guess.states)
    ends = (
        None if deadline is None else deadline - SPARED * max(deadline - time.perf_counter(), 0.0)
    )
    found = solve(reduced, w, motion, solver.tolerance, solver.max_iterations, ends, solver.verbose)
    corrected = Corrected(polish(reduced, found.point, POLISHED), None, 0.0)
    if (
        transcription.accuracy is not None
        and corrected.point.worst <= MET
        and found.status != "stuck"
    ):
        corrected = correct(
            reduced,
            corrected.point,
            transcription.control.linear,
            transcription.accuracy,
            MET,
            deadline,
        )
    return _outcome(problem, transcription, (target, imposed), reduced, found, corrected)


def _reduced(
    problem: Problem, transcription: Transcription, target: Target, scales: Scales, guess: Guess
) -> tuple[ReducedProblem, Array, Target]:
    """Return the problem in force densities, where these start, and the target without rows that they do not move there."""
    gamma = (
        node_values(guess.force_density, transcription.fractions)
        if transcription.control.linear
        else guess.force_density
    )
    strength = max(float(np.sqrt(np.mean(guess.force_density**2))), scales.mass / scales.time**2)
    cost = typical_cost(problem, strength, guess.states, guess.force_density, guess.duration)
    limited = (
        Limited(problem, transcription, target, scales, guess)
        if limited_on_the_way(problem)
        else None
    )
    reduced = ReducedProblem(problem, transcription, target, scales, strength, cost, limited)
    gamma = np.add.reduceat(gamma, reduced.begins) / np.bincount(reduced.span)[:, None]
    w = np.clip(
        reduced.joined(gamma @ (reduced.together / reduced.together.sum(axis=0)), guess.duration)
        / reduced.units,
        reduced.lower,
        reduced.upper,
    )
    jacobian = reduced.about(
        w, first_motion(reduced.chain, reduced.strings(w), reduced.split(w)[1], guess.states)
    ).jacobian
    imposed = _controlled(target, jacobian)
    if imposed is not target:
        reduced = ReducedProblem(problem, transcription, imposed, scales, strength, cost, limited)
    return reduced, w, imposed


def _controlled(target: Target, jacobian: Array) -> Target:
    """Return the target without the rows that the force densities do not move, given their gradient."""
    start, parts = 0, []
    for part in [*(one.target for one in target.waypoints), target]:
        kept = independent_rows(jacobian[start : start + part.count], REACHED)
        start += part.count
        parts.append(part if len(kept) == part.count else part.keep(kept, "out of control"))
    *waypoints, end = parts
    if all(
        part is given
        for part, given in zip(
            parts, [*(one.target for one in target.waypoints), target], strict=True
        )
    ):
        return target
    return replace(
        end,
        waypoints=tuple(
            one._replace(target=part) for one, part in zip(target.waypoints, waypoints, strict=True)
        ),
    )


def _outcome(
    problem: Problem,
    transcription: Transcription,
    targets: tuple[Target, Target],
    reduced: ReducedProblem,
    found: Found,
    corrected: Corrected,
) -> Outcome:
    """Return what was found, and why where it is no plan. targets: all that was asked, and what was imposed."""
    (target, imposed), (point, states, gap) = targets, corrected
    c, duration = reduced.split(point.w)
    if states is None:
        states = states_of(reduced.chain, c, duration, point.motion)
    lower, upper = problem.force_density_limits
    accuracy = transcription.accuracy
    coarse = accuracy is not None and gap > accuracy and found.status in SOLVED
    if coarse:
        why = TOO_COARSE.format(gap, accuracy)
    else:
        why = _why(
            problem,
            target,
            reduced.paths,
            found,
            point,
            state_function(problem.model, states, duration, transcription.fractions),
        )
    return Outcome(
        states=states,
        force_density=np.clip(reduced.force_densities(point.w), lower, upper),
        duration=float(np.clip(duration, problem.shortest, problem.longest)),
        objective=reduced.cost(point.w) * reduced.cost_scale,
        success=not why,
        status=found.status,
        iterations=found.iterations,
        duals=_duals(reduced, imposed, found, point) if coarse or not why else None,
        gap=gap,
        why=why,
        imposed=imposed.describe() + NOT_QUITE.get(found.status, ""),
        coarse=coarse
        or (found.status in SOLVED and MET < point.worst < np.inf and not reduced.paths.count),
    )


def _why(
    problem: Problem, target: Target, paths: PathRows, found: Found, point: Point, state_at: StateAt
) -> str:
    """Tell why what was found is no plan; "" where it is one."""
    missed = measure_misses(target, state_at)
    if point.worst <= MET and found.status in SOLVED:
        return (
            ""
            if goals_met(target, state_at)
            else f"no plan: {missed.worst()}, and no string moves it there to first order: {_PASSES}"
        )
    parts = [f"no plan: {WHY.get(found.status, WHY['stuck'])}"]
    if point.worst <= MET:
        parts.append("all constraints are met, but the cost is not settled")
    elif np.isfinite(point.worst):
        parts.append(
            f"largest violation: {_broken(problem, paths, point) or (missed.worst() if missed.places or missed.speeds else 'the motion')}"
        )
    return "; ".join(parts)


def _broken(problem: Problem, paths: PathRows, point: Point) -> str:
    """Name the limit along the way that is broken most; "" where goals miss by more."""
    left = np.abs(point.left.paths)
    if not left.max(initial=0.0) > max(MET, np.abs(point.left.goals).max(initial=0.0)):
        return ""
    worst = int(np.argmax(left))
    name = paths.names[worst]
    return f"{name}, by {left[worst] * paths.scale[worst]:.2g} {units_of(problem).get(name.partition(',')[0], '')}".rstrip()


def _duals(reduced: ReducedProblem, imposed: Target, found: Found, point: Point) -> Duals:
    """Return the multipliers of goals and limits by name, in physical units, as `named_duals` does."""
    paths = reduced.paths
    names, values, start = list(paths.names), [found.of_paths * reduced.cost_scale / paths.scale], 0
    for part in [*(one.target for one in imposed.waypoints), imposed]:
        own = found.multipliers[start : start + part.count] * reduced.cost_scale
        start += part.count
        if part.count:
            label = next((one.label for one in imposed.waypoints if one.target is part), "")
            names += [f"{label}{name}" for name in part.reduction.names]
            values.append(part.reduction.combinations.T @ own / part.reduction.sizes)
    unknowns = control_names(reduced.together, reduced.begins)
    limits = found.of_limits * reduced.cost_scale / reduced.units
    w_names = (*unknowns, *["duration"] * reduced.free_duration)
    return Duals((*names, *w_names), np.concatenate([*values, limits]), point.w * reduced.units)

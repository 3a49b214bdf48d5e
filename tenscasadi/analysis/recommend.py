"""Recommended scheme and step for an accuracy.

The recommendation rests on measured runs of the motion itself.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from tenscasadi.analysis.reference_solution import GRID, distance, end_nodes, reference_solution
from tenscasadi.analysis.tradeoff import Case, check_ways
from tenscasadi.analysis.tradeoff_table import abbreviate
from tenscasadi.dynamics.coordinates import compare_coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.events import build_events
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme, extent
from tenscasadi.integrators.stability import find_limit
from tenscasadi.integrators.stabilization import Correction, Projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.inputs.controls import ControlInput
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.compile import Compiled, CompileError, Single
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import MAX_ITERATIONS, Array, finite_array, instance, positive_number

_CLOSE = 1.15  # factor between the step found and the largest sufficient one
_REPEATS = 3  # timed runs

SCHEMES: tuple[Scheme, ...] = (
    *(DormandPrince853(), DormandPrince853(rtol=1e-6), DormandPrince54(rtol=1e-6)),
    *(DormandPrince54(), RungeKutta4(), Rattle(), Rattle(order=4)),
    *(Cvodes(), Idas(), Collocation(2, "radau"), Collocation(3, "radau")),
)


class NoSchemeError(ValueError):
    """Raised where no scheme that was tried meets the tolerance."""


@dataclass(frozen=True)
class Recommendation:
    """Cheapest options that reach a tolerance.

    Use them as ``tc.simulate(model, t_end, **recommendation.options)``.

    Attributes
    ----------
    scheme : scheme
        The integration scheme.
    step : float
        Step, s; the largest where the scheme controls its error.
    correction : Projection, BarLengthCorrection or None
        Correction of bars and joints.
    error : float
        Largest position error to expect at the end, m, that of the reference included.
    seconds : float
        Wall time to expect of the time loop, s, without set-up. If the time limit has expired, it
        is that of the search, which may be without machine code.
    work : float
        Instructions of the run without those of error control; NaN for implicit schemes.
    message : str
        Comparison of the schemes.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> advice = tc.Recommendation(tc.RungeKutta4(), 0.01, None, error=1e-7, seconds=0.1, work=1e6, message="")
    >>> advice.options["step"]
    0.01
    """

    scheme: Scheme
    step: float
    correction: Correction | None
    error: float
    seconds: float
    work: float
    message: str

    @property
    def options(self) -> dict[str, Any]:
        """Keywords for `simulate`."""
        return {"scheme": self.scheme, "step": self.step, "correction": self.correction}


@rename_keywords(what="model", seconds="time_limit")
def recommend(
    model: Scene | Model,
    t_end: float,
    tolerance: float,
    state: Any = None,
    control: ControlInput = None,
    schemes: Sequence[Scheme] = SCHEMES,
    corrections: Sequence[Correction | None] = (None, Projection()),
    compiled: Compiled = None,
    time_limit: float = 60.0,
    parameters: Any = None,
) -> Recommendation:
    """Find the cheapest options for a position error.

    The options are the scheme, step and correction; the error is that of the final nodes.

    `reference_solution` solves the motion once to a tenth of the tolerance. A search then finds the
    largest sufficient step or `rtol` of each scheme, and drops a scheme that costs more than the
    best so far. That takes about twenty runs of the recommended kind. If strings go slack or nodes
    meet the ground, schemes with error control come first, since they locate these events.

    Parameters
    ----------
    model : Scene or Model
        Scene or model to simulate.
    t_end : float
        Duration of the motion, s.
    tolerance : float
        Largest distance of a node from its true place at `t_end`, m.
    state : array_like (nx,), optional
        Start; None: the model's initial state.
    control : array_like or callable, optional
        Control input, as for `simulate`.
    schemes : sequence of schemes
        Schemes to choose from. Of those with an `rtol` the tolerance is looked for, without
        corrections.
    corrections : sequence of corrections
        Each None, `Projection()` or `BarLengthCorrection()`.
    compiled : bool or Single, optional
        As for `simulate`.
    time_limit : float
        Wall-clock limit [s], of which the reference may take half. Runs that would exceed it are
        not started. The result is then the best so far, and `message` names the schemes without a
        run.
    parameters : array_like, shape (np,), or mapping, optional
        Values of the model's parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    Recommendation
        Cheapest sufficient options within the time limit.

    Raises
    ------
    NoReferenceError
        If no solution of that accuracy exists: chaos, instability.
    NoSchemeError
        If no scheme meets the tolerance, or none was found within `time_limit`.
    TypeError, ValueError
        If an argument has a wrong type, shape or value.

    Notes
    -----
    Costs are instructions times steps, so the load of the machine does not matter. Machine code
    computes equal steps in blocks of up to 32; incomplete blocks count as complete. Implicit
    schemes are tested only if stability, not accuracy, limits the steps of the best explicit one.
    Their number of iterations is unknown, so wall time decides.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> scene = tc.Scene(tc.shapes.pendulum(), gravity=tc.Gravity())
    >>> advice = tc.recommend(scene, t_end=0.2, tolerance=1e-4, schemes=[tc.RungeKutta4()], compiled=False)
    >>> advice.error <= 1e-4
    True
    """
    instance("model", model, (Scene, Model), "a tenscasadi.Scene or Model")
    model = model if isinstance(model, Model) else Model(model)
    t_end, tolerance = positive_number("t_end", t_end), positive_number("tolerance", tolerance)
    check_ways(schemes, corrections)
    time_limit = positive_number("time_limit", time_limit)
    double = None if isinstance(compiled, Single) else compiled
    start = None if state is None else finite_array("state", state, (model.nx,))
    p = model.parameters.values(parameters)
    deadline = time.perf_counter() + time_limit
    limits = {
        **dict.fromkeys(("max_difference", "target_difference"), 0.1 * tolerance),
        "max_instructions": 1e10 / 60 * time_limit,
        "time_limit": time_limit / 2,  # the search gets half of the time at least
    }
    reference = reference_solution(
        model, t_end, start, control, compiled=double, parameters=p, **limits
    )

    ways = [
        Case(model, scheme, correction, t_end, start, control, compiled, p)
        for scheme, correction in product(schemes, corrections)
    ]
    wanted = 0.7 * tolerance - reference.error
    goal = _AccuracyTarget(reference.nodes, wanted, deadline, time_limit)
    best, told = _find_cheapest(ways, goal)
    names = ", ".join(map(abbreviate, schemes))
    if best is None:
        failed = f"tolerance is {tolerance:g} m: none of {names} meets it up to t_end = {t_end:g} s; give a larger tolerance or other schemes"
        raise NoSchemeError("; ".join(dict.fromkeys([failed, *told])))
    told = [f"compared with {names}", f"reference: {reference.message}", *told]
    return _report_choice(best, reference.error, deadline, told)


def _report_choice(
    best: _Choice, reference_error: float, deadline: float, told: list[str]
) -> Recommendation:
    """Time the choice, and add its limits to the message."""
    case = best.case
    model, scheme = case.model, case.scheme
    expected = best.error + reference_error
    late = time.perf_counter() > deadline  # machine code would take seconds
    duration = best.seconds if late else best.time_loop()
    limit = find_limit(model, scheme, case.state, parameters=case.parameters)
    told = [
        f"{best.steps} steps of {abbreviate(scheme)}: {expected:.2g} m, {duration:.2g} s",
        *told,
    ]
    if best.step > limit and not scheme.adaptive:
        told.append(
            f"the step is above the stability limit {limit:.2g} s: positions serve, fast vibrations of strings are not resolved"
        )
    if advice := compare_coordinates(model.structure, model.coordinates):
        told.append(advice)
    return Recommendation(
        scheme,
        best.step,
        case.correction,
        expected,
        duration,
        work=float(best.steps * case.instructions()) or np.nan,
        message="; ".join(dict.fromkeys(told)),
    )


@dataclass(frozen=True, eq=False)
class _AccuracyTarget:
    """Position error to reach, and the deadline.

    The nodes (n, 3) are to be within `wanted` m. The search ends at the time `deadline` of the
    clock [s], `time_limit` after its start.
    """

    nodes: Array
    wanted: float
    deadline: float
    time_limit: float

    def check_time(self, expected: float, best: _Choice | None) -> None:
        """Raise _OutOfTime if a run would end after the deadline."""
        if time.perf_counter() + expected > self.deadline:
            raise _OutOfTime(best)


class _OutOfTime(Exception):
    """Exception for an expired deadline.

    `best` is the best result so far.
    """

    def __init__(self, best: _Choice | None) -> None:
        super().__init__()
        self.best = best


def _find_cheapest(ways: Sequence[Case], goal: _AccuracyTarget) -> tuple[_Choice | None, list[str]]:
    """Find the cheapest candidate, and why others were rejected.

    Explicit schemes come first: implicit ones are measured against them. Steps that miss events
    serve only when they are tiny: schemes that locate them say beforehand how few may be tried.
    """
    best: _Choice | None = None
    told, late = [], []
    events = build_events(ways[0].model) is not None
    coarsest, speed = 0, 0.0  # steps at the stability limit and instructions per second of `best`
    for case in sorted(
        ways, key=lambda case: (case.scheme.implicit, events and not case.scheme.adaptive)
    ):
        name = abbreviate(case.scheme)
        if time.perf_counter() > goal.deadline:
            late.append(name)
            continue
        if case.scheme.implicit and best is not None and not best.case.scheme.implicit:
            coarsest = coarsest or _count_coarsest(best.case, best.end)
            # More than twice the fewest stable steps are due to accuracy.
            if best.steps > 2.0 * coarsest:
                told.append(
                    f"{name} left out: stability does not bound the steps of {abbreviate(best.case.scheme)}"
                )
                continue
            speed = speed or best.cost / best.time_loop()
        most = np.inf if best is None else best.cost
        try:
            if case.correction is not None and (
                case.scheme.adaptive or case.correction.step(case.model) is None
            ):
                continue  # nothing to correct
            found = _find_option(case, speed or 1.0, goal, most)
        except _OutOfTime as stop:
            found = stop.best
            late.append(name)
        except (
            TypeError,
            ValueError,
            CompileError,
        ) as error:  # such as Appendix C's correction where bars meet
            told.append(f"{name} left out: {error}")
            continue
        best = found if found is not None and found.cost < most else best
    if late:
        told.append(
            f"the time limit of {goal.time_limit:g} s expired before {', '.join(dict.fromkeys(late))} were tested: increase time_limit"
        )
    return best, told


@dataclass(frozen=True)
class _Price:
    """Price of a run in instructions.

    `step` counts for each trial step, `second` for each second of wall time.
    """

    step: float
    second: float


def _find_option(case: Case, speed: float, goal: _AccuracyTarget, most: float) -> _Choice | None:
    """Find about the cheapest sufficient step or rtol.

    None: no option costs less than `most`.

    `speed`: instructions in a second, where they are not counted.
    """
    if not case.scheme.implicit:
        # Error control and event location double the work.
        price = _Price(case.instructions() * (2.0 if case.scheme.adaptive else 1.0), 0.0)
        return (_find_loosest if case.scheme.adaptive else _find_fewest)(case, price, goal, most)
    clock = _Price(0.0, speed)
    if case.scheme.adaptive:
        return _find_loosest(case, clock, goal, most)
    if case.compiled is False:
        return _find_fewest(case, clock, goal, most)
    promising = _find_fewest(
        replace(case, compiled=False), _Price(0.0, speed / 6.0), goal, most
    )  # compilation takes seconds and makes the code about 6 times as fast
    if promising is None:
        return None
    goal.check_time(0.0, None)
    return _measure(case.with_code(), promising.step, clock, goal)


@dataclass(frozen=True, eq=False)
class _Choice:
    """Measured candidate, sufficient or not.

    It takes `steps` of at most `step` s and ends in the state `end` (nx,) with an error of `error`
    m. It costs `cost` instructions and `seconds` s of wall time.
    """

    case: Case
    step: float
    steps: int
    error: float
    end: Array
    cost: float
    seconds: float

    def time_loop(self) -> float:
        """Measure the time loop, s."""
        case = self.case.with_code()
        if not case.even or self.steps <= 2048:
            return min(case.run(self.step, energy_balance=False).seconds for _ in range(_REPEATS))
        return case.seconds_per_step(self.step, _REPEATS) * self.steps


def _measure(case: Case, step: float, price: _Price, goal: _AccuracyTarget) -> _Choice:
    """Run once and measure the error.

    The error is infinite if the run fails.
    """

    def run(**options: Any) -> Trajectory:
        return case.run(step, **options, time_limit=max(0.1, goal.deadline - time.perf_counter()))

    bare = {"energy_balance": False, "save_every": 10**9}
    first = run(**bare)
    error = distance(end_nodes(case.model, first), goal.nodes) if first.success else np.inf
    if error <= goal.wanted and not run().success:  # with its energy, as the user runs it
        error = np.inf
    seconds = first.seconds
    if price.second and error <= goal.wanted:
        seconds = min(seconds, *(run(**bare).seconds for _ in range(_REPEATS - 1)))
    cost = price.step * first.attempts + price.second * seconds
    return _Choice(case, step, first.attempts, error, first.states[-1], cost, first.seconds)


def _find_loosest(case: Case, price: _Price, goal: _AccuracyTarget, most: float) -> _Choice | None:
    """Find about the largest sufficient rtol.

    Its error is at most `wanted`; None if it costs `most` or more.
    """
    best: _Choice | None = None
    wanted, expected = goal.wanted, 0.0
    least = 1e-6 if isinstance(case.compiled, Single) else 1e-15
    rtol, tight, loose = 0.1 * wanted / extent(case.model), 0.0, 0.1
    for _ in range(MAX_ITERATIONS):
        rtol = min(max(rtol, least), 0.1)
        tried = replace(case, scheme=replace(case.scheme, rtol=rtol, atol=None))  # type: ignore[type-var]
        goal.check_time(expected, best)
        now = _measure(tried, case.t_end / GRID, price, goal)
        if now.error <= wanted:
            tight, best = rtol, now
        else:
            loose = rtol
            if rtol <= least or (best is None and np.isfinite(now.error) and now.cost >= most):
                break
        if loose <= 4 * tight or (best is now and now.error > wanted / 4):
            break
        ratio = float(np.clip(0.5 * wanted / max(now.error, 1e-300), 1e-3, 1e3))
        before, rtol = (
            rtol,
            rtol * ratio
            if tight < rtol * ratio < loose
            else float(np.sqrt(max(tight, 1e-16) * loose)),
        )
        expected = now.seconds * (before / rtol) ** (1 / case.scheme.order)
    return best


def _find_fewest(case: Case, price: _Price, goal: _AccuracyTarget, most: float) -> _Choice | None:
    """Find about the fewest equal steps that suffice.

    Their error is at most `wanted`; None if they cost `most` or more.
    """
    wanted = goal.wanted
    limit = np.ceil(most / price.step) - 1 if price.step else np.inf
    steps = int(max(1, min(_count_coarsest(case), limit)))  # the search goes downward from there
    low, best, each = 0, None, price.step / 1e8
    for _ in range(MAX_ITERATIONS):
        if steps > limit:
            return None
        goal.check_time(each * steps, best)
        now = _measure(case, case.t_end / steps, price, goal)
        each = now.seconds / max(now.steps, 1)
        if now.error <= wanted:
            best = now
        else:
            low = steps
            if now.cost >= most:
                return None
        if best is None:
            # extrapolation with the order of the scheme
            factor = (
                (now.error / wanted) ** (1 / case.scheme.order) if np.isfinite(now.error) else 2.0
            )
            steps = max(low + 1, int(np.ceil(low * float(np.clip(1.05 * factor, _CLOSE, 8.0)))))
        elif best.steps <= max(_CLOSE * low, low + 1):
            break
        else:
            middle = int(np.sqrt(low * best.steps)) if low else best.steps // 2
            steps = min(max(middle, low + 1), best.steps - 1)
    return best


def _count_coarsest(case: Case, state: Array | None = None) -> int:
    """Count the steps at the stability limit.

    The limit is that of the start and of `state`.
    """
    if case.scheme.implicit:
        return 8
    states = [case.state] if state is None else [case.state, state]
    limit = min(find_limit(case.model, case.scheme, x, parameters=case.parameters) for x in states)
    return max(1, int(np.ceil(case.t_end / limit))) if np.isfinite(limit) and limit > 0 else 1

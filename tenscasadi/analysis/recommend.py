"""Recommended scheme and step for a required accuracy.

The recommendation is based on measured runs of the user's simulation.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from tenscasadi.analysis.option_search import (
    AccuracyTarget,
    Choice,
    OutOfTime,
    count_coarsest,
    find_option,
)
from tenscasadi.analysis.reference_solution import (
    reference_solution,
    show_progress,
)
from tenscasadi.analysis.tradeoff import Case, check_ways
from tenscasadi.analysis.tradeoff_table import abbreviate
from tenscasadi.dynamics.coordinates import compare_coordinates
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.events import build_events
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stability import find_limit
from tenscasadi.integrators.stabilization import Correction, Projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.inputs.controls import ControlInput
from tenscasadi.simulation.verdict.endings import INTERRUPTED
from tenscasadi.util.compile import Compiled, CompileError, Single, read_compiled
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import (
    finite_array,
    instance,
    positive_number,
)

SCHEMES: tuple[Scheme, ...] = (
    *(DormandPrince853(), DormandPrince853(rtol=1e-6), DormandPrince54(rtol=1e-6)),
    *(DormandPrince54(), RungeKutta4(), Rattle(), Rattle(order=4)),
    *(Cvodes(), Idas(), Collocation(2, "radau"), Collocation(3, "radau")),
)


class NoSchemeError(ValueError):
    """Raised if no tested scheme meets the tolerance."""


@dataclass(frozen=True)
class Recommendation:
    """Cheapest simulation options that reach a tolerance.

    Use them as ``tc.simulate(model, t_end, **recommendation.options)``.

    Attributes
    ----------
    scheme : scheme
        The integration scheme.
    step : float
        Step [s]; the largest one for schemes with error control.
    correction : Projection, BarLengthCorrection or None
        Correction of bars and joints.
    error : float
        Largest expected position error at the end [m], including that of the reference.
    seconds : float
        Expected wall time of the time loop [s], without set-up. After the time limit or Ctrl-C, it
        is that measured in the search, which may be without machine code.
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
        """Keywords for `simulate` by name, such as `scheme` and `step`."""
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
    progress: bool | None = None,
) -> Recommendation:
    """Find the cheapest simulation options for a position error.

    The options are the scheme, step and correction; the error is that of the final nodes.
    `reference_solution` solves the problem once to a tenth of the tolerance. A search then finds
    the largest sufficient step or `rtol` of each scheme, and drops a scheme that costs more than
    the best so far. That takes about twenty runs of the recommended kind. If strings go slack or
    nodes meet the ground, schemes with error control come first, since they locate these events.

    Parameters
    ----------
    model : Scene or Model
        Scene or model to simulate.
    t_end : float
        Duration of the motion [s].
    tolerance : float
        Largest distance of a node from its exact position at `t_end` [m].
    state : array_like (nx,), optional
        Start; None: the model's initial state.
    control : array_like or callable, optional
        Control input, as for `simulate`.
    schemes : sequence of schemes
        Schemes to choose from. For those with `rtol`, the search varies `rtol`, without
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
    progress : bool, optional
        Whether to show a progress bar after two seconds. Default: if standard error is a terminal.

    Returns
    -------
    Recommendation
        Cheapest sufficient options within the time limit, or until Ctrl-C.

    Raises
    ------
    NoReferenceError
        If no reference of that accuracy can be computed, as for chaotic motions.
    NoSchemeError
        If no scheme meets the tolerance, or none was found within `time_limit`.
    KeyboardInterrupt
        After Ctrl-C, if no sufficient options have been found.
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
    compiled = read_compiled("compiled", compiled)
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
        model, t_end, start, control, compiled=double, parameters=p, progress=progress, **limits
    )
    ways = [
        Case(model, scheme, correction, t_end, start, control, compiled, p)
        for scheme, correction in product(schemes, corrections)
    ]
    wanted = 0.7 * tolerance - reference.error
    with show_progress(progress, " schemes", len(ways)) as progress_bar:
        goal = AccuracyTarget(reference.nodes, wanted, deadline, time_limit, progress_bar)
        best, notes = _find_cheapest(ways, goal)
    names = ", ".join(map(abbreviate, schemes))
    if best is None and goal.interrupted:
        raise KeyboardInterrupt
    if best is None:
        failed = f"tolerance is {tolerance:g} m: none of {names} meets it up to t_end = {t_end:g} s; give a larger tolerance or other schemes"
        raise NoSchemeError("; ".join(dict.fromkeys([failed, *notes])))
    notes = [f"compared with {names}", f"reference: {reference.message}", *notes]
    return _report_choice(best, reference.error, goal, notes)


def _report_choice(
    best: Choice, reference_error: float, goal: AccuracyTarget, notes: list[str]
) -> Recommendation:
    """Build the recommendation from a choice, with its wall time.

    The choice is `best`. `reference_error` [m] is that of the reference positions, and `notes` are
    the reasons against other choices.
    """
    case = best.case
    model, scheme = case.model, case.scheme
    expected = best.error + reference_error
    try:  # machine code would take seconds after the deadline
        duration = best.seconds if goal.late else best.time_loop()
    except KeyboardInterrupt:
        duration = best.seconds
        notes = [*notes, f"{INTERRUPTED} before the time loop was measured"]
    limit = find_limit(model, scheme, case.state, parameters=case.parameters)
    notes = [
        f"{best.steps} steps of {abbreviate(scheme)}: {expected:.2g} m, {duration:.2g} s",
        *notes,
    ]
    if best.step > limit and not scheme.adaptive:
        notes.append(
            f"the step is above the stability limit {limit:.2g} s: positions are accurate, but fast vibrations of strings are not resolved"
        )
    if advice := compare_coordinates(model.structure, model.coordinates):
        notes.append(advice)
    return Recommendation(
        scheme,
        best.step,
        case.correction,
        expected,
        duration,
        work=float(best.steps * case.instructions()) or np.nan,
        message="; ".join(dict.fromkeys(notes)),
    )


def _find_cheapest(ways: Sequence[Case], goal: AccuracyTarget) -> tuple[Choice | None, list[str]]:
    """Find the cheapest choice, and why others were rejected.

    `ways` are the cases to compare, and `goal` is the required accuracy. Explicit schemes come
    first: implicit ones are compared with them. Fixed steps that do not locate events are
    sufficient only if they are tiny: schemes with event location show before how few may be tried.
    """
    best: Choice | None = None
    notes, late = [], []
    events = build_events(ways[0].model) is not None
    coarsest, speed = 0, 0.0  # steps at the stability limit and instructions per second of `best`
    for case in sorted(
        ways, key=lambda case: (case.scheme.implicit, events and not case.scheme.adaptive)
    ):
        name = abbreviate(case.scheme)
        if goal.late:
            late.append(name)
            continue
        most = np.inf if best is None else best.cost
        goal.found = None
        try:
            goal.progress_bar.update()
            if case.scheme.implicit and best is not None and not best.case.scheme.implicit:
                coarsest = coarsest or count_coarsest(best.case, best.end)
                # More than twice the fewest stable steps are due to accuracy.
                if best.steps > 2.0 * coarsest:
                    notes.append(
                        f"{name} left out: stability does not bound the steps of {abbreviate(best.case.scheme)}"
                    )
                    continue
                speed = speed or best.cost / best.time_loop()
            if case.correction is not None and (
                case.scheme.adaptive or case.correction.step(case.model) is None
            ):
                continue  # nothing to correct
            found = find_option(case, speed or 1.0, goal, most)
        except (OutOfTime, KeyboardInterrupt) as stop:
            goal.interrupted |= isinstance(stop, KeyboardInterrupt)
            found = goal.found
            late.append(name)
        except (
            TypeError,
            ValueError,
            CompileError,
        ) as error:  # such as Appendix C's correction where bars meet
            notes.append(f"{name} left out: {error}")
            continue
        if found is not None and found.error <= goal.wanted and found.cost < most:
            best = found
    if late:
        end, cure = f"the time limit of {goal.time_limit:g} s expired", ": increase time_limit"
        if goal.interrupted:
            end, cure = INTERRUPTED, ""
        notes.append(f"{end} before {', '.join(dict.fromkeys(late))} were tested{cure}")
    return best, notes

"""Which scheme and step to take for a wanted accuracy, found by measuring the motion itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import median
from typing import Any

import numpy as np

from tenscasadi.correction import Correction, Projection
from tenscasadi.model import Model
from tenscasadi.precision import Compiled, Single
from tenscasadi.rattle import Rattle
from tenscasadi.reference import certify, distance, end_nodes
from tenscasadi.runners import own_steps
from tenscasadi.scene import Scene
from tenscasadi.schemes import DormandPrince54, DormandPrince853, EmbeddedRungeKutta, RungeKutta4, Scheme, extent
from tenscasadi.signals import ControlInput
from tenscasadi.stability import stable_step
from tenscasadi.table import short
from tenscasadi.tradeoff import LONGEST, Case, check_ways
from tenscasadi.validate import Array, finite_array, instance, positive_number

_REFERENCE = 0.1  # error of the reference in units of the tolerance
_MARGIN = 0.7  # of the tolerance that the measured error may take, with that of the reference
_CLOSE = 1.15  # the step found is this close to the largest that serves
_TRIES = 40  # runs to find one step
_REPEATS = 3  # timed runs

_SHORT = 2e8  # instructions that the virtual machine is through with before they are compiled
_OVERHEAD = 2.0  # of such a step: the error, the search for events

SCHEMES: tuple[Scheme, ...] = (
    *(DormandPrince853(), DormandPrince853(rtol=1e-6), DormandPrince54(rtol=1e-6)),
    *(DormandPrince54(), RungeKutta4(), Rattle(), Rattle(order=4)),
)


class NoScheme(ValueError):
    """No scheme that was tried meets the tolerance."""


@dataclass(frozen=True)
class Recommendation:
    """How to reach a tolerance at the least cost: `tc.simulate(model, t_end, **recommendation.options)`.

    step, s, the largest where the scheme controls its error; error: largest position error expected at the end, m, with that of the
    reference that it was measured against;
    seconds: wall time expected of the time loop, s, without set-up; work: instructions of the run, without those of error control;
    message: what was compared.
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


def recommend(
    what: Scene | Model,
    t_end: float,
    tolerance: float,
    state: Any = None,
    control: ControlInput = None,
    schemes: Sequence[Scheme] = SCHEMES,
    corrections: Sequence[Correction | None] = (None, Projection()),
    compiled: Compiled = None,
) -> Recommendation:
    """The scheme, step and correction that bring all nodes within `tolerance`, m, of where they are at `t_end`, s, for the least work.

    what: a scene or a model; state, control, compiled: as for `simulate`. schemes: explicit schemes to choose from; of those with
    `rtol`, which control their error, the tolerance is looked for, without corrections.

    The motion is solved once to a tenth of the tolerance (`certify`), then each scheme looks for the largest step (or `rtol`) that serves, and is
    left out as soon as it costs more than the best so far: some twenty runs like the one recommended. Costs are instructions times steps, so that
    the answer does not depend on what else the machine does; only `seconds` is measured by the clock.
    Raises NoReference when no solution of that accuracy exists (chaos, instability), NoScheme, TypeError, ValueError.
    """
    instance("what", what, (Scene, Model), "a tenscasadi.Scene or Model")
    model = what if isinstance(what, Model) else Model(what)
    t_end, tolerance = positive_number("t_end", t_end), positive_number("tolerance", tolerance)
    check_ways(schemes, corrections)
    for scheme in schemes:
        if own_steps(scheme) and not isinstance(scheme, EmbeddedRungeKutta):
            raise ValueError(f"schemes holds {scheme!r}, whose instructions are not known: give explicit schemes")
    enough = _REFERENCE * tolerance
    start = None if state is None else finite_array("state", state, (model.nx,))
    reference = certify(model, t_end, start, control, accuracy=enough, enough=enough, compiled=None if isinstance(compiled, Single) else compiled)
    wanted = _MARGIN * tolerance - reference.error

    best: _Choice | None = None
    told = []
    for scheme, correction in product(schemes, corrections):
        case = Case(model, scheme, correction, t_end, start, control, compiled)
        if correction is not None and (own_steps(scheme) or correction.step(model) is None):
            continue  # nothing to correct
        try:
            each = case.instructions()
        except (TypeError, ValueError) as error:  # such as Rattle where supports are moved
            told.append(f"{short(scheme)} left out: {error}")
            continue
        most = np.inf if best is None else best.cost
        found = (_loosest if own_steps(scheme) else _fewest)(case, each, reference.nodes, wanted, most)
        best = found or best
    names = ", ".join(map(short, schemes))
    if best is None:
        raise NoScheme(f"tolerance is {tolerance:g} m: none of {names} meets it up to t_end = {t_end:g} s; give a larger tolerance or other schemes")
    seconds = replace(best, case=replace(best.case, compiled=compiled)).seconds()
    expected = best.error + reference.error
    outcome = f"{best.steps} steps of {short(best.case.scheme)}: {expected:.2g} m, {seconds:.2g} s"
    message = f"{outcome}; compared with {names}; reference: {reference.message}"
    work = float(best.steps * best.each)
    return Recommendation(best.case.scheme, best.step, best.case.correction, expected, seconds, work, "; ".join([message, *told]))


@dataclass(frozen=True, eq=False)
class _Choice:
    """A way that serves: `steps` of at most `step` s with `each` instructions."""

    case: Case
    step: float
    steps: int
    error: float
    each: int

    @property
    def cost(self) -> float:
        """Instructions, with the overhead of error control."""
        return self.steps * self.each * (_OVERHEAD if own_steps(self.case.scheme) else 1.0)

    def seconds(self) -> float:
        """Of the time loop, measured."""
        if own_steps(self.case.scheme):
            return median(self.case.run(self.step, energy_balance=False).seconds for _ in range(_REPEATS))
        return self.case.seconds_per_step(self.step, _REPEATS) * self.steps


def _measured(case: Case, step: float, each: int, nodes: Array) -> _Choice:
    """A run; its error is infinite when it fails."""
    run = case.run(step, energy_balance=False, save_every=10**9)
    error = distance(end_nodes(case.model, run), nodes) if run.success else np.inf
    return _Choice(case, step, run.attempts, error, each)


def _loosest(case: Case, each: int, nodes: Array, wanted: float, most: float) -> _Choice | None:
    """About the largest rtol whose error is at most `wanted`; None when that costs `most` or more."""
    if case.compiled is None and most < _SHORT:
        case = replace(case, compiled=False)  # each rtol would be compiled anew
    best: _Choice | None = None
    rtol, tight, loose = 0.1 * wanted / extent(case.model), 0.0, 0.1
    for _ in range(_TRIES // 4):
        rtol = min(max(rtol, 1e-15), 0.1)
        now = _measured(replace(case, scheme=replace(case.scheme, rtol=rtol, atol=None)), LONGEST * case.t_end, each, nodes)  # type: ignore[type-var]
        if now.error <= wanted:
            tight, best = rtol, now
        else:
            loose = rtol
            if rtol <= 1e-15 or (best is None and np.isfinite(now.error) and now.cost >= most):
                break
        if loose <= 4 * tight or (best is now and now.error > wanted / 4):
            break
        ratio = float(np.clip(0.5 * wanted / max(now.error, 1e-300), 1e-3, 1e3))
        rtol = rtol * ratio if tight < rtol * ratio < loose else float(np.sqrt(max(tight, 1e-16) * loose))
    return best if best is not None and best.cost < most else None


def _fewest(case: Case, each: int, nodes: Array, wanted: float, most: float) -> _Choice | None:
    """About the fewest equal steps whose error is at most `wanted`; None when that costs `most` or more."""
    limit = most / each
    steps = min(_coarsest(case), max(1, int(limit) - 1) if np.isfinite(limit) else _coarsest(case))  # from there on downwards
    low, best = 0, None
    for _ in range(_TRIES):
        if steps >= limit:
            return None
        now = _measured(case, case.t_end / steps, each, nodes)
        if now.error <= wanted:
            best = now
        else:
            low = steps
        if best is None:
            # as far as the scheme's order says, if it is in its range already
            factor = (now.error / wanted) ** (1 / case.scheme.order) if np.isfinite(now.error) else 2.0
            steps = max(low + 1, int(np.ceil(low * float(np.clip(1.05 * factor, _CLOSE, 8.0)))))
        elif best.steps <= max(_CLOSE * low, low + 1):
            break
        else:
            middle = int(np.sqrt(low * best.steps)) if low else best.steps // 2
            steps = min(max(middle, low + 1), best.steps - 1)
    return best


def _coarsest(case: Case) -> int:
    """Steps at the limit of stability of the start."""
    limit = stable_step(case.model, case.state, None, case.scheme, safety=1.0)
    return max(1, int(np.ceil(case.t_end / limit))) if np.isfinite(limit) and limit > 0 else 1

"""Which scheme and step to take for a wanted accuracy, found by measuring the motion itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tenscasadi.correction import Correction, Projection
from tenscasadi.model import Model
from tenscasadi.rattle import Rattle
from tenscasadi.reference import certify, distance, end_nodes
from tenscasadi.runners import own_steps
from tenscasadi.scene import Scene
from tenscasadi.schemes import DormandPrince54, DormandPrince853, RungeKutta4, Scheme, check_scheme
from tenscasadi.signals import ControlInput
from tenscasadi.stability import stable_step
from tenscasadi.table import short
from tenscasadi.tradeoff import Case
from tenscasadi.validate import finite_array, instance, positive_number

_REFERENCE = 0.1  # error of the reference in units of the tolerance
_MARGIN = 0.7  # of the tolerance that the measured error may take, with that of the reference
_CLOSE = 1.15  # the step found is this close to the largest that serves
_TRIES = 40  # runs to find one step

SCHEMES: tuple[Scheme, ...] = (DormandPrince54(), DormandPrince853(), RungeKutta4(), Rattle(), Rattle(order=4))


class NoScheme(ValueError):
    """No scheme that was tried meets the tolerance."""


@dataclass(frozen=True)
class Recommendation:
    """How to reach a tolerance at the least cost: `tc.simulate(model, t_end, **recommendation.options)`.

    step, s; error: largest position error expected at the end, m, with that of the reference that it was measured against;
    seconds: wall time expected of the time loop, s, without set-up; work: instructions of the run; message: what was compared.
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
    compiled: bool | None = None,
) -> Recommendation:
    """The scheme, step and correction that bring all nodes within `tolerance`, m, of where they are at `t_end`, s, for the least work.

    what: a scene or a model; state, control, compiled: as for `simulate`. schemes: fixed-step schemes to choose from.

    The motion is solved once to a tenth of the tolerance (`certify`), then each scheme looks for the largest step that serves, and is left
    out as soon as it costs more than the best so far: some twenty runs like the one recommended. Costs are instructions times steps, so that
    the answer does not depend on what else the machine does; only `seconds` is measured by the clock.
    Raises NoReference when no solution of that accuracy exists (chaos, instability), NoScheme, TypeError, ValueError.
    """
    instance("what", what, (Scene, Model), "a tenscasadi.Scene or Model")
    model = what if isinstance(what, Model) else Model(what)
    t_end, tolerance = positive_number("t_end", t_end), positive_number("tolerance", tolerance)
    for scheme in schemes:
        check_scheme(scheme)
        if own_steps(scheme):
            raise ValueError(f"schemes holds {scheme!r}, which chooses its own steps: give schemes of fixed steps")
    enough = _REFERENCE * tolerance
    start = None if state is None else finite_array("state", state, (model.nx,))
    reference = certify(model, t_end, start, control, accuracy=enough, enough=enough, compiled=compiled)
    wanted = _MARGIN * tolerance - reference.error

    best: _Choice | None = None
    told = []
    for scheme in schemes:
        for correction in corrections:
            case = Case(model, scheme, correction, t_end, start, control, compiled)
            if correction is not None and correction.step(model) is None:
                continue  # nothing to correct
            try:
                each = case.instructions()
            except (TypeError, ValueError) as error:  # such as Rattle where supports are moved
                told.append(f"{short(scheme)} left out: {error}")
                continue
            most = np.inf if best is None else best.work / each
            found = _fewest(case, reference.nodes, wanted, most)
            if found is not None and (best is None or found[0] * each < best.work):
                best = _Choice(case, *found, float(found[0] * each))
    names = ", ".join(map(short, schemes))
    if best is None:
        raise NoScheme(f"tolerance is {tolerance:g} m: none of {names} meets it up to t_end = {t_end:g} s; give a larger tolerance or other schemes")
    step = t_end / best.steps
    seconds = best.case.seconds_per_step(step, repeats=3) * best.steps
    expected = best.error + reference.error
    outcome = f"{best.steps} steps of {short(best.case.scheme)}: {expected:.2g} m, {seconds:.2g} s"
    message = f"{outcome}; compared with {names}; reference: {reference.message}"
    return Recommendation(best.case.scheme, step, best.case.correction, expected, seconds, best.work, "; ".join([message, *told]))


@dataclass(frozen=True, eq=False)
class _Choice:
    case: Case
    steps: int
    error: float
    work: float


def _fewest(case: Case, nodes: Any, wanted: float, most: float) -> tuple[int, float] | None:
    """About the fewest steps whose error is at most `wanted`, and that error; None when that takes `most` or more."""

    def error(steps: int) -> float:
        run = case.run(case.t_end / steps, energy_balance=False, save_every=steps)
        return distance(end_nodes(case.model, run), nodes) if run.success else np.inf

    steps = _coarsest(case)
    if steps >= most:  # from there downwards: a short run may be accurate enough above the limit of stability
        steps = max(1, int(most) - 1)
    low, high, error_high = 0, 0, np.inf
    for _ in range(_TRIES):
        if steps >= most:
            return None
        off = error(steps)
        if off <= wanted:
            high, error_high = steps, off
        else:
            low = steps
        if high and (high <= _CLOSE * low or high - low <= 1):
            return high, error_high
        if not high:
            # as far as the scheme's order says, if it is in its range already
            factor = (off / wanted) ** (1 / case.scheme.order) if np.isfinite(off) else 2.0
            steps = max(low + 1, int(np.ceil(low * float(np.clip(1.05 * factor, _CLOSE, 8.0)))))
        else:
            middle = int(np.sqrt(low * high)) if low else high // 2
            steps = min(max(middle, low + 1), high - 1)
    return (high, error_high) if high else None


def _coarsest(case: Case) -> int:
    """Steps at the limit of stability of the start."""
    limit = stable_step(case.model, case.state, None, case.scheme, safety=1.0)
    return max(1, int(np.ceil(case.t_end / limit))) if np.isfinite(limit) and limit > 0 else 1

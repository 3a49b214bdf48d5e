"""Step-size control and event location as CasADi Functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca

from tenscasadi.integrators.events import (
    build_events,
    build_hidden,
    build_latch,
    build_margins,
    build_mode_ode,
    build_potential,
    build_root,
    count_breakable,
)
from tenscasadi.integrators.runge_kutta import EmbeddedRungeKutta, build_trial
from tenscasadi.integrators.scheme import equations
from tenscasadi.integrators.stabilization import Correction, correct
from tenscasadi.integrators.tableaux import Tableau
from tenscasadi.util.validate import NEGLIGIBLE

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

EVENT_SHARE = 0.1  # × tolerance: error of a step by ending after an event instead of at it
MAX_INTERPOLATIONS = 6  # trials in a bracket before bisection


class Memory(NamedTuple):
    """State of the step-size control between trial steps.

    A bracket is the pair `low`, `high` of step lengths between which a step meets its first event.
    """

    rest: Any  # time left in the grid step, s
    step: Any  # next trial step, s
    low: Any  # step without an event, s
    high: Any  # step with an event, s; 0: no event is bracketed
    aim: Any  # trial step in the bracket, s
    allowed: Any  # allowed overshoot of the event, s
    trials: Any  # number of trials in the bracket
    accepted: Any  # number of accepted steps
    rejected: Any  # number of attempts with too large an error
    located: Any  # number of attempts to locate events
    events: Any  # number of mode changes


class StepTolerances(NamedTuple):
    """Tolerances of the step-size control.

    An error of a state entry of size |x| may be `atol` + `rtol` |x|. They are inputs, so one
    compiled Function serves all tolerances.
    """

    longest: Any  # largest step, s
    rtol: Any
    atol: Any  # m and m/s


class Events(NamedTuple):
    """Events within a trial step, as numbers.

    They are changes of contact or slack. All are zero if the scene has no events.
    """

    changed: Any  # number of modes that differ between start and end
    located: Any  # whether the overshoot of the first change is negligible
    hidden: Any  # fraction at which the interpolation is in another mode; 0: none
    root: Any  # time of the first change, s
    jump: Any  # slope change relative to the tolerance


class ErrorControl(NamedTuple):
    """CasADi Functions that form a trial step with error control.

    - ode (z, v) → ż, the equations of motion, with v = (u, modes)
    - prepare (z, memory, u) → (length, v) of the next trial step
    - decide (z, memory, u, limits, length, v, z after, errors, slope, slope after) → (z, memory)
      after the step is accepted or rejected

    z is the state, followed by the energy supplied if it is computed, and u the control with the
    parameters. The columns memory and limits hold a `Memory` and `StepTolerances`. Modes are 1 for
    taut strings and contacts, else 0. Slopes are ż.
    """

    ode: ca.Function
    prepare: ca.Function
    decide: ca.Function


def build_attempt(control: ErrorControl, tableau: Tableau) -> ca.Function:
    """Build one trial step.

    Function "attempt" (z, memory, u, limits) → (z, memory), with the arguments of `ErrorControl`.
    `control` are the Functions of `build_control`, and `tableau` has the coefficients of the
    Runge-Kutta method.
    """
    decide = control.decide
    arguments: Any = [ca.MX.sym(decide.name_in(i), *decide.size_in(i)) for i in range(4)]
    z, memory, u, _ = arguments
    length, held = control.prepare.call([z, memory, u])
    trial: Any = build_trial(tableau, control.ode)(z, held, length)
    return ca.Function("attempt", arguments, list(control.decide(*arguments, length, held, *trial)))


def build_control(
    model: Model, scheme: EmbeddedRungeKutta, correction: Correction | None, power: bool
) -> ErrorControl:
    """Build the Functions of a model's trial steps.

    `scheme` is the Runge-Kutta method, and `correction` corrects bars and joints after each step,
    if given. With `power`, z has one more entry, the energy supplied [J].
    """
    gaps = build_events(model)
    if gaps is not None:
        ode = build_mode_ode(model, power, count_breakable(model))
    else:
        ode = equations(
            model,
            model.with_stacked_input(model.power) if power and model.power is not None else None,
        )
    z, u = ca.MX.sym("z", model.nx + power), ca.MX.sym("u", model.nw)
    packed = ca.MX.sym("memory", len(Memory._fields))
    m = Memory(*ca.vertsplit(packed))
    trial = ca.if_else(m.high > 0, m.aim, ca.if_else(m.step >= m.rest, m.rest, m.step))
    held = u if gaps is None else ca.vertcat(u, gaps(z[: model.nx], u) > 0)
    prepare = ca.Function(
        "prepare", [z, packed, u], [trial, held], ["z", "memory", "u"], ["h", "v"]
    )
    return ErrorControl(ode, prepare, _build_decision(model, scheme, correction, power, gaps, ode))


def _build_decision(
    model: Model,
    scheme: EmbeddedRungeKutta,
    correction: Correction | None,
    power: bool,
    gaps: ca.Function | None,
    ode: ca.Function,
) -> ca.Function:
    sizes = {
        "z": model.nx + power,
        "memory": len(Memory._fields),
        "u": model.nw,
        "limits": len(StepTolerances._fields),
        "h": 1,
        "v": ode.size1_in(1),
        "after": model.nx + power,
        "errors": (model.nx + power, len(scheme.tableau.errors)),
        "slope": model.nx + power,
        "slope_after": model.nx + power,
    }
    symbols: dict[str, Any] = {
        name: ca.MX.sym(name, *(size if isinstance(size, tuple) else (size,)))
        for name, size in sizes.items()
    }
    z, packed, u, limits, trial, held, after, errors, slope, end_slope = symbols.values()
    m, (longest, rtol, atol) = Memory(*ca.vertsplit(packed)), StepTolerances(*ca.vertsplit(limits))
    overloaded, z = _break_strings(model, z, u, power)
    x, mode = z[: model.nx], held[model.nw :]
    if gaps is not None and power:
        stored = build_potential(model)
        after = ca.vertcat(
            after[: model.nx], after[model.nx :] + stored(after[: model.nx], u) - stored(x, u)
        )
    project = None if correction is None else correction.step(model)
    if project is not None:
        after = ca.vertcat(correct(model, project, after[: model.nx], u), after[model.nx :])

    moving = model.moving
    scale = atol + rtol * ca.fmax(ca.fabs(z[moving]), ca.fabs(after[moving]))
    columns: list[Any] = ca.horzsplit(errors)
    error = _norm([ca.vec(column)[moving] / scale for column in columns])
    events = Events(*[ca.MX(0)] * len(Events._fields))
    if gaps is not None:
        path = x, slope[: model.nx], after[: model.nx], end_slope[: model.nx], u, trial, mode
        events = _find_events(model, gaps, ode, m, path, after, scale, longest)
    again, memory = _decide(m, trial, error, events, scheme.order, longest, overloaded)
    outputs = [ca.if_else(again, z, after), memory]
    return ca.Function(
        "decide", list(symbols.values()), outputs, list(symbols), ["z_next", "memory_next"]
    )


def _norm(errors: list[Any]) -> Any:
    """Compute the scaled error norm of a step.

    `errors` has one or two error estimates (n), whose entries are divided by their tolerances. For
    one it is the root mean square. For two it is Hairer's combination in DOP853.
    """
    squared = [ca.sumsqr(error) for error in errors]
    n = max(errors[0].shape[0], 1)
    if len(squared) == 1:
        return ca.sqrt(squared[0] / n)
    return squared[0] / ca.sqrt(n * (squared[0] + 0.01 * squared[1]) + 1e-300)


def _find_events(
    model: Model,
    gaps: ca.Function,
    ode: ca.Function,
    m: Memory,
    path: tuple[Any, ...],
    after: Any,
    scale: Any,
    longest: Any,
) -> Events:
    """Find the changes of contact and slack within a trial step.

    `gaps` are the switching functions of `build_events`, `ode` is the Function of `build_mode_ode`,
    and `m` the state of the step-size control. `path` describes the step by the inputs of `_path`.
    `after` is the final z with the energy supplied. `scale` has the tolerance of each state entry,
    which divides its error. `longest` is the largest step [s].
    """
    _, _, end, _, u, trial, mode = path
    mode_after = gaps(end, u) > 0
    changed = ca.sum1(mode_after != mode)
    power = after.shape[0] > model.nx
    latch = build_latch(model, power) if count_breakable(model) else None
    jump = _jump(ode, scale.shape[0], latch)(
        after, ca.vertcat(u, mode), ca.vertcat(u, mode_after), scale, changed
    )
    bracket = ca.if_else(changed > 0, m.low, trial), ca.if_else(changed > 0, trial, m.high)
    root = build_root(gaps, model)(*path, *bracket, ca.logic_or(changed > 0, m.high > 0))
    negligible = ca.logic_or((trial - root) * jump <= EVENT_SHARE, trial - root <= 1e-15 * longest)
    return Events(
        changed, ca.logic_and(changed > 0, negligible), build_hidden(gaps, model)(*path), root, jump
    )


def _break_strings(model: Model, z: Any, u: Any, power: bool) -> tuple[Any, Any]:
    """Mark strings that are overloaded at the start of a step as broken.

    z is the state, and u the control with the parameters. With `power`, the last entry of z is the
    energy supplied. Returns a flag that there are such strings, None if no string can break, and z
    after the change.
    """
    if not count_breakable(model):
        return None, z
    overloaded = ca.mmin(build_margins(model)(z[: model.nx], u)) <= 0
    return overloaded, build_latch(model, power)(z, u)


def _decide(
    m: Memory,
    trial: Any,
    error: Any,
    events: Events,
    order: int,
    longest: Any,
    overloaded: Any,
) -> tuple[Any, Any]:
    """Accept or reject a trial step, and choose the next length.

    `m` is the state of the step-size control. The trial step has the length `trial` [s], the
    `events` within it, and the scaled error norm `error` of a method of this `order`. Steps are at
    most `longest` s. Steps from an `overloaded` start are repeated from the start with broken
    strings. Returns whether the step is repeated, and the new state of the step-size control.
    """
    # Step-size factor of Hairer, Nørsett, Wanner I, (II.4.13).
    growth = ca.fmin(8.0, ca.fmax(0.2, 0.9 * ca.fmax(error, 1e-300) ** (-1 / order)))
    passed, bracketed, zero = error <= 1, m.high > 0, ca.MX(0)  # NaN does not pass
    crossing = ca.logic_and(events.changed > 0, ca.logic_not(events.located))
    early = ca.logic_and(bracketed, ca.logic_and(events.changed == 0, trial < m.high))
    unseen = ca.logic_and(
        events.hidden > 0, ca.logic_and(events.changed == 0, trial > NEGLIGIBLE * longest)
    )
    suspect = ca.logic_and(unseen, ca.logic_not(bracketed))

    rejected = m._replace(
        step=trial * growth, low=zero, high=zero, trials=zero, rejected=m.rejected + 1
    )
    inspected = m._replace(step=trial * events.hidden, located=m.located + 1)
    allowed = EVENT_SHARE / ca.fmax(events.jump, 1e-300)
    shortened = _aim(m._replace(high=trial, allowed=allowed, located=m.located + 1), events.root)
    lengthened = _aim(m._replace(low=trial, located=m.located + 1), events.root)
    grown = ca.fmin(
        longest, ca.if_else(trial < m.step, ca.fmax(m.step, trial * growth), trial * growth)
    )
    met = m.events + events.changed
    taken = m._replace(
        rest=m.rest - trial,
        step=grown,
        low=zero,
        high=zero,
        trials=zero,
        accepted=m.accepted + 1,
        events=met,
    )

    memory = ca.vertcat(*taken)
    outcomes = [
        (early, lengthened),
        (crossing, shortened),
        (suspect, inspected),
        (ca.logic_not(passed), rejected),
    ]
    again = ca.logic_or(ca.logic_not(passed), ca.logic_or(suspect, ca.logic_or(crossing, early)))
    if overloaded is not None:
        outcomes.append((overloaded, m._replace(located=m.located + 1)))
        again = ca.logic_or(again, overloaded)
    for condition, outcome in outcomes:
        memory = ca.if_else(condition, ca.vertcat(*outcome), memory)
    return again, memory


def _aim(m: Memory, root: Any) -> Memory:
    """Choose the next trial step that locates an event in a bracket.

    The bracket is from `m.low` to `m.high`. The step ends half the allowed overshoot after the
    interpolated `root` [s]. It ends in the middle of the bracket if that is outside or converges
    slowly.
    """
    aim = root + m.allowed / 2
    inside = ca.logic_and(ca.logic_and(aim > m.low, aim < m.high), m.trials < MAX_INTERPOLATIONS)
    return m._replace(aim=ca.if_else(inside, aim, (m.low + m.high) / 2), trials=m.trials + 1)


def _jump(ode: ca.Function, moving: int, latch: ca.Function | None) -> ca.Function:
    """Build the norm of the change of ẋ between two modes.

    `ode` is the Function of `build_mode_ode`, and `moving` the number of state entries in the norm.
    Function (z, w, w_after, scale, changed) → norm, in which w is (u, mode). It evaluates nothing
    and returns 0 if no mode has changed. `latch` marks overloaded strings as broken.
    """
    z, w, after = (
        ca.MX.sym("z", ode.sparsity_in(0)),
        ca.MX.sym("w", ode.sparsity_in(1)),
        ca.MX.sym("after", ode.sparsity_in(1)),
    )
    scale = ca.MX.sym("scale", moving)
    arguments = [z, w, after, scale]
    later = z if latch is None else latch(z, w[: latch.size1_in(1)])
    difference = ca.Function(
        "difference", arguments, [_norm([(ode(later, after) - ode(z, w))[:moving] / scale])]
    )
    nothing = ca.Function("nothing", arguments, [ca.MX(0)])
    changed = ca.MX.sym("changed")
    choice = ca.Function.if_else("jump_choice", difference, nothing)
    return ca.Function("jump", [*arguments, changed], [choice(changed > 0, *arguments)])

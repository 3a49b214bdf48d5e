"""Events: slack strings, contacts and breaks, with smooth dynamics between.

Strings go slack or taut, and nodes meet or leave the ground. A mode is 1 for each taut string and
each closed contact, else 0. Within a mode all forces are smooth. The mode changes at sign changes
of its switching functions.

Strings also break, where their margins to failure vanish. That changes the state instead of the
mode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.dynamics.force_element import NodeMotion
from tenscasadi.util.casadi_tools import hermite_cubic, sparse

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


def build_switching(model: Model) -> ca.Function | None:
    """Build switching functions, positive for taut strings and closed contacts.

    Function (x, u) → g (k,) [m]. Strings come first, then contacts. None if the scene has no such
    events. x is the state, and u the control with the parameters.
    """
    scene, mech = model.scene, model.mechanism
    if not count_switches(model):
        return None
    x, u = model.symbols(not mech.large)
    N, V, time = model.unpack(x)
    w = model.add_schedule(model.extend_inputs(x, u), time)
    elements = forces.build_elements(scene, mech, w)
    at = NodeMotion(N, V, time)
    rows = [element.switches(at) for element in elements if element.switch_count]
    return ca.Function(
        "switching", [x, u], ca.cse([ca.densify(ca.horzcat(*rows).T)]), ["x", "u"], ["g"]
    )


def build_mode_ode(model: Model, work: bool = False, spare: int = 0) -> ca.Function:
    """Build the equations of motion in a fixed mode.

    The mode has 1 for each taut string and closed contact, else 0. Function (z, w) → ż with z = x
    and w = (u, mode (k,)), whatever the switching functions are. `spare` more entries of w have no
    effect.

    With `work`, z has one more entry, the work of all forces [J]. `build_potential` gives its part
    from stored energy. That part has kinks where a stretched, damped string goes slack, so
    integrating it would lose the order.
    """
    kind: Any = ca.MX if model.mechanism.large else ca.SX  # staged functions have no mode input
    size = model.nw + count_switches(model) + spare
    z, w = kind.sym("z", model.nx + work), kind.sym("w", size)
    x = z[: model.nx]
    N, V, time = model.unpack(x)
    own, mode = split_mode(model, w)
    u = model.extend_inputs(x, own)
    acceleration = forward_dynamics(model, N, V, u, time, mode)[0]
    parts = [model.pack(V, acceleration, model.internal_rates(x, own, mode), 1)]
    if work:
        mech = model.with_masses(u, inverse=False)
        if model.scene.supports is None:
            push = forces.total(model.scene, mech, N, V, model.add_schedule(u, time), time, mode)
        else:  # reactions of moving supports do work
            push = ca.mtimes(acceleration, sparse(mech.M))
        parts.append(ca.sum2(ca.sum1(push * V)) + model.internal_power(x, own, False, mode))
    return ca.Function(
        "held", [z, w], ca.cse([ca.densify(ca.vertcat(*parts))]), ["z", "w"], ["zdot"]
    )


def split_mode(model: Model, w: Any) -> tuple[Any, Any]:
    """Split w = (u, mode) into input (nw,) and mode (1×k).

    The input is the control followed by the parameters.
    """
    count = count_switches(model)
    return w[: model.nw, :], w[model.nw : model.nw + count, :].T if count else None


def build_potential(model: Model) -> ca.Function:
    """Build the energy whose change is not in `Model.power`.

    Function (x, u) → elastic and gravity energy [J]; 0 under a control schedule.
    """
    x, u = model.symbols(not model.mechanism.large)
    if model.schedule is not None:
        return ca.Function("potential", [x, u], [ca.DM(0)], ["x", "u"], ["potential"])
    mech = model.with_masses(u, inverse=False)
    w = model.extend_inputs(x, u)
    total = ca.densify(sum(forces.potential_energy(model.scene, mech, model.unpack(x)[0], w)))
    return ca.Function("potential", [x, u], [total], ["x", "u"], ["potential"])


def count_switches(model: Model) -> int:
    """Count the strings that can go slack, and the contacts."""
    w = model.extend_inputs(ca.DM(model.initial_state), ca.DM(model.stack_inputs()))
    elements = forces.build_elements(model.scene, model.mechanism, w)
    return sum(element.switch_count for element in elements)


def count_breakable(model: Model) -> int:
    """Count the cables, and strings in no cable, that can break."""
    return len(model.scene.breakable_inputs)


def build_margins(model: Model) -> ca.Function:
    """Build the elongations that strings can bear before they break.

    Function (x, u) → margins (m,) [m] of breakable cables and strings in no cable. They are
    positive for intact and for broken ones. x is the state, and u the control with the parameters.
    """
    x, u = model.symbols(not model.mechanism.large)
    N, V, time = model.unpack(x)
    w = model.add_schedule(model.extend_inputs(x, u), time)
    elements = forces.build_elements(model.scene, model.mechanism, w)
    at = NodeMotion(N, V, time)
    rows = ca.horzcat(*(element.margins(at) for element in elements))
    return ca.Function("margins", [x, u], ca.cse([ca.densify(rows.T)]), ["x", "u"], ["margins"])


def build_events(model: Model) -> ca.Function | None:
    """Build the switching functions, and margins to failure, of a model.

    Function (x, u) → (k + m,) [m]; None if the scene has no events. There are k switching
    functions, see `build_switching`, and m margins, see `build_margins`.
    """
    gaps = build_switching(model)
    if not count_breakable(model):
        return gaps
    x, u = model.symbols(False)
    rows = [] if gaps is None else [gaps(x, u)]
    return ca.Function(
        "events", [x, u], [ca.vertcat(*rows, build_margins(model)(x, u))], ["x", "u"], ["g"]
    )


def build_latch(model: Model, work: bool) -> ca.Function:
    """Build the change of the state at which strings break.

    Function (z, u) → z, in which strings with a margin of 0 or less are marked as broken. z is the
    state, and u the control with the parameters. With `work`, the last entry of z is the energy
    supplied [J], to which the change of the stored energy is added. If no string breaks, only the
    margins are evaluated.
    """
    count, margins = count_breakable(model), build_margins(model)
    z, u = ca.MX.sym("z", model.nx + work), ca.MX.sym("u", model.nw)
    whole = ca.MX.sym("whole", count)
    x = z[: model.nx]
    end = model.moving.stop - count  # the last internal states are the times
    states = ca.vertcat(x[: end - count], x[end - count : end] * whole, x[end:])
    outputs = [states]
    if work:
        stored = build_potential(model)
        outputs.append(z[model.nx :] + stored(states, u) - stored(x, u))
    symbols = [z, u, whole]
    broken = ca.Function("broken", symbols, [ca.densify(ca.vertcat(*outputs))])
    intact = ca.Function("intact", symbols, [z])
    choice = ca.Function.if_else("break_choice", broken, intact)
    left = margins(x, u) > 0
    return ca.Function(
        "latch", [z, u], [choice(ca.mmin(left) <= 0, z, u, left)], ["z", "u"], ["z_next"]
    )


def build_hidden(gaps: ca.Function, model: Model) -> ca.Function:
    """Build a search for mode changes within a step.

    `gaps` are the switching functions of `build_events`. The Function returns the fraction of the
    step, a multiple of ¼, at which its cubic interpolation is first in another mode, else 0. See
    `_path` for the inputs.
    """
    x, slope, after, end, u, h, mode = path = _path(gaps, model)
    found = ca.MX(0)
    for t in (0.75, 0.5, 0.25):
        found = ca.if_else(
            ca.sum1((gaps(hermite_cubic(x, slope, after, end, h, t), u) > 0) != mode) > 0, t, found
        )
    return ca.Function("hidden", path, [found])


def build_root(gaps: ca.Function, model: Model) -> ca.Function:
    """Build a search for the time of the first event in a bracket.

    `gaps` are the switching functions of `build_events`. Function (*path, low, high, wanted) → time
    [s] at which the cubic interpolation of a step switches. The bracket is from `low` to `high`,
    times from the start of the step; see `_path` for the other inputs. It evaluates nothing unless
    `wanted`.
    """
    x, slope, after, end, u, h, mode = path = _path(gaps, model)
    t = ca.MX.sym("t")
    sign = 2 * mode - 1
    value = ca.Function(
        "value",
        [t, *path],
        [ca.mmin(sign * gaps(hermite_cubic(x, slope, after, end, h, t / h), u))],
    )
    found = search_root(value, path)
    arguments = [*path, ca.MX.sym("low"), ca.MX.sym("high")]
    nothing = ca.Function("nothing", arguments, [ca.MX(0)])
    wanted = ca.MX.sym("wanted")
    return ca.Function(
        "root",
        [*arguments, wanted],
        [ca.Function.if_else("root_choice", found, nothing)(wanted, *arguments)],
    )


def search_root(value: ca.Function, path: list[ca.MX]) -> ca.Function:
    """Build Ridders' search for a root in a bracket.

    `value` is a Function (t, *path) that falls from positive to negative, and `path` are the
    symbols of its other inputs. The result is a Function (*path, low, high) → time [s] just after
    the root, at which `value` is negative. The time is an end of the bracket from `low` to `high`
    if both ends have the same sign.
    """
    low, high = ca.MX.sym("low"), ca.MX.sym("high")
    a, b, at_a, at_b = (ca.MX.sym(name) for name in ("a", "b", "at_a", "at_b"))
    middle = (a + b) / 2
    at_middle = value(middle, *path)
    new = middle + (middle - a) * at_middle / ca.sqrt(at_middle**2 - at_a * at_b + 1e-300)
    at_new = value(new, *path)
    before, half = at_new > 0, at_middle > 0
    ends = [
        ca.if_else(before, new, ca.if_else(half, middle, a)),
        ca.if_else(before, ca.if_else(half, b, middle), new),
    ]
    ends += [
        ca.if_else(before, at_new, ca.if_else(half, at_middle, at_a)),
        ca.if_else(before, ca.if_else(half, at_b, at_middle), at_new),
    ]
    ridders = ca.Function("ridders", [a, b, at_a, at_b, *path], ends)
    bracket = [low, high, value(low, *path), value(high, *path)]
    sure = ca.logic_and(bracket[2] > 0, bracket[3] < 0)
    outside = ca.if_else(bracket[2] > 0, high, low)
    for _ in range(8):
        bracket = list(ridders(*bracket, *path))
    return ca.Function("found", [*path, low, high], [ca.if_else(sure, bracket[1], outside)])


def _path(gaps: ca.Function, model: Model) -> list[ca.MX]:
    """Create the symbols that describe a step for its interpolation.

    They are x and ẋ, the final x and ẋ, u, the length [s] and the mode. `gaps`, the switching
    functions of `build_events`, give the size of the mode.
    """
    ends = [ca.MX.sym(name, model.nx) for name in ("x", "slope", "after", "end")]
    return [*ends, ca.MX.sym("u", model.nw), ca.MX.sym("h"), ca.MX.sym("mode", gaps.size1_out(0))]

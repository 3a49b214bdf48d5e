"""Strings that break within a time step.

A string breaks at the instant at which its margin to failure vanishes, see `build_margins`. A step
of any scheme ends there, the string is marked as broken, and another step follows. The order of the
scheme is kept.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi as ca

from tenscasadi.integrators.events import build_latch, build_margins, count_breakable, search_root

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


def split_at_breaks(step: ca.Function, model: Model) -> ca.Function:
    """Build a step that is divided where strings break.

    `step` is a Function (z, u, h, …) → z_next of a scheme: z is the state of `model`, u the control
    with the parameters, and h the length [s]. The result has the same form, and is `step` if no
    string can break. A step without a break costs two more evaluations of the margins to failure.
    """
    if not count_breakable(model):
        return step
    symbols: list[Any] = [ca.MX.sym(step.name_in(i), step.size1_in(i)) for i in range(step.n_in())]
    z, u, h, *numbers = symbols
    margins, latch = build_margins(model), build_latch(model, step.size1_in(0) > model.nx)
    rest, time = ca.MX.sym("rest"), ca.MX.sym("time")

    def least(state: Any) -> Any:
        return ca.mmin(margins(state[: model.nx], u))

    path = [z, u, *numbers]
    value = ca.Function("value", [time, *path], [least(step(z, u, time, *numbers))])
    root = search_root(value, path)(*path, 0, rest)
    after = ca.MX.sym("after", z.shape[0])
    arguments = [z, rest, after, u, *numbers]
    stop = ca.Function("stop", arguments, [latch(step(z, u, root, *numbers), u), rest - root])
    end = ca.Function("end", arguments, [after, ca.MX(0)])
    trial = step(z, u, rest, *numbers)
    chosen = ca.Function.if_else("stop_choice", stop, end)
    outputs: Any = chosen(least(trial) <= 0, z, rest, trial, u, *numbers)
    piece = ca.Function("piece", [z, rest, u, *numbers], outputs)
    done = ca.Function("done", [z, rest, u, *numbers], [z, rest])
    go_on = ca.Function.if_else("piece_choice", piece, done)
    state, left = latch(z, u), h
    for _ in range(count_breakable(model) + 1):
        state, left = go_on(left > 0, state, left, u, *numbers)
    return ca.Function("step", symbols, [state], step.name_in(), step.name_out())

"""The time loop as one CasADi Function: many steps a call, the state after each of them returned."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.scheme import Scheme
from tenscasadi.integrators.stabilization import Correction, correct

# calls in a row at each level of nesting: code and work space grow like the logarithm of the steps
_BASE = 32
_LONGEST = 1024  # steps a call; beyond this the cost of a call no longer shows
# instructions a call, some 0.05 s compiled: checks, progress bar and Ctrl-C wait no longer than
# this
_WORK = 5e7


def chunk_steps(model: Model, every: int) -> int:
    """Choose the steps of one call: a multiple of `every` that depends on the model alone, so that one compiled loop serves runs of any length."""
    work = (
        4 * max(count_instructions(model.ode), 20 * model.nx) + 1
    )  # mapped functions count once: 20 a state is what members cost
    steps = 2 ** int(np.log2(np.clip(_WORK / work, 1, _LONGEST)))
    return int(every * max(1, steps // every))


def block_steps(model: Model, every: int) -> int:
    """Count the steps of a block of the compiled loop: a run that ends inside one computes the whole of it."""
    return every * min(_BASE, chunk_steps(model, every) // every)


def chunk_function(
    model: Model,
    scheme: Scheme,
    correction: Correction | None,
    power: bool,
    jumps: bool,
    steps: int,
) -> ca.Function:
    """Chain `steps` steps: Function "chunk" (z, h (1, steps), u (nw, steps)[, u_next (nw, steps)]) -> z after each step (nz, steps).

    z is the state x; with `power` or `jumps`, one entry more: the energy in joule supplied to the
    model up to then by forces outside `model.energy` (`power`), and by changes of the control from
    u to u_next at the end of a step (`jumps`). With `jumps` there is an input u_next. The last
    input of Collocation is "tolerance" (1, steps): one compiled loop serves all.
    """
    project = None if correction is None else correction.step(model)
    plain = _advance(model, scheme, None, power, jumps)
    if correction is None or project is None:
        return _repeat("chunk", plain, steps)
    corrected = _advance(model, scheme, project, power, jumps)
    if correction.every == 1:
        return _repeat("chunk", corrected, steps)
    return _repeat(
        "chunk",
        _chain("corrected", [_repeat("plain", plain, correction.every - 1), corrected]),
        steps // correction.every,
    )


def _advance(
    model: Model, scheme: Scheme, project: ca.Function | None, power: bool, jumps: bool
) -> ca.Function:
    """Write one step, then the projection, then the account of the energy supplied."""
    nz = model.nx + (power or jumps)
    z, h, u, u_next = (
        ca.MX.sym("z", nz),
        ca.MX.sym("h"),
        ca.MX.sym("u", model.nw),
        ca.MX.sym("u_next", model.nw),
    )
    own = {"tolerance": ca.MX.sym("tolerance")} if isinstance(scheme, Collocation) else {}
    build = scheme.advance_within if isinstance(scheme, Collocation) else scheme.advance
    if power and model.power is not None:
        end = build(model, model.stacked(model.power))(z, u, h, *own.values())
    else:
        end = ca.vertcat(build(model)(z[: model.nx, :], u, h, *own.values()), z[model.nx :, :])
    x, supplied = (
        end[: model.nx, :],
        end[model.nx :, :],
    )  # the second index for a state of one entry, a clock
    if project is not None:
        x = correct(model, project, x, u)
    if jumps:
        energy = model.stacked(model.energy_function)
        supplied = supplied + energy(x, u_next) - energy(x, u)
    inputs = {"z": z, "h": h, "u": u} | ({"u_next": u_next} if jumps else {}) | own
    return ca.Function(
        "advance",
        list(inputs.values()),
        [ca.densify(ca.vertcat(x, supplied))],
        list(inputs),
        ["z_next"],
    )


def _repeat(name: str, step: ca.Function, times: int) -> ca.Function:
    """Chain `step` to itself, in nested blocks of calls, so that the code stays small."""
    calls: list[ca.Function] = [step] * times
    rest: list[ca.Function] = []
    while len(calls) > _BASE:
        blocks, left = divmod(len(calls), _BASE)
        rest = calls[:left] + rest
        calls = [_pass_over(_chain("block", calls[:_BASE]))] * blocks
    return _chain(name, calls + rest)


def _pass_over(block: ca.Function) -> ca.Function:
    """Guard a block: where its first step has no length, each result is its start, so that a run which ends early does not pay for a whole chunk."""
    inputs = [ca.MX.sym(block.name_in(i), *block.size_in(i)) for i in range(block.n_in())]
    still = ca.Function("still", inputs, [ca.repmat(inputs[0], 1, block.size2_out(0))])
    either = ca.Function.if_else("either", block, still)
    return ca.Function(
        "guarded", inputs, [either(inputs[1][0] > 0, *inputs)], block.name_in(), block.name_out()
    )


def _chain(name: str, steps: list[ca.Function]) -> ca.Function:
    """Join Functions (z, inputs column by column) -> z after each column, one after the other, to one of the same kind."""
    offsets = np.cumsum([0, *(step.size2_in(1) for step in steps)]).tolist()
    first = steps[0]
    start = z = ca.MX.sym("z", first.size1_in(0))
    inputs = [
        ca.MX.sym(first.name_in(i), first.size1_in(i), offsets[-1]) for i in range(1, first.n_in())
    ]
    results = []
    for step, *columns in zip(
        steps, *(ca.horzsplit(values, offsets) for values in inputs), strict=True
    ):
        results.append(step(z, *columns))
        z = results[-1][:, -1]
    return ca.Function(
        name, [start, *inputs], [ca.horzcat(*results)], first.name_in(), first.name_out()
    )

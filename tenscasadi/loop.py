"""The time loop as one CasADi Function: many steps a call, the state after each of them returned."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.correction import Correction
from tenscasadi.model import Model, instructions
from tenscasadi.schemes import Scheme
from tenscasadi.validate import Array

_BASE = 16  # steps unrolled into calls at each level of nesting: code and work space grow with its logarithm
_LONGEST = 1024  # steps a call; beyond this the cost of a call no longer shows
_WORK = 5e7  # instructions a call, some 0.05 s compiled: checks, progress bar and Ctrl-C wait no longer than this


def chunk_steps(model: Model, every: int) -> int:
    """Steps of one call: a multiple of `every` that depends on the model alone, so that one compiled loop serves runs of any length."""
    work = 4 * instructions(model.ode) + model.nx + model.nu
    steps = 2 ** int(np.log2(np.clip(_WORK / work, 1, _LONGEST)))
    return int(every * max(1, steps // every))


def chunk_function(model: Model, scheme: Scheme, correction: Correction | None, power: bool, jumps: bool, steps: int) -> ca.Function:
    """`steps` steps: Function "chunk" (z, h (1, steps), u (nu, steps)[, u_next (nu, steps)]) -> z after each step (nz, steps).

    z is the state x; with `power` or `jumps`, one entry more: the energy in joule supplied to the model up to then by forces outside
    `model.energy` (`power`), and by changes of the control from u to u_next at the end of a step (`jumps`). With `jumps` there is
    a fourth input u_next.
    """
    project = None if correction is None else correction.step(model)
    plain = _advance(model, scheme, None, power, jumps)
    if correction is None or project is None:
        return _repeat("chunk", plain, steps)
    corrected = _advance(model, scheme, project, power, jumps)
    if correction.every == 1:
        return _repeat("chunk", corrected, steps)
    return _repeat("chunk", _append(_repeat("uncorrected", plain, correction.every - 1), corrected), steps // correction.every)


def _advance(model: Model, scheme: Scheme, project: ca.Function | None, power: bool, jumps: bool) -> ca.Function:
    """One step, then the projection, then the account of the energy supplied."""
    nz = model.nx + (power or jumps)
    z, h, u, u_next = ca.MX.sym("z", nz), ca.MX.sym("h"), ca.MX.sym("u", model.nu), ca.MX.sym("u_next", model.nu)
    if power and model.power is not None:
        end = scheme.step(_with_work(model.ode, model.power))(z, u, h)
    else:
        end = ca.vertcat(scheme.step(model.ode)(z[: model.nx], u, h), z[model.nx :])
    x, supplied = end[: model.nx], end[model.nx :]
    if project is not None:
        x = project(x)
    if jumps:
        energy = energy_function(model)
        supplied = supplied + energy(x, u_next) - energy(x, u)
    inputs = {"z": z, "h": h, "u": u} | ({"u_next": u_next} if jumps else {})
    return ca.Function("advance", list(inputs.values()), [ca.densify(ca.vertcat(x, supplied))], list(inputs), ["z_next"])


def _with_work(ode: ca.Function, power: ca.Function) -> ca.Function:
    """The ode with the work of forces outside the model's energy as one more state, so that the scheme integrates both alike."""
    x, u, work = ca.MX.sym("x", ode.size1_in(0)), ca.MX.sym("u", ode.size1_in(1)), ca.MX.sym("work")
    return ca.Function("ode_and_work", [ca.vertcat(x, work), u], [ca.vertcat(ode(x, u), power(x, u))], ["z", "u"], ["zdot"])


def energy_function(model: Model) -> ca.Function:
    """(x, u) -> total energy in joule, without the rest of what `model.observe` computes."""
    kind: Any = ca.SX if model.observe.is_a("SXFunction") else ca.MX
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    return ca.Function("energy", [x, u], [ca.sum1(model.observe(x, u)[model.observe.index_out("energy")])], ["x", "u"], ["energy"])


def _append(head: ca.Function, last: ca.Function) -> ca.Function:
    """`head`, a repeated step, and `last` after it."""
    columns = [ca.MX.sym(last.name_in(i), last.size1_in(i), head.size2_in(i) + 1) for i in range(1, last.n_in())]
    z = ca.MX.sym("z", last.size1_in(0))
    through = head(z, *(values[:, :-1] for values in columns))
    end = last(through[:, -1], *(values[:, -1] for values in columns))
    return ca.Function("block", [z, *columns], [ca.horzcat(through, end)], last.name_in(), ["z_next"])


def _repeat(name: str, step: ca.Function, times: int) -> ca.Function:
    """`step` chained: its first input is what it last returned (the last column), its others come column by column; all results are returned."""
    if step.size2_out(0) > 1:  # chain on the last column
        inputs = step.mx_in()
        columns = step(*inputs)
        step = ca.Function("chained", inputs, [columns[:, -1], columns], step.name_in(), ["last", "z_next"])
    chained = step.mapaccum(name, times, [0], [0], {"base": _BASE})
    inputs = chained.mx_in()
    results = chained.call(inputs)
    return ca.Function(name, inputs, [results[-1]], step.name_in(), ["z_next"])


class Runner:
    """A Function (z, h, u[, u_next]) -> columns evaluated on NumPy memory, without conversions."""

    def __init__(self, function: ca.Function, step: float) -> None:
        self._z = np.zeros(function.size1_in(0))
        self._h = np.full(function.size2_in(1), step)
        self.steps = len(self._h)
        self._u = np.zeros((self.steps + 1, function.size1_in(2)))
        self._out = np.zeros((self.steps, len(self._z)))
        self._buffer: Any
        self._buffer, self._trigger = function.buffer()
        inputs = [self._z, self._h, self._u[:-1], self._u[1:]][: function.n_in()]
        for i, values in enumerate(inputs):
            if values.size:
                self._buffer.set_arg(i, values.reshape(-1).data)
        self._buffer.set_res(0, self._out.reshape(-1).data)

    def __call__(self, z: Array, controls: Array) -> Array:
        """z after each step (steps, nz), valid until the next call; `controls` (steps + 1, nu) holds u of each step and the next."""
        self._z[:] = z
        self._u[:] = controls
        self._trigger()
        if self._buffer.ret():
            raise RuntimeError("the time loop stopped: CasADi could not evaluate a step")
        return self._out

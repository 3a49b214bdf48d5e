"""Discretization residuals from an integration in fine steps.

Errors do not accumulate: each interval starts from the planned state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from ocp.problem.path_constraints import compute_margins
from ocp.transcription.sparse_nlp import Program
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.runge_kutta import DormandPrince853
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array


class Shift(NamedTuple):
    """Change of a program that removes a residual, to first order.

    Attributes
    ----------
    bounds : ndarray, shape (m,)
        Shift of the bounds of all constraints.
    velocities : ndarray or float
        Difference of the initial velocities (K, nq) that connect mesh points in fine steps from the
        planned ones [m/s].
    """

    bounds: Array
    velocities: Array | float = 0.0

    @property
    def size(self) -> float:
        """Size of the residual that corrections reduce."""
        return float(np.abs(self.bounds).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class MotionResidual:
    """Difference between a discrete solution and fine integration.

    Attributes
    ----------
    error : float
        Largest distance from an integration in fine steps along the whole plan [m], also for
        velocities × duration.
    states : ndarray
        States (K + 1, nx) of fine steps along the whole plan.
    find_shift : callable
        Function without arguments that computes `shift`.
    check_limits : callable
        Function without arguments that computes `kept`.
    """

    error: float
    states: Array
    find_shift: Callable[[], Shift]
    check_limits: Callable[[], bool]

    # A plan within the accuracy needs no shift, one beyond it no limits.

    @cached_property
    def shift(self) -> Shift:
        """Shift of the program."""
        return self.find_shift()

    @property
    def kept(self) -> bool:
        """Whether the states satisfy the limits of the program, within the margins of reports."""
        return self.check_limits()


# of unknowns w, and of the residual of a solution nearby
Measure = Callable[[Array, MotionResidual | None], MotionResidual]


class FineSteps:
    """Integration in fine steps of order 8 under planned controls.

    The plan is a solution of the program. `fractions` (K,) are the interval lengths relative to the
    duration.
    """

    def __init__(self, program: Program, model: Model, fractions: Array) -> None:
        self.program, self.model, self.fractions = program, model, fractions
        self.linear = program.unpack.size2_out(1) > len(fractions)
        step = model.keep("fine step", lambda: _build_step(model))
        self._each, self._chain = step.map(len(fractions)), step.mapaccum(len(fractions))

    def planned(self, w: Array) -> tuple[Array, tuple[Array, ...], float]:
        """Unpack states, arguments of the fine steps, and the duration.

        `w` are the scaled decision variables. The arguments are controls at the starts and ends of
        the intervals (α, K), and interval lengths (1, K) [s].
        """
        states, gamma, T = (one.full() for one in self.program.unpack(w))
        held = (gamma[:, :-1], gamma[:, 1:]) if self.linear else (gamma, gamma)
        duration = float(T.squeeze())
        return states.T, (*held, duration * self.fractions[None]), duration

    def ends(self, leaving: Array, held: tuple[Array, ...]) -> Array:
        """Integrate each interval from a given state to its end.

        `leaving` are the states (K, nx) at the starts of the intervals. `held` are the arguments
        that `planned` returns.
        """
        return np.asarray(self._each(leaving.T, *held).full()).T

    def measure(self, w: Array, find_shift: Callable[[], Shift]) -> MotionResidual:
        """Compare a plan with an integration of the whole plan in fine steps.

        `w` are the scaled decision variables. `find_shift` computes the shift of the program.
        """
        states, held, duration = self.planned(w)
        later = self._chain(states[0], *held).full()
        fine = np.column_stack([states[0], later]).T
        places, speeds, *_ = self.model.split(np.abs(fine - states) * self.program.known)
        error = float(max(places.max(initial=0.0), duration * speeds.max(initial=0.0)))
        return MotionResidual(error, fine, find_shift, lambda: self.keeps_limits(w, fine))

    def keeps_limits(self, w: Array, states: Array) -> bool:
        """Return whether states (K + 1, nx) satisfy path constraints and limits of rates.

        They replace those of the scaled decision variables `w`.
        """
        unknowns = self.program.parts.unknowns
        y = np.concatenate([unknowns.scale * w, unknowns.constants])
        y[self.program.states] = states
        for block in self.program.parts.rows:
            if block.kind not in ("path", "rate"):
                continue
            value = block.value(y[block.index].T).full().T
            lower, upper, _ = (limit.reshape(value.shape)[0] for limit in block.limits())
            below, above = compute_margins(value, lower, upper)
            if np.any(value < lower - below) or np.any(value > upper + above):
                return False
        return True


def _build_step(model: Model) -> ca.Function:
    """Build the fine step (x, u, v, h) → x_next.

    The control changes linearly from u to v within the step h [s].
    """
    x, u, v, h = (
        ca.MX.sym(name, size)
        for name, size in (("x", model.nx), ("u", model.nu), ("v", model.nu), ("h", 1))
    )
    z, rate = ca.MX.sym("z", model.nx + model.nu), ca.MX.sym("rate", model.nu)
    rates = ca.vertcat(model.ode(z[: model.nx], z[model.nx :]), rate)
    advance = DormandPrince853().step(ca.Function("ramped", [z, rate], [rates]))
    end = advance(ca.vertcat(x, u), (v - u) / h, h)[: model.nx]
    if model.mechanism.constrained:
        end = build_projection(model, 1)(end)
    return ca.Function("interval", [x, u, v, h], [end])


def measure_ends(program: Program, model: Model, fractions: Array) -> Measure:
    """Prepare the discretization residual of one-step methods.

    It is the change of the defects if fine steps replace the states at the interval ends.
    `fractions` (K,) are the interval lengths relative to the duration. Returns the function that
    `Transcription.measure_residual` describes.
    """
    fine, unknowns = FineSteps(program, model, fractions), program.parts.unknowns
    size = unknowns.count + len(unknowns.constants)
    node = np.full(size, -1)
    node[program.states[1:]] = np.arange(1, len(program.states))[:, None]
    blocks = [
        (block, rows)
        for block, rows in zip(program.parts.rows, program.parts.slices, strict=True)
        if block.kind == "defect"
    ]

    def find_shift(w: Array) -> Shift:
        states, held, _ = fine.planned(w)
        y = np.concatenate([unknowns.scale * w, unknowns.constants])
        ends = y.copy()
        ends[program.states[1:]] = fine.ends(states[:-1], held)
        shift = np.zeros(len(program.lower))
        for block, rows in blocks:
            own = node[block.index]
            after = own == np.maximum(own.max(axis=1), 0)[:, None]
            z = np.where(after, ends[block.index], y[block.index])
            moved, here = (block.value(one.T) for one in (z, y[block.index]))
            shift[rows] = (moved - here).full().ravel(order="F")
        return Shift(shift)

    def measure(w: Array, near: MotionResidual | None = None) -> MotionResidual:
        return fine.measure(w, lambda: find_shift(w))

    return measure


def measure_jumps(program: Program, model: Model, fractions: Array) -> Measure:
    """Prepare the discretization residual of the variational method.

    Fine steps connect successive mesh points by a suitable initial velocity in each interval. The
    residual is the jump between the final velocity of an interval and the initial velocity of the
    next one, as a change of momentum. `fractions` (K,) are the interval lengths relative to the
    duration. Returns the function that `Transcription.measure_residual` describes.
    """
    fine, mech, nq = FineSteps(program, model, fractions), model.mechanism, model.nq
    project = build_projection(model, 1).map(len(fractions)) if mech.constrained else None
    momentum = model.keep("momentum", lambda: _build_momentum(model))
    ends, middle = (_find_rows(program, name) for name in ("ends", "middle"))

    def leave(leaving: Array, places: Array, held: tuple[Array, ...], lengths: Array) -> Array:
        """Find initial velocities whose trajectories end at the mesh points.

        `held` are the arguments of `FineSteps.ends`, `lengths` (K,) the interval lengths [s].
        `leaving` are the initial states, changed in place, and `places` the positions at the ends
        of the intervals. Errors of a tenth of the largest velocity jump remain, as each correction
        leaves about as much. Returns the final velocities.
        """
        sufficient, least = 0.1, np.inf
        while True:
            if project is not None:
                leaving[:] = project(leaving.T).full().T
            arrived = fine.ends(leaving, held)
            missed = (places - arrived[:, :nq]) / lengths[:, None]
            after = arrived[:, nq : 2 * nq]
            jumps = np.abs(leaving[1:, nq : 2 * nq] - after[:-1]).max(initial=0.0)
            size = float(np.abs(missed).max(initial=0.0))
            if not size < 0.5 * least or size <= sufficient * jumps:
                return after
            least = size
            leaving[:, nq : 2 * nq] += missed

    def find_shift(w: Array, near: MotionResidual | None) -> Shift:
        states, held, duration = fine.planned(w)
        planned, leaving = states[:, nq : 2 * nq], states[:-1].copy()
        leaving[:, nq : 2 * nq] += 0.0 if near is None else near.shift.velocities
        arrived = leave(leaving, states[1:, :nq], held, duration * fractions)
        left = leaving[:, nq : 2 * nq]
        at_ends = np.vstack([left[:1] - planned[:1], arrived[-1:] - planned[-1:]])
        jumps = [at_ends, left[1:] - arrived[:-1], arrived[:-1] - planned[1:-1]]
        shift = np.zeros(len(program.lower))
        # Rows of interior velocities exist only if these are unknowns.
        for rows, jump in zip([ends[0], *middle, *ends[1:]], jumps, strict=False):
            moved = duration * momentum(jump.T).full().ravel(order="F")
            shift[rows] = -moved / program.scale[rows]
        return Shift(shift, left - planned[:-1])

    def measure(w: Array, near: MotionResidual | None = None) -> MotionResidual:
        return fine.measure(w, lambda: find_shift(w, near))

    return measure


def _find_rows(program: Program, name: str) -> list[slice]:
    """Find the constraint rows of blocks with a named Function.

    `name` is that of the Function. Returns one slice of rows for each block.
    """
    parts = program.parts
    return [
        rows
        for block, rows in zip(parts.rows, parts.slices, strict=True)
        if block.function.name() == name
    ]


def _build_momentum(model: Model) -> ca.Function:
    """Build the Function from velocities (nq) to momenta (nq)."""
    v = ca.SX.sym("v", model.nq)
    clock = [0.0] * (model.nx - 2 * model.nq)
    _, V, _ = model.unpack(ca.vertcat(v, v, *clock))
    if model.scene.supports is not None:  # prescribed velocities have no jumps
        V[:, model.scene.supports.nodes] = 0.0
    P = ca.mtimes(V, sparse(model.mechanism.M))
    return ca.Function("momentum", [v], [model.mechanism.generalized_forces(P)])

"""Motion as equations between the ends of an interval: the implicit midpoint rule, with bars kept by multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.target import Scales, Target
from ocp.problem.problem import Problem
from ocp.transcription.base import OnGrid, unrolled
from ocp.transcription.initial_guess import Guess
from ocp.transcription.sparse_nlp import Block
from ocp.transcription.variables import Assembly, Program, interval_names, state_names
from tenscasadi.dynamics import mechanism as dynamics
from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Indices


@dataclass(frozen=True)
class ImplicitMidpoint(OnGrid):
    """x⁺ = x + h f((x + x⁺)/2, γ) as a constraint: order 2, one evaluation of f, stable for any interval.

    The rule itself keeps bᵀḃ, but lets bar lengths drift by O(h²): multipliers along the bars, two for each bar and interval, put lengths and
    rates right at the end of every interval, in the sense of Gear, Gupta, Leimkuhler (1985, J. Comput. Appl. Math. 12, 77). They vanish
    with h, and the order stays.
    """

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess. ValueError for full coordinates and moved supports."""
        model = problem.model
        check_reduced("ImplicitMidpoint", model)
        a = self.assembly(problem, target, scales, guess)
        closing = Closing(a)
        for k in range(a.count):
            a.add_control(k)
            closing.add(k)
            a.add_state(k + 1)
        if self.control.linear:
            a.add_control(a.count)
        a.add_duration()
        z, (x, c, after, m, duration, share) = parts(model.nx, a.interval_controls.shape[1], model.nx, closing.size, 1, 1)
        end = x + duration * share * model.ode((x + after) / 2, a.gamma(c, 0.5))
        function = unrolled(model, ca.Function("midpoint", [z], [closing.rows(end, after, m)]))
        index = np.hstack([a.states[:-1], a.interval_controls, a.states[1:], closing.index, a.repeated(a.duration), a.share])
        a.rows.append(Block(function, index, interval_names(a.count, (*state_names(model), *closing.names))))
        return a.finish()


class Closing:
    """Rows that say where an interval ends, up to multipliers along the bars which keep lengths and rates there."""

    def __init__(self, a: Assembly) -> None:
        self._a, self.bars = a, a.model.mechanism.bars
        self.size = 2 * self.bars
        self.index: Indices = np.zeros((a.count, self.size), dtype=np.intp)
        self.names = bar_names(self.bars, "length") + bar_names(self.bars, "rate")

    def add(self, k: int) -> None:
        """The multipliers of interval k: kg, and kg/s."""
        mass, time = self._a.scales.mass, self._a.scales.time
        names = [f"{name}, interval {k}" for name in self.names]
        self.index[k] = self._a.unknowns.add(names, 0.0, np.repeat([mass, mass / time], self.bars), stage=k)

    def rows(self, end: Any, after: Any, multipliers: Any) -> Any:
        """x⁺ − end − M⁻¹ (what the multipliers push), and the bars' lengths and rates at x⁺, all scaled."""
        model, scales = self._a.model, self._a.scales
        mech = model.mechanism
        gap = after - end
        if self.bars:
            N, _, _ = model.unpack(after)
            B = ca.mtimes(N, sparse(mech.C_b.T))
            none = ca.DM.zeros(3, 0)
            moves = [mech.with_inverse(dynamics.push(mech, B, m.T, none)) for m in ca.vertsplit(multipliers, self.bars)]
            gap = gap - model.pack(moves[0], moves[1], 0)
        return ca.vertcat(gap / ca.DM(scales.state), *bar_rows(model, after, scales, rates=True))


def bar_rows(model: Model, x: Any, scales: Scales, rates: bool) -> list[Any]:
    """(bᵀb/l² − 1)/2, and, where wanted, bᵀḃ in the same scale, of the bars at x."""
    mech = model.mechanism
    if not mech.bars:
        return []
    N, V, _ = model.unpack(x)
    B, Bd = (ca.mtimes(Z, sparse(mech.C_b.T)) for Z in (N, V))
    squared = ca.DM(mech.lengths**2)
    rows = [(ca.sum1(B * B).T / squared - 1) / 2]
    return [*rows, ca.sum1(B * Bd).T / squared * scales.time] if rates else rows


def bar_names(count: int, what: str) -> tuple[str, ...]:
    """Names of rows or unknowns, one for each bar."""
    return tuple(f"bar {k} {what}" for k in range(count))


def parts(*sizes: int, kind: Any = ca.MX) -> tuple[Any, tuple[Any, ...]]:
    """A symbol and its pieces of these sizes."""
    z = kind.sym("z", sum(sizes))
    return z, tuple(ca.vertsplit(z, np.cumsum((0, *sizes)).tolist()))


def check_reduced(name: str, model: Model) -> None:
    """ValueError unless bars are all that is to be kept: reduced coordinates, supports that stand still."""
    if model.mechanism.joints:
        raise ValueError(f'{name} keeps bars, not joints: give a problem with Model(scene, coordinates="reduced"), or MultipleShooting')
    if model.scene.supports is not None:
        raise ValueError(f"{name} does not know moved supports (Scene.supports): use MultipleShooting")

"""The base of all transcriptions: a mesh of intervals and a profile of force densities; and the rows that keep bars at its nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.transcription.initial_guess import Guess
from ocp.transcription.mesh import Intervals, PiecewiseConstant, PiecewiseLinear, Profile, check_intervals, fractions
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variables import Assembly
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices, instance, positive_number


@dataclass(frozen=True)
class OnGrid:
    """What all transcriptions have: intervals, a number of equal ones or their relative lengths, and the profile of γ on them.

    accuracy: m, how near (speeds: per duration) the motion shall be to that of fine steps; what the intervals leave is put right by solving again
    from the solution (`ocp.correct`), which takes a few iterations each time. None: as the intervals make it.
    """

    intervals: Intervals = 40
    control: Profile = field(default=PiecewiseConstant(), kw_only=True)
    accuracy: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        name = type(self).__name__
        object.__setattr__(self, "intervals", check_intervals(f"{name}.intervals", self.intervals))
        instance(f"{name}.control", self.control, (PiecewiseConstant, PiecewiseLinear), "ocp.PiecewiseConstant() or ocp.PiecewiseLinear()")
        if self.accuracy is not None:
            positive_number(f"{name}.accuracy", self.accuracy)

    @property
    def count(self) -> int:
        """Intervals."""
        return len(self.fractions)

    @property
    def fractions(self) -> Array:
        """The share of the duration that each interval takes."""
        return fractions(self.intervals)

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess."""
        raise NotImplementedError

    def assembly(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Assembly:
        """An empty program on this grid."""
        return Assembly(problem, target, scales, guess, self.fractions, self.control)


def unrolled(model: Model, function: ca.Function) -> ca.Function:
    """The function as scalar code, where the model's equations are: its derivatives are sparse and quickly built."""
    return function.expand() if model.ode.is_a("SXFunction") else function


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
            B = mech.bar_vectors(N)
            moves = [mech.with_inverse(nodal_forces(mech, B, m.T)) for m in ca.vertsplit(multipliers, self.bars)]
            gap = gap - model.pack(moves[0], moves[1], 0)
        return ca.vertcat(gap / ca.DM(scales.state), *bar_rows(model, after, scales, rates=True))


def bar_rows(model: Model, x: Any, scales: Scales, rates: bool) -> list[Any]:
    """(bᵀb/l² − 1)/2, and, where wanted, bᵀḃ in the same scale, of the bars at x."""
    mech = model.mechanism
    if not mech.bars:
        return []
    N, V, _ = model.unpack(x)
    B, Bd = mech.bar_vectors(N), mech.bar_vectors(V)
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

"""The base of all transcriptions: a mesh of intervals and a profile of force densities; and the rows that keep bars at its nodes.

A transcription is a subclass of `Transcription` that gives `defects`: see
`ocp.transcription.multiple_shooting` for a short one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.targets.target import Target
from ocp.transcription.assemble import Defects, Stage, assemble, problem_blocks
from ocp.transcription.fine_steps import Measure, measure_ends
from ocp.transcription.initial_guess import Guess
from ocp.transcription.mesh import (
    Intervals,
    NamedProfile,
    PiecewiseConstant,
    PiecewiseLinear,
    Profile,
    check_intervals,
    fractions,
)
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variables import Variables
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.model import Model
from tenscasadi.schema.containers import Either
from tenscasadi.schema.definitions import OneOf
from tenscasadi.schema.field_types import TIMES, WHOLE
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, Indices, instance, positive_number


@dataclass(frozen=True)
class Transcription(Value):
    """The options that all transcriptions have.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    control : PiecewiseConstant or PiecewiseLinear
        How force densities run over the intervals.
    accuracy : float, optional
        How near the motion shall be to that of fine steps, m (speeds: m per duration). The program
        is solved again from its solution until it is (`ocp.solvers.correction`). By
        default the motion is as the intervals make it.
    """

    intervals: Annotated[Intervals, Either((list, tuple), TIMES, WHOLE)] = 40
    control: Annotated[Profile, OneOf(NamedProfile)] = field(
        default=PiecewiseConstant(), kw_only=True
    )
    accuracy: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        name = type(self).__name__
        object.__setattr__(self, "intervals", check_intervals(f"{name}.intervals", self.intervals))
        instance(
            f"{name}.control",
            self.control,
            (PiecewiseConstant, PiecewiseLinear),
            "ocp.PiecewiseConstant() or ocp.PiecewiseLinear()",
        )
        if self.accuracy is not None:
            positive_number(f"{name}.accuracy", self.accuracy)

    @property
    def count(self) -> int:
        """Number of intervals."""
        return len(self.fractions)

    @property
    def fractions(self) -> Array:
        """Share of the duration that each interval takes (K,)."""
        return fractions(self.intervals)

    def longest_step(self, duration: float) -> float:
        """Return the longest step, s, of a motion of `duration` s."""
        return duration * float(self.fractions.max())

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """Return the nonlinear program, scaled about the guess. Raise ValueError for a model that the transcription cannot take."""
        self.check_model(problem.model)
        variables = Variables(problem, target, scales, guess, self.fractions, self.control)
        return assemble([self.stage(variables)])

    def stage(self, variables: Variables, *contact: Any) -> Stage:
        """Build all blocks in variables; contact: what `defects` takes beside them."""
        blocks = problem_blocks(variables)
        used = variables.entries.used_by([*blocks.rows, *blocks.costs])
        return Stage(variables, blocks, self.defects(variables, used, *contact))

    def measure_residual(self, program: Program, model: Model) -> Measure:
        """Prepare the residual of solutions against fine steps: gaps between intervals."""
        return measure_ends(program, model, self.fractions)

    def check_model(self, model: Model) -> None:
        """Raise ValueError for a model that the transcription cannot take."""
        refused = self.refusal(model)
        if refused:
            raise ValueError(refused)

    def refusal(self, model: Model) -> str:  # any will do
        """Return why the transcription cannot take a model, and what can; "" where it can."""
        return ""

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Add further unknowns, and return the rows that vanish on a motion; used tells which entries costs, bounds and goals depend on."""
        raise NotImplementedError


class ReducedOnly(Transcription):
    """Transcriptions that keep bars by rows of their own. `solve` gives them problems in full coordinates as those of a `ReducedTwin`."""

    def refusal(self, model: Model) -> str:
        """Return why not, unless bars are all that is to be kept: reduced coordinates."""
        if not model.mechanism.joints:
            return ""
        return f'{type(self).__name__} keeps bars, not joints: give a problem with Model(scene, coordinates="reduced"), or MultipleShooting'


def unrolled(model: Model, function: ca.Function) -> ca.Function:
    """Return the function as scalar code, where the model's equations are: its derivatives are sparse and quickly built."""
    return function.expand() if model.ode.is_a("SXFunction") else function


def scalar_code(function: ca.Function) -> ca.Function:
    """Expand a function, if it has no calls that cannot be: its derivatives take a fraction of the time."""
    try:
        return function.expand()
    except RuntimeError:  # CasADi's word for such a call
        return function


def bar_multipliers(v: Variables) -> Indices:
    """Add two multipliers for each bar and interval, in kg and kg/s, and return their entries (K, 2β)."""
    size = 2 * v.model.mechanism.bars
    names = [f"{name}, interval {k}" for k in range(v.count) for name in end_names(v.model)]
    scale = np.repeat([v.scales.mass, v.scales.mass / v.scales.time], size // 2)
    return v.entries.unknowns(
        names, np.zeros((v.count, size)), scale, interval=np.arange(v.count)[:, None]
    )


def end_rows(v: Variables, end: Any, after: Any, multipliers: Any) -> Any:
    """Return x⁺ − end − M⁻¹ (what the multipliers push), and the bars' lengths and rates at x⁺, all scaled."""
    model, mech = v.model, v.model.mechanism
    gap = after - end
    if mech.bars:
        N, _, _ = model.unpack(after)
        B = mech.bar_vectors(N)
        moves = [
            mech.with_inverse(nodal_forces(mech, B, m.T))
            for m in ca.vertsplit(multipliers, mech.bars)
        ]
        gap = gap - model.pack(moves[0], moves[1], 0)
    return ca.vertcat(gap / ca.DM(v.scales.state), *bar_rows(model, after, v.scales))


def end_names(model: Model) -> tuple[str, ...]:
    """Return the names of the rows that keep bars, and of their multipliers."""
    return bar_names(model.mechanism.bars, "length") + bar_names(model.mechanism.bars, "rate")


def bar_rows(model: Model, x: Any, scales: Scales) -> list[Any]:
    """Return (bᵀb/l² − 1)/2 and bᵀḃ/l², in the same scale, of the bars at x."""
    mech = model.mechanism
    if not mech.bars:
        return []
    N, V, _ = model.unpack(x)
    B, Bd = mech.bar_vectors(N), mech.bar_vectors(V)
    squared = ca.DM(mech.lengths**2)
    return [(ca.sum1(B * B).T / squared - 1) / 2, ca.sum1(B * Bd).T / squared * scales.time]


def bar_names(count: int, what: str) -> tuple[str, ...]:
    """Return names of rows or unknowns, one for each bar."""
    return tuple(f"bar {k} {what}" for k in range(count))

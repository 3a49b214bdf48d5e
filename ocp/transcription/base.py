"""Base class of transcriptions: mesh and control profile.

A transcription is a subclass of `Transcription` that defines `defects`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

from ocp.transcription.fine_steps import Measure, measure_ends
from ocp.transcription.mesh import (
    Intervals,
    NamedProfile,
    PiecewiseConstant,
    PiecewiseLinear,
    Profile,
    check_intervals,
    fractions,
)
from ocp.transcription.sparse_nlp import Block, Program
from ocp.transcription.variables import Variables
from tenscasadi.dynamics.model import Model
from tenscasadi.schema.containers import Either
from tenscasadi.schema.definitions import OneOf
from tenscasadi.schema.field_types import TIMES, WHOLE
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, Check, Positive, of_type


class Defects(NamedTuple):
    """Defect constraints: discretized equations of motion.

    Attributes
    ----------
    rows : list of Block
        The constraints.
    states : callable or None
        Function of the vector y of all variables (see `Entries`) that returns all states (nx, K + 1).
        None if all states are decision variables.
    """

    rows: list[Block]
    states: Callable[[Any], Any] | None = None


@dataclass(frozen=True)
class Transcription(Value):
    """Base class of transcriptions, with their common options.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    control : PiecewiseConstant or PiecewiseLinear
        Profile of the controls over the intervals.
    accuracy : float, optional
        Largest permitted distance of the plan from an integration in fine steps [m]; that of
        velocities is multiplied by the duration. `solve` reaches it by deferred correction.
        Default: no correction.
    """

    intervals: Annotated[Intervals, Either((list, tuple), TIMES, WHOLE), Check(check_intervals)] = (
        40
    )
    control: Annotated[
        Profile,
        OneOf(NamedProfile),
        of_type(
            (PiecewiseConstant, PiecewiseLinear), "ocp.PiecewiseConstant() or ocp.PiecewiseLinear()"
        ),
    ] = field(default=PiecewiseConstant(), kw_only=True)
    accuracy: Positive | None = field(default=None, kw_only=True)

    @property
    def count(self) -> int:
        """Number of intervals."""
        return len(self.fractions)

    @property
    def fractions(self) -> Array:
        """Interval lengths (K,) as fractions of the duration."""
        return fractions(self.intervals)

    def longest_step(self, duration: float) -> float:
        """Compute the longest integration step [s] for a duration [s]."""
        return duration * float(self.fractions.max())

    def measure_residual(self, program: Program, model: Model) -> Measure:
        """Prepare the discretization residual for deferred correction.

        The residual is the difference from an integration in fine steps. The result is a function
        of the scaled decision variables w of the program, and of the residual of a solution nearby
        or None. It returns a `MotionResidual`.
        """
        return measure_ends(program, model, self.fractions)

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Build the defect constraints and their additional variables.

        `variables` are those of the plan or phase. `used` marks the ones on which limits, costs and
        goals depend.
        """
        raise NotImplementedError

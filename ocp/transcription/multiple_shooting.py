"""Multiple shooting: the states between intervals are unknowns, each interval is integrated by an explicit scheme."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import casadi as ca
import numpy as np

from ocp.transcription.assemble import Defects
from ocp.transcription.base import Transcription, unrolled
from ocp.transcription.interval_step import ramped_step, shooting_step
from ocp.transcription.sparse_nlp import Block, Derivatives, split_symbol
from ocp.transcription.step_derivatives import StepDerivatives
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.runge_kutta import ExplicitRungeKutta, RungeKutta4
from tenscasadi.integrators.scheme import NamedScheme, Scheme, check_scheme
from tenscasadi.schema.definitions import OneOf
from tenscasadi.util.casadi_tools import ArrayCallback
from tenscasadi.util.validate import Array, whole_number

MOST_SUBSTEPS = 10_000  # in an interval
_UNIFORM = ca.Function("ode", [ca.SX.sym("x"), ca.SX.sym("u")], [ca.SX.ones(1)])  # x' = 1


@dataclass(frozen=True)
class MultipleShooting(Transcription, kind="MultipleShooting"):
    """Multiple shooting: an explicit scheme integrates each interval, and constraints close the gaps between intervals.

    The states at the nodes of the mesh are unknowns too. The steps of an interval are followed by a
    projection onto bars and joints: without it these drift, and imposed as constraints they would
    repeat the dynamics.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    scheme : RungeKutta4, DormandPrince54, DormandPrince853 or Collocation
        Scheme of `tenscasadi` that integrates an interval.
    substeps : int
        Number of its steps in each interval.
    control : PiecewiseConstant or PiecewiseLinear
        How force densities run over the intervals.
    accuracy : float, optional
        How near the motion shall be to that of fine steps, m (speeds: m per duration): `solve` then
        solves again, with `Ipopt`, until it is. By default the motion is as the intervals make it.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind, or the scheme steps whole models only.

    References
    ----------
    H. G. Bock, K. J. Plitt, A multiple shooting algorithm for direct solution of optimal control
    problems, IFAC Proceedings 17, 1984.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.MultipleShooting(4))
    >>> plan.success, plan.force_density.shape
    (True, (4, 2))
    """

    scheme: Annotated[Scheme, OneOf(NamedScheme)] = field(default_factory=RungeKutta4)
    substeps: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_number("MultipleShooting.substeps", self.substeps, 1, MOST_SUBSTEPS)
        check_scheme(self.scheme)
        try:
            self.scheme.step(_UNIFORM)
        except TypeError:
            name = type(self.scheme).__name__
            text = f"MultipleShooting.scheme is {name}(), which steps whole models, not the equations with force densities of an interval"
            raise ValueError(
                f"{text}: give RungeKutta4(), DormandPrince54(), DormandPrince853() or Collocation()"
            ) from None

    def longest_step(self, duration: float) -> float:
        """Return the longest step of a motion.

        Parameters
        ----------
        duration : float
            Of the motion, s.

        Returns
        -------
        float
            Seconds.
        """
        return super().longest_step(duration) / self.substeps

    def defects(self, variables: Variables, used: Array) -> Defects:
        """Return the blocks of rows that vanish on a motion: the gaps between intervals.

        Parameters
        ----------
        variables : Variables
            States at the nodes of the mesh, force densities and duration; further unknowns are
            added to them.
        used : ndarray of bool
            Which of their entries bounds, costs and goals depend on.

        Returns
        -------
        Defects
            The blocks, and how states follow from unknowns where not all are.
        """
        v, model = variables, variables.model
        z, (x, c, after, duration, share) = split_symbol(
            ca.MX, model.nx, v.interval_controls.shape[1], model.nx, 1, 1
        )
        if self.control.linear:
            end = ramped_step(model, self.scheme, self.substeps)(
                x, v.gamma(c, 0.0), v.gamma(c, 1.0), duration * share
            )
        else:
            end = shooting_step(model, self.scheme, self.substeps)(
                x, v.gamma(c, 0.0), duration * share
            )
        gap = unrolled(model, ca.Function("gap", [z], [(after - end) / ca.DM(v.scales.state)]))
        index = np.hstack(
            [v.states[:-1], v.interval_controls, v.states[1:], v.repeated(v.duration), v.share]
        )
        names = interval_names(v.count, state_names(model))
        derivatives = None
        if isinstance(self.scheme, ExplicitRungeKutta | Collocation) and not model.mechanism.large:
            derivatives = self._derivatives(v, self.scheme)
        return Defects(
            [
                Block(
                    gap,
                    index,
                    names,
                    scale=v.scales.state,
                    closes=v.states[1:],
                    derivatives=derivatives,
                )
            ]
        )

    def _derivatives(self, v: Variables, scheme: ExplicitRungeKutta | Collocation) -> Derivatives:
        """Return those of the gaps, from the stages of their steps."""
        nx, m, count = v.model.nx, v.interval_controls.shape[1], v.count
        inner = StepDerivatives(
            v.model, v.group_matrix, scheme, self.substeps, self.control.linear, v.free_time, count
        )
        ends = np.cumsum([nx, m, nx, 1])
        varied = np.concatenate([np.arange(nx + m), np.arange(ends[2], ends[2] + v.free_time)])
        scale = v.scales.state

        def jacobian(z: Array) -> Array:
            x, c, _, duration, share = np.split(z, ends, axis=1)
            rows = np.empty(
                (count, inner.size + 1, nx)
            )  # of what the interval starts from, and what is behind it
            inner.jacobian(x, c, duration, share, rows[:, :-1])
            rows[:, :-1] *= -1 / scale
            rows[:, -1] = 1 / scale
            return rows

        def hessian(z: Array, weights: Array) -> Array:
            x, c, _, duration, share = np.split(z, ends, axis=1)
            return inner.hessian(x, c, duration, share, weights / -scale)

        shape = (nx + m + nx + 2, count)
        return Derivatives(
            ArrayCallback("gap_jacobian", jacobian, [shape], (nx * (inner.size + 1), count)),
            np.tile(np.arange(nx), inner.size + 1),
            np.concatenate([np.repeat(varied, nx), np.arange(ends[1], ends[2])]),
            ArrayCallback("gap_hessian", hessian, [shape, (nx, count)], (inner.size**2, count)),
            varied,
        )

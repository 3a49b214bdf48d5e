"""Variational transcription."""

from __future__ import annotations

from dataclasses import dataclass

from ocp.problem.control import reject_coupled_rates
from ocp.transcription.base import Defects, Transcription
from ocp.transcription.contact_set import ContactSet, build_empty_set
from ocp.transcription.discrete_equations import DiscreteEquations
from ocp.transcription.fine_steps import Measure, measure_jumps
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variables import Variables
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


@dataclass(frozen=True)
class Variational(Transcription, kind="Variational"):
    """Variational transcription by a discrete principle of least action.

    It has order 2, is the fastest transcription, and conserves momenta and bar lengths exactly. All
    constraints are polynomials of low degree with few nonzeros.

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

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds.

    Notes
    -----
    The discrete Euler-Lagrange equations M (q⁺ − 2q + q⁻)/h² = F(q, γ) + B λ̂ C_b, with bᵀb = l² at
    each mesh point, are those of the leapfrog method (Störmer-Verlet, Rattle), with a Lagrange
    multiplier λ for each bar and mesh point [1]_. Velocities follow from the discrete momenta,
    which account for jumps of the force densities. Interior velocities are unknowns only if a goal,
    a limit or a cost depends on them.

    References
    ----------
    .. [1] J. E. Marsden, M. West, Acta Numerica 10, 2001, 357-514, sections 1.5 and 3.5.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    >>> goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    >>> problem = ocp.Problem(model, goals=goals, costs=[ocp.Effort()])
    >>> plan = ocp.solve(problem, ocp.Variational(6))
    >>> plan.success, plan.force_density.shape
    (True, (6, 2))
    """

    def defects(
        self, variables: Variables, used: Array, contact: ContactSet | None = None
    ) -> Defects:
        """Build the discrete Euler-Lagrange equations and bar constraints.

        Parameters
        ----------
        variables : Variables
            States at the mesh points, controls and duration; further unknowns are added.
        used : ndarray of bool
            Whether limits, costs or goals depend on each entry.
        contact : ContactSet, optional
            Contact nodes, whose reactions are unknowns like bar forces.

        Returns
        -------
        Defects
            Blocks, and the states as functions of the unknowns.
        """
        reject_coupled_rates(variables.model, type(self).__name__)
        equations = DiscreteEquations(
            variables, used, build_empty_set(variables) if contact is None else contact
        )
        return Defects(equations.blocks(), equations.all_states)

    def measure_residual(self, program: Program, model: Model) -> Measure:
        """Prepare the discretization residual for deferred correction.

        It is the difference from an integration in fine steps.

        Parameters
        ----------
        program : Program
            Program of this transcription.
        model : Model
            Model of its problem.

        Returns
        -------
        callable
            Function of the unknowns, and of the `MotionResidual` of a solution nearby or None. It
            returns a `MotionResidual`.
        """
        return measure_jumps(program, model, self.fractions)

"""Transcription by a discrete principle of least action."""

from __future__ import annotations

from dataclasses import dataclass

from ocp.transcription.base import Defects, Transcription
from ocp.transcription.contact_set import ContactSet, no_contact
from ocp.transcription.discrete_equations import DiscreteEquations
from ocp.transcription.fine_steps import Measure, measure_jumps
from ocp.transcription.sparse_nlp import Program
from ocp.transcription.variables import Variables
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array


@dataclass(frozen=True)
class Variational(Transcription, kind="Variational"):
    """A discrete principle of least action (leapfrog): order 2, momenta and bars kept exactly; the fastest of the transcriptions.

    Neither accelerations nor inverse matrices appear: all rows are polynomials of low degree with
    few non-zeros.

    Parameters
    ----------
    intervals : int or sequence of float
        Number of equal intervals, or their lengths relative to each other.
    control : PiecewiseConstant or PiecewiseLinear
        How force densities run over the intervals.
    accuracy : float, optional
        How near the motion shall be to that of fine steps, m (speeds: m per duration): `solve` then
        solves again, with `Ipopt`, until it is. By default the motion is as the intervals make it.

    Raises
    ------
    TypeError, ValueError
        If a value is not of its kind; from `solve`, if the model has full coordinates and redundant
        constraints.

    Notes
    -----
    The discrete Euler-Lagrange equations M (q⁺ − 2q + q⁻)/h² = F(q, γ) + B λ̂ C_b, with bᵀb = l² at
    every node of the mesh, are those of the leapfrog (Störmer-Verlet, Rattle) method, with a
    Lagrangian multiplier λ for each bar and node [1]_. Velocities are those of the discrete
    momenta, which unlike central differences see force densities that jump; within, they are
    unknowns only where a goal, a limit or a cost asks for them.

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
        """Build the discrete Euler-Lagrange equations, and the bars at the nodes of the mesh.

        Parameters
        ----------
        variables : Variables
            States at the nodes of the mesh, force densities and duration; further unknowns are
            added to them.
        used : ndarray of bool
            Which of their entries bounds, costs and goals depend on.
        contact : ContactSet, optional
            The nodes that stand, whose reactions enter as those of the bars do.

        Returns
        -------
        Defects
            The blocks, and how states follow from unknowns where not all are.
        """
        equations = DiscreteEquations(
            variables, used, no_contact(variables) if contact is None else contact
        )
        return Defects(equations.blocks(), equations.all_states)

    def measure_residual(self, program: Program, model: Model) -> Measure:
        """Prepare the residual of solutions against fine steps: jumps of the momentum.

        Parameters
        ----------
        program : Program
            The program of this transcription.
        model : Model
            The model of its problem.

        Returns
        -------
        callable
            Function of the unknowns that returns a `MotionResidual`.
        """
        return measure_jumps(program, model, self.fractions)

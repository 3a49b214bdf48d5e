"""Symbolic positions, lengths and forces at one instant."""

from __future__ import annotations

from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ocp.problem.control import controls_force_densities, has_elastic_strings
from tenscasadi.dynamics.body_motion import body_frame
from tenscasadi.util.casadi_tools import column_norms, sparse
from tenscasadi.util.validate import Array, Indices, nonnegative, per_item

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model


class Instant:
    """Positions, lengths and forces at one instant of a plan.

    They are CasADi expressions, built at their first use. User-defined functions of `Constraint`,
    `Integral` and `AtEnd` have an instant as argument.

    Parameters
    ----------
    model : Model
        The model of the problem.
    state : casadi.SX or casadi.MX, shape (nx,)
        State of the model.
    control : casadi.SX or casadi.MX, shape (nu,)
        Control of the model: force densities γ [N/m], or tensions [N] or rest lengths [m] of cables
        and strings.
    time : casadi.SX or casadi.MX
        Time since the start [s].

    Examples
    --------
    >>> import casadi as ca
    >>> import ocp
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity()))
    >>> x, u, t = ca.SX.sym("x", model.nx), ca.SX.sym("u", model.nu), ca.SX.sym("t")
    >>> now = ocp.Instant(model, x, u, t)
    >>> now.nodes.shape, now.tension.shape
    ((3, 6), (9, 1))
    """

    def __init__(self, model: Model, state: Any, control: Any, time: Any) -> None:
        self.model, self.state, self.control, self.time = model, state, control, time

    @property
    def symbols(self) -> tuple[Any, Any, Any]:
        """State x, control u and time t, as CasADi symbols."""
        return self.state, self.control, self.time

    @cached_property
    def model_nodes(self) -> Any:
        """Positions 3×n [m] of structural nodes and nodes inside strings.

        Strings that are modeled in segments have such nodes.
        """
        return self.model.nodes(self.state).T

    @cached_property
    def model_velocities(self) -> Any:
        """Velocities 3×n [m/s] of structural nodes and nodes inside strings."""
        return self.model.velocities(self.state).T

    @cached_property
    def nodes(self) -> Any:
        """Positions of the structure's nodes, 3×n [m]."""
        return self.model_nodes[:, : len(self.model.scene.structure.nodes)]

    @cached_property
    def velocities(self) -> Any:
        """Velocities of the structure's nodes, 3×n [m/s]."""
        return self.model_velocities[:, : len(self.model.scene.structure.nodes)]

    @cached_property
    def accelerations(self) -> Any:
        """Accelerations of the structure's nodes, 3×n [m/s²]."""
        build = partial(_build_accelerations, self.model)
        return self.model.keep("accelerations", build)(self.state, self.control)

    @cached_property
    def center_of_mass(self) -> Any:
        """Center of mass of bars, bodies, nodes and strings (3,) [m]."""
        return ca.mtimes(self._columns[0], self._mass_fractions)

    @cached_property
    def center_of_mass_velocity(self) -> Any:
        """Velocity of the center of mass (3,) [m/s]."""
        return ca.mtimes(self._columns[1], self._mass_fractions)

    @cached_property
    def angular_momentum(self) -> Any:
        """Angular momentum about the center of mass (3,) [kg m²/s]."""
        N, V = self._columns
        arms = N - ca.repmat(self.center_of_mass, 1, N.shape[1])
        momenta = ca.mtimes(V, sparse(self.model.mechanism.M))
        return ca.sum2(ca.horzcat(*map(ca.cross, ca.horzsplit(arms), ca.horzsplit(momenta))))

    def orientation(self, body: int) -> Any:
        """Compute the rotation matrix (3×3) of a rigid body from the structure's nodes.

        Parameters
        ----------
        body : int
            Index of the body in ``Structure.bodies``.

        Returns
        -------
        casadi.SX or casadi.MX, shape (3, 3)
            Matrix that rotates vectors between nodes of the body from their directions in
            ``Structure.nodes`` to those at the instant.
        """
        return body_frame(self.model.scene.structure, body).rotation(self.nodes)

    def angular_velocity(self, body: int) -> Any:
        """Compute the angular velocity of a rigid body.

        Parameters
        ----------
        body : int
            Index of the body in ``Structure.bodies``.

        Returns
        -------
        casadi.SX or casadi.MX, shape (3,)
            Angular velocity along x, y and z [rad/s].
        """
        frame = body_frame(self.model.scene.structure, body)
        return frame.angular_velocity(self.nodes, self.velocities)

    @cached_property
    def lengths(self) -> Any:
        """Distances between the ends of strings (α,) [m]."""
        return column_norms(self._across(self.nodes, self.model.scene.structure.strings))

    @cached_property
    def rates(self) -> Any:
        """Time derivatives of the string lengths (α,) [m/s]."""
        strings = self.model.scene.structure.strings
        return (
            ca.sum1(self._across(self.nodes, strings) * self._across(self.velocities, strings)).T
            / self.lengths
        )

    @cached_property
    def force_density(self) -> Any:
        """Force densities γ (α,) [N/m].

        They are the control, or follow from it by the string law.
        """
        if controls_force_densities(self.model):
            return self.control
        mean = self._gather(
            self.model.structure.string_parent, self.model.structure.string_fraction
        )  # weighted mean over segments: their tensions differ by the inertia of inner nodes
        return ca.mtimes(mean, self.tension) / self.lengths

    @cached_property
    def tension(self) -> Any:
        """Tensions of the strings or segments of the model [N].

        They are in the order of ``model.structure.strings``.
        """
        return self.model.tension(self.state, self.control)

    @cached_property
    def bar_force(self) -> Any:
        """Bar forces λ ‖b‖ (β,) [N], positive in compression."""
        b = self._across(self.nodes, self.model.scene.structure.bars)
        return self.model.multiplier_function(self.state, self.control)[0] * column_norms(b)

    def rest_lengths(self, stiffness: Any) -> Any:
        """Compute the rest lengths that give the force densities.

        They are ρ = s (1 − γ/k), summed over the segments of a string and the strings of a cable.
        Under rest-length control, they are the control itself, or states.

        Parameters
        ----------
        stiffness : array_like, shape (α,)
            Stiffness k of each string [N/m].

        Returns
        -------
        casadi.SX or casadi.MX, shape (nu,)
            Rest lengths of cables and strings [m] (Eq. 99).

        Raises
        ------
        TypeError, ValueError
            If the stiffness is not one positive number for each string.
        """
        control = self.model.scene.control
        if control is not None and has_elastic_strings(self.model):
            return control.command(self.control, self.model.split(self.state).internal)
        s = self.model.structure
        along = column_norms(self._across(self.model.nodes(self.state).T, s.strings))
        given = per_item("stiffness", stiffness, len(self.model.scene.structure.strings))
        whole = ca.DM(
            nonnegative("stiffness", given, "string", strict=True)[s.string_parent]
            / s.string_fraction
        )
        parts = along - self.tension / whole  # s (1 − γ/k)
        return ca.mtimes(self._gather(self.model.scene.input_of, np.ones(len(s.strings))), parts)

    @cached_property
    def _columns(self) -> tuple[Any, Any]:
        """Matrices N [m] and V [m/s] of the equation of motion.

        Their columns are the positions and velocities of nodes.
        """
        N, V, _ = self.model.unpack(self.state)
        return N, V

    @property
    def _mass_fractions(self) -> ca.DM:
        """Fraction of the total mass in each column of N."""
        weight = np.asarray(self.model.mechanism.M.sum(axis=1)).ravel()
        return ca.DM(weight / weight.sum())

    def _gather(self, whole: Indices, weights: Array) -> ca.DM:
        """Build a matrix that sums over segments or cables.

        ``whole`` is the index of the string or cable to which each segment or string belongs, and
        ``weights`` its factor.
        """
        count = int(whole.max(initial=-1)) + 1
        return ca.sparsify(ca.DM((np.arange(count)[:, None] == whole[None]) * weights[None]))

    def _across(self, columns: Any, pairs: Any) -> Any:
        return columns[:, pairs[:, 1].tolist()] - columns[:, pairs[:, 0].tolist()]


def _build_accelerations(model: Model) -> ca.Function:
    """Build the Function (x, u) → node accelerations 3×n [m/s²]."""
    now = symbolic(model)
    rate = model.ode(now.state, now.control)
    moved = ca.jtimes(ca.vec(now.velocities), now.state, rate)
    return ca.Function(
        "accelerations",
        [now.state, now.control],
        [ca.densify(ca.reshape(moved, *now.velocities.shape))],
    )


def forces_of(model: Model, states: Array, controls: Array) -> Array:
    """Compute the force densities at states under given controls.

    States are (K, nx), controls (K, nu), force densities (K, α) [N/m].
    """
    if controls_force_densities(model):
        return controls
    now = symbolic(model)
    follow = ca.Function("follow", [now.state, now.control], [ca.densify(now.force_density)]).map(
        len(states)
    )
    return np.asarray(follow(states.T, controls.T).full()).T


def symbolic(model: Model) -> Instant:
    """Build an instant in new symbols for state, control and time.

    The symbols are SX if the model's equations are SX functions; otherwise MX, for large models.
    """
    kind: Any = (
        ca.SX if model.ode.is_a("SXFunction") and model.observe.is_a("SXFunction") else ca.MX
    )
    return Instant(model, kind.sym("x", model.nx), kind.sym("u", model.nu), kind.sym("t"))

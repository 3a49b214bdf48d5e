"""Quantities of a state: nodes, forces, energies, constraint errors."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.force_element import NodeMotion
from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.dynamics.state_space import StateSpace
from tenscasadi.scene.dissipation import is_conservative
from tenscasadi.util.casadi_tools import sparse


class Energy(NamedTuple):
    """Kinetic and potential energies of a state.

    Attributes
    ----------
    kinetic : float
        Kinetic energy [J].
    elastic : float
        Energy of taut strings, elastic bars and the ground's springs [J].
    gravity : float
        Potential energy of gravity [J]. It is 0 with all mass at the origin, or if gravity varies.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pendulum = tc.Structure([(0, 0, 0), (0, 0, -1)], bars=[(0, 1)], pinned=(0,))
    >>> model = tc.Model(tc.Scene(pendulum, gravity=tc.Gravity((0, 0, -10))))
    >>> round(model.energy(model.initial_state).total, 6)
    -5.0
    """

    kinetic: float
    elastic: float
    gravity: float

    @property
    def total(self) -> float:
        """Sum of kinetic, elastic and gravity energy [J]."""
        return self.kinetic + self.elastic + self.gravity


def _kinetic_energy(mech: Mechanism, V: Any) -> Any:
    return ca.sum2(ca.sum1(V * ca.mtimes(V, sparse(mech.M)))) / 2


class Observations(StateSpace):
    """Base class of `Model` with quantities of a state.

    They are node positions, forces, energies and constraint errors, as CasADi Functions and as
    numbers.
    """

    @cached_property
    def observe(self) -> ca.Function:
        """Function "observe" (x, u) → nodes, forces, energies and errors.

        ``nodes`` [m] and ``velocities`` [m/s] are (3n), node by node. ``force_density`` [N/m] and
        ``tension`` [N] of the modeled strings are (α). ``energy`` [J] is kinetic, elastic and
        gravity energy. ``bar_length_error`` [1] and ``joint_error`` [m] are scalars.
        """
        x, u = self.symbols(not self.mechanism.large)
        N, V, time = self.unpack(x)
        mech = self.with_masses(u, inverse=False)
        w = self.add_schedule(self.extend_inputs(x, u), time)
        gamma, S = forces.string_force_density(self.scene, mech, N, V, w)
        first = self.mechanism.first.tolist()
        outputs = {
            "nodes": ca.vec(N[:, first]),
            "velocities": ca.vec(V[:, first]),
            "force_density": gamma.T,
            "tension": (gamma * ca.sqrt(ca.sum1(S * S))).T,
            "energy": ca.vertcat(
                _kinetic_energy(mech, V) + self._internal_kinetic_energy(mech, w),
                *forces.potential_energy(self.scene, mech, N, w),
            ),
            "bar_length_error": self._bar_length_error(N),
            "joint_error": self._joint_error(N, time),
        }
        return self._function(
            "observe", x, u, [ca.densify(value) for value in outputs.values()], list(outputs)
        )

    @cached_property
    def energy_function(self) -> ca.Function:
        """Function "energy" (x, u) → total energy [J]."""
        x, u = self.symbols(not self.mechanism.large)
        energy = ca.sum1(
            self.with_stacked_input(self.observe)(x, u)[self.observe.index_out("energy")]
        )
        return self._function("energy", x, u, [energy], ["energy"])

    # --- numbers in, numbers out ---

    def force_density(self, x: Any, u: Any = None, parameters: Any = None) -> Any:
        """Compute the force densities γ of the modeled strings.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.
        u : array_like, shape (nu,), or CasADi column, optional
            Control; the initial control if None.
        parameters : array_like, shape (np,), mapping, or CasADi column, optional
            Parameters, see `ParameterLayout.values`; nominal if None.

        Returns
        -------
        ndarray, shape (α,), or CasADi column
            Tension divided by length [N/m] (Eq. 99); CasADi if x or u is.
        """
        return self._evaluate("force_density", x, u, parameters)

    def tension(self, x: Any, u: Any = None, parameters: Any = None) -> Any:
        """Compute the tensions of the modeled strings.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.
        u : array_like, shape (nu,), or CasADi column, optional
            Control; the initial control if None.
        parameters : array_like, shape (np,), mapping, or CasADi column, optional
            Parameters, see `ParameterLayout.values`; nominal if None.

        Returns
        -------
        ndarray, shape (α,), or CasADi column
            Tensions [N]; CasADi if x or u is.
        """
        return self._evaluate("tension", x, u, parameters)

    def energy(self, x: Any, u: Any = None, parameters: Any = None) -> Energy:
        """Compute kinetic, elastic and gravity energy.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.
        u : array_like, shape (nu,), or CasADi column, optional
            Control; the initial control if None.
        parameters : array_like, shape (np,), mapping, or CasADi column, optional
            Parameters, see `ParameterLayout.values`; nominal if None.

        Returns
        -------
        Energy
            Energies [J], CasADi if x or u is. Strings with force-density control store no energy.
        """
        return Energy(*self._scalars("energy", x, u, parameters))

    def bar_length_error(self, x: Any) -> Any:
        """Compute the largest relative error of bar lengths.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.

        Returns
        -------
        float, or CasADi scalar
            Maximum of | |b| − l | / l over the bars.
        """
        return self._scalars("bar_length_error", x)[0]

    def joint_error(self, x: Any) -> Any:
        """Compute the largest position error of joints and pins.

        Parameters
        ----------
        x : array_like, shape (nx,), or CasADi column
            State.

        Returns
        -------
        float, or CasADi scalar
            Maximum of | N P − D | [m], 0 in reduced coordinates.
        """
        return self._scalars("joint_error", x)[0]

    @property
    def conservative(self) -> bool:
        """Whether all forces are conservative under constant control."""
        return self.schedule is None and is_conservative(self.scene)

    # --- expressions ---

    def internal_rates(self, x: Any, w: Any, mode: Any = None) -> Any:
        """Compute the time derivatives (na,) of the internal states.

        x (nx) is the state, and w (nw) the stacked input, control and parameters. `mode` is that of
        `forces.build_elements`.
        """
        if not self.na:
            return ca.DM(0, 1)
        N, V, time = self.unpack(x)
        mech = self.with_masses(w, inverse=False)
        elements = forces.build_elements(
            self.scene, mech, self.add_schedule(self.extend_inputs(x, w), time), mode
        )
        return forces.internal_rates(elements, NodeMotion(N, V, time))

    def internal_power(self, x: Any, w: Any, stored: bool, mode: Any = None) -> Any:
        """Compute the power [W] due to changes of the internal states.

        It is their contribution to the rate of the kinetic energy and, if `stored`, of the
        potential energy. The arguments are those of `internal_rates`.
        """
        if not self.na:
            return ca.DM(0)
        symbol = type(x).sym("x", self.nx)
        N = self.unpack(symbol)[0]
        mech, given = self.with_masses(w, inverse=False), self.extend_inputs(symbol, w)
        energy = self._internal_kinetic_energy(mech, given)
        if stored:
            energy = energy + sum(forces.potential_energy(self.scene, mech, N, given))
        still = ca.DM.zeros(*N.shape)
        change = self.pack(still, still, self.internal_rates(symbol, w, mode), 0)
        return ca.substitute(ca.jtimes(ca.densify(energy), symbol, change), symbol, x)

    def _internal_kinetic_energy(self, mech: Mechanism, w: Any) -> Any:
        if not self.na:
            return ca.DM(0)
        elements = forces.build_elements(self.scene, mech, w)
        return sum(element.internal_kinetic_energy() for element in elements)

    def _bar_length_error(self, N: Any) -> Any:
        if not self.mechanism.bars:
            return ca.DM(0)
        B = self.mechanism.bar_vectors(N)
        return ca.mmax(ca.fabs(ca.sqrt(ca.sum1(B * B)) / ca.DM(self.mechanism.lengths).T - 1))

    def _joint_error(self, N: Any, time: Any) -> Any:
        if not self.mechanism.joints:
            return ca.DM(0)
        gap = self.mechanism.project_onto_constraints(
            ca.mtimes(N, sparse(self.mechanism.P)) - self.targets(time)[0]
        )
        return ca.mmax(ca.fabs(gap))

    # --- numbers ---

    def _evaluate(self, name: str, x: Any, u: Any, parameters: Any = None) -> Any:
        arguments = self.arguments(x, u, parameters)
        value = self.observe(*arguments)[self.observe.index_out(name)]
        return value.full().ravel() if isinstance(value, ca.DM) else value

    def _scalars(self, name: str, x: Any, u: Any = None, parameters: Any = None) -> list[Any]:
        value = self._evaluate(name, x, u, parameters)
        return ca.vertsplit(value) if isinstance(value, (ca.SX, ca.MX)) else value.tolist()

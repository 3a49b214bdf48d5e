"""Base class of kinds of control, such as rest-length control."""

from __future__ import annotations

from typing import Any, ClassVar

import casadi as ca

from tenscasadi.scene.internal_states import InternalStates
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array


class Control(Value):
    """Kind of control: the quantity that actuates the strings.

    A control has one input for each string, or for each cable and each string in no cable.

    Attributes
    ----------
    name, quantity, unit : str
        Names of one input and of all inputs in messages, and their unit.
    attribute : str
        Attribute of plans that holds the inputs.
    commands_forces : bool
        Whether the inputs are forces, so that strings have no stiffness.
    commands_densities : bool
        Whether these forces are force densities, one for each string.
    sets_rest_lengths : bool
        Whether rest lengths are the inputs, or follow from them over time.
    """

    name: ClassVar[str]
    quantity: ClassVar[str]
    unit: ClassVar[str]
    attribute: ClassVar[str]
    commands_forces: ClassVar[bool] = False
    commands_densities: ClassVar[bool] = False
    sets_rest_lengths: ClassVar[bool] = False

    def check(self, count: int) -> None:
        """Check that the fields have `count` entries, one per input.

        The inputs belong to cables, and to strings in no cable.
        """

    def internal_states(self, rest: Array) -> tuple[InternalStates, ...]:
        """Return the internal states of the control.

        `rest` are initial rest lengths of cables and of strings in no cable [m].

        Parameters
        ----------
        rest : ndarray, shape (nu,)
            Initial rest lengths [m].

        Returns
        -------
        tuple of InternalStates
            Their names, units, scales and initial values; empty by default.
        """
        return ()

    @property
    def locked(self) -> Control:
        """Control for statics, in which internal states become inputs."""
        return self

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        """Compute the inputs that keep the initial rest lengths.

        Parameters
        ----------
        rest, tension : ndarray, shape (nu,)
            Initial rest lengths [m] and tensions [N] of cables and strings in no cable.

        Returns
        -------
        ndarray, shape (nu,)
            Inputs.
        """
        raise NotImplementedError

    def command(self, u: Any, internal: Any) -> Any:
        """Return the force densities [N/m], tensions [N] or rest lengths [m] (nu,).

        Without actuator dynamics they are the inputs u. Otherwise they follow from u and the
        internal states `internal` (na,) of the actuators.
        """
        return u

    def internal_rates(self, u: Any, internal: Any, tension: Any) -> Any:
        """Build the rates (na,) of the internal states.

        Parameters
        ----------
        u : casadi column, shape (nu,)
            Inputs.
        internal : casadi column, shape (na,)
            Internal states.
        tension : casadi column, shape (nu,)
            Tensions of the strings at the winches [N].

        Returns
        -------
        casadi column
            Rates.
        """
        return ca.DM(0, 1)

    def follow(
        self, rest: Array, tension: Array, interval: Any, limits: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Compute inputs and internal states for desired rest lengths.

        The rest lengths are approximated within the limits.

        Parameters
        ----------
        rest : ndarray, shape (K + 1, nu)
            Rest lengths over time, from the initial ones [m].
        tension : ndarray, shape (K, nu)
            Tensions between these times [N].
        interval : float or ndarray, shape (K,)
            Time between them [s].
        limits : tuple of ndarray, shape (nu,)
            Limits of the inputs.

        Returns
        -------
        tuple of ndarray, shapes (K, na) and (K, nu)
            Internal states after the first time, and inputs.
        """
        raise NotImplementedError

    def kinetic_energy(self, internal: Any) -> Any:
        """Build the kinetic energy [J] stored in the internal states.

        `internal` (na,) are these states.
        """
        return ca.DM(0)

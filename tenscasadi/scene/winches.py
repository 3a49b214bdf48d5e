"""Winches: rest lengths as states, driven by rates or motor torques."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.scene.control import Control
from tenscasadi.scene.internal_states import InternalStates
from tenscasadi.scene.strings import RestLength
from tenscasadi.schema.field_types import LIMITS, PER_ITEM
from tenscasadi.util.validate import (
    Array,
    per_item,
    positive_each,
)


@dataclass(frozen=True)
class RestLengthRate(Control, kind="RestLengthRate"):
    """Control by rest-length rates [m/s] of cables and single strings.

    There is one input for each cable and each string that is not part of a cable. Rest lengths are
    internal states, which begin at those of the structure. A negative rate shortens the string. The
    initial control is zero.

    Notes
    -----
    Damping acts on the rate of the length, as under ``RestLength()``. The work of the inputs is
    −∫ t ρ̇ dt, with the elastic tensions t and the rest lengths ρ.

    Examples
    --------
    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(prestress=10.0), control=tc.RestLengthRate()))
    >>> model.nx, model.nu
    (45, 9)
    >>> run = tc.simulate(model, 0.1, control=np.full(9, -0.05), compiled=False)
    >>> rest = model.split(run.states).internal
    >>> (rest[-1] - rest[0]).round(6).tolist()[:2]
    [-0.005, -0.005]
    """

    name: ClassVar[str] = "rest-length rate"
    quantity: ClassVar[str] = "rest-length rates"
    unit: ClassVar[str] = "m/s"
    attribute: ClassVar[str] = "rest_length_rate"
    sets_rest_lengths: ClassVar[bool] = True

    @property
    def locked(self) -> Control:
        """Control for statics, by rest lengths."""
        return RestLength()

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        """Return zero rates.

        Parameters
        ----------
        rest, tension : ndarray, shape (nu,)
            Initial rest lengths [m] and tensions [N], one for each input.

        Returns
        -------
        ndarray, shape (nu,)
            Zeros [m/s].
        """
        return np.zeros(len(rest))

    def internal_states(self, rest: Array) -> tuple[InternalStates, ...]:
        """Return the rest lengths as internal states.

        Parameters
        ----------
        rest : ndarray, shape (nu,)
            Initial rest lengths [m].

        Returns
        -------
        tuple of InternalStates
            The rest lengths [m].
        """
        return (InternalStates("rest length", "m", rest, rest, 0.0),)

    def command(self, u: Any, internal: Any) -> Any:
        """Return the rest lengths, which are the internal states.

        Parameters
        ----------
        u : casadi column, shape (nu,)
            Rates of the rest lengths [m/s], not used.
        internal : casadi column, shape (na,)
            Rest lengths [m].

        Returns
        -------
        casadi column, shape (nu,)
            Rest lengths [m].
        """
        return internal

    def internal_rates(self, u: Any, internal: Any, tension: Any) -> Any:
        """Return the inputs, which are the rates of the rest lengths.

        Parameters
        ----------
        u : casadi column, shape (nu,)
            Rates of the rest lengths [m/s].
        internal : casadi column, shape (na,)
            Rest lengths [m], not used.
        tension : casadi column, shape (nu,)
            Tensions of the strings at the winches [N], not used.

        Returns
        -------
        casadi column, shape (na,)
            Rates of the rest lengths [m/s].
        """
        return u

    def follow(
        self, rest: Array, tension: Array, interval: Any, limits: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Compute rates, within limits, for desired rest lengths.

        Also returns the resulting rest lengths.

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
        steps = np.broadcast_to(interval, len(rest) - 1)[:, None]
        own, rates = np.array(rest, dtype=float), np.zeros(rest[1:].shape)
        for k, step in enumerate(steps):  # later steps make up for clipped rates
            rates[k] = np.clip((rest[k + 1] - own[k]) / step, *limits)
            own[k + 1] = own[k] + step * rates[k]
        return own[1:], rates


@dataclass(frozen=True, eq=False)
class Winch(Control, kind="Winch"):
    """Control by motor torques [N·m] of winches.

    There is a winch for each cable and each string in no cable. Rest lengths ρ and angular speeds ω
    of the drums are internal states. They begin at the rest lengths of the structure, at rest. A
    positive speed shortens the string. The initial control keeps the drums at rest.

    Parameters
    ----------
    radius : float or array_like, shape (nu,)
        Radius r of the drum [m]: one number, or one for each winch.
    inertia : float or array_like, shape (nu,)
        Inertia J of drum and motor about the axis of the drum [kg·m²].
    friction : float or array_like, shape (nu,)
        Viscous friction c [N·m·s].
    torque : float or array_like, shape (nu,), optional
        Largest torque in both directions [N·m], a limit in plans and controllers. Simulations apply
        the given torques, and their message names those beyond it. None or inf for no limit.
    speed : float or array_like, shape (nu,), optional
        Largest winding speed in both directions [rad/s], a limit in plans and `ocp.Mpc`. None or
        inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If a value is not positive (friction: negative). In a `Scene`: if the number of values differs
        from that of inputs.

    Notes
    -----
    J ω̇ = τ − c ω − r t, ρ̇ = −r ω, with the torque τ and the tension t of the string. In a cable with
    friction, t is the tension of its first string. The kinetic energy of the drums is ½ J ω².

    Examples
    --------
    >>> import tenscasadi as tc
    >>> winch = tc.Winch(radius=0.02, inertia=1e-4, friction=1e-3)
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(prestress=10.0), control=winch))
    >>> model.nx, model.nu
    (54, 9)
    >>> run = tc.simulate(model, 0.1, 1e-3, compiled=False)  # motors hold the tensions
    >>> bool(abs(run.internal_states["winding speed"]).max() < 1e-9)
    True
    """

    name: ClassVar[str] = "motor torque"
    quantity: ClassVar[str] = "motor torques"
    unit: ClassVar[str] = "N m"
    attribute: ClassVar[str] = "motor_torque"
    sets_rest_lengths: ClassVar[bool] = True
    radius: Annotated[ArrayLike, PER_ITEM, positive_each("input")]
    inertia: Annotated[ArrayLike, PER_ITEM, positive_each("input")]
    friction: Annotated[ArrayLike, PER_ITEM, positive_each("input", zero=True)] = 0.0
    torque: Annotated[ArrayLike | None, LIMITS, positive_each("input", infinite=True)] = None
    speed: Annotated[ArrayLike | None, LIMITS, positive_each("input", infinite=True)] = None

    @property
    def locked(self) -> Control:
        """Control for statics, by rest lengths."""
        return RestLength()

    def check(self, count: int) -> None:
        """Check that the fields have values for `count` winches.

        Parameters
        ----------
        count : int
            Number of winches.

        Raises
        ------
        ValueError
            If the number of values differs.
        """
        for name in ("radius", "inertia", "friction"):
            per_item(f"Winch.{name}", getattr(self, name), count)
        self.limits("torque", count)
        self.limits("speed", count)

    def limits(self, name: str, count: int) -> Array:
        """Return the limits (count,) of torques or speeds.

        They are inf if there are none.

        Parameters
        ----------
        name : {"torque", "speed"}
            Name of the field.
        count : int
            Number of winches.

        Returns
        -------
        ndarray, shape (count,)
            Largest torques [N·m] or speeds [rad/s].

        Raises
        ------
        ValueError
            If the number of values differs.
        """
        value = getattr(self, name)
        array = np.asarray(np.inf if value is None else value, dtype=float)
        if array.ndim and array.shape != (count,):
            raise ValueError(f"Winch.{name} has shape {array.shape}: give one number, or {count}")
        return np.broadcast_to(array, (count,))

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        """Compute the torques [N·m] that balance the tensions.

        Parameters
        ----------
        rest, tension : ndarray, shape (nu,)
            Initial rest lengths [m] and tensions [N], one for each input.

        Returns
        -------
        ndarray, shape (nu,)
            Torques [N·m].
        """
        return np.asarray(self._values("radius", len(rest)) * tension)

    def internal_states(self, rest: Array) -> tuple[InternalStates, ...]:
        """Return rest lengths and drum speeds as internal states.

        Parameters
        ----------
        rest : ndarray, shape (nu,)
            Initial rest lengths [m].

        Returns
        -------
        tuple of InternalStates
            Rest lengths [m] and winding speeds [rad/s].
        """
        speeds = rest / self._values("radius", len(rest))  # in one second
        return (
            InternalStates("rest length", "m", rest, rest, 0.0),
            InternalStates("winding speed", "rad/s", speeds, np.zeros(len(rest))),
        )

    def command(self, u: Any, internal: Any) -> Any:
        """Return the rest lengths from the internal states.

        Parameters
        ----------
        u : casadi column, shape (nu,)
            Motor torques [N·m].
        internal : casadi column, shape (na,)
            Rest lengths [m], then winding speeds [rad/s].

        Returns
        -------
        casadi column, shape (nu,)
            Rest lengths [m].
        """
        return internal[: u.shape[0]]

    def internal_rates(self, u: Any, internal: Any, tension: Any) -> Any:
        """Build the rates of rest lengths and drum speeds.

        Parameters
        ----------
        u : casadi column, shape (nu,)
            Motor torques [N·m].
        internal : casadi column, shape (na,)
            Rest lengths [m], then winding speeds [rad/s].
        tension : casadi column, shape (nu,)
            Tensions of the strings at the winches [N].

        Returns
        -------
        casadi column, shape (na,)
            Rates of the rest lengths [m/s] and of the winding speeds [rad/s²].
        """
        count = u.shape[0]
        radius, inertia, friction = (
            ca.DM(self._values(name, count)) for name in ("radius", "inertia", "friction")
        )
        speed = internal[count:]
        return ca.vertcat(-radius * speed, (u - friction * speed - radius * tension) / inertia)

    def follow(
        self, rest: Array, tension: Array, interval: Any, limits: tuple[Array, Array]
    ) -> tuple[Array, Array]:
        """Compute torques, within limits, for desired rest lengths.

        Also returns the resulting rest lengths and drum speeds.

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
        count = rest.shape[1]
        radius, inertia, friction = (
            self._values(name, count) for name in ("radius", "inertia", "friction")
        )
        steps = np.broadcast_to(interval, len(rest) - 1)[:, None]
        speeds = -np.diff(rest, axis=0) / (steps * radius)
        gains = np.diff(speeds, axis=0, prepend=0.0) / steps
        torques = np.clip(inertia * gains + friction * speeds + radius * tension, *limits)
        return np.hstack([rest[1:], speeds]), torques

    def kinetic_energy(self, internal: Any) -> Any:
        """Build the kinetic energy of the drums [J].

        Parameters
        ----------
        internal : casadi column, shape (na,)
            Internal states.

        Returns
        -------
        casadi expression
            Energy [J].
        """
        count = internal.shape[0] // 2
        speed = internal[count:]
        return ca.dot(ca.DM(self._values("inertia", count)), speed * speed) / 2

    def _values(self, name: str, count: int) -> Array:
        return per_item(f"Winch.{name}", getattr(self, name), count)

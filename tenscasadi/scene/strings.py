"""Laws of strings: force density and elastic energy (Appendix A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np

from tenscasadi.scene.control import Control
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, Positive, one_of


@dataclass(frozen=True)
class ForceDensity(Control, kind="ForceDensity"):
    """Control by force densities γ [N/m] of parent strings.

    Strings then have neither stiffness nor damping nor slack.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity())).nu
    9
    """

    name: ClassVar[str] = "force density"
    quantity: ClassVar[str] = "force densities"
    unit: ClassVar[str] = "N/m"
    attribute: ClassVar[str] = "force_density"
    commands_forces: ClassVar[bool] = True
    commands_densities: ClassVar[bool] = True


@dataclass(frozen=True)
class Tension(Control, kind="Tension"):
    """Control by tensions T [N] of cables and single strings.

    There is one input for each cable and each string that is not part of a cable. Strings then have
    neither stiffness nor damping nor slack. In a cable with friction, T is the tension of its first
    string.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism()
    >>> cables = prism.replace(cables=[[0, 1, 2], [3, 4, 5]])
    >>> tc.Model(tc.Scene(cables, control=tc.Tension())).nu
    5
    """

    name: ClassVar[str] = "tension"
    quantity: ClassVar[str] = "tensions"
    unit: ClassVar[str] = "N"
    attribute: ClassVar[str] = "input_tension"
    commands_forces: ClassVar[bool] = True

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        """Return the initial tensions [N].

        Parameters
        ----------
        rest, tension : ndarray, shape (nu,)
            Initial rest lengths [m] and tensions [N] of cables and strings in no cable.

        Returns
        -------
        ndarray, shape (nu,)
            Tensions [N].
        """
        return tension


@dataclass(frozen=True)
class RestLength(Control, kind="RestLength"):
    """Control by rest lengths ρ [m] of cables and single strings.

    There is one input for each cable and each string that is not part of a cable. Rest lengths are
    greater than 0. The string law (`Clip`, `Smooth` or `Linear`) converts them to force densities.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.RestLength()))
    >>> bool((model.initial_control == model.structure.rest_length).all())
    True
    """

    name: ClassVar[str] = "rest length"
    quantity: ClassVar[str] = "rest lengths"
    unit: ClassVar[str] = "m"
    attribute: ClassVar[str] = "rest_length"
    sets_rest_lengths: ClassVar[bool] = True

    def initial_inputs(self, rest: Array, tension: Array) -> Array:
        """Return the initial rest lengths [m].

        Parameters
        ----------
        rest, tension : ndarray, shape (nu,)
            Initial rest lengths [m] and tensions [N] of cables and strings in no cable.

        Returns
        -------
        ndarray, shape (nu,)
            Rest lengths [m].
        """
        return rest


class StringLaw(Value):
    """Base class of laws of force density and elastic energy of strings.

    `switches` tells whether strings go slack at an event, and `pushes` whether they can carry
    compression.
    """

    switches: ClassVar[bool]  # between taut and slack, as an event
    pushes: ClassVar[bool]  # compression-capable

    @property
    def clamps(self) -> bool:
        """Whether damping cannot make the tension negative."""
        return False

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Build the force densities of strings, see `Clip.force_density`.

        The arguments are those of the latter.
        """
        raise NotImplementedError

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Build the elastic energy of strings, see `Clip.energy`.

        The arguments are those of the latter.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class Clip(StringLaw, kind="Clip"):
    """Exact slack law (Eq. 99).

    A string is taut while it is longer than its rest length and its tension is positive.

    Parameters
    ----------
    damping : {"clamped", "unclamped"}
        Damping of a taut string. "clamped": the tension is at least 0. "unclamped": damping acts in
        full, and a string that shortens fast is in compression, as in STEDY.

    Notes
    -----
    With unclamped damping the tension jumps by c ds/dt when a string becomes taut or slack. The
    damping dissipates the power c (ds/dt)² while the string is longer than its rest length. Clamped
    damping dissipates less.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> gamma = tc.Clip().force_density(squared=4.0, rest=1.0, stiffness=10.0, rate=None, unit=1.0)
    >>> round(float(gamma), 6)
    5.0
    >>> fast = tc.Clip(damping="unclamped").force_density(squared=4.0, rest=1.0, stiffness=10.0, rate=-40.0, unit=1.0)
    >>> round(float(fast), 6)
    -5.0
    """

    switches: ClassVar[bool] = True
    pushes: ClassVar[bool] = False
    damping: Annotated[Literal["clamped", "unclamped"], one_of("clamped", "unclamped")] = "clamped"

    @property
    def clamps(self) -> bool:
        """Whether damping cannot make the tension negative."""
        return self.damping == "clamped"

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Build the force densities of strings (Eq. 99).

        They are γ = k (s − ρ)/s + c sᵀṡ/s² of taut strings, and 0 of slack ones, for length s, rest
        length ρ, stiffness k and damping c.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        rate : casadi expression or None
            Damping coefficient c times sᵀṡ of string vectors s [N·m], None without damping.
        unit : casadi expression
            Constant typical lengths [m]. Lengths are regularized by 1e-9 of them, so that
            derivatives are finite at length 0.
        taut : casadi expression, optional
            Prescribed mode, 1 for taut and 0 for slack. Default: as length and tension give it.

        Returns
        -------
        casadi expression
            γ [N/m], in the shape of the arguments.
        """
        safe = squared + (1e-9 * unit) ** 2
        length = ca.sqrt(safe)
        # the second form has shorter derivatives
        strain = (length - rest) / length if taut is None else 1 - rest / length
        gamma = stiffness * strain if rate is None else stiffness * strain + rate / safe
        if taut is None:
            taut = strain > 0 if rate is None or not self.clamps else (strain > 0) * (gamma > 0)
        return gamma * taut  # the product has the shortest code and finite derivatives

    def gap(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any) -> Any:
        """Build the switching functions, which are positive for taut strings.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        rate : casadi expression or None
            Damping coefficient c times sᵀṡ of string vectors s [N·m], None without damping.
        unit : casadi expression
            Constant typical lengths [m].

        Returns
        -------
        casadi expression
            The stretch [m]. With clamped damping, at most the tension divided by the stiffness.
        """
        length = ca.sqrt(squared + (1e-9 * unit) ** 2)
        stretch = length - rest
        if rate is None or not self.clamps:
            return stretch
        return ca.fmin(
            stretch, (stiffness * stretch + rate / length) / (stiffness + (stiffness == 0))
        )

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Build the elastic energy ½ k (s − ρ)² of taut strings.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        unit : casadi expression
            Not used by this law.

        Returns
        -------
        casadi expression
            Energy of each string [J].
        """
        stretch = ca.sqrt(ca.fmax(squared, rest * rest)) - rest
        return stiffness * stretch * stretch / 2


@dataclass(frozen=True)
class Smooth(StringLaw, kind="Smooth"):
    """Smooth slack law, for optimization.

    The tension is t = (t′ + √(t′² + (k w)²))/2, where t′ is the tension without slack. Its error is
    at most k w/2, at the rest length, and k w²/(4 |s − ρ|) far from it. Damping fades over the same
    width.

    Parameters
    ----------
    width : float
        Width w [m] over which the kink at the rest length is rounded.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> gamma = tc.Smooth(0.01).force_density(squared=1.0, rest=1.0, stiffness=10.0, rate=None, unit=1.0)
    >>> round(float(gamma), 6)
    0.05
    """

    switches: ClassVar[bool] = False
    pushes: ClassVar[bool] = False
    width: Positive

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Build the force densities t/s with the smoothed tension t.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        rate : casadi expression or None
            Damping coefficient c times sᵀṡ of string vectors s [N·m], None without damping.
        unit : casadi expression
            Constant typical lengths [m]. Lengths are regularized by 1e-9 of them, so that
            derivatives are finite at length 0.
        taut : None
            Not used: this law has no modes.

        Returns
        -------
        casadi expression
            γ [N/m], in the shape of the arguments.
        """
        length = self._length(squared, unit)
        stretch = length - rest
        tension = stiffness * stretch
        if rate is not None:
            fade = (1 + stretch / ca.sqrt(stretch * stretch + self.width**2)) / 2
            tension = tension + fade * rate / length
        return (tension + ca.sqrt(tension * tension + (stiffness * self.width) ** 2)) / (2 * length)

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Build the elastic energy, the integral of the undamped tension.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        unit : casadi expression
            Constant typical lengths [m], see `force_density`.

        Returns
        -------
        casadi expression
            Energy of each string [J], 0 at the rest length as w → 0.
        """
        e = self._length(squared, unit) - rest
        w = self.width
        return stiffness * (e * e + e * ca.sqrt(e * e + w * w) + w * w * ca.asinh(e / w)) / 4

    def _length(self, squared: Any, unit: Any) -> Any:
        return ca.sqrt(squared + (1e-9 * unit) ** 2)


@dataclass(frozen=True)
class Linear(StringLaw, kind="Linear"):
    """Law without slack: a linear spring and damper.

    Such a string is compression-capable and has no events. Its force density can be negative.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> gamma = tc.Linear().force_density(squared=0.25, rest=1.0, stiffness=10.0, rate=None, unit=1.0)
    >>> round(float(gamma), 6)
    -10.0
    """

    switches: ClassVar[bool] = False
    pushes: ClassVar[bool] = True

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Build the force densities of linear springs and dampers.

        They are γ = k (s − ρ)/s + c sᵀṡ/s² for length s, rest length ρ, stiffness k and damping c.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        rate : casadi expression or None
            Damping coefficient c times sᵀṡ of string vectors s [N·m], None without damping.
        unit : casadi expression
            Constant typical lengths [m]. Lengths are regularized by 1e-9 of them, so that
            derivatives are finite at length 0.
        taut : None
            Not used: these strings are never slack.

        Returns
        -------
        casadi expression
            γ [N/m], in the shape of the arguments.
        """
        safe = squared + (1e-9 * unit) ** 2
        gamma = stiffness * (1 - rest / ca.sqrt(safe))
        return gamma if rate is None else gamma + rate / safe

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Build the elastic energy ½ k (s − ρ)² of strings.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s² [m²].
        rest : casadi expression
            Rest lengths ρ [m].
        stiffness : casadi expression
            Stiffness k [N/m].
        unit : casadi expression
            Constant typical lengths [m], see `force_density`.

        Returns
        -------
        casadi expression
            Energy of each string [J].
        """
        stretch = ca.sqrt(squared + (1e-9 * unit) ** 2) - rest
        return stiffness * stretch * stretch / 2


def rest_length(force_density: Array, length: Array, stiffness: Array) -> Array:
    """Compute rest lengths ρ = s (1 − γ/k) (Eq. 99) [m].

    Strings have lengths s, force densities γ and stiffness k.

    Parameters
    ----------
    force_density : ndarray
        γ [N/m].
    length : ndarray
        s [m].
    stiffness : ndarray
        k [N/m].

    Returns
    -------
    ndarray
        ρ [m]. It is not positive if γ ≥ k, because no rest length gives such a γ. It is NaN if
        k = 0 and γ ≠ 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(force_density == 0, length, length * (1 - force_density / stiffness))

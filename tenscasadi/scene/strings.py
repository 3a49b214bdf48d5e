"""The law of a string: stretch and its rate → force density γ and elastic energy, and back from γ to the rest length (Appendix A)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, cast

import casadi as ca
import numpy as np

from tenscasadi.schema.value import Value
from tenscasadi.util.validate import Array, as_tuple, choice, instance, node_index, positive_number


class Control(Value):
    """Control of a scene: the input of its strings."""


@dataclass(frozen=True)
class ForceDensity(Control, kind="ForceDensity"):
    """Control by force densities: the input is γ of every parent string, N/m.

    γ acts as it is commanded: no stiffness, damping or slack is built.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.Model(tc.Scene(tc.shapes.prism(), control=tc.ForceDensity())).nu
    9
    """


@dataclass(frozen=True)
class RestLength(Control, kind="RestLength"):
    """Control by rest lengths: the input is ρ of every parent string, m, greater than 0.

    The string law (`Clip`, `Smooth` or `Linear`) turns it into a force density.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), control=tc.RestLength()))
    >>> bool((model.initial_control == model.structure.rest_length).all())
    True
    """


class StringLaw(Value):
    """Law of a string: stretch and its rate to force density and energy."""

    switches: ClassVar[bool]
    pushes: ClassVar[bool]

    @property
    def clamps(self) -> bool:
        """Whether damping ends where the tension does."""
        return False

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Build the force densities of strings, see `Clip.force_density`."""
        raise NotImplementedError

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Build the elastic energy of strings, see `Clip.energy`."""
        raise NotImplementedError


@dataclass(frozen=True)
class Clip(StringLaw, kind="Clip"):
    """Slack as it is: a string pulls only while it is longer than its rest length and its tension is positive (Eq. 99).

    Parameters
    ----------
    damping : {"clamped", "unclamped"}
        What damping may do to a taut string. "clamped": it never makes it push, the tension ends at
        zero. "unclamped": it acts in full while the string is longer than at rest, so that one that
        shortens fast pushes, as in STEDY.

    Notes
    -----
    Unclamped damping jumps by c ds/dt where a string becomes taut or slack. It takes c (ds/dt)² out
    of the motion at any time while the string is longer than at rest, clamped damping less.

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
    damping: Literal["clamped", "unclamped"] = "clamped"

    def __post_init__(self) -> None:
        choice("Clip.damping", self.damping, "clamped", "unclamped")

    @property
    def clamps(self) -> bool:
        """Whether damping ends where the tension does."""
        return self.damping == "clamped"

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Return the force densities of strings, γ = k (s − ρ)/s + c sᵀṡ/s² where they are taut (Eq. 99).

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        rate : casadi expression or None
            c sᵀṡ of each string, N·m; None when none is damped.
        unit : casadi expression
            Typical lengths, m, constant: a string of no length is taken as 1e-9 of them long, to
            have finite derivatives.
        taut : casadi expression, optional
            1 or 0 where strings are held to pull, or not to, whatever their length; by default as
            they are.

        Returns
        -------
        casadi expression
            γ, N/m, in the shape of the arguments.
        """
        safe = squared + (1e-9 * unit) ** 2
        length = ca.sqrt(safe)
        strain = (
            (length - rest) / length if taut is None else 1 - rest / length
        )  # whose derivatives are shorter
        gamma = stiffness * strain if rate is None else stiffness * strain + rate / safe
        if taut is None:
            taut = strain > 0 if rate is None or not self.clamps else (strain > 0) * (gamma > 0)
        return gamma * taut  # a product: the shortest code, and finite in all derivatives

    def gap(self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any) -> Any:
        """Return lengths that are positive where strings pull: how much longer than at rest they are, or what their tension would stretch them by.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        rate : casadi expression or None
            c sᵀṡ of each string, N·m; None when none is damped.
        unit : casadi expression
            Typical lengths, m, constant.

        Returns
        -------
        casadi expression
            The lesser of both, m.
        """
        length = ca.sqrt(squared + (1e-9 * unit) ** 2)
        stretch = length - rest
        if rate is None or not self.clamps:
            return stretch
        return ca.fmin(
            stretch, (stiffness * stretch + rate / length) / (stiffness + (stiffness == 0))
        )

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Return the elastic energy of strings, ½ k (s − ρ)² where they are taut.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        unit : casadi expression
            Not needed here.

        Returns
        -------
        casadi expression
            Energy of each string, J.
        """
        stretch = ca.sqrt(ca.fmax(squared, rest * rest)) - rest
        return stiffness * stretch * stretch / 2


@dataclass(frozen=True)
class Smooth(StringLaw, kind="Smooth"):
    """Slack as a smooth maximum, for optimisers: t = (t′ + √(t′² + (k w)²))/2 with the unclipped tension t′.

    The tension is wrong by at most k w/2, at the rest length, and by k w²/(4 |s − ρ|) far from it.
    Damping fades over the same width.

    Parameters
    ----------
    width : float
        w, m, over which the corner at the rest length is rounded.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> gamma = tc.Smooth(0.01).force_density(squared=1.0, rest=1.0, stiffness=10.0, rate=None, unit=1.0)
    >>> round(float(gamma), 6)
    0.05
    """

    switches: ClassVar[bool] = False
    pushes: ClassVar[bool] = False
    width: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "width", positive_number("Smooth.width", self.width))

    def force_density(
        self, squared: Any, rest: Any, stiffness: Any, rate: Any | None, unit: Any, taut: Any = None
    ) -> Any:
        """Return the force densities of strings, t/s with the smooth tension t.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        rate : casadi expression or None
            c sᵀṡ of each string, N·m; None when none is damped.
        unit : casadi expression
            Typical lengths, m, constant: a string of no length is taken as 1e-9 of them long, to
            have finite derivatives.
        taut : None
            Not needed here: strings are both.

        Returns
        -------
        casadi expression
            γ, N/m, in the shape of the arguments.
        """
        length = self._length(squared, unit)
        stretch = length - rest
        tension = stiffness * stretch
        if rate is not None:
            fade = (1 + stretch / ca.sqrt(stretch * stretch + self.width**2)) / 2
            tension = tension + fade * rate / length
        return (tension + ca.sqrt(tension * tension + (stiffness * self.width) ** 2)) / (2 * length)

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Return the elastic energy of strings: the integral of the undamped tension over the stretch.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        unit : casadi expression
            Typical lengths, m, constant: a string of no length is taken as 1e-9 of them long, to
            have finite derivatives.

        Returns
        -------
        casadi expression
            Energy of each string, J, 0 at the rest length as w → 0.
        """
        e = self._length(squared, unit) - rest
        w = self.width
        return stiffness * (e * e + e * ca.sqrt(e * e + w * w) + w * w * ca.asinh(e / w)) / 4

    def _length(self, squared: Any, unit: Any) -> Any:
        return ca.sqrt(squared + (1e-9 * unit) ** 2)  # finite derivatives at no length


@dataclass(frozen=True)
class Linear(StringLaw, kind="Linear"):
    """No slack: a spring and a damper, which pull while they are longer than at rest and push while they are shorter.

    Such a string has no events, and its force density may be negative.

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
        """Return the force densities of strings, γ = k (s − ρ)/s + c sᵀṡ/s², of either sign.

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        rate : casadi expression or None
            c sᵀṡ of each string, N·m; None when none is damped.
        unit : casadi expression
            Typical lengths, m, constant: a string of no length is taken as 1e-9 of them long, to
            have finite derivatives.
        taut : None
            Not needed here: these strings are never slack.

        Returns
        -------
        casadi expression
            γ, N/m, in the shape of the arguments.
        """
        safe = squared + (1e-9 * unit) ** 2
        gamma = stiffness * (1 - rest / ca.sqrt(safe))
        return gamma if rate is None else gamma + rate / safe

    def energy(self, squared: Any, rest: Any, stiffness: Any, unit: Any) -> Any:
        """Return the elastic energy of strings, ½ k (s − ρ)².

        Parameters
        ----------
        squared : casadi expression
            Squared lengths s², m².
        rest : casadi expression
            Rest lengths ρ, m.
        stiffness : casadi expression
            Stiffness k, N/m.
        unit : casadi expression
            Typical lengths, m, constant: a string of no length is taken as 1e-9 of them long, to
            have finite derivatives.

        Returns
        -------
        casadi expression
            Energy of each string, J.
        """
        stretch = ca.sqrt(squared + (1e-9 * unit) ** 2) - rest
        return stiffness * stretch * stretch / 2


def read_slack(given: Any, strings: int) -> StringLaw | tuple[StringLaw, ...]:
    """Return one law for all strings, or a law for each; of a mapping those that it does not name have `Clip()`. Raises TypeError, ValueError."""
    example = (
        "Clip(), Smooth(width), Linear(), or one of them for each string, such as {3: Linear()}"
    )
    if isinstance(given, StringLaw):
        return given
    if isinstance(given, Mapping):
        laws: list[Any] = [Clip()] * strings
        for key, law in given.items():
            laws[node_index("Scene.slack, string", key, strings, "string")] = law
    else:
        if isinstance(given, (str, bytes)) or not isinstance(given, Sequence):
            instance("Scene.slack", given, StringLaw, example)
        laws = list(as_tuple("Scene.slack", given, example))
        if len(laws) != strings:
            raise ValueError(
                f"Scene.slack has {len(laws)} entries: give one law, or one for each of {strings} strings"
            )
    for string, law in enumerate(laws):
        instance(
            f"Scene.slack[{string}]",
            law,
            StringLaw,
            "Clip(), Smooth(width) or Linear()",
        )
    return (
        cast(StringLaw, laws[0])
        if laws and len(set(laws)) == 1
        else tuple(laws)
        if laws
        else Clip()
    )


def rest_length(force_density: Array, length: Array, stiffness: Array) -> Array:
    """Return the rest lengths ρ = s (1 − γ/k) at which strings carry force densities (Eq. 99).

    Parameters
    ----------
    force_density : ndarray
        γ, N/m.
    length : ndarray
        s, m.
    stiffness : ndarray
        k, N/m.

    Returns
    -------
    ndarray
        ρ, m: not positive where γ ≥ k, as no rest length reaches that, and NaN where k = 0, unless
        γ = 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(force_density == 0, length, length * (1 - force_density / stiffness))

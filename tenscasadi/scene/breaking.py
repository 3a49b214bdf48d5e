"""Strength of strings: the tension at which they break or yield."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.schema.containers import for_items
from tenscasadi.schema.field_types import LIMITS, NUMBER
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import (
    Array,
    IndexOrName,
    NonNegative,
    Positive,
    format_value,
    node_index,
    nonnegative,
    number_or_vector,
    positive_number,
    replace_inf,
)


class Strength(Value, implied="Breaking"):
    """Base class of the failure of strings at a given tension.

    Attributes
    ----------
    verb : str
        Verb for the failure in messages, "breaks" or "yields".
    breaks : bool
        Whether a string fails suddenly and permanently.
    force, margin
        Fields of the subclasses.
    """

    verb: ClassVar[str]
    breaks: ClassVar[bool]
    force: Any
    margin: NonNegative

    def __post_init__(self) -> None:
        name = type(self).__name__
        super().__post_init__()
        if self.margin >= 1:
            raise ValueError(f"{name}.margin is {self.margin:g}: give less than 1")
        given, field = self.force, f"{name}.force"
        if isinstance(given, Mapping):
            own: Any = {
                key: positive_number(f"{field}[{format_value(key)}]", one)
                for key, one in given.items()
            }
            if not own:
                raise ValueError(
                    f"{field} is empty: give the force of a string, such as {{3: 500.0}}"
                )
        else:
            array = number_or_vector(field, replace_inf(given))
            nonnegative(field, array, "string", strict=True)
            own = tuple(np.asarray(given, dtype=float).tolist()) if array.ndim else float(given)
        object.__setattr__(self, "force", own)

    def check(self, strings: int) -> None:
        """Check that the forces are given for the number of strings.

        Parameters
        ----------
        strings : int
            Number of strings.

        Raises
        ------
        TypeError, ValueError
            If there is no such string, or the number of forces differs.
        """
        self.list_forces(strings)

    def list_forces(self, strings: int) -> Array:
        """Return the tension at failure of each string (α,) [N].

        Parameters
        ----------
        strings : int
            Number of strings.

        Returns
        -------
        ndarray, shape (α,)
            Tensions at which strings break [N], inf for strings that cannot break.

        Raises
        ------
        TypeError, ValueError
            If there is no such string, or the number of forces differs.
        """
        if isinstance(self.force, Mapping):
            found = np.full(strings, np.inf)
            for key, one in self.force.items():
                found[
                    node_index(f"{type(self).__name__}.force, string", key, strings, "string")
                ] = one
            return found
        found = np.asarray(self.force, dtype=float)
        if found.ndim and found.shape != (strings,):
            raise ValueError(
                f"{type(self).__name__}.force has {len(found)} entries: "
                f"give one number, or one for each of {strings} strings"
            )
        return np.broadcast_to(found, (strings,))


@dataclass(frozen=True)
class Breaking(Strength, kind="Breaking"):
    """Strings that break when their tension reaches a given force.

    A broken string exerts no force for the rest of the run. A cable breaks as a whole, and so does
    a string that is divided into segments.

    Parameters
    ----------
    force : float or array_like, shape (α,), or mapping of int or str to float
        Tension at which each string breaks [N], greater than 0; inf for strings that cannot break.
        Strings that a mapping such as ``{3: 500.0}`` does not name cannot break.
    margin : float
        Fraction of the force that plans keep as a reserve, at least 0 and less than 1. Their motion
        may exceed a limit a little between the mesh points at which it holds.

    Raises
    ------
    TypeError, ValueError
        If a force is wrong. In a `Scene`: if the number of forces differs from that of strings.

    See Also
    --------
    Trajectory.breaks : Strings that break in a run, with their times.

    Notes
    -----
    Each cable, and each string in no cable, that can break has two internal states: 1 while it is intact and 0 when it
    is broken, and the time for which it has been intact [s]. The tension includes damping. The
    elastic energy of a string that breaks is lost; the energy balance includes it.

    Examples
    --------
    A mass of 1 kg falls onto a string that carries at most 15 N:

    >>> import tenscasadi as tc
    >>> hung = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], node_mass=1.0, pinned=[0], stiffness=1000.0)
    >>> scene = tc.Scene(hung, gravity=tc.Gravity(), strength=tc.Breaking(15.0))
    >>> run = tc.simulate(tc.Model(scene), 0.2, 1e-3, compiled=False)
    >>> [(found.member, round(found.time, 6)) for found in run.breaks]
    [('string 0', 0.067302)]
    """

    verb: ClassVar[str] = "breaks"
    breaks: ClassVar[bool] = True
    force: Annotated[
        ArrayLike | Mapping[IndexOrName, float],
        for_items("string", NUMBER, LIMITS),
    ]

    margin: NonNegative = 0.05


@dataclass(frozen=True)
class Yielding(Strength, kind="Yielding"):
    """Strings that yield while their tension exceeds a given force.

    The rest length of a string grows at the rate (t − F)/η while its tension t exceeds its force F,
    with the viscosity η. The tension then stays near F, and the elongation remains. A cable
    lengthens as a whole, and so does a string that is divided into segments.

    Parameters
    ----------
    force : float or array_like, shape (α,), or mapping of int or str to float
        Tension F at which each string yields [N], greater than 0; inf for strings that cannot yield.
        Strings that a mapping such as ``{3: 500.0}`` does not name cannot yield.
    viscosity : float
        Viscosity η [N·s/m]: the tension exceeds F by η times the rate of the elongation. η over the
        stiffness of the string is a time that the steps must resolve.
    margin : float
        Fraction of the force that plans keep as a reserve, at least 0 and less than 1.

    Raises
    ------
    TypeError, ValueError
        If a field is wrong. In a `Scene`: if the number of forces differs from that of strings, or
        if the control prescribes forces.

    See Also
    --------
    Breaking : Strings that break.
    Trajectory.yields : Strings that yield in a run.

    Notes
    -----
    The elongation p of each string or cable is an internal state: t = k (l − ρ − p). This is
    Perzyna's viscoplasticity [1]_, which tends to perfect plasticity as η tends to 0. The plastic
    work ∫ t dp is lost; the energy balance includes it.

    References
    ----------
    .. [1] P. Perzyna, Fundamental problems in viscoplasticity, Advances in Applied Mechanics 9,
       1966.

    Examples
    --------
    A mass of 1 kg falls onto a string that yields at 15 N:

    >>> import tenscasadi as tc
    >>> hung = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], node_mass=1.0, pinned=[0], stiffness=1000.0)
    >>> scene = tc.Scene(hung, gravity=tc.Gravity(), strength=tc.Yielding(15.0, viscosity=5.0))
    >>> run = tc.simulate(tc.Model(scene), 0.3, 1e-3, compiled=False)
    >>> [(found.member, round(found.elongation, 3)) for found in run.yields]
    [('string 0', 0.006)]
    """

    verb: ClassVar[str] = "yields"
    breaks: ClassVar[bool] = False
    force: Annotated[
        ArrayLike | Mapping[IndexOrName, float],
        for_items("string", NUMBER, LIMITS),
    ]
    viscosity: Positive
    margin: NonNegative = 0.05

"""Bounds on the forces in bars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import ArrayLike

from ocp.problem.bounds.bound import (
    Limit,
    PathBound,
    broadcast_limits,
    drop_infinite,
)
from tenscasadi.schema.field_types import LIMITS, PER_ITEM
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import Array, Positive, per_item, positive_each

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


_Limit = Annotated[ArrayLike, LIMITS, positive_each("bar", zero=True, infinite=True)]


@dataclass(frozen=True, eq=False)
class BarForceLimits(PathBound, kind="BarForceLimits"):
    """Limits of the force in each bar.

    They hold at both ends of every interval.

    Parameters
    ----------
    compression : float or array_like, shape (β,), optional
        Largest compression [N], ≥ 0: one number, or one for each bar. None or inf for no limit.
    tension : float or array_like, shape (β,), optional
        Largest tension [N], ≥ 0: one number, or one for each bar. None or inf for no limit.

    Raises
    ------
    TypeError, ValueError
        If both are None, or if a limit is negative or not a number. In a `Problem`: if there are no
        bars, or if the number of limits differs from that of bars.

    See Also
    --------
    Buckling : Limits of the compression from the bars' material and radius.

    Examples
    --------
    >>> import ocp
    >>> ocp.BarForceLimits(compression=30.0).compression
    30.0
    """

    compression: _Limit | None = None
    tension: _Limit | None = None

    def __post_init__(self) -> None:
        if self.compression is None and self.tension is None:
            raise ValueError(
                "BarForceLimits.compression and .tension are both None: give at least one"
            )
        super().__post_init__()

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If there are no bars, or if the number of limits differs from that of bars.
        """
        _check_bars("BarForceLimits", structure)
        self._most(structure)

    def _most(self, structure: Structure) -> tuple[Array, Array]:
        """Broadcast the largest compression and tension of bars (β,) [N]."""
        count = len(structure.bars)
        compression = broadcast_limits(
            "BarForceLimits.compression", self.compression, count, np.inf
        )
        return compression, broadcast_limits("BarForceLimits.tension", self.tension, count, np.inf)

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Force of each bar [N], positive in compression.
        """
        compression, tension = self._most(now.model.scene.structure)
        names = tuple(f"compression of bar {k}" for k in range(len(tension)))
        return drop_infinite(Limit(now.bar_force, -tension, compression, names, "N"))


@dataclass(frozen=True, eq=False)
class Buckling(PathBound, kind="Buckling"):
    """Compression of solid round bars below their Euler load.

    It holds at both ends of every interval.

    Parameters
    ----------
    modulus : float or array_like, shape (β,)
        Young's modulus E [Pa], > 0: one number, or one for each bar.
    safety : float, optional
        Factor of safety, > 0, by which the load is divided.

    Raises
    ------
    TypeError, ValueError
        If modulus or safety is not a positive number. In a `Problem`: if there are no bars, if the
        number of moduli differs from that of bars, or if a bar has no radius.

    Notes
    -----
    The limit is π² E I / (l² · safety) with I = π r⁴/4, for a bar with pinned ends. Its radius r
    and length l are those of the structure.

    Examples
    --------
    >>> import ocp
    >>> import tenscasadi as tc
    >>> steel = tc.Structure([[0, 0, 0], [0, 0, 1.0]], bars=[(0, 1)], strings=[], bar_radius=0.01)
    >>> ocp.Buckling(200e9).loads(steel).round()
    array([15503.])
    """

    modulus: Annotated[ArrayLike, PER_ITEM, positive_each("bar")]
    safety: Positive = 1.0

    def check(self, structure: Structure) -> None:
        """Check that the bound can apply to a structure.

        Parameters
        ----------
        structure : Structure
            The structure of the problem's model.

        Raises
        ------
        TypeError, ValueError
            If there are no bars, if the number of moduli differs from that of bars, or if a bar has
            no radius.
        """
        _check_bars("Buckling", structure)
        bad = np.flatnonzero(structure.bar_radius == 0)
        if bad.size:
            raise ValueError(
                f"Buckling needs the radius of bar {bad[0]}, which is 0: give Structure(bar_radius=...) or BarForceLimits"
            )
        self.loads(structure)

    def loads(self, structure: Structure) -> Array:
        """Compute the allowed compression of each bar (β,) [N].

        Parameters
        ----------
        structure : Structure
            The structure with the bars.

        Returns
        -------
        numpy.ndarray, shape (β,)
            Euler load divided by the factor of safety [N].
        """
        E = per_item("Buckling.modulus", self.modulus, len(structure.bars))
        inertia = np.pi * structure.bar_radius**4 / 4
        return np.asarray(np.pi**2 * E * inertia / structure.bar_lengths**2 / self.safety)

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Compression of each bar [N].
        """
        loads = self.loads(now.model.scene.structure)
        names = tuple(f"buckling of bar {k}" for k in range(len(loads)))
        return Limit(now.bar_force, np.full(len(loads), -np.inf), loads, names, "N")


def _check_bars(name: str, structure: Structure) -> None:
    if not len(structure.bars):
        raise ValueError(f"{name} limits bars, and the structure has none: leave it out")

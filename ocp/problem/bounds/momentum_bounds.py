"""Bounds on the velocity of the center of mass and on the angular momentum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ocp.problem.bounds.axis_limits import AxisLimits
from ocp.problem.bounds.bound import Limit

if TYPE_CHECKING:
    from ocp.problem.instant import Instant


@dataclass(frozen=True, eq=False)
class CenterOfMassVelocityLimits(AxisLimits, kind="CenterOfMassVelocityLimits"):
    """Limits of the velocity of the center of mass.

    They hold at the end of every interval. The start has to satisfy them, too. The mass is that of
    bars, bodies, nodes and strings, pinned or not.

    Parameters
    ----------
    lower : sequence of float or None, length 3, optional
        Smallest velocity (vx, vy, vz) [m/s]; None for an open side.
    upper : sequence of float or None, length 3, optional
        Largest velocity (vx, vy, vz) [m/s]; None for an open side.

    Raises
    ------
    TypeError, ValueError
        If all sides are open, if a limit is not three numbers or None, or if ``lower`` is not below
        ``upper``. In a `Problem`: if the start is outside.

    See Also
    --------
    CenterOfMassVelocity : The velocity at the end.

    Examples
    --------
    >>> import ocp
    >>> ocp.CenterOfMassVelocityLimits(upper=(None, None, 0.2)).upper
    (None, None, 0.2)
    """

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Velocity of the center of mass [m/s].
        """
        velocity = now.center_of_mass_velocity
        return self.limit_vector(velocity, "velocity of the center of mass", "m/s")


@dataclass(frozen=True, eq=False)
class AngularMomentumLimits(AxisLimits, kind="AngularMomentumLimits"):
    """Limits of the angular momentum about the center of mass.

    They hold at the end of every interval. The start has to satisfy them, too.

    Parameters
    ----------
    lower : sequence of float or None, length 3, optional
        Smallest angular momentum about x, y and z [kg m²/s]; None for an open side.
    upper : sequence of float or None, length 3, optional
        Largest angular momentum about x, y and z [kg m²/s]; None for an open side.

    Raises
    ------
    TypeError, ValueError
        If all sides are open, if a limit is not three numbers or None, or if ``lower`` is not below
        ``upper``. In a `Problem`: if the start is outside.

    See Also
    --------
    AngularMomentum : The angular momentum at the end.

    Examples
    --------
    >>> import ocp
    >>> ocp.AngularMomentumLimits(upper=(None, None, 0.01)).lower
    (None, None, None)
    """

    def limit(self, now: Instant) -> Limit:
        """Build the constrained quantities.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Limit
            Angular momentum about the center of mass [kg m²/s].
        """
        return self.limit_vector(now.angular_momentum, "angular momentum", "kg m²/s")

"""Goals for linear and angular momentum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.problem.goals.goal import FreePoint, Goal
from ocp.problem.rows import Rows
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from ocp.problem.instant import Instant
    from tenscasadi.dynamics.model import Model


@dataclass(frozen=True, eq=False)
class CenterOfMassVelocity(Goal, kind="CenterOfMassVelocity"):
    """Goal for the final velocity of the center of mass.

    The mass is that of bars, bodies, nodes and strings, pinned or not.

    Parameters
    ----------
    velocity : sequence of float or None, length 3
        Velocity (vx, vy, vz) [m/s], with None for a free axis.

    Raises
    ------
    TypeError, ValueError
        If the velocity is not three numbers or None, or if all are None.

    See Also
    --------
    CenterOfMass : Position of the center of mass.
    CenterOfMassVelocityLimits : Limits along the whole plan.

    Examples
    --------
    >>> import ocp
    >>> ocp.CenterOfMassVelocity((0.0, None, 2.0)).velocity
    (0.0, None, 2.0)
    """

    velocity: FreePoint

    def residuals(self, now: Instant) -> Rows:
        """Build the center of mass velocity minus the desired one.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Rows
            Named residuals [m/s], zero if the goal is satisfied.
        """
        return _rows("CenterOfMassVelocity: {}", now.center_of_mass_velocity, self.velocity, 1.0)


@dataclass(frozen=True, eq=False)
class AngularMomentum(Goal, kind="AngularMomentum"):
    """Goal for the final angular momentum about the center of mass.

    Parameters
    ----------
    momentum : sequence of float or None, length 3
        Angular momentum about x, y and z [kg m²/s], with None for a free axis.

    Raises
    ------
    TypeError, ValueError
        If the momentum is not three numbers or None, or if all are None. In a `Problem`: if the
        whole mass is in one point.

    See Also
    --------
    AngularMomentumLimits : Limits along the whole plan.

    Notes
    -----
    Residuals are divided by the mass m and the radius of gyration r of the model's initial nodes,
    m r² = Σ M (n − c)·(n − c). They are then speeds [m/s], with the tolerance of other speeds.

    Examples
    --------
    >>> import ocp
    >>> ocp.AngularMomentum((None, None, 0.05)).momentum
    (None, None, 0.05)
    """

    momentum: FreePoint

    def bind(self, model: Model, start: Array | None) -> Goal:
        """Check that the model can have an angular momentum.

        Parameters
        ----------
        model : Model
            The model of the problem.
        start : ndarray of shape (nx,), optional
            Initial state; None if it is free.

        Returns
        -------
        Goal
            The same goal.

        Raises
        ------
        ValueError
            If the whole mass is in one point.
        """
        if not _momentum_of_unit_speed(model):
            raise ValueError(
                "AngularMomentum: the whole mass is in one point, which has no angular momentum: "
                "leave the goal out"
            )
        return self

    def residuals(self, now: Instant) -> Rows:
        """Build the angular momentum minus the desired one.

        Parameters
        ----------
        now : Instant
            Symbolic instant.

        Returns
        -------
        Rows
            Named residuals, divided by mass and radius of gyration [m/s].
        """
        name = "AngularMomentum: {}, divided by mass and radius of gyration"
        scale = _momentum_of_unit_speed(now.model)
        return _rows(name, now.angular_momentum, self.momentum, scale)


def _rows(name: str, vector: Any, wanted: Sequence[float | None], scale: float) -> Rows:
    """Build the scaled residuals [m/s] of a vector (3,).

    There is one for each axis on which ``wanted`` has a goal. ``scale`` divides them. ``name`` is
    their name with {} for the axis.
    """
    axes = [axis for axis in range(3) if wanted[axis] is not None]
    value = (vector[axes] - np.array([wanted[axis] for axis in axes])) / scale
    return Rows(value, tuple(name.format("xyz"[axis]) for axis in axes), ("m/s",) * len(axes))


def _momentum_of_unit_speed(model: Model) -> float:
    """Compute mass × radius of gyration [kg m] in the initial nodes.

    The angular momentum divided by it is a velocity [m/s].
    """
    M, N = model.mechanism.M, model.mechanism.N
    weight = np.asarray(M.sum(axis=1)).ravel()
    arms = N - (N @ weight / weight.sum())[:, None]
    square = float(np.sum(arms * np.asarray(M @ arms.T).T))  # mass × (radius of gyration)²
    return float(np.sqrt(max(square, 0.0) * weight.sum()))

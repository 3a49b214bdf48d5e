"""The ground: it pushes on nodes below it, with Coulomb's friction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.util.validate import finite_array, number, positive_number


@dataclass(frozen=True)
class Ground:
    """A plane that pushes on every node below it, and never pulls (Sect. 7.4).

    The plane is normalᵀx = height. A node at depth d that moves along the normal at speed v is pushed with k d − c v.

    Parameters
    ----------
    stiffness : float
        k, N/m.
    damping : float
        c, N·s/m.
    friction : float, optional
        Coulomb's coefficient μ; by default the plane is frictionless.
    height : float
        Distance of the plane from the origin along the normal, m.
    normal : sequence of float, shape (3,)
        Direction away from the ground, of any length.
    slip_speed : float
        Speed v_s, m/s, over which friction is regularised.

    Notes
    -----
    Friction is μ f v_t/√(v_t² + v_s²) for a push f and a tangential velocity v_t. A body that should stick therefore creeps, at
    v_s r/√(1 − r²) where it needs the share r of the friction that there is.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> ground = tc.Ground(stiffness=1e3, height=0.5)
    >>> round(float(ground.forces([0, 0, 0.25], [0, 0, 0])[2]), 6)
    250.0
    """

    stiffness: float = 1e4
    damping: float = 0.0
    friction: float | None = None
    height: float = 0.0
    normal: Sequence[float] = (0.0, 0.0, 1.0)
    slip_speed: float = 1e-3

    def __post_init__(self) -> None:
        normal = finite_array("Ground.normal", self.normal, (3,))
        size = float(np.linalg.norm(normal))
        if size == 0:
            raise ValueError("Ground.normal is (0, 0, 0): give the direction away from the ground, such as (0, 0, 1)")
        checked = {
            "stiffness": positive_number("Ground.stiffness", self.stiffness),
            "damping": positive_number("Ground.damping", self.damping, zero=True),
            "friction": None if self.friction is None else positive_number("Ground.friction", self.friction),
            "height": number("Ground.height", self.height),
            "normal": tuple(float(v) for v in (normal if abs(size - 1) < 1e-15 else normal / size)),  # once normalised it stays as it is
            "slip_speed": positive_number("Ground.slip_speed", self.slip_speed),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def conservative(self) -> bool:
        """Whether the plane neither damps nor rubs."""
        return self.damping == 0 and self.friction is None

    def forces(self, N: Any, V: Any, touching: Any = None) -> Any:
        """Return the ground's forces on nodes.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.
        V : casadi expression, shape (3, n)
            Velocities, m/s.
        touching : casadi expression, shape (1, n), optional
            1 or 0 where nodes are held in contact, or off it; by default as their depths say.

        Returns
        -------
        casadi expression, shape (3, n)
            W, N.
        """
        normal = ca.DM(self.normal)
        depth = self.depth(N)
        push = self.stiffness * depth
        if self.damping:
            push = push - self.damping * ca.mtimes(normal.T, V)
            push = ca.fmax(push, 0) if touching is None else push
        push = ca.if_else(depth > 0, push, 0) if touching is None else touching * push  # 1×n
        W = ca.mtimes(normal, push)
        if self.friction is not None:
            slip = V - ca.mtimes(normal, ca.mtimes(normal.T, V))
            drag = self.friction * push / ca.sqrt(ca.sum1(slip * slip) + self.slip_speed**2)
            W = W - slip * ca.repmat(drag, 3, 1)
        return W

    def energy(self, N: Any) -> Any:
        """Return the energy stored in the plane's springs.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        casadi expression
            Energy, J.
        """
        depth = ca.fmax(self.depth(N), 0)
        return self.stiffness * ca.sum2(depth * depth) / 2

    def depth(self, N: Any) -> Any:
        """Return how deep nodes are below the plane.

        Parameters
        ----------
        N : casadi expression, shape (3, n)
            Nodes, m.

        Returns
        -------
        casadi expression, shape (1, n)
            Depths, m, negative above the plane.
        """
        return self.height - ca.mtimes(ca.DM(self.normal).T, N)

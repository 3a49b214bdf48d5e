"""Linear response of a scene about given nodes and member forces."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from tenscasadi.statics.solver.motions import (
    find_stable_factors,
    neutral_motions,
    softest_motions,
)
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.static_equations import StaticPoint
from tenscasadi.util.linear_algebra import DENSE
from tenscasadi.util.validate import ROUNDING, Array

LOWEST = 20  # motions of large structures that are computed by default


class PrestressedState:
    """Nodes and member forces of a scene, with the tangent stiffness.

    Displacements and modes are those of the free coordinates.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    point : StaticPoint
        Forces and stiffness of the members in the nodes.
    tension : ndarray (β_r,)
        Tensions of the rigid bars [N].
    """

    def __init__(self, system: NewtonSystem, point: StaticPoint, tension: Array) -> None:
        self.system, self.point, self.tension = system, point, tension

    @cached_property
    def scale(self) -> float:
        """Largest stiffness [N/m], approximately."""
        return self.system.stiffness_scale(self.point, self.tension)

    @cached_property
    def tangent(self) -> Any:
        """Tangent stiffness K (free, free), sparse."""
        return self.system.tangent(self.point, self.tension)

    @cached_property
    def lengthening(self) -> Any:
        """Sparse Jacobian J (β_r, free) of the lengths of rigid bars."""
        return self.system.lengthening(self.point)

    @cached_property
    def neutral(self) -> Array:
        """Orthonormal rigid-body motions (free, ·) without stiffness."""
        return neutral_motions(self.system, self.point, self.tension)

    @cached_property
    def is_stable(self) -> bool:
        """Whether all displacements have a positive stiffness.

        Rigid-body motions without stiffness are excluded.
        """
        return find_stable_factors(self.system, self.point, self.tension) is not None

    def describe_softest(self, values: Array) -> str:
        """Describe the softest mode by the smallest eigenvalues [N/m].

        `values` are these eigenvalues in ascending order.
        """
        zero = ROUNDING * self.scale
        if not len(values):
            return "no motion changes the shape"
        flat = int(np.sum(np.abs(values) <= zero))
        if flat and values[0] >= -zero:
            least = "at least " if flat == len(values) else ""  # there may be more of them
            motions = "1 motion has" if flat == 1 else f"{flat} motions have"
            return f"{least}{motions} no stiffness: prestress the structure, or add members or supports"
        return f"softest motion {values[0]:.4g} N/m"

    @cached_property
    def lowest(self) -> tuple[Array, Array]:
        """Smallest eigenvalues of K [N/m], and their modes (free, ·).

        For a small structure they are all eigenvalues.
        """
        return self.softest(None if self.system.size <= DENSE else LOWEST)

    @cached_property
    def flat(self) -> Array:
        """Orthonormal modes (free, ·) without stiffness.

        They include rigid-body motions.
        """
        zero = ROUNDING * self.scale
        values, motions = self.lowest
        if len(values) and values[-1] <= zero:  # there may be more of them
            values, motions = self.softest(None)
        return np.hstack([self.neutral, motions[:, np.abs(values) <= zero]])

    def softest(self, count: int | None) -> tuple[Array, Array]:
        """Compute the smallest eigenvalues of K and their modes.

        Eigenvalues are (count,) [N/m]. Modes are columns (free, count). None as count means all.
        """
        return softest_motions(self.tangent, self.lengthening, self.neutral, count)

    def displace(self, forces: Array) -> tuple[Array, Array]:
        """Compute the linear response to nodal forces.

        Parameters
        ----------
        forces : ndarray, shape (n, 3)
            Forces on the nodes [N].

        Returns
        -------
        tuple of ndarray
            Displacements (free,) [m] and changes of the tensions of rigid bars (β_r,) [N].
        """
        system, flat = self.system, self.flat
        f = system.equations.in_free_directions(forces)
        f = f - flat @ (flat.T @ f)
        factors = system.factor(self.point, self.tension, self.scale, ROUNDING * self.scale)
        y, multipliers = factors.solve(f)
        for _ in range(3):  # removes the shift
            rest = f - self.tangent @ y - self.lengthening.T @ multipliers
            change, more = factors.solve(rest - flat @ (flat.T @ rest))
            y, multipliers = y + change, multipliers + more
        return np.asarray(y - flat @ (flat.T @ y)), multipliers

    def force_stiffness(self, forces: Array) -> Any:
        """Build the geometric stiffness of the member forces due to a load.

        Parameters
        ----------
        forces : ndarray, shape (n, 3)
            Forces on the nodes [N].

        Returns
        -------
        csc_array (free, free)
            Σ Δt/l (I − e eᵀ) over all members, of length l, direction e and tension change Δt [N/m].
        """
        y, tension = self.displace(forces)
        equations, point = self.system.equations, self.point
        moved = equations.spring_vectors((equations.free @ y).reshape(-1, 3))
        squared = np.einsum("ij,ij->i", point.springs, point.springs)
        along = point.gamma + 2 * point.slope * squared  # stiffness along the member
        stretch = np.einsum("ij,ij->i", moved, point.springs)  # l Δl
        pull = along * stretch / squared  # Δt/l
        for one, other in (equations.coupled.T, equations.coupled.T[::-1]):
            np.add.at(pull, one, 2 * point.coupling * stretch[other])
        density = np.concatenate([pull, tension / equations.lengths])
        vectors = np.concatenate([point.springs, point.bars])
        squared = np.einsum("ij,ij->i", vectors, vectors)
        return self.system.member_matrix(density, -density / squared, vectors)

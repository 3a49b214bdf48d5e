"""The forces that a plan asks of strings and bars, and the rest lengths that bring them about."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import rest_length
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import Structure
from tenscasadi.util.tables import Columns, Tabular, name_columns, name_coordinates
from tenscasadi.util.validate import Array, flag, nonnegative, per_item


class PlannedForces(Tabular):
    """The part of a `Plan` that tells its forces; a plan has these attributes as fields.

    Its table has a row for each node of the mesh. What is held from a node to the next stands in
    the row of the first, and once more in the last row. Rest lengths are those of `rest_lengths`,
    and left out where none of the structure's stiffness pulls as planned.
    """

    time: Array
    force_density: Array
    rest_length: Array | None
    trajectory: Trajectory
    structure: Structure

    def require_model(self, user: str) -> Model:
        """Return the model, which `user` needs. Raises ValueError where it is not known."""
        raise NotImplementedError

    @property
    def control(self) -> Array:
        """Rest lengths, m, or force densities, N/m, as decided (K, α) or (K + 1, α)."""
        return self.force_density if self.rest_length is None else self.rest_length

    @property
    def linear(self) -> bool:
        """Whether force densities are given at the nodes of the mesh, and linear between them."""
        return len(self.force_density) == len(self.time)

    def _columns(self) -> Columns:
        rows = np.minimum(np.arange(len(self.time)), len(self.force_density) - 1)
        gamma = self.force_density[rows]
        soft = self.rest_length is None and np.any(
            (gamma > 0) & (gamma >= self.structure.stiffness)
        )
        return {
            "time (s)": self.time,
            **name_columns("string {} force density (N/m)", gamma),
            **name_columns("string {} tension (N)", gamma * self.lengths()),
            **(
                {} if soft else name_columns("string {} rest length (m)", self.rest_lengths()[rows])
            ),
            **name_coordinates("node {} {} (m)", self.trajectory.nodes),
            **name_coordinates("node {} velocity {} (m/s)", self.trajectory.velocities),
        }

    def lengths(self) -> Array:
        """Return the distances between the ends of each string.

        Returns
        -------
        ndarray, shape (K + 1, α)
            Lengths at the nodes of the mesh, m.
        """
        ends = self.trajectory.nodes[:, self.structure.strings]
        return np.asarray(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2))

    def tension(self, end: bool = False) -> Array:
        """Return the tensions of the strings, force density times length.

        Parameters
        ----------
        end : bool
            Whether to take them at the end of each interval, instead of at its start.

        Returns
        -------
        ndarray, shape (K, α)
            Tensions, N.
        """
        flag("end", end)
        instants, gamma = slice(1, None) if end else slice(-1), self.force_density
        return np.asarray((gamma[instants] if self.linear else gamma) * self.lengths()[instants])

    def bar_forces(self) -> Array:
        """Return the forces of the bars at the start of each interval, λ ‖b‖ (Eqs. 46, 87).

        Returns
        -------
        ndarray, shape (K, β)
            Forces, N, positive in compression.

        Raises
        ------
        ValueError
            The model is not known.
        """
        model, count = self.require_model("bar_forces"), len(self.time) - 1
        lam = model.multiplier_function.map(count)(
            self.trajectory.states[:-1].T, self.force_density[:count].T
        )[0]
        ends = self.trajectory.nodes[:-1, self.structure.bars]
        return np.asarray(
            np.asarray(lam.full()).T * np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
        )

    def rest_lengths(self, stiffness: ArrayLike | None = None) -> Array:
        """Return the rest lengths that were decided, or those of elastic strings that pull as planned, s (1 − γ/k) (Eq. 99, without damping).

        Parameters
        ----------
        stiffness : array_like, scalar or shape (α,), optional
            Stiffness k, N/m. Default: the structure's.

        Returns
        -------
        ndarray, shape (K, α) or (K + 1, α)
            Rest lengths, m, at the start of each interval; at all nodes of the mesh where force
            densities are linear.

        Raises
        ------
        ValueError
            The force density of a string reaches its stiffness; the message names it.
        """
        if self.rest_length is not None and stiffness is None:
            return np.asarray(self.rest_length)
        k = per_item(
            "stiffness",
            self.structure.stiffness if stiffness is None else stiffness,
            self.force_density.shape[1],
        )
        nonnegative("stiffness", k, "string")
        largest = self.force_density.max(axis=0)
        if np.any(soft := (largest > 0) & (largest >= k)):
            i = int(np.argmax(soft))
            raise ValueError(
                f"stiffness of string {i} is {k[i]:g} N/m: it must exceed its force density, up to {largest[i]:g} N/m in this plan"
            )
        return rest_length(self.force_density, self.lengths()[: len(self.force_density)], k)

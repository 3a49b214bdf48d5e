"""Planned forces of strings and bars, and corresponding rest lengths."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.control import Control
from tenscasadi.scene.strings import RestLength, Tension, rest_length
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.cables import name_inputs
from tenscasadi.structure.class_one import distances
from tenscasadi.structure.structure import Structure
from tenscasadi.util.tables import Quantity, Tabular
from tenscasadi.util.validate import Array, flag, nonnegative, per_item


class PlannedForces(Tabular):
    """Base class of `Plan` that computes its forces.

    The attributes are fields of a plan. The table has one row for each mesh point. Piecewise
    constant values are in the row of the start of their interval; the last row repeats the values
    of the last interval. The columns of rest lengths are those of `rest_lengths`. They are omitted
    if a planned force density reaches the stiffness of its string.
    """

    time: Array
    force_density: Array
    inputs: Array | None
    input_attribute: str
    trajectory: Trajectory
    structure: Structure

    def require_model(self, user: str) -> Model:
        """Return the model, or raise ValueError if it is unknown.

        The message names the function `user` that needs it.
        """
        raise NotImplementedError

    @property
    def control(self) -> Array:
        """Control values (K, nu) or (K + 1, nu).

        They are force densities [N/m] of strings. Otherwise they are rest lengths [m], their rates
        [m/s], motor torques [N m] or tensions [N], one for each cable and for each string in no
        cable.
        """
        return self.force_density if self.inputs is None else self.inputs

    @property
    def rest_length(self) -> Array | None:
        """Rest lengths (K, nu) or (K + 1, nu) [m] under ``control=RestLength()``, else None.

        A cable has one entry. `force_density` has the resulting force densities at the same times.
        """
        return self._inputs_of(RestLength)

    @property
    def input_tension(self) -> Array | None:
        """Tensions (K, nu) or (K + 1, nu) [N] under ``control=Tension()``, else None."""
        return self._inputs_of(Tension)

    @property
    def rest_length_rate(self) -> Array | None:
        """Winding speeds (K, nu) or (K + 1, nu) [m/s] under ``control=RestLengthRate()``, else None.

        `rest_lengths` returns the resulting rest lengths.
        """
        return self._inputs_of(RestLengthRate)

    @property
    def motor_torque(self) -> Array | None:
        """Motor torques (K, nu) or (K + 1, nu) [N m] under ``control=Winch(...)``, else None."""
        return self._inputs_of(Winch)

    def _inputs_of(self, control: type[Control]) -> Array | None:
        return self.inputs if self.input_attribute == control.attribute else None

    @property
    def linear(self) -> bool:
        """Whether force densities are piecewise linear.

        They are then given at the mesh points; otherwise they are constant on each interval.
        """
        return len(self.force_density) == len(self.time)

    def _quantities(self) -> Iterable[Quantity]:
        rows = np.minimum(np.arange(len(self.time)), len(self.force_density) - 1)
        gamma = self.force_density[rows]
        soft = self.rest_length is None and np.any(
            (gamma > 0) & (gamma >= self.structure.stiffness)
        )
        string, nodes = ("string",), ("node", "axis")
        yield Quantity("time", "time (s)", self.time)
        yield Quantity("force_density", "string {} force density (N/m)", gamma, string)
        yield Quantity("tension", "string {} tension (N)", gamma * self.lengths(), string)
        if not soft:
            item, column = "string", "string {} rest length (m)"
            if self.structure.cables:  # whose labels say which are cables
                item, column = "input", "{} rest length (m)"
            yield Quantity("rest_length", column, self.rest_lengths()[rows], (item,))
        yield Quantity("position", "node {} {} (m)", self.trajectory.nodes, nodes)
        velocities = self.trajectory.velocities
        yield Quantity("velocity", "node {} velocity {} (m/s)", velocities, nodes)

    def _labels(self) -> Mapping[str, Sequence[str]]:
        s = self.structure
        return {"node": s.node_names, "string": s.string_names, "input": name_inputs(s)}

    def lengths(self) -> Array:
        """Compute the lengths of all strings.

        Returns
        -------
        ndarray, shape (K + 1, α)
            Lengths at the mesh points [m].
        """
        return distances(self.trajectory.nodes, self.structure.strings)

    def tension(self, end: bool = False) -> Array:
        """Compute the string tensions, force density times length.

        Parameters
        ----------
        end : bool
            Whether to evaluate them at the end of each interval instead of at its start.

        Returns
        -------
        ndarray, shape (K, α)
            Tensions [N].
        """
        flag("end", end)
        instants, gamma = slice(1, None) if end else slice(-1), self.force_density
        return np.asarray((gamma[instants] if self.linear else gamma) * self.lengths()[instants])

    def bar_forces(self) -> Array:
        """Compute the bar forces λ ‖b‖ (Eqs. 46, 87).

        Returns
        -------
        ndarray, shape (K, β)
            Forces at the start of each interval [N], positive in compression.

        Raises
        ------
        ValueError
            If the model is unknown.
        """
        model, count = self.require_model("bar_forces"), len(self.time) - 1
        lam = model.multiplier_function.map(count)(
            self.trajectory.states[:-1].T, self.control[:count].T
        )[0]
        lengths = distances(self.trajectory.nodes[:-1], self.structure.bars)
        return np.asarray(lam.full()).T * lengths

    def rest_lengths(self, stiffness: ArrayLike | None = None) -> Array:
        """Compute the rest lengths that produce the planned force densities.

        If no stiffness is given, a plan under rest-length control returns its control, and a plan
        of winches its internal states. Otherwise the rest lengths are s (1 − γ/k) for elastic
        strings of length s, without damping (Eq. 99). That of a cable is the sum over its strings.

        Parameters
        ----------
        stiffness : array_like, scalar or shape (α,), optional
            Stiffness k [N/m]. Default: that of the structure.

        Returns
        -------
        ndarray, shape (K, nu) or (K + 1, nu)
            Rest lengths [m] of cables and strings in no cable at the start of each interval, or at all
            mesh points if force densities are piecewise linear.

        Raises
        ------
        ValueError
            If the force density of a string reaches its stiffness. The message names the string.
        """
        if self.rest_length is not None and stiffness is None:
            return np.asarray(self.rest_length)
        known = self.trajectory.internal_states
        if known and stiffness is None:
            return known["rest length"][: len(self.force_density)]
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
        rest = rest_length(self.force_density, self.lengths()[: len(self.force_density)], k)
        if not self.structure.cables:
            return rest
        inputs = np.arange(len(name_inputs(self.structure)))
        return np.asarray(rest @ np.equal.outer(self.structure.cable_of, inputs).astype(float))

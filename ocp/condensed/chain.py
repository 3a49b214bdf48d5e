"""The motion of `Variational` as a chain of stations in NumPy: its residuals, its linearisation, and solutions with it forwards and backwards."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.condensed.controls import Controls, compact
from ocp.transcription.mesh import Profile
from tenscasadi.dynamics import forces
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices


class Motion(NamedTuple):
    """Iterates of the motion, apart from the force densities.

    places Q (K + 1, n, 3), m; rates Y (X, n, 3): velocities times the duration, at the taps; bars l
    (K + X, β): −λ̂ σ T², kg.
    """

    places: Array
    rates: Array
    bars: Array

    def moved(self, step: Motion, length: float = 1.0) -> Motion:
        """Return the motion after a part of a step."""
        return Motion(*(one + length * change for one, change in zip(self, step, strict=True)))


class Rows(NamedTuple):
    """Residuals of the motion: M⁻ times impulses (K + X, 3n), m, and of the bars (K + X, β), m²."""

    impulses: Array
    lengths: Array


class Chain:
    """The constant matrices of the discrete equations of motion.

    Stations i: the nodes k = 0 … K − 1 of the mesh, whose rows lead to the places at k + 1, then
    the taps, whose rows give velocities: the last node, and others where waypoints ask for them.
    With Y_k = (Q_{k+1} − Q_k)/s_k, s_k the shares of the duration T, rows are

        M (Y_i − Y_{i−1}) + C_sᵀ γ̂ T²σ_i C_s Q_i + C_bᵀ l̂_i C_b Q_i − T²σ_i W_i = 0,   ½ (bᵀb − l²) = 0 at k + 1, or bᵀḃ = 0 at a tap.

    They are those of `Variational`, with each multiplier of a bar taken times −σ T².
    """

    def __init__(
        self, model: Model, fractions: Array, profile: Profile, start: Array, taps: Indices
    ) -> None:
        mech = model.mechanism
        self.model, self.mech, self.shares, self.taps = model, mech, fractions, taps
        self.count, self.nodes, self.bars = len(fractions), mech.N.shape[1], mech.bars
        self.at = np.concatenate([np.arange(self.count), taps])  # node of the mesh of each station
        self.before = self.at - 1
        self.controls = Controls(model, fractions, profile, taps)
        self.C_s, self.C_b, self.C_sT, self.C_bT = (
            compact(matrix) for matrix in (mech.C_s, mech.C_b, mech.C_s.T, mech.C_b.T)
        )
        self.squared = mech.lengths**2
        self.mass = mech.M.toarray()
        self.alike = len(mech.inverse) == 1  # what moves along one axis moves along all
        self.inverse = mech.inverse[0].toarray() if self.alike else _wide_inverse(mech.inverse)
        self._set_start(start)

    def _set_start(self, start: Array) -> None:
        """Read where nodes start, where supports are moved to, and what loads push."""
        model, self.start = self.model, start
        self.clock = float(start[-1]) if model.scene.has_clock else 0.0
        x = ca.SX.sym("x", model.nx)
        N, V, _ = model.unpack(x)
        self._unpack = ca.Function("unpack", [x], [ca.vec(N), ca.vec(V)])
        self.first_rate = self.unpack(start[None])[1][0]
        T, part, share = ca.SX.sym("T"), ca.SX.sym("t"), ca.SX.sym("s")
        terms = forces.terms(
            model.scene,
            self.mech,
            ca.DM(self.mech.N),
            ca.DM.zeros(*self.mech.N.shape),
            ca.DM.zeros(model.nu),
            self.clock + T * part,
        )
        loads = [value for name, value in terms.items() if name != "strings"]
        impulse = ca.densify(T**2 * share * ca.vec(sum(loads, start=ca.SX.zeros(3, self.nodes))))
        slope = ca.jacobian(impulse, T)
        self._impulse = (
            ca.Function("impulse", [T, part, share], [impulse, slope, ca.jacobian(slope, T)])
            if loads
            else None
        )
        self.time = np.append(0.0, np.cumsum(self.shares))
        supports, self.moved = model.scene.supports, list[int]()
        if supports is not None:
            self.moved, rates = supports.nodes, supports.rates()(self.clock + T * part)
            N, V = ca.SX(3, self.nodes), ca.SX(3, self.nodes)
            N[:, self.moved], V[:, self.moved] = rates[0], T * rates[1]
            values = [ca.vec(N), ca.vec(V)]
            values += [ca.jacobian(value, T) for value in values]
            values += [ca.jacobian(value, T) for value in values[2:]]
            self._carried = ca.Function(
                "carried", [T, part], [ca.densify(value) for value in values]
            )

    def unpack(self, states: Array) -> tuple[Array, Array]:
        """Return places and velocities (P, n, 3) of states (P, nx)."""
        values = self._unpack.map(len(states))(states.T)
        places, rates = (
            np.asarray(value.full()).T.reshape(len(states), self.nodes, 3) for value in values
        )
        return places, rates

    def impulses(self, duration: float) -> Array:
        """Return what loads push at the stations, T²σW, and its first two derivatives by T: (3, K + X, 3n)."""
        return self.loads_at(duration, self.time[self.at], self.controls.weight)

    def loads_at(self, duration: float, shares: Array, weights: Array) -> Array:
        """Return T²σW and its first two derivatives by T, (3, P, 3n), at shares of the duration (P,), with weights σ (P,)."""
        if self._impulse is None:
            return np.zeros((3, len(shares), 3 * self.nodes))
        values = self._impulse.map(len(shares))(duration, shares[None], weights[None])
        return np.array([np.asarray(value.full()).T for value in values])

    # --- nodes and members ---

    def across(self, matrix: Any, places: Array) -> Array:
        """Return the differences (P, m, 3) that a connectivity matrix (m×n) takes of places (P, n, 3); with its transpose, sums at nodes."""
        count, size = len(places), places.shape[1]
        flat = matrix @ places.transpose(1, 0, 2).reshape(size, -1)
        return np.asarray(flat.reshape(matrix.shape[0], count, 3).transpose(1, 0, 2))

    def by_inverse(self, pushes: Array) -> Array:
        """Return M⁻ times columns of forces (…, 3n, r)."""
        if self.alike:
            shape = pushes.shape
            return np.asarray(
                np.matmul(self.inverse, pushes.reshape(*shape[:-2], self.nodes, -1)).reshape(shape)
            )
        return np.asarray(np.matmul(self.inverse, pushes))

    def stiffness(self, strings: Array, bars: Array) -> Array:
        """Return C_sᵀ ĝ C_s + C_bᵀ l̂ C_b (…, n, n)."""
        flat = self._products @ np.concatenate([strings, bars], axis=1).T
        return np.ascontiguousarray(flat.T).reshape(-1, self.nodes, self.nodes)

    @cached_property
    def _products(self) -> sp.csr_array:
        """(n², α + β): the outer products of each member's row."""
        both = sp.csr_array(sp.vstack([self.mech.C_s, self.mech.C_b]))
        ends = both.tocoo()
        first, n = np.split(ends.col.reshape(-1, 2), 2, axis=1), self.nodes
        i, j = (part.ravel() for part in first)
        own = np.arange(len(i))
        rows, columns = (
            np.concatenate([i * n + i, j * n + j, i * n + j, j * n + i]),
            np.tile(own, 4),
        )
        return sp.csr_array(
            (np.repeat([1.0, 1.0, -1.0, -1.0], len(i) * np.array([1, 1, 1, 1])), (rows, columns)),
            shape=(n * n, len(i)),
        )

    def free(self, nodes: Array) -> Array:
        """Return the free coordinates (nq,) of a vector (n, 3) or (3n,)."""
        return np.asarray(self.mech.local(nodes.reshape(-1))[self.mech.free_index])

    def at_nodes(self, free: Array) -> Array:
        """Return vectors (3n, r) whose free coordinates are (nq, r), and zero elsewhere."""
        wide = np.zeros((free.shape[1], 3 * self.nodes))
        wide[:, self.mech.free_index] = free.T
        return np.asarray(self.mech.world(wide)).T

    def zero_step(self, columns: int) -> Motion:
        """Return a step of r columns that moves nothing."""
        n, taps = 3 * self.nodes, len(self.taps)
        return Motion(
            np.zeros((self.count + 1, n, columns)),
            np.zeros((taps, n, columns)),
            np.zeros((len(self.at), self.bars, columns)),
        )

    # --- residuals ---

    def rows(self, strings: Array, duration: float, motion: Motion) -> Rows:
        """Return what the rows leave at a motion under T²σγ at the stations (K + X, α)."""
        push = self.pushes(strings, duration * self.first_rate, motion) - self.impulses(duration)[0]
        ends, at = (
            self.across(self.C_b, places)
            for places in (motion.places[1:], motion.places[self.taps])
        )
        lengths = 0.5 * ((ends * ends).sum(axis=2) - self.squared)
        turning = (at * self.across(self.C_b, motion.rates)).sum(axis=2)
        return Rows(self.by_inverse(push[:, :, None])[:, :, 0], np.concatenate([lengths, turning]))

    def pushes(self, strings: Array, leaving: Array, motion: Motion) -> Array:
        """Return the changes of momentum less what members push (K + X, 3n), of a motion that leaves its start at rates (n, 3): linear in both."""
        Q, Y, bars = motion
        between = (Q[1:] - Q[:-1]) / self.shares[:, None, None]
        rates = np.concatenate([leaving[None], between, Y])
        change = np.concatenate([between, Y]) - rates[self.at]
        at = Q[self.at]
        pull = self.across(self.C_sT, strings[:, :, None] * self.across(self.C_s, at))
        pull += self.across(self.C_bT, bars[:, :, None] * self.across(self.C_b, at))
        return np.asarray((np.matmul(self.mass, change) + pull).reshape(len(at), -1))

    # --- moved supports ---

    def carried(self, duration: float) -> tuple[Motion, Motion, Motion]:
        """Return places and rates (one column) of nodes that are moved, zero elsewhere, and their first two derivatives by T."""
        found = []
        shares = np.append(self.time, self.time[self.taps])
        values = self._carried.map(len(shares))(duration, shares[None])
        for k in range(0, 6, 2):
            places, rates = (np.asarray(value.full()).T[:, :, None] for value in values[k : k + 2])
            found.append(
                Motion(
                    places[: self.count + 1],
                    rates[self.count + 1 :],
                    np.zeros((len(self.at), self.bars, 1)),
                )
            )
        return found[0], found[1], found[2]

    def placed(self, motion: Motion, duration: float) -> Motion:
        """Return the motion with the nodes that are moved where they are at a duration."""
        if not self.moved:
            return motion
        places, rates = motion.places.copy(), motion.rates.copy()
        where = self.carried(duration)[0]
        for own, given in ((places, where.places), (rates, where.rates)):
            own[:, self.moved] = given.reshape(own.shape)[:, self.moved]
        return Motion(places, rates, motion.bars)


def _wide_inverse(inverse: tuple[Any, ...]) -> Array:
    """M⁻ (3n×3n), node by node, from that of each axis or of each pair of axes."""
    n = inverse[0].shape[0]
    wide = np.zeros((n, 3, n, 3))
    for a in range(3):
        for b in range(3):
            if len(inverse) == 9:
                wide[:, b, :, a] = inverse[3 * a + b].toarray().T  # X M⁻ takes rows a to b
            elif a == b:
                wide[:, a, :, a] = inverse[a].toarray()
    return wide.reshape(3 * n, 3 * n)

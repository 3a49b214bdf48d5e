"""Leapfrog by a discrete principle of least action, with the forces of bars and ground as unknowns."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.base import bar_names, bar_rows, scalar_code
from ocp.transcription.contact_set import ContactSet, reaction_names
from ocp.transcription.sparse_nlp import Block, gathered, split_symbol, symbol_kind
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.dynamics import forces
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

# Where, in an interval, a linear γ has its mean in the sense of the hat functions of the interval's
# start and end: its impulse there.
EARLY, LATE = 1 / 3, 2 / 3


class DiscreteEquations:
    """The equations from node to node of the mesh.

    pushes (K + 1, β + 3s): entries of the force densities of bars and of the reactions on nodes
    that stand.
    """

    def __init__(self, v: Variables, used: Array, contact: ContactSet) -> None:
        self.v, self.model, self.mech, self.contact = v, v.model, v.model.mechanism, contact
        self.nq, self.bars = v.model.nq, v.model.mechanism.bars
        self.pushed = self.bars + len(contact.held)
        self.moved = [] if v.model.scene.supports is None else v.model.scene.supports.nodes
        self._back = v.entries.constants(-v.fractions[:, None])
        self._row_scale = v.scales.mass * v.scales.length / v.count
        # velocities within, and the clock, are unknowns only where something depends on them
        inner, clock = v.states[1:-1, self.nq : 2 * self.nq], v.states[1:, 2 * self.nq :]
        self.with_velocities, self.with_clock = (
            bool(used[asked].any()) for asked in (inner, clock)
        )
        for asked, kept in ((inner, self.with_velocities), (clock, self.with_clock)):
            if not kept:
                v.entries.leave_out(asked)
        lam = self._guessed()
        forces = v.unknowns_at_nodes(bar_names(self.bars, "force density"), lam, v.strength)
        self.pushes = np.hstack([forces, contact.reactions])
        if self.with_velocities:
            # where γ jumps, bars and ground push otherwise before a node than after it: `pushes`
            # are the means of both
            before = "force density before the end"
            ground = np.zeros((v.count - 1, len(contact.held)))
            self.pushes_before = np.hstack(
                [
                    v.unknowns_at_nodes(bar_names(self.bars, before), lam[1:-1], v.strength, 1),
                    v.unknowns_at_nodes(
                        reaction_names("reaction before the end", contact.stands),
                        ground,
                        contact.force,
                        1,
                    ),
                ]
            )

    def _guessed(self) -> Array:
        """λ (K + 1, β) of the guess."""
        if not self.bars:
            return np.zeros((self.v.count + 1, 0))
        guess = self.v.guess
        gamma = (
            guess.force_density
            if self.v.profile.linear
            else np.concatenate([guess.force_density, guess.force_density[-1:]])
        )
        x, u = (
            symbol_kind(self.model.ode).sym(name, size)
            for name, size in (("x", self.model.nx), ("u", self.model.nu))
        )
        N, V, time = self.model.unpack(x)
        _, lam, _ = forward_dynamics(self.model, N, V, u, time)
        values = (
            ca.Function("forces", [x, u], [ca.densify(lam.T)])
            .map(len(gamma))(guess.states.T, gamma.T)
            .full()
            .T
        )
        return np.asarray(np.nan_to_num(values, posinf=0.0, neginf=0.0))

    def blocks(self) -> list[Block]:
        """Return all rows of the motion."""
        v, nq = self.v, self.nq
        q, own, T = v.states[:, :nq], v.interval_controls, v.duration
        m = own.shape[1]
        names = state_names(self.model)[:nq]
        kind = symbol_kind(self.model.ode)

        # First and last: v is given, at the end backwards in time. T² and shares instead of h:
        # polynomial also where the duration is free.
        z, (q0, rate, q1, c, lam, duration, share, passed) = split_symbol(
            kind, nq, nq, nq, m, self.pushed, 1, 1, 1
        )
        force = self._force(q0, rate, v.gamma(c, EARLY), lam, duration * passed)
        (p0, speed), (p1, _) = (self._carried(duration * time) for time in (passed, passed + share))
        row = (
            self._momentum(
                (q1 - q0) / share - duration * rate, (p1 - p0) / share - duration * speed
            )
            - duration**2 * share / 2 * force
        )
        first = np.concatenate(
            [q[0], v.states[0, nq : 2 * nq], q[1], own[0], self.pushes[0], T, v.share[0], v.time[0]]
        )
        rows = tuple(
            f"dynamics of interval {k}, {name}{at}"
            for k, at in ((0, ""), (v.count - 1, " at its end"))
            for name in names
        )
        last = self._backwards(v.states[-1:, nq : 2 * nq], self.pushes[-1:], slice(-1, None))
        self._leaving = self._block("ends", z, row, np.vstack([first, last]), rows)
        result = [self._leaving]

        if v.count > 1:
            z, (q0, q1, q2, c, d, lam, duration, before, after, passed) = split_symbol(
                kind, nq, nq, nq, m, m, self.pushed, 1, 1, 1, 1
            )
            both = before + after
            gamma = (before * v.gamma(c, LATE) + after * v.gamma(d, EARLY)) / both
            force = self._force(q1, (q2 - q0) / (duration * both), gamma, lam, duration * passed)
            p0, p1, p2 = (
                self._carried(duration * time)[0]
                for time in (passed - before, passed, passed + after)
            )
            row = self._momentum(
                (q2 - q1) / after - (q1 - q0) / before, (p2 - p1) / after - (p1 - p0) / before
            )
            row -= duration**2 * both / 2 * force
            index = np.hstack(
                [
                    q[:-2],
                    q[1:-1],
                    q[2:],
                    own[:-1],
                    own[1:],
                    self.pushes[1:-1],
                    v.repeated(T, v.count - 1),
                    v.share[:-1],
                    v.share[1:],
                    v.time[1:-1],
                ]
            )
            rows = tuple(
                f"dynamics of interval {k}, {name}" for k in range(1, v.count) for name in names
            )
            result.append(self._block("middle", z, row, index, rows))

        if self.bars:
            result += self._lengths()
        if self.contact.lands:
            result += self._impact()
        if self.with_velocities:
            result += self._inner_velocities()
        if self.with_clock:
            result.append(self._clock())
        return result

    def _lengths(self) -> list[Block]:
        v, nq = self.v, self.nq
        q, speeds, when = (
            ca.SX.sym("q", nq),
            ca.SX.sym("v", nq),
            ca.SX.sym("when", 2 if self.moved else 0),
        )
        time = when[0] * when[1] if self.moved else 0
        lengths, rates = bar_rows(self.model, self._state(q, speeds, time), v.scales)
        at_nodes = ca.Function(
            "lengths", [ca.vertcat(q, when)], [ca.substitute(lengths, speeds, ca.SX.zeros(nq))]
        )
        names = interval_names(v.count, bar_names(self.bars, "length"))
        last = tuple(
            f"dynamics of interval {v.count - 1}, {name}" for name in bar_names(self.bars, "rate")
        )
        self._rates = Block(
            ca.Function("rates", [ca.vertcat(q, speeds, when)], [rates]),
            self._when(v.states[-1:, : 2 * nq], slice(-1, None)),
            last,
        )
        return [Block(at_nodes, self._when(v.states[1:, :nq], slice(1, None)), names), self._rates]

    def _when(self, entries: Indices, nodes: slice) -> Indices:
        """Entries at nodes of the mesh, with those of their times where supports are moved."""
        v = self.v
        return (
            np.hstack([entries, v.repeated(v.duration, len(entries)), v.time[nodes]])
            if self.moved
            else entries
        )

    def _block(self, name: str, z: Any, row: Any, index: Indices, names: tuple[str, ...]) -> Block:
        function = scalar_code(ca.Function(name, [z], [row / self._row_scale]))
        return Block(function, index, names, scale=self._row_scale)

    def _state(self, q: Any, v: Any, time: Any) -> Any:
        clock = [time + float(self.v.target.start[-1])] if self.model.scene.has_clock else []
        return ca.vertcat(q, v, *clock)

    def _force(self, q: Any, v: Any, gamma: Any, pushes: Any, time: Any) -> Any:
        """F + B λ̂ C_b on the free coordinates, and the reactions of the ground."""
        N, V, clock = self.model.unpack(self._state(q, v, time))
        total = forces.total(self.model.scene, self.mech, N, V, gamma, clock)
        return self._coordinates(total) + self._pushed(N, pushes)

    def _pushed(self, N: Any, pushes: Any) -> Any:
        """B λ̂ C_b on the free coordinates, and the reactions of the ground."""
        standing = sparse(np.eye(self.nq)[:, self.contact.held])
        result = ca.mtimes(standing, pushes[self.bars :, :])
        if self.bars:
            bars = nodal_forces(self.mech, self.mech.bar_vectors(N), pushes[: self.bars].T)
            result = result + self._coordinates(bars)
        return result

    def _coordinates(self, columns: Any) -> Any:
        """Select the free coordinates of columns (3, n)."""
        return self.model.split(self.model.pack(columns, columns, 0))[0]

    def _carried(self, time: Any) -> tuple[Any, Any]:
        """Places and velocities (3×m) of the supports that are moved, at a time since the start."""
        supports = self.model.scene.supports
        if supports is None:
            return ca.DM(3, 0), ca.DM(3, 0)
        places, speeds, _ = supports.rates()(time + float(self.v.target.start[-1]))
        return places, speeds

    def _momentum(self, change: Any, carried: Any) -> Any:
        """M times a change of the free coordinates, and of the supports that are moved, along the free coordinates."""
        _, V, _ = self.model.unpack(self._state(change, change, 0))
        if self.moved:
            V[:, self.moved] = carried
        return self._coordinates(ca.mtimes(V, sparse(self.mech.M)))

    def _per_mass(self) -> ca.Function:
        """M⁻¹ times what pushes the free coordinates."""
        pushed = ca.SX.sym("pushed", self.nq)
        _, V, _ = self.model.unpack(self._state(pushed, pushed, 0))
        return ca.Function("per_mass", [pushed], [self._coordinates(self.mech.with_inverse(V))])

    def _backwards(self, velocities: Indices, lam: Indices, intervals: slice) -> Indices:
        """Entries of the momenta (of velocities) at the ends of intervals, seen backwards in time; lam: of bars before these ends."""
        v = self.v
        before, after = (
            v.states[part, : self.nq][intervals] for part in (slice(-1), slice(1, None))
        )
        own = v.interval_controls[intervals]
        controls = own.reshape(len(own), -1, v.controls.shape[1])[:, ::-1].reshape(own.shape)
        duration = v.repeated(v.duration, len(own))
        return np.hstack(
            [
                after,
                velocities,
                before,
                controls,
                lam,
                duration,
                self._back[intervals],
                v.time[1:][intervals],
            ]
        )

    def _impact(self) -> list[Block]:
        """Rows of an impact without rebound on the nodes that stand from now on.

        M (v⁺ − v⁻) are impulses Jᵀ of bars and ground, J v⁺ = 0 with J the gradients of the bars'
        lengths and of the held coordinates: v⁺ = v⁻ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J v⁻, the projection that
        takes the least energy away.
        """
        v, nq = self.v, self.nq
        bar = v.entries.unknowns(
            bar_names(self.bars, "impulse density"),
            np.zeros(self.bars),
            v.scales.mass / v.scales.time,
        )
        z, (q, was, now, impulses) = split_symbol(ca.SX, nq, nq, nq, self.pushed)
        N, _, _ = self.model.unpack(self._state(q, q, 0))
        row = self._momentum(now - was, self._carried(0)[1]) - self._pushed(N, impulses)
        scale = v.scales.mass * v.scales.length / v.scales.time
        start = v.states[0, : 2 * nq]
        index = [start[:nq], self.contact.arriving, start[nq:], bar, self.contact.impulses]
        names = tuple(f"impact, {name}" for name in state_names(self.model)[:nq])
        blocks = [Block(ca.Function("impact", [z], [row / scale]), np.hstack(index)[None], names)]
        if self.bars:
            rates = tuple(f"impact, {name}" for name in bar_names(self.bars, "rate"))
            blocks.append(replace(self._rates, index=start[None], names=rates))
        return blocks

    def _inner_velocities(self) -> list[Block]:
        """Rows of the velocities within."""
        v, nq = self.v, self.nq
        index = self._backwards(v.states[1:-1, nq : 2 * nq], self.pushes_before, slice(-1))
        blocks = [
            replace(
                self._leaving,
                index=index,
                names=interval_names(v.count - 1, state_names(self.model)[nq : 2 * nq]),
            )
        ]
        if self.bars:
            rates = interval_names(v.count - 1, bar_names(self.bars, "rate"))
            blocks.append(
                replace(
                    self._rates,
                    index=self._when(v.states[1:-1, : 2 * nq], slice(1, -1)),
                    names=rates,
                )
            )
        return blocks

    def _clock(self) -> Block:
        v, z = self.v, ca.SX.sym("z", 3)
        row = (z[0] - float(v.target.start[-1]) - z[1] * z[2]) / v.scales.time
        index = np.hstack([v.states[1:, -1:], v.repeated(v.duration), v.time[1:]])
        return Block(ca.Function("clock", [z], [row]), index, interval_names(v.count, ("clock",)))

    def all_states(self, entries: Any) -> Any:
        """Return the states (nx, K + 1) from the column of all entries."""
        v, nq = self.v, self.nq
        q, rates = (gathered(entries, v.states[:, part]) for part in (slice(nq), slice(nq, 2 * nq)))
        duration = gathered(entries, v.duration[:, None])
        if v.count > 1 and not self.with_velocities:
            rates = ca.horzcat(rates[:, 0], self._momenta(entries, q, duration), rates[:, -1])
        x = ca.vertcat(q, rates)
        if self.model.scene.has_clock:
            x = ca.vertcat(
                x, float(v.target.start[-1]) + ca.mtimes(duration, gathered(entries, v.time))
            )
        if self.bars and v.count > 1 and not self.contact.stands:
            inner = build_projection(self.model, 1).map(v.count - 1)(x[:, 1:-1])
            x = ca.horzcat(x[:, 0], inner, x[:, -1])
        return x

    def _momenta(self, entries: Any, q: Any, duration: Any) -> Any:
        """Velocities (nq, K - 1) of the discrete momenta within; central differences where nodes stand, which these keep at rest."""
        v = self.v
        spacing = ca.diag(1 / (v.fractions[1:] + v.fractions[:-1]))
        central = ca.mtimes(q[:, 2:] - q[:, :-2], spacing) / duration
        if self.contact.stands:
            return central
        # whatever stands at these entries: `central` takes its place
        nowhere = np.zeros((v.count - 1, self.nq), dtype=np.intp)
        z = gathered(entries, self._backwards(nowhere, self.pushes[1:-1], slice(-1)))
        z = ca.vertcat(z[: self.nq, :], central, z[2 * self.nq :, :])
        left = self._leaving.function.map(v.count - 1)(z)
        return central + self._per_mass().map(v.count - 1)(left) * (self._row_scale / duration)

"""Discrete Euler-Lagrange equations as constraints.

Constraint forces and ground reactions are decision variables.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.contact_set import ContactSet, reaction_names
from ocp.transcription.equations import build_constraints, constraint_names, evaluate_multipliers
from ocp.transcription.sparse_nlp import Block, expand, gather, split_symbol
from ocp.transcription.variables import Variables, name_intervals, name_states
from tenscasadi.dynamics import forces
from tenscasadi.integrators.stabilization import build_projection
from tenscasadi.util.casadi_tools import sparse, symbol_kind
from tenscasadi.util.validate import Array, Indices

# Fractions of an interval at which a linear γ equals its mean weighted by the hat function of the
# interval's start and end, which gives its impulse there.
EARLY, LATE = 1 / 3, 2 / 3


class DiscreteEquations:
    """Discrete Euler-Lagrange equations of all mesh points.

    Their variables are those of the plan (`v`), and forces that are added. `used` marks the entries
    on which limits, costs and goals depend.

    Attributes
    ----------
    pushes : ndarray of int, shape (K + 1, c + 3s)
        Variable indices of the forces of c constraints, and of the reactions on s contact nodes.
    """

    def __init__(self, v: Variables, used: Array, contact: ContactSet) -> None:
        self.v, self.model, self.contact, self.nq = v, v.model, contact, v.model.nq
        self.names, self.kept = name_states(v.model), constraint_names(v.model)
        self.constraints = build_constraints(v.model)
        self._back = v.entries.constants(-v.fractions[:, None])
        self._row_scale = v.scales.mass * v.scales.length / v.count
        # Interior velocities and the clock are unknowns only if something depends on them.
        moving = v.model.moving.stop
        self.internal = v.states[:, 2 * self.nq : moving]
        inner, clock = v.states[1:-1, self.nq : 2 * self.nq], v.states[1:, moving:]
        self.with_velocities, self.with_clock = (
            bool(used[asked].any()) for asked in (inner, clock)
        )
        for asked, needed in ((inner, self.with_velocities), (clock, self.with_clock)):
            if not needed:
                v.entries.leave_out(asked)
        controls = v.guess.force_density
        controls = controls if v.profile.linear else np.vstack([controls, controls[-1:]])
        first = evaluate_multipliers(v.model, v.guess.states, controls)
        self.pushes = np.hstack([self._add_forces("force", first), contact.reactions])
        if self.with_velocities:
            # If γ jumps at a mesh point, constraint and ground forces differ before and after it.
            # `pushes` are the means of both.
            names = reaction_names("reaction before the end", contact.stands)
            ground = np.zeros((v.count - 1, len(contact.held)))
            ground_before = v.add_at_nodes(names, ground, contact.force, 1)
            before = self._add_forces("force before the end", first[1:-1], 1)
            self.pushes_before = np.hstack([before, ground_before])

    def _add_forces(self, what: str, first: Array, node: int = 0) -> Indices:
        """Add the forces of constraints as variables.

        They belong to the mesh points from `node` on. `first` are their initial values, one row for
        each mesh point. `what` ends their names.
        """
        names, v = [f"{name} {what}" for name in self.kept], self.v
        return v.add_at_nodes(names, first, v.strength * v.scales.length, node)

    def blocks(self) -> list[Block]:
        """Build all constraints of the discrete dynamics."""
        v, nq = self.v, self.nq
        self._leaving = self._momentum_at_ends()
        result = [self._leaving]
        if v.count > 1:
            result.append(self._momentum_within())
        if self.kept:
            result += [self._lengths(), self._rates(slice(v.count, None))]
        if self.contact.lands:
            result += self._impact()
        if self.with_velocities:
            inner = v.states[1:-1, nq : 2 * nq]
            index = self._backwards(inner, self.pushes_before, slice(-1))
            names = name_intervals(v.count - 1, self.names[nq : 2 * nq])
            result.append(replace(self._leaving, index=index, names=names))
            result += [self._rates(slice(1, -1))] if self.kept else []
        if v.model.na:
            result.append(self._internal())
        return [*result, self._clock()] if self.with_clock else result

    def _momentum_at_ends(self) -> Block:
        """Build the discrete momenta at the start and the end.

        Those at the end follow from the same formula, backwards in time. The equations contain T²
        and fractions of the duration T instead of the step h, so that they are polynomials also for
        a free duration.
        """
        v, nq = self.v, self.nq
        columns = [v.states[:1, :nq], v.states[:1, nq : 2 * nq], v.states[1:2, :nq]]
        columns += [v.interval_controls[:1], self.pushes[:1], v.duration[None]]
        columns += [v.share[:1], v.time[:1], self.internal[:1]]
        z, (q0, speed, q1, c, push, T, share, passed, own) = self._symbols(columns)
        before, after = (
            self._state(q0, speed, T * passed),
            self._state(q1, q1, T * (passed + share)),
        )
        change = (self._nodes(after) - self._nodes(before)) / share
        velocity = self.model.unpack(before)[1]
        row = self._momentum(change - T * velocity)
        row -= T**2 * share / 2 * self._force(before, own, v.gamma(c, EARLY), push)
        last = self._backwards(v.states[-1:, nq : 2 * nq], self.pushes[-1:], slice(-1, None))
        names = name_intervals(1, self.names[:nq])
        at_end = [f"dynamics of interval {v.count - 1}, {name} at its end" for name in self.names]
        return self._block(
            "ends", z, row, np.vstack([np.hstack(columns), last]), (*names, *at_end[:nq])
        )

    def _momentum_within(self) -> Block:
        """Build the discrete Euler-Lagrange equations within the plan."""
        v, nq = self.v, self.nq
        q, own = v.states[:, :nq], v.interval_controls
        columns = [q[:-2], q[1:-1], q[2:], own[:-1], own[1:], self.pushes[1:-1]]
        columns += [v.repeat(v.duration, v.count - 1), v.share[:-1], v.share[1:], v.time[1:-1]]
        columns += [self.internal[1:-1]]
        z, (q0, q1, q2, c, d, push, T, before, after, passed, own) = self._symbols(columns)
        both, times = before + after, (passed - before, passed, passed + after)
        rate = (q2 - q0) / (T * both)
        states = [
            self._state(at, rate, T * time) for at, time in zip((q0, q1, q2), times, strict=True)
        ]
        n0, n1, n2 = map(self._nodes, states)
        gamma = (before * v.gamma(c, LATE) + after * v.gamma(d, EARLY)) / both
        row = self._momentum((n2 - n1) / after - (n1 - n0) / before)
        row -= T**2 * both / 2 * self._force(states[1], own, gamma, push)
        names = [
            f"dynamics of interval {k}, {name}"
            for k in range(1, v.count)
            for name in self.names[:nq]
        ]
        return self._block("middle", z, row, np.hstack(columns), names)

    def _lengths(self) -> Block:
        """Build the bar and joint constraints at mesh points.

        The initial state satisfies them already.
        """
        v, nq = self.v, self.nq
        z, (q, *when) = self._symbols(columns := self._when(v.states[1:, :nq], slice(1, None)))
        x = self._state(q, type(q).zeros(nq), ca.mtimes(*when) if when else 0)
        value = self.constraints(x, 0)[0] / v.scales.length
        names = name_intervals(v.count, self.kept)
        function = expand(ca.Function("lengths", [z], [value]))
        return Block(function, np.hstack(columns), names, scale=v.scales.length)

    def _rates(self, points: slice) -> Block:
        """Build the time derivatives of bar and joint constraints.

        `points` selects the mesh points.
        """
        v, scale = self.v, self.v.scales.length / self.v.scales.time
        columns = self._when(v.states[points, : 2 * self.nq], points)
        z, (moving, *when) = self._symbols(columns)
        x = self._state(moving, type(moving)(0, 1), ca.mtimes(*when) if when else 0)
        function = expand(ca.Function("rates", [z], [self.constraints(x, 0)[1] / scale]))
        names = [
            f"dynamics of interval {k - 1}, {name} rate"
            for k in range(v.count + 1)[points]
            for name in self.kept
        ]
        return Block(function, np.hstack(columns), tuple(names), scale=scale)

    def _when(self, entries: Indices, points: slice) -> list[Indices]:
        """Append the indices of duration and relative times.

        They are needed only if supports move. Returns the index arrays as a list. `entries` are the
        variable indices of a block at the mesh points `points`.
        """
        v = self.v
        if v.model.scene.supports is None:
            return [entries]
        return [entries, v.repeat(v.duration, len(entries)), v.time[points]]

    def _symbols(self, columns: Sequence[Indices]) -> tuple[Any, tuple[Any, ...]]:
        sizes = [column.shape[1] for column in columns]
        return split_symbol(symbol_kind(self.model.ode), *sizes)

    def _block(self, name: str, z: Any, row: Any, index: Indices, names: Sequence[str]) -> Block:
        function = expand(ca.Function(name, [z], [row / self._row_scale]))
        return Block(function, index, tuple(names), scale=self._row_scale)

    def _state(self, q: Any, v: Any, time: Any) -> Any:
        clock = [time + float(self.v.target.start[-1])] if self.model.has_clock else []
        return ca.vertcat(q, v, type(q).zeros(self.model.na), *clock)

    def _nodes(self, x: Any) -> Any:
        return self.model.unpack(x)[0]

    def _momentum(self, velocities: Any) -> Any:
        """Compute the momenta of the free coordinates.

        `velocities` (3, n) are those of all nodes, moving supports included. If they are
        displacements, the result is momenta × time.
        """
        return self.model.mechanism.generalized_forces(
            ca.mtimes(velocities, sparse(self.model.mechanism.M))
        )

    def _force(self, x: Any, internal: Any, gamma: Any, pushes: Any) -> Any:
        """Compute the total forces on the free coordinates.

        They depend on the state x, internal states, force densities `gamma`, and the constraint
        forces and reactions `pushes`.
        """
        N, V, clock = self.model.unpack(x)
        inputs = ca.vertcat(gamma, internal) if self.model.na else gamma
        total = forces.total(self.model.scene, self.model.mechanism, N, V, inputs, clock)
        return self.model.mechanism.generalized_forces(total) + self._push(x, pushes)

    def _push(self, x: Any, pushes: Any) -> Any:
        """Compute constraint forces and ground reactions from their variables.

        They are generalized forces on the free coordinates. `x` is the state; `pushes` are the
        multipliers of the constraints, followed by the reactions.
        """
        count, standing = len(self.kept), sparse(np.eye(self.nq)[:, self.contact.held])
        return self.constraints(x, pushes[:count, :])[2] + ca.mtimes(standing, pushes[count:, :])

    def _backwards(self, velocities: Indices, pushes: Indices, intervals: slice) -> Indices:
        """Select the variables of the momenta at interval ends.

        The momenta follow from the formula of interval starts, backwards in time. `pushes` are the
        forces before these ends. `velocities` are the indices of the velocities at the ends of
        `intervals`.
        """
        v, q = self.v, self.v.states[:, : self.nq]
        own = v.interval_controls[intervals]
        controls = own.reshape(len(own), -1, v.controls.shape[1])[:, ::-1].reshape(own.shape)
        columns = [q[1:][intervals], velocities, q[:-1][intervals], controls, pushes]
        columns += [v.repeat(v.duration, len(own)), self._back[intervals], v.time[1:][intervals]]
        return np.hstack([*columns, self.internal[1:][intervals]])

    def _impact(self) -> list[Block]:
        """Build the equations of an inelastic impact.

        Constraints and ground cause the change of momentum M (v⁺ − v⁻) = Jᵀ p with impulses p, and
        J v⁺ = 0. J has the gradients of the constraints and of the contact nodes' coordinates. The
        result is v⁺ = v⁻ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J v⁻, the projection with the least loss of energy.
        """
        v, nq = self.v, self.nq
        scale = v.scales.mass * v.scales.length / v.scales.time
        names = [f"{name} impulse" for name in self.kept]
        impulses = v.entries.unknowns(names, np.zeros(len(names)), scale)
        pushes = np.append(impulses, self.contact.impulses)
        q, after = np.split(v.states[:1, : 2 * nq], [nq], axis=1)
        columns = [q, self.contact.arriving[None], after, pushes[None]]
        z, (at, was, now, push) = self._symbols(columns)
        change = self.model.unpack(self._state(at, now - was, 0))[1]
        row = (self._momentum(change) - self._push(self._state(at, at, 0), push)) / scale
        function = expand(ca.Function("impact", [z], [row]))
        rows = tuple(f"impact, {name}" for name in self.names[:nq])
        blocks = [Block(function, np.hstack(columns), rows, scale=scale)]
        if self.kept:
            rates = tuple(f"impact, {name} rate" for name in self.kept)
            blocks.append(replace(self._rates(slice(1)), names=rates))
        return blocks

    def _internal(self) -> Block:
        """Build the equations of internal states, such as rest lengths.

        Their rates depend on the controls alone.
        """
        v = self.v
        columns = [self.internal[:-1], self.internal[1:], v.interval_controls]
        columns += [v.repeat(v.duration), v.share]
        z, (before, after, c, T, share) = self._symbols(columns)
        x = self._state(type(z).zeros(self.nq), type(z).zeros(self.nq), 0)
        change = T * share * self.model.internal_rates(x, v.gamma(c, 0.5))
        scale = v.scales.state[2 * self.nq : v.model.moving.stop]
        row = (after - before - change) / ca.DM(scale)
        names = name_intervals(v.count, self.names[2 * self.nq : v.model.moving.stop])
        function = expand(ca.Function("internal", [z], [row]))
        return Block(function, np.hstack(columns), names, scale=scale)

    def _clock(self) -> Block:
        v = self.v
        columns = [v.states[1:, -1:], v.repeat(v.duration), v.time[1:]]
        z, (clock, T, passed) = self._symbols(columns)
        row = (clock - float(v.target.start[-1]) - T * passed) / v.scales.time
        names = name_intervals(v.count, ("clock",))
        return Block(ca.Function("clock", [z], [row]), np.hstack(columns), names)

    def all_states(self, entries: Any) -> Any:
        """Compute the states (nx, K + 1) from all variables.

        `entries` are all decision variables and constants in physical units.
        """
        v, nq = self.v, self.nq
        q, rates = (gather(entries, v.states[:, part]) for part in (slice(nq), slice(nq, 2 * nq)))
        duration = gather(entries, v.duration[:, None])
        if v.count > 1 and not self.with_velocities:
            rates = ca.horzcat(rates[:, 0], self._inner_rates(entries, q, duration), rates[:, -1])
        x = ca.vertcat(q, rates, gather(entries, self.internal))
        if self.model.has_clock:
            clock = float(v.target.start[-1]) + ca.mtimes(duration, gather(entries, v.time))
            x = ca.vertcat(x, clock)
        if self.kept and v.count > 1 and not self.contact.stands:
            inner = build_projection(self.model, 1).map(v.count - 1)(x[:, 1:-1])
            x = ca.horzcat(x[:, 0], inner, x[:, -1])
        return x

    def _inner_rates(self, entries: Any, q: Any, duration: Any) -> Any:
        """Compute the velocities (nq, K − 1) at interior mesh points.

        `entries` are all variables, `q` (nq, K + 1) the positions, and `duration` is in seconds.
        Velocities follow from the discrete momenta. With contact nodes they are central
        differences, which are zero at these nodes.
        """
        v = self.v
        spacing = ca.diag(1 / (v.fractions[1:] + v.fractions[:-1]))
        central = ca.mtimes(q[:, 2:] - q[:, :-2], spacing) / duration
        if self.contact.stands:
            return central
        # arbitrary entries, which `central` replaces
        nowhere = np.zeros((v.count - 1, self.nq), dtype=np.intp)
        z = gather(entries, self._backwards(nowhere, self.pushes[1:-1], slice(-1)))
        z = ca.vertcat(z[: self.nq, :], central, z[2 * self.nq :, :])
        left = self._leaving.function.map(v.count - 1)(z)
        pushed = ca.SX.sym("pushed", self.nq)
        P = self.model.unpack(self._state(pushed, pushed, 0))[1]
        P[:, np.flatnonzero(self.model.mechanism.dependent).tolist()] = 0.0
        V = self.model.mechanism.with_inverse(P)
        per_mass = self.model.split(self.model.pack(V, V, 0, 0)).positions
        divide = ca.Function("per_mass", [pushed], [per_mass]).map(v.count - 1)
        return central + divide(left) * (self._row_scale / duration)

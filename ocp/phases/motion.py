"""The motion of one phase: leapfrog, with the forces of bars, and of the ground on nodes that stand, as unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.transcription.base import bar_names, bar_rows
from ocp.transcription.sparse_nlp import Block, split_symbol
from ocp.transcription.variables import Variables, interval_names, state_names
from tenscasadi.dynamics import forces
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

# of its share of the weight: less holds no node that stands where the ground gives way a little
PRESSED = 0.1


class PhaseMotion:
    """The unknowns and rows of a phase, in which some nodes stand.

    A node that stands keeps its place of the start, and has no velocity: its coordinates are the
    same entries at all nodes of the mesh, so that no row has to hold them. What holds it are
    reactions of the ground, unknowns in the equations of motion, as the forces of the bars are.

    reactions (K + 1, 3s): of the ground on the s nodes that stand, N; impulses (3s,): of the impact
    in which they land, N·s, where they do. least_push: what every reaction has along the normal at
    least, N; weight: a typical reaction, N. begins: entries of the start that are those of the end
    before, which `ends` returns in the same order.
    """

    def __init__(
        self, v: Variables, stands: tuple[int, ...], lands: bool, bar_force: float, reactions: Array
    ) -> None:
        self.v, self.model, self.mech = v, v.model, v.model.mechanism
        self.nq, self.bars, self.stands, self.lands = (
            v.model.nq,
            v.model.mechanism.bars,
            stands,
            lands,
        )
        self.coordinates = node_coordinates(v.model)
        self.held = self.coordinates[list(stands)].ravel()
        self.weight = v.scales.mass * v.scales.length / v.scales.time**2
        self.least_push = PRESSED * float(np.linalg.norm(reactions[:3]))
        self._row_scale = self.weight / v.count
        self._hold()
        self.lam = self._add(
            np.full(self.bars, bar_force), bar_names(self.bars, "force density"), v.strength
        )
        self.reactions = self._add(reactions, self._pushes("reaction"), self.weight)
        self._back = v.entries.constants(-v.fractions[:, None])
        start, free = v.states[0], np.setdiff1d(np.arange(self.nq), self.held)
        self.impulses, before = np.zeros(0, dtype=np.intp), start[self.nq + free]
        self._linked, self._impact = free, []
        if lands:
            self._linked = np.arange(self.nq)
            before = v.entries.unknowns(
                [
                    f"{name} before the impact"
                    for name in state_names(self.model)[self.nq : 2 * self.nq]
                ],
                np.zeros(self.nq),
                v.scales.state[self.nq : 2 * self.nq],
            )
            self._impact = self._land(before)
        self.begins = np.concatenate([start[: self.nq], before])

    def ends(self, linked: Indices) -> Indices:
        """Return the entries at the end: all places, and the velocities `linked`."""
        end = self.v.states[-1]
        return np.concatenate([end[: self.nq], end[self.nq + linked]])

    @property
    def linked(self) -> Indices:
        """The velocities at the start, by number, that are those of the end before."""
        return self._linked

    def blocks(self, with_velocities: bool) -> list[Block]:
        """Return the discrete Euler-Lagrange equations, the bars, and the impact; velocities within only where something asks for them."""
        v, nq, s = self.v, self.nq, len(self.held)
        q, own, T = v.states[:, :nq], v.interval_controls, v.duration
        m, push = own.shape[1], np.hstack([self.lam, self.reactions])
        names = state_names(self.model)[:nq]

        # First and last: v is given, at the end backwards in time. T² and shares instead of h:
        # polynomial also where the duration is free.
        z, (q0, rate, q1, c, lam, ground, duration, share) = split_symbol(
            ca.SX, nq, nq, nq, m, self.bars, s, 1, 1
        )
        force = self._force(q0, rate, v.gamma(c, 0.0), lam, ground)
        row = self._momentum((q1 - q0) / share - duration * rate) - duration**2 * share / 2 * force
        first = np.concatenate(
            [q[0], v.states[0, nq : 2 * nq], q[1], own[0], push[0], T, v.share[0]]
        )
        last = np.concatenate(
            [q[-1], v.states[-1, nq : 2 * nq], q[-2], own[-1], push[-1], T, self._back[-1]]
        )
        rows = tuple(
            f"dynamics of interval {k}, {name}{at}"
            for k, at in ((0, ""), (v.count - 1, " at its end"))
            for name in names
        )
        result = [
            *self._impact,
            Block(
                ca.Function("ends", [z], [row / self._row_scale]), np.vstack([first, last]), rows
            ),
        ]
        if v.count > 1:
            z, (q0, q1, q2, c, d, lam, ground, duration, before, after) = split_symbol(
                ca.SX, nq, nq, nq, m, m, self.bars, s, 1, 1, 1
            )
            both = before + after
            gamma = (before * v.gamma(c, 1.0) + after * v.gamma(d, 0.0)) / both
            force = self._force(q1, (q2 - q0) / (duration * both), gamma, lam, ground)
            row = (
                self._momentum((q2 - q1) / after - (q1 - q0) / before)
                - duration**2 * both / 2 * force
            )
            index = np.hstack(
                [
                    q[:-2],
                    q[1:-1],
                    q[2:],
                    own[:-1],
                    own[1:],
                    push[1:-1],
                    v.repeated(T, v.count - 1),
                    v.share[:-1],
                    v.share[1:],
                ]
            )
            rows = tuple(
                f"dynamics of interval {k}, {name}" for k in range(1, v.count) for name in names
            )
            result += [
                Block(ca.Function("middle", [z], [row / self._row_scale]), index, rows),
                *self._velocities(with_velocities),
            ]
        if self.bars:
            lengths, rates = self._bar_functions()
            end = tuple(
                f"dynamics of interval {v.count - 1}, {name}"
                for name in bar_names(self.bars, "rate")
            )
            result.append(
                Block(lengths, q[1:], interval_names(v.count, bar_names(self.bars, "length")))
            )
            result.append(Block(rates, v.states[-1:, : 2 * nq], end))
        return result

    def _hold(self) -> None:
        """Make the places of nodes that stand those of the start, and their velocities zero."""
        v, rates = self.v, self.nq + self.held
        v.entries.leave_out(v.states[1:, self.held])
        v.states[1:, self.held] = v.states[0, self.held]
        v.entries.leave_out(v.states[:, rates])
        v.states[:, rates] = v.entries.constants(np.zeros(v.states[:, rates].shape))

    def _add(self, first: Array, names: Sequence[str], scale: float) -> Indices:
        """Add unknowns at all nodes of the mesh."""
        count = self.v.count + 1
        every = [f"{name}, interval {k}" for k in range(count) for name in names]
        return self.v.entries.unknowns(
            every, np.tile(first, (count, 1)), scale, interval=np.arange(count)[:, None]
        )

    def _pushes(self, what: str) -> list[str]:
        return [f"{what} on node {node} along {axis}" for node in self.stands for axis in "xyz"]

    def _velocities(self, asked: bool) -> list[Block]:
        """Velocities at the nodes of the mesh within: central differences; where nothing asks for them, they are no unknowns."""
        v, nq = self.v, self.nq
        free = np.setdiff1d(np.arange(nq), self.held)
        if not asked:
            v.entries.leave_out(v.states[1:-1, nq + free])
            return []
        z, (before, now, after, duration, left, right) = split_symbol(
            ca.SX, *[len(free)] * 3, 1, 1, 1
        )
        row = (duration * (left + right) * now - (after - before)) / v.scales.length
        q = v.states[:, free]
        index = np.hstack(
            [
                q[:-2],
                v.states[1:-1, nq + free],
                q[2:],
                v.repeated(v.duration, v.count - 1),
                v.share[:-1],
                v.share[1:],
            ]
        )
        names = [state_names(self.model)[nq + k] for k in free]
        return [
            Block(ca.Function("velocities", [z], [row]), index, interval_names(v.count - 1, names))
        ]

    def _land(self, before: Indices) -> list[Block]:
        """Return the rows of an impact without rebound on the nodes that stand from now on; before: entries of the velocities (nq,) v⁻.

        M (v⁺ − v⁻) are impulses Jᵀ of bars and ground, J v⁺ = 0 with J the gradients of the bars'
        lengths and of the coordinates that stand: v⁺ = v⁻ − M⁻¹Jᵀ (J M⁻¹Jᵀ)⁻¹ J v⁻, the projection
        that takes the least energy away.
        """
        v, nq = self.v, self.nq
        scale = v.scales.mass / v.scales.time
        lam = v.entries.unknowns(
            bar_names(self.bars, "impulse density"), np.zeros(self.bars), scale
        )
        self.impulses = v.entries.unknowns(
            self._pushes("impulse"), np.zeros(len(self.held)), scale * v.scales.length
        )
        z, (q, was, now, push, pushed) = split_symbol(ca.SX, nq, nq, nq, self.bars, len(self.held))
        row = (self._momentum(now - was) - self._pushed(q, push, pushed)) / (
            scale * v.scales.length
        )
        start = v.states[0]
        index = np.concatenate([start[:nq], before, start[nq : 2 * nq], lam, self.impulses])[None]
        blocks = [
            Block(
                ca.Function("impact", [z], [row]),
                index,
                tuple(f"impact, {name}" for name in state_names(self.model)[:nq]),
            )
        ]
        if self.bars:
            rates = tuple(f"impact, {name}" for name in bar_names(self.bars, "rate"))
            blocks.append(Block(self._bar_functions()[1], start[None, : 2 * nq], rates))
        return blocks

    def _bar_functions(self) -> tuple[ca.Function, ca.Function]:
        """Functions q → lengths and (q, v) → rates of the bars, as rows."""
        q, v = ca.SX.sym("q", self.nq), ca.SX.sym("v", self.nq)
        lengths, rates = bar_rows(self.model, ca.vertcat(q, v), self.v.scales)
        return ca.Function("lengths", [q], [lengths]), ca.Function(
            "rates", [ca.vertcat(q, v)], [rates]
        )

    def _force(self, q: Any, v: Any, gamma: Any, lam: Any, ground: Any) -> Any:
        """F + B λ̂ C_b + Ω Pᵀ on the coordinates, Eq. 85."""
        N, V, _ = self.model.unpack(ca.vertcat(q, v))
        return self._flat(forces.total(self.model.scene, self.mech, N, V, gamma, 0)) + self._pushed(
            q, lam, ground
        )

    def _pushed(self, q: Any, lam: Any, ground: Any) -> Any:
        """B λ̂ C_b + Ω Pᵀ on the coordinates."""
        N, _, _ = self.model.unpack(ca.vertcat(q, q))
        result = (
            ca.densify(self._flat(nodal_forces(self.mech, self.mech.bar_vectors(N), lam.T)))
            if self.bars
            else ca.SX.zeros(self.nq)
        )
        result[self.held.tolist()] += ground
        return result

    def _momentum(self, change: Any) -> Any:
        """M times a change of the coordinates."""
        _, V, _ = self.model.unpack(ca.vertcat(change, change))
        return self._flat(ca.mtimes(V, sparse(self.mech.M)))

    def _flat(self, X: Any) -> Any:
        return self.model.split(self.model.pack(X, X, 0))[0]


def node_coordinates(model: Any) -> Indices:
    """Return where the coordinates of each node (n, 3) are among the free ones; −1 of those that are pinned."""
    found = np.full(3 * len(model.mechanism.physical), -1, dtype=np.intp)
    found[model.mechanism.free_index] = np.arange(model.nq)
    return found.reshape(-1, 3)

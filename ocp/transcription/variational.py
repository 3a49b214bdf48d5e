"""Motion by a discrete principle of least action: leapfrog, with the forces of the bars as unknowns and their lengths as constraints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.transcription.assemble import symbols
from ocp.transcription.base import OnGrid, bar_names, bar_rows, check_reduced, parts
from ocp.transcription.initial_guess import Guess
from ocp.transcription.sparse_nlp import Block, Program
from ocp.transcription.variables import Assembly, interval_names, state_names
from tenscasadi.dynamics import forces
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.integrators.stabilization import projection
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

# Where, in an interval, a linear γ has its mean in the sense of the hat functions of the interval's start and end: its impulse there.
EARLY, LATE = 1 / 3, 2 / 3


@dataclass(frozen=True)
class Variational(OnGrid):
    """M (q⁺ − 2q + q⁻)/h² = F(q, γ) + B λ̂ C_b with bᵀb = l² at every node: order 2, momenta and bars kept exactly.

    The discrete Euler-Lagrange equations of the leapfrog (Störmer-Verlet, Rattle) method with a Lagrangian multiplier λ for each bar and node
    (Marsden, West, Acta Numerica 2001, 10, 357, sections 1.5 and 3.5). Neither accelerations nor inverse matrices appear: all is polynomial,
    of low degree, with few non-zeros, which makes this the fastest of the transcriptions. Velocities are those of the discrete momenta, which
    unlike central differences see force densities that jump; within, they are unknowns only where a goal, a limit or a cost asks for them.
    """

    def program(self, problem: Problem, target: Target, scales: Scales, guess: Guess) -> Program:
        """The nonlinear program, scaled about the guess. ValueError for full coordinates and moved supports."""
        check_reduced("Variational", problem.model)
        a = self.assembly(problem, target, scales, guess)
        chain = _Chain(a)
        for k in range(a.count + 1):
            if k:
                a.add_state(k, slice(0, chain.nq) if k < a.count else slice(0, 2 * chain.nq))
            if k < len(a.controls):
                a.add_control(k)
            chain.add_forces(k)
        a.add_duration()
        a.rows += chain.blocks()
        return a.finish(chain.all_states, chain.missing)


class _Chain:
    """The equations from node to node."""

    def __init__(self, a: Assembly) -> None:
        self.a, self.model, self.mech = a, a.model, a.model.mechanism
        self.nq, self.nx, self.bars = a.model.nq, a.model.nx, a.model.mechanism.bars
        self.lam: Indices = np.zeros((a.count + 1, self.bars), dtype=np.intp)
        # what is no unknown, unless asked for: velocities within, and the clock
        hidden = np.zeros(a.states.shape, dtype=bool)
        hidden[1:, self.nq :] = True
        hidden[-1, self.nq : 2 * self.nq] = False
        a.states[hidden] = a.unknowns.constant(np.full(int(hidden.sum()), np.nan))
        self.hidden = hidden
        self._back = a.unknowns.constant(-a.fractions[:, None])
        self._bar_forces = self._guessed()
        self._row_scale = a.scales.mass * a.scales.length / a.count

    def _guessed(self) -> Array:
        """λ (K + 1, β) of the guess."""
        if not self.bars:
            return np.zeros((self.a.count + 1, 0))
        guess = self.a.guess
        gamma = guess.force_density if self.a.profile.linear else np.concatenate([guess.force_density, guess.force_density[-1:]])
        x, u = symbols(self.model.ode, self.nx, self.model.nu)
        N, V, time = self.model.unpack(x)
        _, lam, _ = forward_dynamics(self.model, N, V, u, time)
        values = ca.Function("forces", [x, u], [ca.densify(lam.T)]).map(len(gamma))(guess.states.T, gamma.T).full().T
        return np.asarray(np.nan_to_num(values, posinf=0.0, neginf=0.0))

    def add_forces(self, k: int) -> None:
        """λ at node k."""
        names = [f"{name}, interval {k}" for name in bar_names(self.bars, "force density")]
        self.lam[k] = self.a.unknowns.add(names, self._bar_forces[k], self.a.strength, stage=k)

    def blocks(self) -> list[Block]:
        """All rows of the motion."""
        a, nq = self.a, self.nq
        q, own, T = a.states[:, :nq], a.interval_controls, a.duration
        m = own.shape[1]
        names = state_names(self.model)[:nq]
        kind = ca.SX if self.model.ode.is_a("SXFunction") else ca.MX

        # First and last: v is given, at the end backwards in time. T² and shares instead of h: polynomial also where the duration is free.
        z, (q0, v, q1, c, lam, duration, share, passed) = parts(nq, nq, nq, m, self.bars, 1, 1, 1, kind=kind)
        force = self._force(q0, v, a.gamma(c, EARLY), lam, duration * passed)
        row = self._momentum((q1 - q0) / share - duration * v) - duration**2 * share / 2 * force
        first = np.concatenate([q[0], a.states[0, nq : 2 * nq], q[1], own[0], self.lam[0], T, a.share[0], a.time[0]])
        rows = tuple(f"dynamics of interval {k}, {name}{at}" for k, at in ((0, ""), (a.count - 1, " at its end")) for name in names)
        last = self._backwards(a.states[-1:, nq : 2 * nq], self.lam[-1:], slice(-1, None))
        self._leaving = self._block("ends", z, row, np.vstack([first, last]), rows)
        result = [self._leaving]

        if a.count > 1:
            z, (q0, q1, q2, c, d, lam, duration, before, after, passed) = parts(nq, nq, nq, m, m, self.bars, 1, 1, 1, 1, kind=kind)
            both = before + after
            gamma = (before * a.gamma(c, LATE) + after * a.gamma(d, EARLY)) / both
            force = self._force(q1, (q2 - q0) / (duration * both), gamma, lam, duration * passed)
            row = self._momentum((q2 - q1) / after - (q1 - q0) / before) - duration**2 * both / 2 * force
            index = np.hstack(
                [q[:-2], q[1:-1], q[2:], own[:-1], own[1:], self.lam[1:-1], a.repeated(T, a.count - 1), a.share[:-1], a.share[1:], a.time[1:-1]]
            )
            rows = tuple(f"dynamics of interval {k}, {name}" for k in range(1, a.count) for name in names)
            result.append(self._block("middle", z, row, index, rows))

        if self.bars:
            result += self._lengths()
        return result

    def _lengths(self) -> list[Block]:
        a, nq = self.a, self.nq
        z = ca.SX.sym("z", 2 * nq)
        x = ca.vertcat(z, ca.SX.zeros(self.nx - 2 * nq))
        lengths, rates = bar_rows(self.model, x, a.scales, rates=True)
        at_nodes = ca.Function("lengths", [z[:nq]], [ca.substitute(lengths, z[nq:], ca.SX.zeros(nq))])
        names = interval_names(a.count, bar_names(self.bars, "length"))
        last = tuple(f"dynamics of interval {a.count - 1}, {name}" for name in bar_names(self.bars, "rate"))
        self._rates = Block(ca.Function("rates", [z], [rates]), a.states[-1:, : 2 * nq], last)
        return [Block(at_nodes, a.states[1:, :nq], names), self._rates]

    def _block(self, name: str, z: Any, row: Any, index: Indices, names: tuple[str, ...]) -> Block:
        return Block(ca.Function(name, [z], [row / self._row_scale]), index, names)

    def _state(self, q: Any, v: Any, time: Any) -> Any:
        clock = [time + float(self.a.target.start[-1])] if self.model.scene.has_clock else []
        return ca.vertcat(q, v, *clock)

    def _force(self, q: Any, v: Any, gamma: Any, lam: Any, time: Any) -> Any:
        """F + B λ̂ C_b on the free coordinates."""
        mech = self.mech
        N, V, clock = self.model.unpack(self._state(q, v, time))
        total = forces.total(self.model.scene, mech, N, V, gamma, clock)
        if self.bars:
            total = total + nodal_forces(mech, mech.bar_vectors(N), lam.T)
        return self.model.split(self.model.pack(total, total, 0))[0]

    def _momentum(self, change: Any) -> Any:
        """M times a change of the free coordinates."""
        _, V, _ = self.model.unpack(self._state(change, change, 0))
        P = ca.mtimes(V, sparse(self.mech.M))
        return self.model.split(self.model.pack(P, P, 0))[0]

    def _per_mass(self) -> ca.Function:
        """M⁻¹ times what pushes the free coordinates."""
        pushed = ca.SX.sym("pushed", self.nq)
        _, V, _ = self.model.unpack(self._state(pushed, pushed, 0))
        faster = self.mech.with_inverse(V)
        return ca.Function("per_mass", [pushed], [self.model.split(self.model.pack(faster, faster, 0))[0]])

    # --- what the motion leaves out ---

    def _backwards(self, v: Indices, lam: Indices, intervals: slice) -> Indices:
        """What the momenta (of velocities v) at the ends of intervals refer to, seen backwards in time; lam: of bars before these ends."""
        a = self.a
        before, after = (a.states[part, : self.nq][intervals] for part in (slice(-1), slice(1, None)))
        own = a.interval_controls[intervals]
        controls = own.reshape(len(own), -1, a.controls.shape[1])[:, ::-1].reshape(own.shape)
        return np.hstack([after, v, before, controls, lam, a.repeated(a.duration, len(own)), self._back[intervals], a.time[1:][intervals]])

    def missing(self, needed: Callable[[Indices], Array]) -> list[Block]:
        """Unknowns and rows for velocities within and the clock, where a block depends on them."""
        a, nq = self.a, self.nq
        blocks = []
        asked = needed(a.states[self.hidden])
        columns = np.nonzero(self.hidden)[1]
        if np.any(asked[columns < 2 * nq]) and a.count > 1:
            blocks += self._velocities()
        if np.any(asked[columns >= 2 * nq]):
            for k in range(1, a.count + 1):
                a.add_state(k, slice(2 * nq, None))
            z = ca.SX.sym("z", 3)
            row = (z[0] - float(a.target.start[-1]) - z[1] * z[2]) / a.scales.time
            index = np.hstack([a.states[1:, -1:], a.repeated(a.duration), a.time[1:]])
            blocks.append(Block(ca.Function("clock", [z], [row]), index, interval_names(a.count, ("clock",))))
        return blocks

    def _velocities(self) -> list[Block]:
        """Unknowns and rows for the velocities within. Where γ jumps, bars push otherwise before a node than after it; λ is the mean of both."""
        a, nq = self.a, self.nq
        v, lam = (np.zeros((a.count - 1, size), dtype=np.intp) for size in (nq, self.bars))
        names = state_names(self.model)[nq : 2 * nq]
        before = bar_names(self.bars, "force density before the end")
        for k in range(1, a.count):
            at = f", interval {k - 1}"
            v[k - 1] = a.unknowns.add([name + at for name in names], a.guess.states[k, nq : 2 * nq], a.scales.state[nq : 2 * nq], stage=k)
            lam[k - 1] = a.unknowns.add([name + at for name in before], self._bar_forces[k], a.strength, stage=k)
        a.states[1:-1, nq : 2 * nq] = v
        blocks = [replace(self._leaving, index=self._backwards(v, lam, slice(-1)), names=interval_names(a.count - 1, names))]
        if self.bars:
            rates = interval_names(a.count - 1, bar_names(self.bars, "rate"))
            blocks.append(replace(self._rates, index=a.states[1:-1, : 2 * nq], names=rates))
        return blocks

    def all_states(self, seen: Callable[[Indices], Any]) -> Any:
        """States (nx, K + 1), given what reads references."""
        a, nq = self.a, self.nq
        q = seen(a.states[:, :nq])
        v = seen(a.states[:, nq : 2 * nq])
        if a.count > 1 and a.states[1, nq] < 0:  # velocities within are no unknowns
            central = ca.mtimes(q[:, 2:] - q[:, :-2], ca.diag(1 / (a.fractions[1:] + a.fractions[:-1]))) / seen(a.duration)
            nowhere = np.zeros((a.count - 1, nq), dtype=np.intp)  # whatever: `central` takes the place of what stands there
            z = seen(self._backwards(nowhere, self.lam[1:-1], slice(-1)))
            left = self._leaving.function.map(a.count - 1)(ca.vertcat(z[:nq, :], central, z[2 * nq :, :]))
            faster = self._per_mass().map(a.count - 1)(left) * (self._row_scale / seen(a.duration))
            v = ca.horzcat(v[:, 0], central + faster, v[:, -1])
        x = ca.vertcat(q, v)
        if self.model.scene.has_clock:
            x = ca.vertcat(x, float(a.target.start[-1]) + ca.mtimes(seen(a.duration[None]), seen(a.time)))
        if self.bars and a.count > 1:
            inner = projection(self.model, 1).map(a.count - 1)(x[:, 1:-1])
            x = ca.horzcat(x[:, 0], inner, x[:, -1])
        return x

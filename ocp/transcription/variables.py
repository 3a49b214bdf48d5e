"""What all transcriptions share: unknowns interval by interval, goals, limits and costs, and the program that they make."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.boundary.free_start import FreeStartRows
from ocp.boundary.target import Target
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, typical_cost
from ocp.transcription.assemble import bound_blocks, cost_blocks, waypoint_blocks
from ocp.transcription.initial_guess import Guess
from ocp.transcription.mesh import Profile, at, between, node_values, spread
from ocp.transcription.sparse_nlp import Block, Program, Separable, Unknowns, exact
from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import projection
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

States = Callable[[Callable[[Indices], Any]], Any]
Missing = Callable[[Callable[[Indices], Array]], list[Block]]


class Assembly:
    """Collects the unknowns and rows of a plan; a transcription adds the motion.

    fractions (K,): shares of the duration. guess: on this grid, with its force densities as the profile has them. In references
    (`Unknowns`): states (K + 1, nx), controls (K, m) or (K + 1, m) of the m groups of strings, duration (1,), and, as parts of
    it, share (K, 1) of each interval and time (K + 1, 1) of their ends.
    """

    def __init__(self, problem: Problem, target: Target, scales: Scales, guess: Guess, fractions: Array, profile: Profile) -> None:
        self.problem, self.target, self.fractions = problem, target, fractions
        self.scales = replace(scales, state=exact(scales.state))
        self.model, self.count = problem.model, len(fractions)
        self.strength = _strength(scales, guess)
        self.profile = profile
        self.spread = spread(profile, self.model.nu)
        self.objective = typical_cost(problem, self.strength, guess.states, guess.force_density, guess.duration)
        self.guess = on_grid(self.model, guess, fractions, profile)
        self.unknowns = Unknowns()
        self.states = np.zeros((self.count + 1, self.model.nx), dtype=np.intp)
        self.states[0] = self.unknowns.constant(target.start)
        self.controls = np.zeros((self.count + profile.linear, self.spread.shape[1]), dtype=np.intp)
        self.share = self.unknowns.constant(fractions[:, None])
        self.time = self.unknowns.constant(np.append(0.0, np.cumsum(fractions))[:, None])
        self.duration = self.unknowns.constant([problem.longest])
        self.rows: list[Block] = []
        self._state_names = state_names(self.model)
        members = [np.flatnonzero(column) for column in self.spread.T]
        least, most = problem.force_density_limits
        self._control_names = [f"force density of string{'s' * (len(own) > 1)} {', '.join(map(str, own))}" for own in members]
        self._least, self._most = (np.array([choose(limit[own]) for own in members]) for choose, limit in ((np.max, least), (np.min, most)))
        self._control_first = self.guess.force_density @ (self.spread / self.spread.sum(axis=0))
        if target.free_start is not None:
            self._add_free_start(target.free_start)

    # --- unknowns ---

    def _add_free_start(self, free: FreeStartRows) -> None:
        """The start, but for its clock, and the rows that hold there alone."""
        size = 2 * self.model.nq
        names = [f"{name}, start" for name in self._state_names[:size]]
        self.states[0, :size] = self.unknowns.add(names, self.guess.states[0, :size], self.scales.state[:size])
        rows = tuple(f"start, combination {k} of bars and goals" for k in range(free.start.size1_out(0)))
        if rows:
            self.rows.append(Block(free.start, self.states[:1], rows, kind="start"))

    def add_control(self, k: int) -> None:
        """Force densities of interval k, or, where they are piecewise linear, at its start; k = K: at the end."""
        names = [f"{name}, interval {k}" for name in self._control_names]
        self.controls[k] = self.unknowns.add(names, self._control_first[k], self.strength, self._least, self._most, k)

    def add_state(self, k: int, part: slice = slice(None)) -> None:
        """The state, or part of it, at the end of interval k − 1."""
        names = [f"{name}, interval {k - 1}" for name in self._state_names[part]]
        self.states[k, part] = self.unknowns.add(names, self.guess.states[k, part], self.scales.state[part], stage=k)

    def add_duration(self) -> None:
        """The duration, where it is free: comes last."""
        shortest, longest = self.problem.shortest, self.problem.longest
        if shortest < longest:
            self.duration = self.unknowns.add(["duration"], self.guess.duration, self.scales.time, shortest, longest, stage=self.count)

    # --- what an interval sees ---

    @property
    def interval_controls(self) -> Indices:
        """References (K, m or 2m) to what `gamma` needs in each interval."""
        return np.hstack([self.controls[:-1], self.controls[1:]]) if self.profile.linear else self.controls

    def gamma(self, local: Any, share: float) -> Any:
        """Force densities (α,) at a share of an interval, from its entries of `interval_controls`."""
        m = self.spread.shape[1]
        left = local[:m]
        return ca.mtimes(sparse(self.spread), between(left, local[m:] if self.profile.linear else left, share))

    def repeated(self, reference: Indices, count: int | None = None) -> Indices:
        """The same references (n,) for every instance."""
        return np.tile(reference, (self.count if count is None else count, 1))

    # --- the program ---

    def finish(self, states: States | None = None, missing: Missing | None = None) -> Program:
        """The program with goals, limits along the way and costs.

        states: gives all states, from what reads references, where some are no unknowns; missing: adds unknowns and rows for those that goals, limits
        and costs depend on, from what tells which of some references they are.
        """
        rows, costs = self._asked()
        if missing is not None:
            more = missing(lambda references: _needed([*rows, *costs], references))
            self.rows += more
            if more:
                rows, costs = self._asked()
        rows = [*self.rows, *rows]
        unknowns = self.unknowns
        w = ca.MX.sym("w", len(unknowns.names))
        separable = Separable(unknowns, rows, costs, 1 / self.objective, w)
        y = unknowns.physical(w)

        def seen(reference: Indices) -> Any:
            return ca.reshape(y[unknowns.place(reference).ravel().tolist()], reference.shape[-1], reference.size // reference.shape[-1])

        controls = ca.mtimes(sparse(self.spread), seen(self.controls))
        motion = seen(self.states) if states is None else states(seen)
        least, most, row_scale = (np.concatenate(columns) for columns in zip(*(block.limits() for block in rows), strict=True))
        first, scale, lower, upper = (unknowns.column(k) for k in range(4))
        return Program(
            {"x": w, "f": separable.f, "g": separable.g},
            lower / scale,
            upper / scale,
            least,
            most,
            row_scale,
            first / scale,
            tuple(name for block in rows for name in block.names),
            tuple(unknowns.names),
            scale,
            self.objective,
            ca.Function("unpack", [w], [motion, controls, seen(self.duration)]),
            separable,
            sum(block.rows * block.count for block in self.rows),
            self.states,
            self.model.scene.ground is not None,
        )

    def _asked(self) -> tuple[list[Block], list[Block]]:
        return [*bound_blocks(self), *self._goal()], cost_blocks(self)

    def _goal(self) -> list[Block]:
        """The rows of waypoints, those of the end, and those of an end that repeats the start."""
        blocks = waypoint_blocks(self, self.target)
        if self.target.count:
            names = tuple(f"goal, combination {k}" for k in range(self.target.count))
            blocks.append(Block(self.target.single, self.states[-1:], names, combination=self.target.weights, kind="end"))
        free = self.target.free_start
        if free is not None and free.reduction.names:
            names = tuple(f"goal of repeating, combination {k}" for k in range(free.repeats.size1_out(0)))
            z = ca.SX.sym("z", 2 * self.model.nx)
            function = ca.Function("repeats", [z], [free.repeats(*ca.vertsplit(z, self.model.nx))])
            blocks.append(Block(function, np.hstack([self.states[:1], self.states[-1:]]), names, kind="periodic"))
        return blocks


def _needed(blocks: Sequence[Block], references: Indices) -> Array:
    """Which of the references some block depends on."""
    used: set[int] = set()
    for block in blocks:
        columns = np.unique(np.array(block.function.jac_sparsity(0, 0).get_triplet()[1], dtype=np.intp))
        used.update(block.index[:, columns].ravel().tolist())
    return np.array([int(reference) in used for reference in references], dtype=bool)


def on_grid(model: Model, guess: Guess, fractions: Array, profile: Profile) -> Guess:
    """A guess on equal intervals, moved to another grid and another profile."""
    intervals, nodes = len(guess.states) - 1, np.append(0.0, np.cumsum(fractions))
    if intervals == len(fractions) and np.ptp(fractions) < 1e-12:
        states, held = guess.states, guess.force_density
    else:
        before = np.linspace(0.0, 1.0, intervals + 1)
        states = np.column_stack([np.interp(nodes, before, column) for column in guess.states.T])
        if model.mechanism.constrained:
            states[1:-1] = np.asarray(projection(model, 3).map(len(nodes))(states.T).full()).T[1:-1]
        held = at(guess.force_density, before, (nodes[:-1] + nodes[1:]) / 2)
    return Guess(states, node_values(held, fractions) if profile.linear else held, guess.duration)


def state_names(model: Model) -> tuple[str, ...]:
    """What each entry of the state is, such as "node 2 z velocity"."""
    mech = model.mechanism
    places = [f"node {mech.physical[k // 3]} {'xyz'[k % 3]}" for k in np.flatnonzero(mech.free.ravel())]
    return (*places, *(f"{place} velocity" for place in places), *["clock"] * (model.nx - 2 * len(places)))


def interval_names(count: int, rows: Sequence[str]) -> tuple[str, ...]:
    """Names of the rows of the motion."""
    return tuple(f"dynamics of interval {k}, {name}" for k in range(count) for name in rows)


def _strength(scales: Scales, guess: Guess) -> float:
    """A typical force density, N/m: of the guess, or what moves the structure's mass by its size within the duration."""
    return max(float(np.sqrt(np.mean(guess.force_density**2))), scales.mass / scales.time**2)

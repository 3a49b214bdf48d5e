"""The unknowns and constants of a plan: states at the nodes of the mesh, force densities, the duration, and what a transcription adds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.control import control_name
from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, control_scale, typical_cost
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, Profile, group_matrix, on_mesh, spans
from ocp.transcription.sparse_nlp import Block, Unknowns
from tenscasadi.dynamics.model import Model
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

_ENTRY = np.dtype(
    [
        ("first", float),
        ("scale", float),
        ("lower", float),
        ("upper", float),
        ("interval", float),
        ("unknown", bool),
    ]
)


class Entries:
    """Numbers that rows refer to: unknowns, described as in `Unknowns`, and constants.

    They are numbered in the order in which they are added. suffix: of the names of the phase that
    adds them; "" where there are no phases.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._table = np.zeros(0, _ENTRY)
        self._phases = self._first_interval = 0
        self.suffix = ""

    def begin_phase(self) -> None:
        """Count intervals from those of the phase before, and name what is added after the phase."""
        interval = self._table["interval"]
        if interval.size:
            self._first_interval = 1 + int(interval[np.isfinite(interval)].max())
        self.suffix = f", phase {self._phases}"
        self._phases += 1

    def unknowns(
        self,
        names: Sequence[str],
        first: Any,
        scale: Any,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        interval: Any = 0,
    ) -> Indices:
        """Add unknowns and return their numbers in the shape of `first`; all else is broadcast to it."""
        named = [name + self.suffix for name in names]
        counted = np.add(self._first_interval, interval)
        return self._add(named, first, scale, lower, upper, counted, True)

    def constants(self, values: Any) -> Indices:
        """Add constants and return their numbers in the shape of `values`."""
        return self._add([""] * np.size(values), values, 1.0, 0.0, 0.0, 0, False)

    def _add(self, names: Sequence[str], first: Any, *columns: Any) -> Indices:
        new = np.zeros(np.shape(first), _ENTRY)
        for name, values in zip(_ENTRY.names or (), (first, *columns), strict=True):
            new[name] = values
        start = len(self._table)
        self._names += names
        self._table = np.concatenate([self._table, new.ravel()])
        return np.arange(start, start + new.size).reshape(new.shape)

    def leave_out(self, index: Indices) -> None:
        """Take back unknowns on which nothing depends."""
        self._table["unknown"][index], self._table["first"][index] = False, np.nan

    def used_by(self, blocks: Sequence[Block]) -> Array:
        """Return for each entry whether some block depends on it."""
        used = np.zeros(len(self._table), dtype=bool)
        for block in blocks:
            columns = np.unique(
                np.array(block.function.jac_sparsity(0, 0).get_triplet()[1], dtype=np.intp)
            )
            used[block.index[:, columns]] = True
        return used

    def ordered(self) -> tuple[Unknowns, Indices]:
        """Return the unknowns interval by interval, so that the solver's matrices are banded, and the place that each entry has there."""
        table, unknown = self._table, self._table["unknown"]
        order = np.flatnonzero(unknown)
        order = order[np.argsort(table["interval"][order], kind="stable")]
        place = np.zeros(len(table), dtype=np.intp)
        place[np.concatenate([order, np.flatnonzero(~unknown)])] = np.arange(len(table))
        first, scale, lower, upper, interval = (
            table[name][order] for name in ("first", "scale", "lower", "upper", "interval")
        )
        names = tuple(self._names[k] for k in order)
        return Unknowns(
            names, first, scale, lower, upper, interval, table["first"][~unknown]
        ), place

    def values(self, w: Array) -> Array:
        """Return the values of all entries that scaled unknowns stand for."""
        unknowns, place = self.ordered()
        return np.concatenate([unknowns.scale * w, unknowns.constants])[place]


class Variables:
    """The variables of a plan on a mesh, and what is needed to write rows in them.

    fractions (K,): shares of the duration. guess: on this mesh, with its force densities as the
    profile has them. As numbers of `entries`: states (K + 1, nx), controls (K, m) or (K + 1, m) of
    the m groups of strings, duration (1,), and, as parts of it, share (K, 1) of each interval and
    time (K + 1, 1) of the nodes of the mesh. strength: a typical γ, N/m; objective: a typical cost;
    noise: None, or that of the guess, for each group. start: entries (nx,) of the state with which a
    phase begins, the end of the one before; None for that of the target.
    """

    def __init__(
        self,
        problem: Problem,
        target: Target,
        scales: Scales,
        guess: Guess,
        fractions: Array,
        profile: Profile,
        entries: Entries | None = None,
        start: Indices | None = None,
    ) -> None:
        self.problem, self.target, self.fractions, self.profile = (
            problem,
            target,
            fractions,
            profile,
        )
        self.scales = scales
        self.model, self.count = problem.model, len(fractions)
        self.strength = _strength(
            scales,
            forces_of(self.model, (guess.states[:-1] + guess.states[1:]) / 2, guess.force_density),
        )
        self.objective = typical_cost(
            problem, self.strength, guess.states, guess.force_density, guess.duration
        )
        self.guess = on_mesh(self.model, guess, fractions, profile)
        self.group_matrix = group_matrix(profile, self.model.nu)
        self.noise = (
            None
            if guess.noise is None
            else guess.noise @ (self.group_matrix / self.group_matrix.sum(axis=0))
        )
        self.entries = Entries() if entries is None else entries
        self.suffix = self.entries.suffix
        self.states = np.vstack([self._start() if start is None else start, self._later_states()])
        self.controls = self._controls()
        self.duration = self._duration()
        self.share = self.entries.constants(fractions[:, None])
        self.time = self.entries.constants(np.append(0.0, np.cumsum(fractions))[:, None])

    def _start(self) -> Indices:
        """Return the given state, or unknowns for a free start, but for its clock."""
        size = 0 if self.target.free_start is None else 2 * self.model.nq
        names = [f"{name}, start" for name in state_names(self.model)[:size]]
        free = self.entries.unknowns(names, self.guess.states[0, :size], self.scales.state[:size])
        return np.append(free, self.entries.constants(self.target.start[size:]))

    def _later_states(self) -> Indices:
        names = [
            f"{name}, interval {k}" for k in range(self.count) for name in state_names(self.model)
        ]
        return self.entries.unknowns(
            names,
            self.guess.states[1:],
            self.scales.state,
            interval=np.arange(1, self.count + 1)[:, None],
        )

    def _controls(self) -> Indices:
        """Add force densities of intervals, or, where they are piecewise linear, at the nodes of the mesh."""
        members = [np.flatnonzero(column) for column in self.group_matrix.T]
        least, most = self.problem.control_limits
        lower, upper = (
            np.array([choose(limit[own]) for own in members])
            for choose, limit in ((np.max, least), (np.min, most))
        )
        first = self.guess.force_density @ (self.group_matrix / self.group_matrix.sum(axis=0))
        span = np.arange(len(first)) if self.profile.linear else spans(self.profile, self.fractions)
        begins = np.unique(span, return_index=True)[1]
        first = np.add.reduceat(first, begins) / np.bincount(span)[:, None]
        names = control_names(self.group_matrix, begins, control_name(self.model))
        scale = np.array(
            [np.max(control_scale(self.problem, self.strength)[own]) for own in members]
        )
        return self.entries.unknowns(names, first, scale, lower, upper, begins[:, None])[span]

    @property
    def free_time(self) -> bool:
        """Whether the duration is an unknown."""
        return self.problem.shortest != self.problem.longest

    def _duration(self) -> Indices:
        shortest, longest = self.problem.shortest, self.problem.longest
        if not self.free_time:
            return self.entries.constants([longest])
        return self.entries.unknowns(
            ["duration"], [self.guess.duration], self.scales.time, shortest, longest, np.inf
        )

    @property
    def interval_controls(self) -> Indices:
        """Entries (K, m or 2m) that `gamma` needs in each interval."""
        return (
            np.hstack([self.controls[:-1], self.controls[1:]])
            if self.profile.linear
            else self.controls
        )

    def gamma(self, local: Any, share: float) -> Any:
        """Return force densities (α,) at a share of an interval, from its `interval_controls`."""
        m = self.group_matrix.shape[1]
        held = (1 - share) * local[:m] + share * local[m:] if self.profile.linear else local
        return ca.mtimes(sparse(self.group_matrix), held)

    def unknowns_at_nodes(
        self, names: Sequence[str], first: Array, scale: float, node: int = 0
    ) -> Indices:
        """Add unknowns, `first` (n, m), at the nodes of the mesh from `node` on."""
        every = [f"{name}, interval {k}" for k in range(len(first)) for name in names]
        return self.entries.unknowns(
            every, first, scale, interval=node + np.arange(len(first))[:, None]
        )

    def repeated(self, index: Indices, count: int | None = None) -> Indices:
        """Return the same entries (n,) for every interval, or for `count` instances."""
        return np.tile(index, (self.count if count is None else count, 1))


def control_names(group_matrix: Array, begins: Indices, what: str = "force density") -> list[str]:
    """Return the names of what is decided and held from the start of these intervals on, those of one interval after the other."""
    members = [np.flatnonzero(column) for column in group_matrix.T]
    own = [
        f"{what} of string{'s' * (len(strings) > 1)} {', '.join(map(str, strings))}"
        for strings in members
    ]
    return [f"{name}, interval {k}" for k in begins for name in own]


def state_names(model: Model) -> tuple[str, ...]:
    """Return what each entry of the state is, such as "node 2 z velocity"."""
    places = model.mechanism.coordinate_names
    return (
        *places,
        *(f"{place} velocity" for place in places),
        *["clock"] * (model.nx - 2 * len(places)),
    )


def interval_names(count: int, rows: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the rows of the motion."""
    return tuple(f"dynamics of interval {k}, {name}" for k in range(count) for name in rows)


def _strength(scales: Scales, force_density: Array) -> float:
    """Return a typical force density, N/m: of the guess, or what moves the structure's mass by its size within the duration."""
    return max(float(np.sqrt(np.mean(force_density**2))), scales.mass / scales.time**2)

"""Decision variables of a plan: states, controls, duration and others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.control import control_name
from ocp.problem.instant import forces_of
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales, control_scale, typical_cost, typical_mass
from ocp.targets.target import Target
from ocp.transcription.mesh import Guess, Profile, group_matrix, list_groups, on_mesh, spans
from ocp.transcription.sparse_nlp import Block, Unknowns
from tenscasadi.dynamics.model import Model
from tenscasadi.structure.cables import name_inputs
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
    """Vector y of decision variables and constants.

    They are in the order of their addition, and referred to by index. `suffix` is the phase in
    their names; "" without phases.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._table = np.zeros(0, _ENTRY)
        self._phases = self._first_interval = 0
        self.suffix = ""

    def begin_phase(self) -> None:
        """Begin a phase, whose interval numbers continue the last one's."""
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
        """Append decision variables to y and return their indices.

        There is one name for each. The indices have the shape of the initial values `first`, to
        which the other arguments are broadcast. `scale` is a typical size, `lower` and `upper` are
        bounds. `interval` is the mesh interval, counted from the start of the phase.
        """
        named = [name + self.suffix for name in names]
        counted = np.add(self._first_interval, interval)
        return self._add(named, first, scale, lower, upper, counted, True)

    def constants(self, values: Any) -> Indices:
        """Append constants to y and return their indices, shaped like `values`."""
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
        """Remove variables on which nothing depends.

        `index` are their indices in y.
        """
        self._table["unknown"][index], self._table["first"][index] = False, np.nan

    def find_used(self, blocks: Sequence[Block]) -> Array:
        """Mark the variables and constants on which some block depends."""
        used = np.zeros(len(self._table), dtype=bool)
        for block in blocks:
            columns = np.unique(
                np.array(block.function.jac_sparsity(0, 0).get_triplet()[1], dtype=np.intp)
            )
            used[block.index[:, columns]] = True
        return used

    def order(self) -> tuple[Unknowns, Indices]:
        """Order the decision variables by intervals, for banded matrices.

        Returns them, and the new index of each entry of y.
        """
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
        """Compute y from the scaled decision variables w."""
        unknowns, place = self.order()
        return np.concatenate([unknowns.scale * w, unknowns.constants])[place]


class Variables:
    """Decision variables of a plan or phase on a mesh.

    The mesh has intervals of the lengths `fractions` (K,) relative to the duration. `start` are the
    indices of the initial state, if it belongs to the preceding phase.

    Attributes
    ----------
    entries : Entries
        Vector y of all decision variables and constants. The following are indices in it.
    states, controls, duration : ndarray of int
        Indices (K + 1, nx), (K, m) or (K + 1, m) for m groups of strings, and (1,).
    share, time : ndarray of int
        Indices (K, 1) of the interval lengths, and (K + 1, 1) of the mesh points, relative to
        the duration.
    guess : Guess
        Initial guess on this mesh and profile.
    strength, objective : float
        Typical force density [N/m], and typical cost.
    noise : ndarray, shape (m,), or None
        Noise of the guess.
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
        self.strength = _estimate_strength(
            self.model.nq / 3 * typical_mass(self.model) / scales.time**2,
            forces_of(self.model, (guess.states[:-1] + guess.states[1:]) / 2, guess.force_density),
        )
        self.objective = typical_cost(
            problem, self.strength, guess.states, guess.force_density, guess.duration
        )
        self.guess = on_mesh(self.model, guess, fractions, profile)
        self.group_matrix = group_matrix(profile, self.model.nu)
        self._by_group = sparse(self.group_matrix)
        self.noise = (
            None
            if guess.noise is None
            else guess.noise @ (self.group_matrix / self.group_matrix.sum(axis=0))
        )
        self.entries = Entries() if entries is None else entries
        self.suffix = self.entries.suffix
        self.states = np.vstack([self._add_start() if start is None else start, self._add_states()])
        self.controls = self._add_controls()
        self.duration = self._add_duration()
        self.share = self.entries.constants(fractions[:, None])
        self.time = self.entries.constants(np.append(0.0, np.cumsum(fractions))[:, None])

    def _add_start(self) -> Indices:
        """Add the given initial state, or variables for a free one."""
        size = 0 if self.target.free_start is None else 2 * self.model.nq
        names = [f"{name}, start" for name in name_states(self.model)[:size]]
        free = self.entries.unknowns(names, self.guess.states[0, :size], self.scales.state[:size])
        return np.append(free, self.entries.constants(self.target.start[size:]))

    def _add_states(self) -> Indices:
        names = [
            f"{name}, interval {k}" for k in range(self.count) for name in name_states(self.model)
        ]
        return self.entries.unknowns(
            names,
            self.guess.states[1:],
            self.scales.state,
            interval=np.arange(1, self.count + 1)[:, None],
        )

    def _add_controls(self) -> Indices:
        """Add the controls as decision variables.

        They belong to intervals, or to mesh points if they are piecewise linear.
        """
        members = list_groups(self.profile, self.model.nu)
        least, most = self.problem.control_limits
        lower, upper = (
            np.array([choose(limit[own]) for own in members])
            for choose, limit in ((np.max, least), (np.min, most))
        )
        first = self.guess.force_density @ (self.group_matrix / self.group_matrix.sum(axis=0))
        span = np.arange(len(first)) if self.profile.linear else spans(self.profile, self.fractions)
        begins = np.unique(span, return_index=True)[1]
        first = np.add.reduceat(first, begins) / np.bincount(span)[:, None]
        labels = name_inputs(self.model.scene.structure)
        names = name_controls(self.group_matrix, begins, control_name(self.model), labels)
        scale = np.array(
            [np.max(control_scale(self.problem, self.strength)[own]) for own in members]
        )
        return self.entries.unknowns(names, first, scale, lower, upper, begins[:, None])[span]

    @property
    def free_time(self) -> bool:
        """Whether the duration is a decision variable."""
        return self.problem.shortest != self.problem.longest

    def _add_duration(self) -> Indices:
        shortest, longest = self.problem.shortest, self.problem.longest
        if not self.free_time:
            return self.entries.constants([longest])
        return self.entries.unknowns(
            ["duration"], [self.guess.duration], self.scales.time, shortest, longest, np.inf
        )

    @property
    def interval_controls(self) -> Indices:
        """Indices of the controls of each interval, for `gamma`."""
        return (
            np.hstack([self.controls[:-1], self.controls[1:]])
            if self.profile.linear
            else self.controls
        )

    def gamma(self, local: Any, share: float) -> Any:
        """Evaluate the controls (α,) at a fraction of an interval.

        `local` are the variables with the indices `interval_controls`. `share` is the fraction,
        from 0 to 1.
        """
        m = self.group_matrix.shape[1]
        held = (1 - share) * local[:m] + share * local[m:] if self.profile.linear else local
        return ca.mtimes(self._by_group, held)

    def add_at_nodes(
        self, names: Sequence[str], first: Array, scale: float, node: int = 0
    ) -> Indices:
        """Add decision variables at the mesh points from `node` on.

        `names` are those at one mesh point. `first` are the initial values, one row for each mesh
        point. `scale` is their typical size. Returns their indices in y.
        """
        every = [f"{name}, interval {k}" for k in range(len(first)) for name in names]
        return self.entries.unknowns(
            every, first, scale, interval=node + np.arange(len(first))[:, None]
        )

    def repeat(self, index: Indices, count: int | None = None) -> Indices:
        """Repeat indices (n,) for every interval, or `count` times.

        Returns an array with one row for each.
        """
        return np.tile(index, (self.count if count is None else count, 1))


def name_controls(
    group_matrix: Array, begins: Indices, what: str, labels: Sequence[str]
) -> list[str]:
    """Name the control variables, interval by interval.

    `what` is the quantity, such as "force density". `group_matrix` is the 0/1 matrix (strings,
    groups). `begins` are the intervals in which control values begin. `labels` name the cables, and
    the strings that belong to no cable.
    """
    own = []
    for column in group_matrix.T:
        names = [labels[k] for k in np.flatnonzero(column).tolist()]
        if len(names) > 1 and all(name.startswith("string ") for name in names):
            names = [f"strings {', '.join(name.removeprefix('string ') for name in names)}"]
        own.append(f"{what} of {', '.join(names)}")
    return [f"{name}, interval {k}" for k in begins for name in own]


def name_states(model: Model) -> tuple[str, ...]:
    """Name the entries of the state x.

    An example is "node 2 z velocity".
    """
    places = model.mechanism.coordinate_names
    return (
        *places,
        *(f"{place} velocity" for place in places),
        *(
            f"{label} {part.quantity}"
            for part in model.scene.internal_states
            for label in name_inputs(model.scene.structure)
        ),
        *["clock"] * int(model.has_clock),
    )


def name_intervals(count: int, rows: Sequence[str]) -> tuple[str, ...]:
    """Name the defect constraints of all intervals.

    `count` is the number of intervals; `rows` name the constraints of one.
    """
    return tuple(f"dynamics of interval {k}, {name}" for k in range(count) for name in rows)


def _estimate_strength(least: float, force_density: Array) -> float:
    """Estimate a typical force density [N/m].

    It is the root mean square of the guess `force_density`, at least `least`.
    """
    return max(float(np.sqrt(np.mean(force_density**2))), least)

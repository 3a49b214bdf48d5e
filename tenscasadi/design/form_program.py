"""Form finding as a nonlinear program.

The unknowns are nodes and force densities. Equilibrium and goals are constraints. Among the forms
that satisfy them, those are selected that keep the lengths of bars best. Among these, it is the
form nearest to the start for unsupported structures, and the form with the most equal force
densities for supported ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from scipy.linalg import qr

from tenscasadi.design.force_densities import ForceDensities
from tenscasadi.statics.self_stress import rigid_body_motions
from tenscasadi.structure.class_one import connectivity, distances
from tenscasadi.structure.equilibrium_matrix import body_pairs, free_directions, member_pairs
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.validate import Array, Indices

# Residuals of goals and constraints, relative to lengths or forces. With this weight, an objective
# selects among the minima of the one before it.
FEASIBLE = 1e-8
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.tol": 1e-11,
    "ipopt.acceptable_tol": 1e-9,
    "ipopt.max_iter": 300,
    "ipopt.mumps_scaling": 0,
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_pivot_order": 5,  # METIS, which leaves less fill-in than AMD in large nets
    "ipopt.bound_relax_factor": 0.0,
}


class Goals(NamedTuple):
    """Prescribed properties of a form.

    Attributes
    ----------
    lengths : mapping of int to float
        Lengths of strings [m].
    positions : mapping of int to tuple
        Positions of nodes (x, y, z) [m]; None for a free coordinate.
    equal_tension : tuple of tuple of int
        Groups of strings whose tensions are equal.
    loads : ndarray (n, 3)
        Forces on the nodes [N].
    """

    lengths: Mapping[int, float]
    positions: Mapping[int, tuple[float | None, ...]]
    equal_tension: tuple[tuple[int, ...], ...]
    loads: Array

    def hold(self, structure: Structure) -> bool:
        """Return whether nodes are unique for given force densities.

        They are if supports or loads determine them.
        """
        return bool(structure.held.any() or self.loads.any())


class FormProgram:
    """Nonlinear program of form finding in the unknowns x = (y, p, inner).

    y are displacements along the free directions, p the unknown force densities, and inner those of
    the massless bars that keep bodies rigid. They are in units of a mean length and a mean force
    density.
    """

    def __init__(self, structure: Structure, densities: ForceDensities, goals: Goals) -> None:
        self.structure, self.densities = structure, densities
        strings, count = len(structure.strings), len(structure.nodes)
        free = free_directions(structure, rigid=False)
        moved = np.diff(free.indptr).reshape(count, 3).any(axis=1)
        inside = body_pairs(structure)
        inside = inside[moved[inside].any(axis=1)]
        pairs = np.concatenate([member_pairs(structure), inside])
        members = len(pairs) - len(inside)
        lengths = distances(structure.nodes, pairs)
        self.length = float(lengths[:members].mean())
        self.density = densities.scale
        self._free = free
        self._held = structure.nodes.ravel() / self.length
        y, p = ca.SX.sym("y", self._free.shape[1]), ca.SX.sym("p", len(densities.lower))
        inner = ca.SX.sym("inner", len(inside))  # force densities of the bars of bodies
        N = ca.reshape(ca.DM(self._held) + sparse(self._free) @ y, 3, count)
        S = N @ sparse(connectivity(pairs, count).T)
        q = ca.DM(densities.given / self.density) + sparse(densities.basis) @ p
        q = ca.vertcat(q, inner)
        squared = ca.sum1(S**2).T
        forces = (S * ca.repmat(q.T, 3, 1)) @ sparse(connectivity(pairs, count))
        loads = ca.DM(goals.loads.ravel() / (self.density * self.length))
        self.x = ca.vertcat(y, p, inner)
        balance = sparse(self._free.T) @ (ca.vec(forces) - loads)
        self.equilibrium = balance[_independent_rows(structure, free).tolist()]
        if not (densities.has_scale or goals.loads.any()):
            self.equilibrium = ca.vertcat(self.equilibrium, ca.sum1(q[:strings]) / strings - 1)
        bars = ca.DM(lengths[strings:] / self.length)
        longer = (squared[strings:, 0] - bars**2) / (2 * bars)
        self.bars, self.bodies = longer[: members - strings], longer[members - strings :]
        self.goals, self.names = self._goal_rows(goals, N, squared, q)
        uneven = ca.sumsqr(p - ca.DM(np.where(np.isfinite(densities.lower), 1.0, -1.0)))
        first, then = (uneven, ca.sumsqr(y)) if goals.hold(structure) else (ca.sumsqr(y), uneven)
        self.distance = first + FEASIBLE * then
        self._lower = np.full(self.x.numel(), -np.inf)
        self._lower[y.numel() : y.numel() + p.numel()] = densities.lower

    def _goal_rows(self, goals: Goals, N: Any, squared: Any, q: Any) -> tuple[Any, list[str]]:
        """Build the residuals of the goals, and their names.

        Nodes N (3×n), squared member lengths and force densities q are in scaled units.
        """
        rows, names = [], []
        for string, length in goals.lengths.items():
            target = length / self.length
            rows.append((squared[string] - target**2) / (2 * target))
            names.append(f"length of string {string}")
        for node, place in goals.positions.items():
            for axis, value in enumerate(place):
                if value is not None:
                    rows.append(N[axis, node] - value / self.length)
                    names.append(f"{'xyz'[axis]} of node {node}")
        for first, *others in goals.equal_tension:
            for other in others:
                rows.append((q[other] ** 2 * squared[other] - q[first] ** 2 * squared[first]) / 2)
                names.append(f"tension of string {other} against string {first}")
        return ca.vertcat(ca.SX(0, 1), *rows), names

    def nodes(self, x: Array) -> Array:
        """Compute the nodes (n, 3) [m] from the unknowns x."""
        return np.asarray(
            self.length * (self._held + self._free @ x[: self._free.shape[1]]).reshape(-1, 3)
        )

    def force_densities(self, x: Array) -> Array:
        """Compute the force densities of all members [N/m].

        They follow from the unknowns x.
        """
        own = self._free.shape[1] + np.arange(len(self.densities.lower))
        return self.densities.of(x[own] * self.density)

    def unknowns(self, nodes: Array, p: Array) -> Array:
        """Compute the unknowns x from nodes and force densities.

        They are nodes (n, 3) [m] and force densities p (u,) [N/m].
        """
        y = self._free.T @ (nodes.ravel() / self.length - self._held)
        inner = self.x.numel() - len(y) - len(p)
        return np.concatenate([y, p / self.density, np.zeros(inner)])

    def minimize(self, objective: Any, constraints: Any, start: Array) -> tuple[Array, bool]:
        """Minimize an objective subject to constraints = 0.

        `start` is the initial guess of x. Equilibrium and rigid bodies are constraints, too.
        Returns x, and whether it satisfies all constraints.
        """
        rows = ca.vertcat(self.equilibrium, self.bodies, constraints)
        program = {"x": self.x, "f": objective, "g": ca.densify(rows)}
        if rows.numel() > self.x.numel():
            return start, False
        solver = ca.nlpsol("form", "ipopt", program, _OPTIONS)
        bounded = np.maximum(start, self._lower)
        x = solver(x0=bounded, lbx=self._lower, lbg=0.0, ubg=0.0)["x"].full().ravel()
        if not np.all(np.isfinite(x)):
            return start, False
        return x, bool(np.all(np.abs(self._evaluate(rows, x)) <= FEASIBLE))

    def solve(self, start: Array) -> tuple[Array, Array]:
        """Find the form by objectives in order of priority.

        They are the goals, then the lengths of bars, then the distance. `start` is the initial
        guess of x. Returns x, and the residuals of the goals [in units of mean length and force].
        """
        x, feasible = self.minimize(self.distance, ca.vertcat(self.goals, self.bars), start)
        if feasible:
            return x, np.zeros(self.goals.numel())
        fitted = ca.sumsqr(self.bars) + FEASIBLE * self.distance
        x, feasible = self.minimize(fitted, self.goals, start)
        missed = np.zeros(self.goals.numel())
        if not feasible:
            fitted = ca.sumsqr(self.goals) + FEASIBLE * fitted
            x, feasible = self.minimize(fitted, ca.SX(0, 1), start)
            missed = self._evaluate(self.goals, x)
        attained = ca.vertcat(
            self.goals - ca.DM(missed), self.bars - ca.DM(self._evaluate(self.bars, x))
        )
        nearest, feasible = self.minimize(self.distance, attained, x)
        return (nearest if feasible else x), missed

    def _evaluate(self, expression: Any, x: Array) -> Array:
        return np.asarray(ca.Function("value", [self.x], [expression])(x).full().ravel())


def _independent_rows(structure: Structure, free: Any) -> Indices:
    """Select independent equilibrium equations.

    Internal forces do no work on rigid-body motions. One equation is omitted for each rigid-body
    motion that the supports allow. The equations are those of free directions (3n, rows).
    """
    motions = free.T @ rigid_body_motions(structure)
    pivots = qr(motions.T, pivoting=True)[2]
    return np.sort(pivots[motions.shape[1] :])

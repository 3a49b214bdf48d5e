"""Minimum mass of members as a linear program.

Unknowns are the areas a and, for each load case, forces f of members in equilibrium. Any such
forces within the limits are admissible (lower-bound theorem of plasticity).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from tenscasadi.design.conic import LinearRows, solve_conic
from tenscasadi.design.sizing.material import Sections
from tenscasadi.structure.equilibrium_matrix import (
    equilibrium_matrix,
    free_directions,
    member_pairs,
)
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import NEGLIGIBLE, Array, Indices


class BucklingRows(NamedTuple):
    """Linear buckling constraints −f ≤ slope · a + constant on areas a.

    Attributes
    ----------
    members : ndarray of int (k,)
        The bars.
    slope : ndarray (k,)
        Derivative of the bound with respect to the area [N/m²].
    constant : ndarray (k,)
        Bound at zero area [N].
    """

    members: Indices
    slope: Array
    constant: Array


class SizedForces(NamedTuple):
    """Solution of the linear program for areas and forces.

    Attributes
    ----------
    mass : float
        Objective [kg]; inf if there is no solution.
    area : ndarray (members,)
        Areas [m²].
    force : ndarray (cases, members)
        Forces [N], positive in tension.
    """

    mass: float
    area: Array
    force: Array


class SizingProgram:
    """Linear program for the smallest mass under load cases.

    The members are the cables and strings in no cable, then the bars.

    Attributes
    ----------
    sections : Sections
        Sections of the members.
    strings, members : int
        Number of cables and strings in no cable, and of members.
    balance : csc_array (free coordinates, members)
        Nodal loads that balance a unit tension of each member.
    end_weights : csc_array (3n, members)
        Nodal weights of members per area [N/m²].
    weight : csc_array (free coordinates, members)
        These weights along the free directions [N/m²].
    cases : ndarray (cases, 3n)
        Nodal loads [N].
    loads : ndarray (cases, free coordinates)
        Loads along the free directions [N].
    """

    def __init__(
        self, structure: Structure, sections: Sections, cases: Array, gravity: Array | None
    ) -> None:
        self.sections = sections
        self.members = len(sections.lengths)
        self.strings = self.members - len(structure.bars)
        per_force = np.concatenate([1.0 / structure.string_lengths, -1.0 / structure.bar_lengths])
        each = np.arange(len(sections.unit))
        tensions = sp.csc_array(
            (per_force, (each, sections.unit)), shape=(len(each), self.members)
        )  # λ > 0 is compression
        self.balance = sp.csc_array(equilibrium_matrix(structure) @ tensions)
        free = free_directions(structure)
        self.cases = cases.reshape(len(cases), structure.nodes.size)
        self.loads = self.cases @ free
        acceleration = np.zeros(3) if gravity is None else gravity
        self.end_weights = _end_weights(structure, sections, acceleration)
        self.weight = sp.csc_array(free.T @ self.end_weights)
        self._units, self._rows = self._build()

    def nodal_weight(self, area: Array) -> Array:
        """Compute the nodal weights (n, 3) of the members [N].

        `area` (members,) are their areas [m²].
        """
        return np.asarray((self.end_weights @ area).reshape(-1, 3))

    def _build(self) -> tuple[_SizingUnits, _SizingRows]:
        """Build the constant constraints of the program, in scaled units.

        The units are the largest load, and the areas that it requires.
        """
        cases, members = len(self.loads), self.members
        force = float(np.abs(self.loads).max(initial=0.0)) or 1.0
        units = _SizingUnits(force, force / self.sections.strength)
        every, each = np.ones((cases, 1)), sp.eye_array(cases, format="csr")
        own = sp.eye_array(members, format="csr")
        bar = sp.diags_array(np.where(np.arange(members) < self.strings, 0.0, 1.0), format="csr")
        weight = self.weight @ sp.diags_array(units.area / units.force)
        equal = LinearRows(
            sp.hstack([sp.kron(every, -weight), sp.kron(each, self.balance)], format="csc"),
            self.loads.ravel() / units.force,
        )
        tension = sp.hstack([sp.kron(every, -own), sp.kron(each, own)])
        compression = sp.hstack([sp.kron(every, -bar), sp.kron(each, -own)])
        least = sp.hstack([-own, sp.csr_array((members, cases * members))])
        below = LinearRows(
            sp.vstack([tension, compression, least], format="csc"),
            np.concatenate([np.zeros(2 * cases * members), -self.sections.minimum / units.area]),
        )
        mass = self.sections.mass_per_area * units.area
        cost = np.concatenate([mass / mass.max(initial=1e-300), np.zeros(cases * members)])
        return units, _SizingRows(equal, below, cost)

    def solve(self, rows: BucklingRows | None = None, most: Array | None = None) -> SizedForces:
        """Minimize the mass subject to limits of forces.

        Besides the allowable stress, `rows` bound compressions by areas, and `most` (members,)
        bounds them by constants [N].
        """
        cases, members = len(self.loads), self.members
        units, fixed = self._units, self._rows
        bars = np.arange(self.strings, members)
        below = [fixed.below]
        if rows is not None and len(rows.members):
            below.append(self._buckling_rows(rows))
        if most is not None:
            below.append(self._buckling_rows(BucklingRows(bars, np.zeros(len(bars)), most[bars])))
        limits = LinearRows(
            sp.vstack([part.A for part in below], format="csc"),
            np.concatenate([part.b for part in below]),
        )
        found = solve_conic(fixed.cost, fixed.equal, limits)
        if found.status != "solved":
            return SizedForces(np.inf, np.zeros(members), np.zeros((cases, members)))
        x = np.where(np.abs(found.x) > NEGLIGIBLE, found.x, 0.0)  # beyond the solver's accuracy
        area = x[:members] * units.area
        forces = x[members:].reshape(cases, members) * units.force
        return SizedForces(float(self.sections.mass_per_area @ area), area, forces)

    def _buckling_rows(self, rows: BucklingRows) -> LinearRows:
        """Build the buckling constraints of all load cases, bar by bar.

        They are −f − slope · a ≤ constant [in scaled units]. `rows` contains the bars with their
        slopes and constants.
        """
        cases, members, count = len(self.loads), self.members, len(rows.members)
        slope = rows.slope * (self._units.area[rows.members] / self._units.force)
        of_area = sp.csr_array((-slope, (np.arange(count), rows.members)), shape=(count, members))
        of_force = sp.csr_array(
            (np.full(count, -1.0), (np.arange(count), rows.members)), shape=(count, members)
        )
        every, each = np.ones((cases, 1)), sp.eye_array(cases, format="csr")
        matrix = sp.hstack([sp.kron(every, of_area), sp.kron(each, of_force)])
        return LinearRows(matrix, np.tile(rows.constant / self._units.force, cases))


class _SizingUnits(NamedTuple):
    """Units of force and area in the scaled program.

    Attributes
    ----------
    force : float
        Unit of forces [N].
    area : ndarray (members,)
        Area of each member that this force requires [m²].
    """

    force: float
    area: Array


class _SizingRows(NamedTuple):
    """Constant constraints of the program, and the cost.

    They are equilibrium (`equal`) and the allowable stress (`below`).
    """

    equal: LinearRows
    below: LinearRows
    cost: Array


def _end_weights(structure: Structure, sections: Sections, gravity: Array) -> Any:
    """Build the nodal weights per area of members [N/m²].

    Their matrix is (3n, members). One half of the weight of a string or bar acts at each end.
    `gravity` (3,) is in m/s².
    """
    pairs = member_pairs(structure)
    lengths = np.concatenate([structure.string_lengths, structure.bar_lengths])
    half = 0.5 * (sections.density[sections.unit] * lengths)[:, None] * gravity
    rows = 3 * pairs[:, :, None] + np.arange(3)
    values = np.stack([half, half], axis=1)
    columns = np.repeat(sections.unit, 6)
    shape = (structure.nodes.size, len(sections.lengths))
    return sp.csc_array((values.ravel(), (rows.ravel(), columns)), shape=shape)

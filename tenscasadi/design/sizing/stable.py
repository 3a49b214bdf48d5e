"""Minimum mass with global stability, by semidefinite programs.

The tangent stiffness is linear in areas and prestress for given responses to the loads. It is
constrained to be positive semidefinite on the modes that were unstable in earlier solutions.
Responses and Euler loads are linearized about the areas of the last program, until both agree.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp

from tenscasadi.design.conic import LinearRows, scaled_triangle, solve_conic
from tenscasadi.design.sizing.elastic_forces import elastic_response, response_slopes
from tenscasadi.design.sizing.program import SizingProgram
from tenscasadi.design.tangent_stiffness import SOFTEST, TangentStiffness, extend_basis
from tenscasadi.util.validate import MAX_ITERATIONS, NEGLIGIBLE, TOLERANCE, Array

_FACTOR = 10.0  # largest factor of an area per iteration, before the areas oscillate
_START = 1e-3  # least initial area, relative to the largest: no area grows from zero


class StableDesign(NamedTuple):
    """Areas, forces and prestress of a stable design.

    Attributes
    ----------
    area : ndarray (α + β,)
        Areas [m²].
    force : ndarray (cases, α + β)
        Forces in each load case [N].
    prestress : ndarray (α + β,)
        Forces without loads [N].
    message : str
        The reason of a failure; empty on success.
    """

    area: Array
    force: Array
    prestress: Array
    message: str


class _Response(NamedTuple):
    """Force changes due to a load, linearized in the areas.

    They are constant + slope · area, of the members, then of the massless bars that keep bodies
    rigid.
    """

    constant: Array
    slope: Array

    def at(self, area: Array) -> Array:
        """Compute the force changes (units,) for given areas [N]."""
        return np.asarray(self.constant + self.slope @ area)

    def of(self, members: int) -> _Response:
        """Select the force changes of the first `members` members."""
        return _Response(self.constant[:members], self.slope[:members])


class StableSizing:
    """Search for the smallest mass with stability in all load cases.

    Unknowns are areas and prestress. The unloaded state is a load case, too.

    Attributes
    ----------
    program : SizingProgram
        Sections, equilibrium and loads.
    tangent : TangentStiffness
        Tangent stiffness with elastic bars.
    given : ndarray (α + β,) or None
        Prestress [N]; None if it is to be optimized.
    factor : float
        Factor of the forces at which all states are stable.
    """

    def __init__(
        self, program: SizingProgram, tangent: TangentStiffness, given: Array | None
    ) -> None:
        self.program, self.tangent, self.given = program, tangent, given
        each = np.arange(len(tangent.lengths))
        # force densities of members per force of a unit
        self._densities = sp.csr_array((1.0 / tangent.lengths, (each, tangent.unit)))
        self._of_members, self._of_loads = self._transfer_forces()
        self._seen = np.zeros((tangent.free.shape[1], 0))
        self._factor = _FACTOR
        self.factor = 1.0

    def search(self, start: Array) -> StableDesign:
        """Find a stable design by successive linearization.

        `start` (members,) are the initial areas [m²]. The response is linearized about the areas of
        the last program.
        """
        if not start.any():  # no member carries a load
            return self._design(start, np.zeros_like(start), "")
        area = np.maximum(start, _START * start.max(initial=0.0))
        own, last = np.zeros_like(area), np.zeros_like(area)
        weight = self.program.sections.mass_per_area
        self._factor = _FACTOR
        for _ in range(MAX_ITERATIONS):
            found = self._stabilize(area, self._linearize(area))
            if found is None and self._factor < _START**-2:
                self._factor *= _FACTOR
                continue
            if found is None:
                reason = "no areas and prestress keep all load cases stable: add members or supports, or let the prestress be chosen"
                return self._design(area, own, reason)
            step, own = found[0] - area, found[1]
            area = np.maximum(found[0], NEGLIGIBLE * found[0].max(initial=0.0))
            if abs(weight @ step) <= NEGLIGIBLE * (weight @ area):
                return self._design(area, own, "")
            if step @ last < 0.0:  # the areas oscillate
                self._factor = self._factor**0.5
            last = step
        return self._design(
            area, own, "areas and response to the loads do not settle: give a minimum area"
        )

    def _design(self, area: Array, own: Array, message: str) -> StableDesign:
        response = elastic_response(self.program, area)
        if np.abs(own).max(initial=0.0) <= TOLERANCE * np.abs(response).max(initial=0.0):
            own = np.zeros_like(own)
        return StableDesign(area, own + response, own, message)

    def _transfer_forces(self) -> tuple[Array, Array]:
        """Compute all member forces, also in massless bars of bodies.

        Returns them per force of a member (units, members), and per nodal load (units, 3n). The
        loads balance the members, so that bodies are in equilibrium.
        """
        members, tangent = self.program.members, self.tangent
        springs = tangent.springs.toarray()
        held = np.linalg.pinv(springs[members:].T)
        of_members = np.vstack([np.eye(members), -held @ springs[:members].T])
        nothing = np.zeros((members, tangent.free.shape[0]))
        return of_members, np.vstack([nothing, held @ tangent.free.T])

    def _linearize(self, area: Array) -> list[_Response]:
        """Linearize the force changes of all load cases in the areas (members,) [m²].

        The first case is without loads.
        """
        every, loads = self._of_members, self._of_loads
        slopes = response_slopes(self.program, area)
        values = elastic_response(self.program, area)
        weight = loads @ self.program.end_weights
        cases = zip(values, slopes, self.program.cases, strict=True)
        return [
            _Response(np.zeros(len(every)), np.zeros(every.shape)),
            *(
                _Response(every @ (value - slope @ area) + loads @ case, every @ slope + weight)
                for value, slope, case in cases
            ),
        ]

    def _stabilize(self, area: Array, states: list[_Response]) -> tuple[Array, Array] | None:
        """Solve semidefinite programs until all load cases are stable.

        They are linearized about the areas (members,) [m²], and `states` are the responses of load
        cases there. Unstable modes of a solution become constraints of the next program. Returns
        areas and prestress, None if there is no solution.
        """
        sections = self.program.sections
        for _ in range(MAX_ITERATIONS):
            found = self._minimize(area, states)
            if found is None:
                return None
            k = np.zeros(len(self._of_members))
            k[: len(found[0])] = sections.modulus * found[0] / sections.lengths
            known = self._seen.shape[1]
            for state in states:
                forces = self._of_members @ found[1] + state.at(found[0])
                q = self.factor * (self._densities @ forces)
                values, motions = self.tangent.softest(q, SOFTEST, k)
                unstable = motions[:, values < -NEGLIGIBLE * k.max(initial=0.0)]
                self._seen = extend_basis(self._seen, unstable)
            if self._seen.shape[1] == known:
                return found
        return None

    def _minimize(self, area: Array, states: list[_Response]) -> tuple[Array, Array] | None:
        """Minimize the mass over areas and prestress.

        The force changes due to loads are linearized about the areas (members,) [m²], and given by
        `states`. Returns areas and prestress; None if there is no solution.
        """
        sections, members = self.program.sections, self.program.members
        known = [state.at(area)[:members] for state in states]
        known.append(np.zeros(members) if self.given is None else self.given)
        force = float(np.abs(known).max(initial=0.0)) or 1.0
        unit = force / sections.strength
        units = [
            _Response(state.constant / force, state.slope * (unit / force)) for state in states
        ]
        balance = self.program.balance
        equal = [LinearRows(_beside(np.zeros(balance.shape), balance), np.zeros(balance.shape[0]))]
        if self.given is not None:
            zeros = np.zeros((members, members))
            equal.append(LinearRows(_beside(zeros, np.eye(members)), self.given / force))
        cones = []
        if self._seen.shape[1]:
            material, geometric = self.tangent.reduce(self._seen)
            slope = (sections.modulus / sections.lengths)[:, None, None]
            by_area = _triangles(material[:members] * slope)
            by_force = self.factor * _triangles(geometric) @ self._densities.toarray()
            cones = [
                LinearRows(
                    -_beside(
                        by_area * (unit / force) + by_force @ each.slope,
                        by_force @ self._of_members,
                    ),
                    by_force @ each.constant,
                )
                for each in units
            ]
        mass = sections.mass_per_area * unit
        found = solve_conic(
            np.concatenate([mass / mass.max(initial=1e-300), np.zeros(members)]),
            _stack(equal),
            _stack(self._limits(area / unit, units, unit)),
            semidefinite=cones,
        )
        if found.status != "solved":
            return None
        return np.maximum(found.x[:members], 0.0) * unit, found.x[members:] * force

    def _limits(self, at: Array, states: list[_Response], unit: Array) -> list[LinearRows]:
        """Build the limits of areas and forces [in scaled units].

        Euler loads are linearized about the areas `at` (members,). `states` are the responses of
        load cases there, and `unit` (members,) are the units of areas [m²].
        """
        sections, strings = self.program.sections, self.program.strings
        eye = np.eye(self.program.members)
        c = (sections.buckling * unit / sections.strength)[strings:]
        euler = 2.0 * (c * at[strings:])[:, None] * eye[strings:]
        rows = [LinearRows(_beside(-eye, 0.0 * eye), -sections.minimum / unit)]
        for sign, bound in ((1.0, at * self._factor), (-1.0, -at / self._factor)):
            rows.append(LinearRows(_beside(sign * eye, 0.0 * eye), bound))
        for constant, slope in (each.of(len(eye)) for each in states):
            push = -slope[strings:], -eye[strings:]
            rows += [
                LinearRows(_beside(slope - eye, eye), -constant),
                LinearRows(_beside(-slope[:strings], -eye[:strings]), constant[:strings]),
                LinearRows(_beside(push[0] - eye[strings:], push[1]), constant[strings:]),
                LinearRows(
                    _beside(push[0] - euler, push[1]), constant[strings:] - c * at[strings:] ** 2
                ),
            ]
        return rows


def _triangles(matrices: Array) -> Array:
    """Stack the scaled upper triangles of matrices (k, r, r) as columns."""
    return np.stack([scaled_triangle(each) for each in matrices], axis=1)


def _beside(of_areas: Array, of_prestress: Any) -> sp.csc_array:
    """Concatenate constraint coefficients of areas and of prestress.

    Both have one row for each constraint.
    """
    return sp.hstack([sp.csc_array(of_areas), sp.csc_array(of_prestress)], format="csc")


def _stack(rows: list[LinearRows]) -> LinearRows:
    """Stack several sets of linear constraints (`rows`) to one."""
    return LinearRows(
        sp.vstack([each.A for each in rows], format="csc"),
        np.concatenate([each.b for each in rows]),
    )

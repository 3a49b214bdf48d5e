"""Cables: several strings with one tension that slide over nodes.

A cable is one string law of the length L = Σ |s_i|, with the rest length Σ ρ_i and the compliance Σ
1/k_i. The force densities of its strings are γ_i = T/|s_i|. A *control input* is a cable, or a
string that is not part of a cable, because each of them has one control.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.structure.cables import add_compliances, find_directions, select_first
from tenscasadi.util.casadi_tools import constant_row, is_expression, sparse
from tenscasadi.util.validate import NEGLIGIBLE

# Sliding velocity [m/s] below which friction is regularized, as `slip_speed` of the grounds.
SLIP_SPEED = 1e-3


class CableRows:
    """Conversion between strings (1×α) and control inputs (1×m).

    A control input is a cable, or a string that is not part of a cable. Quantities are row vectors.

    Parameters
    ----------
    structure : Structure
        Modeled structure with cables, whose constants may be expressions.
    """

    def __init__(self, structure: Any) -> None:
        s = self.structure = structure
        self.cabled = [string for cable in s.cables for string in cable]
        self.lone = np.setdiff1d(np.arange(len(s.strings)), self.cabled).tolist()
        sizes = [len(cable) for cable in s.cables]
        incidence = np.repeat(np.eye(len(sizes)), sizes, axis=0)
        self.incidence = sparse(incidence)  # cabled strings × cables
        first = [*self.lone, *(cable[0] for cable in s.cables)]
        self.order = np.argsort(s.cable_of[first]).tolist()
        self.strings = np.argsort([*self.lone, *self.cabled]).tolist()

    # --- constants of inputs ---

    def constants(self) -> Any:
        """Compute the constants (m,) or (1×m) of control inputs.

        They are stiffness, damping and rest length, under the names of `Structure`.
        """
        s = self.structure
        first = select_first(s.cable_of)
        return SimpleNamespace(
            stiffness=self._constants(s.stiffness, series=True),
            damping=self._constants(s.damping, series=True),
            rest_length=self._constants(s.rest_length),
            string_parent=s.string_parent[first],
            string_fraction=s.string_fraction[first],
        )

    def _constants(self, values: Any, series: bool = False) -> Any:
        """Compute a constant of each control input.

        `values` (α,) or (1×α) belong to strings. They are added; if in `series`, as stiffness and
        damping, their inverses are added and the sum is inverted. The result is (m,) or (1×m).
        """
        if is_expression(values):
            row = ca.repmat(values, 1, len(self.structure.strings) // values.shape[1])
            return self._join(
                row[:, self.lone],
                1 / self._add(1 / row[:, self.cabled])
                if series
                else self._add(row[:, self.cabled]),
            )
        if series:
            return add_compliances(self.structure.cable_of, values)
        return np.bincount(self.structure.cable_of, weights=values)

    # --- rows of inputs ---

    def sum(self, row: Any) -> Any:
        """Sum string values over each control input.

        `row` is 1×α, the result 1×m.
        """
        return self._join(row[:, self.lone], self._add(row[:, self.cabled]))

    def squared_lengths(self, squared: Any) -> Any:
        """Compute squared lengths (1×m) [m²] of control inputs.

        The length of a cable is that of its strings together. `squared` (1×α) are the squared
        lengths of the strings.
        """
        return self._join(squared[:, self.lone], self._add(self._lengths(squared)) ** 2)

    def rates(self, squared: Any, rates: Any) -> Any:
        """Compute L dL/dt (1×m) [m²/s] for each control input.

        L is the length of a cable, or of a string in no cable. `squared` (1×α) are the squared
        lengths ‖s‖² of the string vectors s, and `rates` (1×α) are sᵀṡ.
        """
        lengths = self._lengths(squared)
        speeds = rates[:, self.cabled] / lengths
        return self._join(rates[:, self.lone], self._add(lengths) * self._add(speeds))

    # --- rows of strings ---

    def force_densities(self, gamma: Any, squared: Any) -> Any:
        """Compute force densities (1×α) of strings from those of inputs [N/m].

        `gamma` (1×m) is T/L of each control input, its tension over its length. `squared` (1×α) are
        the squared lengths of the strings.
        """
        inverse = np.argsort(self.order).tolist()
        own = gamma[:, inverse]
        lone, cables = own[:, : len(self.lone)], own[:, len(self.lone) :]
        lengths = self._lengths(squared)
        tension = ca.mtimes(cables * self._add(lengths), self.incidence.T)
        return ca.horzcat(lone, tension / lengths)[:, self.strings]

    def friction_ratios(self, S: Any, V: Any, driven: bool) -> Any:
        """Compute each string's tension relative to that without friction.

        Parameters
        ----------
        S, V : casadi matrix, shape (3, α)
            String vectors [m], and their velocities [m/s].
        driven : bool
            Whether the tension of the first string is given. Its ratio is 1 then.

        Returns
        -------
        casadi row, shape (1, α)
            Ratios r_i/Σ w_i r_i with the weights w_i = |s_i|/L, or r_i/r_1 if `driven`.

        Notes
        -----
        Over each node, T₁ = T₂ exp(μ θ v/√(v² + v_s²)) (Euler–Eytelwein). θ is the angle between
        the directions of travel. v is the velocity of the cable from string 2 to string 1, if the
        strain is the same along the cable. The tension Σ w_i T_i is that without friction, so
        elastic energy plus Σ (T₁ − T₂) v ≥ 0 is the work of the cable.
        """
        s = self.structure
        ratios: list[Any] = [ca.DM(1)] * len(s.strings)
        squared = ca.sum1(S * S)
        lengths = ca.sqrt(squared + (1e-9 * constant_row(s.rest_length)) ** 2)
        speeds = ca.sum1(S * V) / lengths
        for cable, friction in zip(s.cables, s.cable_friction.tolist(), strict=True):
            if friction and len(cable) > 1:
                own = list(cable)
                signs = [
                    1.0 if int(s.strings[string, 0]) == start else -1.0
                    for string, (start, _) in zip(own, find_directions(s.strings, own), strict=True)
                ]
                directions = S[:, own] * ca.repmat(ca.DM(signs).T / lengths[:, own], 3, 1)
                found = _tension_ratios(
                    friction, lengths[:, own], speeds[:, own], directions, driven
                )
                for string, ratio in zip(own, ca.horzsplit(found), strict=True):
                    ratios[string] = ratio
        return ca.horzcat(*ratios)

    def _lengths(self, squared: Any) -> Any:
        """Compute the lengths of the strings in cables [m], as a row.

        `squared` (1×α) are the squared lengths of all strings. The lengths are regularized at zero
        like those of string laws.
        """
        unit = constant_row(self.structure.rest_length)
        if unit.shape[1] > 1:
            unit = unit[:, self.cabled]
        return ca.sqrt(squared[:, self.cabled] + (1e-9 * unit) ** 2)

    def _add(self, row: Any) -> Any:
        return ca.mtimes(row, self.incidence)

    def _join(self, lone: Any, cables: Any) -> Any:
        return ca.horzcat(lone, cables)[:, self.order]


def _tension_ratios(
    friction: float, lengths: Any, speeds: Any, directions: Any, driven: bool
) -> Any:
    """Compute tensions (1×q) along a cable relative to that without friction.

    The q strings have lengths (1×q) [m], rates of length `speeds` (1×q) [m/s] and unit vectors
    `directions` (3×q). If the tension is controlled (`driven`), it is that of the first string.
    `friction` is the coefficient between cable and nodes.
    """
    count = lengths.shape[1]
    share = lengths / ca.sum2(lengths)
    slips = ca.cumsum(speeds - share * ca.sum2(speeds), 1)
    exponents = [ca.DM(0)]
    for j in range(count - 2, -1, -1):
        a, b, v = directions[:, j], directions[:, j + 1], slips[:, j]
        across = ca.cross(a, b)
        # the angle between parallel directions has no derivative
        angle = ca.atan2(ca.sqrt(ca.dot(across, across) + NEGLIGIBLE**2), ca.dot(a, b))
        sign = v / ca.sqrt(v * v + SLIP_SPEED**2)
        exponents.insert(0, exponents[0] + friction * angle * sign)
    ratios = ca.exp(ca.horzcat(*exponents))
    return ratios / (ratios[:, 0] if driven else ca.sum2(share * ratios))

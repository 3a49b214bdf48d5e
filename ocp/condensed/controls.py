"""How the unknowns of a plan, force densities and the duration, act on the stations of the motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from ocp.transcription.discrete_equations import EARLY, LATE
from ocp.transcription.mesh import Profile, group_matrix, spans
from tenscasadi.dynamics.model import Model
from tenscasadi.util.validate import Array, Indices

SMALL = 2000  # entries of a matrix


class Controls:
    """T²σγ of the modelled strings at the stations, as a function of the groups' force densities c (Kc, m) and the duration T.

    weight σ (K + X,): the share of the duration that acts at each station: half of the intervals
    around it, of a tap half of that before.
    """

    def __init__(self, model: Model, fractions: Array, profile: Profile, taps: Indices) -> None:
        count, s = len(fractions), model.structure
        early, late = (_halves(fractions, profile, end) for end in (EARLY, LATE))
        nothing = sp.csr_array((1, early.shape[1]))
        inner = sp.csr_array(sp.vstack([nothing, late])[:count] + early)
        mesh = sp.csr_array(sp.vstack([inner, late[taps - 1]]))
        half = fractions / 2
        self.weight = np.concatenate([half + np.append(0.0, half[:-1]), half[taps - 1]])
        together = group_matrix(profile, model.nu)
        strings = sp.csr_array(together[s.string_parent] / np.asarray(s.string_fraction)[:, None])
        self.late, self.mesh, self.mesh_T, self.strings, self.strings_T = (
            compact(matrix) for matrix in (late, mesh, mesh.T, strings, strings.T)
        )
        self.shape = (early.shape[1], together.shape[1])

    def at_stations(self, c: Array) -> Array:
        """Return σγ (K + X, α) of c (Kc, m)."""
        return np.asarray((self.strings @ (self.mesh @ c).T).T)

    def before_nodes(self, c: Array) -> Array:
        """Return σγ (K, α) that acts from the interval before at the nodes k = 1 … K."""
        return np.asarray((self.strings @ (self.late @ c).T).T)

    def gathered(self, values: Array) -> Array:
        """Return the transpose of `at_stations`: (Kc, m, r) of (K + X, α, r)."""
        columns = values.shape[2]
        own = (self.mesh_T @ values.reshape(len(values), -1)).reshape(self.shape[0], -1, columns)
        flat = self.strings_T @ own.transpose(1, 0, 2).reshape(own.shape[1], -1)
        return np.asarray(flat.reshape(self.shape[1], self.shape[0], columns).transpose(1, 0, 2))


def compact(matrix: Any) -> Any:
    """Return a sparse matrix as an array where it is small, which takes less time to multiply with, else by rows."""
    return matrix.toarray() if np.prod(matrix.shape) <= SMALL else sp.csr_array(matrix)


def _halves(fractions: Array, profile: Profile, end: float) -> sp.csr_array:
    """(K, Kc): half of each interval's share times the force density that acts at one of its ends."""
    count = len(fractions)
    half = fractions / 2
    if not profile.linear:
        return sp.csr_array((half, (np.arange(count), spans(profile, fractions))))
    return sp.csr_array(
        sp.diags_array([half * (1 - end), half * end], offsets=[0, 1], shape=(count, count + 1))
    )

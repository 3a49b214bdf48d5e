"""Equilibrium of structures, computed without the package's own statics."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.structure.structure import Structure


def unbalanced(s: Structure, gamma: Any) -> float:
    """Largest nodal force that remains when each bar takes the force that suits it best, in N."""
    N = s.nodes.T
    strings = (
        -N @ s.C_s.T @ np.diag(np.broadcast_to(gamma, len(s.strings))) @ s.C_s
    )  # forces on nodes, 3×n
    held = s.fixed.T.ravel()
    left = -strings.ravel()[~held]
    if len(s.bars):
        B = N @ s.C_b.T
        columns = [np.outer(B[:, k], s.C_b[k]).ravel()[~held] for k in range(len(s.bars))]
        A = np.stack(columns, axis=1)
        left = left - A @ np.linalg.lstsq(A, left, rcond=None)[0]
    return float(np.abs(left).max(initial=0.0))


def gamma_of(s: Structure) -> Any:
    """Force densities of the rest lengths, N/m."""
    return s.stiffness * (1 - s.rest_length / s.string_lengths)

"""Constraints that repeat each other: found when a model is built, by bar and joint."""

from __future__ import annotations

import casadi as ca
import numpy as np

from tenscasadi.dynamics import mechanism as dynamics
from tenscasadi.dynamics.mechanism import Mechanism
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import sparse

SINGULAR = 1e-9  # relative to a system of unit diagonal
LARGEST = 600  # unknowns, for a dense eigenvalue problem


class RedundantConstraints(UserWarning):
    """Bar lengths and joints say the same thing twice, or nearly, in the initial shape: multipliers are not unique there."""


def find_redundancy(structure: Structure, mechanism: Mechanism) -> str | None:
    """A message that names the bars and joints whose constraints depend on each other in the initial shape, or None.

    Looks at the system that the multipliers solve, scaled to unit diagonal; systems above 600 unknowns are not looked at.
    """
    size = mechanism.system_size
    if not 0 < size <= LARGEST:
        return None
    B = ca.mtimes(ca.DM(mechanism.N), sparse(mechanism.C_b.T))
    matrix, _ = dynamics.system(mechanism, B, ca.DM.zeros(1, mechanism.bars), ca.DM.zeros(3, mechanism.joints))
    A = matrix.full()
    diagonal = np.sqrt(np.maximum(A.diagonal(), 0))
    scale = np.divide(1, diagonal, out=np.zeros(size), where=diagonal > 1e-12 * diagonal.max(initial=1e-300))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    null = values < SINGULAR * values[-1]
    if not null.any():
        return None
    share = np.abs(vectors[:, null]).max(axis=1)
    involved = np.flatnonzero(share > 1e-6 * share.max())
    smallest = max(float(values[0]), np.finfo(float).eps * float(values[-1]))
    if mechanism.joints:
        names = "joints " + ", ".join(str(k) for k in np.unique(involved // 3)) + " (columns of P) and the bars between them"
    else:
        names = "bars " + ", ".join(str(k) for k in involved)
    return (
        f"the constraints of {names} depend on each other in the initial shape ({int(null.sum())} redundant, condition number "
        f"{float(values[-1]) / smallest:.1e}): motion is exact as long as they stay consistent, their multipliers are not unique; "
        "remove a bar or a pin to make them so"
    )

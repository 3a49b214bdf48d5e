"""Error thresholds of the acceptance test of runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.util.validate import Booleans


class Threshold(NamedTuple):
    """Relative errors at which a run is reported or fails.

    Attributes
    ----------
    reported : float
        Error above which the message reports it.
    failed : float
        Error above which the run fails.
    """

    reported: float
    failed: float


class Doubts(NamedTuple):
    """Reasons not to trust runs, after comparison with thresholds.

    Attributes
    ----------
    text : list of str
        Reasons, each after a semicolon.
    failed : ndarray of bool, shape (n,)
        Whether a run fails for one of its reasons.
    """

    text: list[str]
    failed: Booleans


# Errors of node positions are relative to the motion, of bars to their length, of the energy to the
# energy exchanged, of the start to lengths and speeds.
THRESHOLDS = {
    "position": Threshold(0.01, 0.1),
    "bars": Threshold(0.01, np.inf),
    "energy": Threshold(0.05, 0.5),
    "start": Threshold(1e-6, 0.2),
}
# rounding error of differences of state entries, relative to the largest entry
EPSILON = 64 * float(np.finfo(float).eps)

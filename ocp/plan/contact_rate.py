"""How fast a node on the ground vibrates: what the steps of a replay have to follow."""

from __future__ import annotations

import numpy as np

from tenscasadi.dynamics.model import Model

CONTACT_STEP = 0.25  # of this rate, in radians, in a step of a replay


def contact_rate(model: Model) -> float:
    """Return the rate, rad/s, of the lightest node on the hardest ground: of its spring, or of its damper where that is faster; 0: no ground.

    A linearisation at the start does not show it where nothing touches the ground yet.
    """
    lightest = max(float(np.max(inverse.diagonal())) for inverse in model.mechanism.inverse)  # 1/kg
    return max((max(np.sqrt(ground.stiffness * lightest), ground.damping * lightest) for ground in model.scene.grounds), default=0.0)

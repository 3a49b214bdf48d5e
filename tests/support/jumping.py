"""A prism of three bars on a ground with friction, and its jumps in phases."""

from __future__ import annotations

from functools import cache

import numpy as np

import ocp
import tenscasadi as tc

FEET = (0, 1, 2)
HEIGHT = 0.6


def low_prism():
    """Build a prism of 0.6 m height with bars of 1 m in equilibrium."""
    return tc.shapes.prism(
        3, np.sqrt(1 - HEIGHT**2) / (2 * np.sin(np.radians(75))), HEIGHT, bar_mass=0.3
    )


@cache
def standing(stiffness=1e4, damping=60.0, **ground):
    """Build the model of the prism on a ground."""
    surface = tc.Ground(
        **{
            "stiffness": stiffness,
            "damping": damping,
            "friction": 0.6,
            "slip_speed": 1e-2,
            **ground,
        }
    )
    return tc.Model(
        tc.Scene(low_prism(), control=tc.ForceDensity(), gravity=tc.Gravity(), ground=surface)
    )


def push(**changes):
    return ocp.Phase(**{"duration": (0.1, 0.5), "contact_nodes": FEET, **changes})


def flight(rise, **changes):
    goals = [ocp.CenterOfMass((None, None, HEIGHT / 2 + rise))]
    return ocp.Phase(**{"duration": (0.02, 0.5), "goals": goals, **changes})


def jumping(*phases, model=None, **changes):
    """Build a minimum-effort problem with given phases.

    Force densities are between 5 and 500 N/m.
    """
    given = {"bounds": [ocp.ForceDensityLimits(5.0, 500.0)], "costs": [ocp.Effort()], **changes}
    return ocp.Problem(standing() if model is None else model, phases=phases, **given)

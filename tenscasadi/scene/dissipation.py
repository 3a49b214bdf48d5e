"""Dissipation and external work in a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.util.casadi_tools import is_expression


def is_damped(scene: Any) -> bool:
    """Return whether any string has damping.

    Strings have none if the control prescribes forces.
    """
    if scene.commands_forces:
        return False
    damping = scene.modelled.damping
    return is_expression(damping) or scene.has_parameter("damping") or bool(np.any(damping > 0))


def has_friction(scene: Any) -> bool:
    """Return whether any contact has damping or friction, or any cable friction."""
    return (
        scene.has_parameter("ground_damping")
        or scene.has_parameter("bar_contact_damping")
        or any(not law.conservative for law in scene.contact_laws)
        or has_cable_friction(scene)
    )


def has_cable_friction(scene: Any) -> bool:
    """Return whether any cable has friction."""
    return bool(scene.structure.cable_friction.any())


def is_conservative(scene: Any) -> bool:
    """Return whether all forces are conservative under constant control."""
    driven = scene.commands_forces and len(scene.modelled.strings) > 0
    loaded = scene.pressure is not None or scene.forces is not None or bool(scene.over_time)
    driven = driven or bool(scene.internal_states)  # inputs do work
    return not (driven or is_damped(scene) or has_friction(scene) or loaded)

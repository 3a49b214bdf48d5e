"""Plans decide the force densities of strings, or the rest lengths of elastic ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.strings import ForceDensity, Linear, RestLength


def winds(model: Model) -> bool:
    """Tell whether rest lengths are the model's control, instead of force densities."""
    return isinstance(model.scene.control, RestLength)


def control_name(model: Model) -> str:
    """Return what the control of one string is called."""
    return "rest length" if winds(model) else "force density"


def pulled(model: Model) -> Model:
    """Return the same structure under force densities: what elastic strings could do at any moment."""
    return _changed(model, control=ForceDensity()) if winds(model) else model


def stretched(model: Model) -> Model:
    """Return the model of elastic strings without slack, which programs keep from pushing by limits: smooth, where `Clip` has a corner.

    A string that is slack in a plan is wound so that it just does not pull.
    """
    return (
        _changed(model, slack=Linear()) if winds(model) and model.scene.slack != Linear() else model
    )


def _changed(model: Model, **changes: Any) -> Model:
    """Return the model of a changed scene; the model keeps it, as its functions take time to build."""
    kept: dict[Any, Any] = model.functions
    key = "changed", tuple(changes)
    if key not in kept:
        kept[key] = Model(
            replace(model.scene, **changes),
            model.coordinates,
            "constant" if model.mechanism.constant_length else "current",
        )
    changed: Model = kept[key]
    return changed


def check_control(model: Model) -> None:
    """Refuse a model whose strings cannot be driven. Raises ValueError."""
    control = model.scene.control
    if not isinstance(control, (ForceDensity, RestLength)):
        raise ValueError(
            f"Problem.model has the control {control}: give a model of Scene(..., control=ForceDensity()) or RestLength()"
        )
    limp = np.flatnonzero(model.scene.structure.stiffness == 0)
    if winds(model) and limp.size:
        raise ValueError(
            f"Problem.model has string {limp[0]} without stiffness, which no rest length pulls: give Structure(stiffness=...)"
        )
    if model.nu == 0:
        raise ValueError("Problem.model has no strings: there is nothing to plan")


def refuse_wound(model: Model, user: str) -> None:
    """Refuse a model whose control is rest lengths, which `user` does not know. Raises ValueError."""
    if winds(model):
        raise ValueError(
            f"{user} is for force densities, and the model has control=RestLength(): give a model of Scene(..., control=ForceDensity())"
        )

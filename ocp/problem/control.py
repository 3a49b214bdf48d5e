"""Control of a plan: force densities, tensions or rest lengths."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tenscasadi.scene.strings import ForceDensity, Linear, RestLength, Tension
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import Array

if TYPE_CHECKING:
    from tenscasadi.dynamics.model import Model

# × damping: between mesh points, strings get longer faster than on average. Of eight plans with
# least force densities, 1.05 finds 7 in 60 s of CPU time, 1.5 all in 29 s.
TAUT_MARGIN = 1.5


def controls_force_densities(model: Model) -> bool:
    """Return whether the model is controlled by force densities."""
    return isinstance(model.scene.control, ForceDensity)


def controls_rest_lengths(model: Model) -> bool:
    """Return whether the model is controlled by rest lengths."""
    return isinstance(model.scene.control, RestLength)


def has_elastic_strings(model: Model) -> bool:
    """Return whether a string law determines the string forces.

    Otherwise the control prescribes force densities or tensions.
    """
    return not model.scene.commands_forces


def control_name(model: Model) -> str:
    """Return the name of the control, such as "rest length"."""
    control = model.scene.control
    return "" if control is None else control.name


def control_unit(model: Model) -> str:
    """Return the unit of the control variable."""
    control = model.scene.control
    return "" if control is None else control.unit


def build_force_density_model(model: Model) -> Model:
    """Build the same model with force densities as control.

    It has no cables, so that each string has its own force density.
    """
    if controls_force_densities(model):
        return model
    structure = model.scene.structure
    if not structure.cables:
        return _change(model, control=ForceDensity())
    lone = structure.replace(cables=(), cable_friction=0.0)
    return _change(model, control=ForceDensity(), structure=lone)


def build_force_model(model: Model) -> Model:
    """Build the same model with string forces as control.

    If force densities are the control already, the model is returned. Otherwise the control is the
    tension of each cable and of each string that is not part of a cable. Accelerations are linear
    in force densities and in tensions.
    """
    return model if model.scene.commands_forces else _change(model, control=Tension())


def build_locked_model(model: Model) -> Model:
    """Build the model with rest lengths as control, not states.

    Winches then do not turn.
    """
    control = model.scene.control
    return model if control is None or not model.na else _change(model, control=control.locked)


def build_smooth_model(model: Model) -> Model:
    """Build the model without slackening of elastic strings.

    A nonlinear program limits force densities to γ ≥ 0. The nonsmooth slack law is then not needed.
    """
    smooth = not has_elastic_strings(model) or model.scene.slack == Linear()
    return model if smooth else _change(model, slack=Linear())


def _change(model: Model, **changes: Any) -> Model:
    """Build the model with changed fields of its scene.

    It is cached in the given model, as its CasADi functions take time to build.
    """
    kinds = ((name, type(value)) for name, value in changes.items())
    return model.keep(
        ("changed", *kinds), lambda: model.with_scene(replace(model.scene, **changes))
    )


def slackening_damping(model: Model) -> Array:
    """Select the damping (α,) of elastic strings that can go slack [N s/m].

    With force density γ and length s, such a string stays taut if γ ≥ c ṡ/s. The values are 0 for
    strings that cannot go slack on their own, such as those of a cable.
    """
    scene, of = model.scene, model.scene.structure.cable_of
    damping = np.asarray(scene.structure.damping) * has_elastic_strings(model)
    damping[np.bincount(of)[of] > 1] = 0.0
    for law, which in scene.string_laws:
        if law.pushes:
            damping[scene.modelled.string_parent[which]] = 0.0
    return damping


def check_control(model: Model) -> None:
    """Raise ValueError if the strings cannot be controlled."""
    control = model.scene.control
    if control is None:
        raise add_address(
            ValueError(
                f"Problem.model has the control {control}: give a model of Scene(..., control=ForceDensity()), "
                "Tension(), RestLength(), RestLengthRate() or Winch(...)"
            )
        )
    limp = np.flatnonzero(model.scene.structure.stiffness == 0)
    if has_elastic_strings(model) and limp.size:
        raise ValueError(
            f"Problem.model has string {limp[0]} without stiffness, which no rest length pulls: give Structure(stiffness=...)"
        )
    if model.nu == 0:
        raise ValueError("Problem.model has no strings: there is nothing to plan")


def reject_coupled_rates(model: Model, user: str) -> None:
    """Raise ValueError if rates of internal states depend on others.

    Internal states are for example rest lengths of winches. `user` names the method that cannot
    treat such models.
    """
    if model.has_coupled_rates:
        raise ValueError(
            f"{user} takes no model with control={type(model.scene.control).__name__}(...): "
            "give MultipleShooting() or DirectCollocation()"
        )


def require_force_densities(model: Model, user: str) -> None:
    """Raise ValueError unless force densities are the control.

    `user` names the method that needs them, for the message.
    """
    if not controls_force_densities(model):
        raise ValueError(
            f"{user} is for force densities, and the model has control={model.scene.control}: give a model of Scene(..., control=ForceDensity())"
        )

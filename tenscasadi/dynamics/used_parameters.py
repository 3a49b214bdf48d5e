"""Check that every parameter affects the motion."""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca

from tenscasadi.scene.strings import ForceDensity, RestLength

_BY_CONTROL: dict[type, tuple[tuple[str, ...], str]] = {
    ForceDensity: (("stiffness", "rest_length"), "force densities"),
    RestLength: (("rest_length",), "rest lengths"),
}


def check_parameters(model: Any) -> None:
    """Reject parameters without effect.

    Warns of parameters that only set the default control. Raises ValueError for others.
    """
    unused = _unused(model)
    inside, commanded = _BY_CONTROL.get(type(model.scene.control), ((), ""))
    for name in unused:
        if name not in inside:
            raise ValueError(
                f"Parameters has {name!r}, on which no motion of this scene depends{_reason(model.scene, name)}: leave the name out"
            )
    for name in unused:
        warnings.warn(
            f"Parameters has {name!r}, which sets the default control alone: under {model.scene.control} {commanded} are commanded, and motions "
            "under a control that is given do not depend on it",
            UserWarning,
            stacklevel=3,
        )


def _unused(model: Any) -> list[str]:
    """Find the quantities that do not enter the ode."""
    places = model.parameters.places
    x, u, one = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu), ca.MX.sym("one", len(places))
    p = ca.vertcat(
        *(ca.repmat(one[k], place.stop - place.start, 1) for k, place in enumerate(places.values()))
    )
    by_quantity = ca.Function("by_quantity", [x, u, one], [model.ode(x, u, p)]).jac_sparsity(0, 2)
    used = set(by_quantity.get_triplet()[1])
    return [name for k, name in enumerate(places) if k not in used]


def _reason(scene: Any, name: str) -> str:
    if isinstance(scene.control, ForceDensity) and name == "damping":
        return f" (under {scene.control} force densities are commanded)"
    return " (strings have mass where segments= cuts them)" if name == "string_mass" else ""

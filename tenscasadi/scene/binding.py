"""Substitution of parameters in the fields of a scene."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.internal_states import InternalStates
from tenscasadi.scene.quantities import BODIES, ELASTIC_BARS, QUANTITIES, build_inertia
from tenscasadi.scene.strength import declare_strength
from tenscasadi.structure.cables import add_compliances
from tenscasadi.util.casadi_tools import is_expression
from tenscasadi.util.validate import Array

Value = TypeVar("Value")

_LOADS = ("gravity", "pressure", "forces")


def with_fields(value: Value, **fields: Any) -> Value:
    """Copy a frozen object with other field values, without checks.

    The values can be CasADi expressions.
    """
    new = copy.copy(value)
    vars(new).update(fields)
    return new


def bind(scene: Any, w: Any) -> tuple[Any, Any, Any]:
    """Replace constants of a scene by expressions of the parameters.

    Parameters
    ----------
    scene : Scene
        The scene.
    w : casadi column, shape (nu + np + na,)
        Control, followed by the parameters and the internal states.

    Returns
    -------
    tuple
        Scene without parameters, the control (nu,) and the internal states (na,). Quantities of the
        modeled strings are rows 1×α, or 1×1 if they are equal.
    """
    known = scene.nu + len(scene.layout)
    internal = w[known:] if scene.internal_states else ca.DM(0, 1)
    if scene.parameters is None:
        return scene, w[: scene.nu] if scene.internal_states else w, internal
    p, items, s = w[scene.nu : known], scene.layout.quantities, scene.modelled
    changes: dict[str, Any] = {"parameters": None}
    own, count = {}, len(s.string_parent)
    for name in items.keys() & {"stiffness", "damping", "rest_length"}:
        if name == "rest_length" and sets_rest_lengths(scene):
            continue
        share = s.string_fraction if name == "rest_length" else 1 / s.string_fraction
        segments = np.arange(count), s.string_parent
        onto_segments = sp.csr_array((share, segments), shape=(count, len(items[name].constant)))
        own[name] = items[name].then(onto_segments).expression(p).T
    own |= {name: items[name].expression(p).T for name in items.keys() & set(ELASTIC_BARS)}
    if own:
        changes["modelled"] = with_fields(s, **own)
    on_grounds = {
        name.removeprefix("ground_"): affine.expression(p, full=True)
        for name, affine in items.items()
        if name.startswith("ground_")
    }
    if on_grounds:
        changes["ground"] = tuple(
            with_fields(ground, **_own_entries(ground, k, on_grounds))
            for k, ground in enumerate(scene.grounds)
        )
    touching = {
        name.removeprefix("bar_contact_"): affine.expression(p, full=True)
        for name, affine in items.items()
        if name.startswith("bar_contact_")
    }
    if touching:
        changes["bar_contact"] = with_fields(scene.bar_contact, **touching)
    for name in items.keys() & set(_LOADS):
        load, value = getattr(scene, name), items[name].expression(p, full=True)
        if name in scene.parameters.scale:
            changes[name] = with_fields(load, factor=value)
        else:
            size = 1 if name == "pressure" else 3
            rows = ca.reshape(value, size, value.shape[0] // size).T
            changes[name] = with_fields(load, **{load.quantity_name: rows})
    return with_fields(scene, **changes), w[: scene.nu], internal


def sets_rest_lengths(scene: Any) -> bool:
    """Return whether the control determines rest lengths.

    It prescribes them, or their rates of change.
    """
    return scene.control is not None and scene.control.sets_rest_lengths


def initial_control(scene: Any, p: Array) -> Array:
    """Compute the control (nu,) in the initial state.

    The control consists of the rest lengths [m] of the structure, or of the corresponding force
    densities [N/m] or tensions [N], or it keeps winches at rest. p (np,) are the parameters.
    """
    s, layout = scene.structure, scene.layout
    if scene.control is None:
        return np.zeros(0)
    stiffness, rest = (
        layout.item_values(name, p, getattr(s, name)) for name in ("stiffness", "rest_length")
    )
    if scene.control.commands_densities:
        return np.asarray(stiffness * np.maximum(0.0, 1 - rest / s.string_lengths))  # Eq. 99
    total = np.asarray(np.bincount(s.cable_of, weights=rest), dtype=float)
    lengths = np.bincount(s.cable_of, weights=s.string_lengths)
    stiffness = add_compliances(s.cable_of, stiffness)
    return scene.control.initial_inputs(  # type: ignore[no-any-return]
        total, np.asarray(stiffness * np.maximum(0.0, lengths - total))
    )


def declare_internal_states(scene: Any, p: Array) -> tuple[InternalStates, ...]:
    """List the internal states of a scene.

    They are states besides positions and velocities, such as rest lengths of winches. p (np,) are
    the parameters, which affect their initial values.
    """
    if scene.control is None:
        return declare_strength(scene)
    s = scene.structure
    rest = scene.layout.item_values("rest_length", p, s.rest_length)
    total = np.asarray(np.bincount(s.cable_of, weights=rest), dtype=float)
    return (*scene.control.internal_states(total), *declare_strength(scene))


def fix(scene: Any, p: Array) -> Any:
    """Replace the parameters of a scene by constants.

    p (np,) are the values.
    """
    if scene.parameters is None:
        return scene
    items = {name: affine.numbers(p) for name, affine in scene.layout.quantities.items()}
    own = {name: value for name, value in items.items() if QUANTITIES[name].part == "structure"}
    for name in own.keys() & set(ELASTIC_BARS):  # rigid bars have none
        own[name] = np.where(scene.structure.elastic, own[name], getattr(scene.structure, name))
    if bodies := own.keys() & set(BODIES):
        mass, inertia = (own.pop(name) if name in bodies else None for name in BODIES)
        own["bodies"] = _fix_bodies(scene.structure.bodies, mass, inertia)
    changes: dict[str, Any] = {"parameters": None, "structure": scene.structure.replace(**own)}
    on_grounds = {
        name.removeprefix("ground_"): values
        for name, values in items.items()
        if name.startswith("ground_")
    }
    if on_grounds:
        changes["ground"] = tuple(
            _fix_contact(ground, _own_entries(ground, k, on_grounds))
            for k, ground in enumerate(scene.grounds)
        )
    touching = {
        name.removeprefix("bar_contact_"): values[0]
        for name, values in items.items()
        if name.startswith("bar_contact_")
    }
    if touching:
        changes["bar_contact"] = _fix_contact(scene.bar_contact, touching)
    for name in items.keys() & set(_LOADS):
        load, value = getattr(scene, name), items[name]
        if name in scene.parameters.scale:
            scaled = partial(_scale, load.quantity, float(value[0]))
            value = scaled if load.is_function else float(value[0]) * np.asarray(load.quantity)
        else:
            value = value.reshape(np.shape(load.quantity))
        changes[name] = replace(load, **{load.quantity_name: value})
    return replace(scene, **changes)


def _fix_bodies(bodies: Any, mass: Array | None, moments: Array | None) -> list[Any]:
    """Copy bodies with other masses and inertia.

    `mass` (k,) [kg] are those of the k bodies, and `moments` (6k,) [kg m²] their inertia, six
    entries each (xx, yy, zz, xy, xz, yz). None: unchanged.
    """
    found = list(bodies)
    if mass is not None:
        found = [replace(body, mass=float(m)) for body, m in zip(found, mass, strict=True)]
    if moments is not None:
        own = build_inertia(moments.reshape(-1, 6))
        found = [replace(body, inertia=each) for body, each in zip(found, own, strict=True)]
    return found


def _own_entries(ground: Any, k: int, values: dict[str, Any]) -> dict[str, Any]:
    """Select the parameter values that belong to ground number k.

    `values` has an array with one entry for each ground, by the name of a field. Fields that the
    ground does not use are omitted.
    """
    given = {name: value for name, value in values.items() if getattr(ground, name) is not None}
    return {name: value[k] for name, value in given.items()}


def _fix_contact(law: Any, values: dict[str, Any]) -> Any:
    numbers: dict[str, Any] = {name: float(value) for name, value in values.items()}
    if numbers.get("friction") == 0:  # no friction at all
        numbers["friction"] = None
    return replace(law, **numbers)


def _scale(function: Any, factor: float, time: Any) -> Any:
    """Multiply the result of a function of time by a factor.

    The result can be a nested sequence.
    """
    return _multiply(function(time), factor)


def _multiply(value: Any, factor: float) -> Any:
    if isinstance(value, Iterable) and not is_expression(value):
        return [_multiply(part, factor) for part in value]
    return factor * value

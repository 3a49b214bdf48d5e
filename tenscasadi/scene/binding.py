"""A scene whose constants are expressions of its parameters: what force laws read in place of numbers."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, TypeVar

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.parameters import QUANTITIES
from tenscasadi.scene.strings import RestLength
from tenscasadi.util.casadi_tools import is_expression
from tenscasadi.util.validate import Array

Value = TypeVar("Value")


def with_fields(value: Value, **fields: Any) -> Value:
    """Return a copy of a frozen value in which some fields are other ones, which are not checked: expressions of CasADi's in place of numbers."""
    new = copy.copy(value)
    for name, field in fields.items():
        object.__setattr__(new, name, field)
    return new


def bind(scene: Any, w: Any) -> tuple[Any, Any]:
    """Return the scene with expressions of the parameters in w = (u, p) as its constants, and the control u; itself and w where it has none.

    Strings' quantities are then rows (1×α, or 1×1) of the modelled strings. The scene that comes
    back has no parameters left.
    """
    if scene.parameters is None:
        return scene, w
    nu, layout = scene.nu, scene.layout
    p = w[nu:]
    changes: dict[str, Any] = {"parameters": None}
    items = layout.quantities
    s = scene.modelled
    own, fraction, parent = {}, s.string_fraction, s.string_parent
    for name in items.keys() & {"stiffness", "damping", "rest_length"} - (
        {"rest_length"} if isinstance(scene.control, RestLength) else set()
    ):
        share = fraction if name == "rest_length" else 1 / fraction
        onto_segments = sp.csr_array(
            (share, (np.arange(len(parent)), parent)),
            shape=(len(parent), len(items[name].constant)),
        )
        own[name] = items[name].then(onto_segments).expression(p).T
    if own:
        changes["modelled"] = _with_attributes(s, own)
    on_grounds = {
        name.removeprefix("ground_"): _column(affine, p)
        for name, affine in items.items()
        if name.startswith("ground_")
    }
    if on_grounds:
        changes["ground"] = tuple(
            _bind_ground(ground, k, on_grounds) for k, ground in enumerate(scene.grounds)
        )
    for name in items.keys() & {"gravity", "pressure", "forces"}:
        load, value = getattr(scene, name), _column(items[name], p)
        if name in scene.parameters.scale:
            changes[name] = with_fields(load, factor=value)
        else:
            size = 1 if name == "pressure" else 3
            rows = ca.reshape(value, size, value.shape[0] // size).T
            changes[name] = with_fields(load, **{load.quantity_name: rows})
    return with_fields(scene, **changes), w[:nu]


def _bind_ground(ground: Any, k: int, values: dict[str, Any]) -> Any:
    """Return ground k with its entries of `values` (grounds×1); one that has been made frictionless stays so."""
    return with_fields(
        ground,
        **{
            name: value[k]
            for name, value in values.items()
            if getattr(ground, name, None) is not None
        },
    )


def _column(affine: Any, p: Any) -> Any:
    value = affine.expression(p)
    return (
        value
        if value.shape[0] == len(affine.constant)
        else ca.repmat(value, len(affine.constant), 1)
    )


def _with_attributes(structure: Any, attributes: dict[str, Any]) -> Any:
    new = copy.copy(structure)
    new.__dict__.update(attributes)
    return new


def fix(scene: Any, p: Array) -> Any:
    """Return the scene without parameters whose constants are those of p (np,), which is checked."""
    if scene.parameters is None:
        return scene
    items = {name: affine.numbers(p) for name, affine in scene.layout.quantities.items()}
    structure = {
        name: values for name, values in items.items() if QUANTITIES[name].part == "structure"
    }
    changes: dict[str, Any] = {
        "parameters": None,
        "structure": scene.structure.replace(**structure),
    }
    on_grounds = {
        name.removeprefix("ground_"): values
        for name, values in items.items()
        if name.startswith("ground_")
    }
    if on_grounds:
        each = [
            {name: float(values[k]) for name, values in on_grounds.items()}
            for k in range(len(scene.grounds))
        ]
        changes["ground"] = tuple(
            replace(
                ground, **values | ({} if values.get("friction", 1.0) else {"friction": None})
            )  # no friction at all is None
            for ground, values in zip(scene.grounds, each, strict=True)
        )
    for name in items.keys() & {"gravity", "pressure", "forces"}:
        load = getattr(scene, name)
        if name in scene.parameters.scale:
            factor = float(items[name][0])
            changed = (
                _ScaledFunction(load.quantity, factor)
                if load.is_function
                else factor * np.asarray(load.quantity)
            )
            changes[name] = replace(load, **{load.quantity_name: changed})
        else:
            changes[name] = replace(
                load, **{load.quantity_name: items[name].reshape(np.shape(load.quantity))}
            )
    return replace(scene, **changes)


class _ScaledFunction:
    """A function of time times a factor."""

    def __init__(self, function: Any, factor: float) -> None:
        self._function, self._factor = function, factor

    def __call__(self, time: Any) -> Any:
        return self._times(self._function(time))

    def _times(self, value: Any) -> Any:
        if isinstance(value, Iterable) and not is_expression(value):
            return [self._times(part) for part in value]
        return self._factor * value

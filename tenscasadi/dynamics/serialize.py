"""Conversion of models to named arrays, and back.

Functions of time cannot be stored.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Ground, Surface, Terrain
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.over_time import OverTime, read_sample
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, Linear, RestLength, Smooth, StringLaw
from tenscasadi.structure.class_one import Layout
from tenscasadi.structure.structure import PARAMETERS, Structure
from tenscasadi.util.archive import Fields
from tenscasadi.util.validate import Array, Indices, finite_array

Content = Mapping[str, Any]

_MEMBERS = [
    name for name in PARAMETERS if name not in ("pinned", "rollers") and "_names" not in name
]
_GROUND = list(dict.fromkeys(field.name for kind in (Ground, Terrain) for field in fields(kind)))
_LAYOUT = [name for name in Layout._fields if name != "P"]
_INDICES = "bars strings string_parent layout.physical layout.bar_columns layout.string_columns layout.tied segments pressure.faces supports.nodes"
_MORE_INDICES = ["grounds", "ground.nodes", "rollers.nodes", "forces.bars"]
_TEXTS = dict.fromkeys(["ends", "functions", "slack.laws", "parameters"], "U")
_KINDS = (
    dict.fromkeys([*_INDICES.split(), *_MORE_INDICES], "i") | {"fixed": "b"} | _TEXTS
)  # NumPy's kinds; all others are real numbers
_DIMENSIONS = {"fixed": 2, "bars": 2, "strings": 2, "layout.physical": 1, "layout.tied": 0}
_LATER = (
    "grounds",
    "slack.laws",
    "gravity.times",
    "pressure.times",
    "forces.bars",
    "parameters",
)  # fields of a scene that files of version 0.1 lack
_CONTROLS = {type(control).__name__: control for control in (ForceDensity(), RestLength(), None)}
_NOTHING = np.zeros(0)  # represents None


def structure_to_arrays(structure: Structure) -> dict[str, Array]:
    """Convert a structure to named arrays.

    They include the results of `subdivide` and `from_matrices`.
    """
    layout = structure._layout
    ties = layout.P.tocoo()
    content = {
        name: getattr(structure, name)
        for name in (*_MEMBERS, "fixed", "string_parent", "string_fraction")
    }
    content |= {"rollers": [normal for normals in structure.rollers.values() for normal in normals]}
    content |= {
        "rollers.nodes": [node for node, normals in structure.rollers.items() for _ in normals]
    }
    content |= {f"layout.{name}": getattr(layout, name) for name in _LAYOUT}
    content |= {
        "layout.ties": np.column_stack([*ties.coords, ties.data]),
        "layout.tied": np.asarray(layout.P.shape[1]),
    }
    return {f"structure.{name}": np.asarray(value) for name, value in content.items()}


def structure_from_arrays(content: Content) -> Structure:
    """Restore the structure of `structure_to_arrays`. Raises ValueError.

    Old files without a layout have the default one.
    """
    given = _checked(Fields(content).within("structure."))
    pinned = {
        int(node): "".join(np.array(list("xyz"))[axes])
        for node, axes in enumerate(given["fixed"])
        if axes.any()
    }
    rollers: dict[int, list[Array]] = {}
    for node, normal in zip(
        given.get("rollers.nodes", _NOTHING).ravel().tolist(),
        np.atleast_1d(given.get("rollers", _NOTHING)),
        strict=True,
    ):
        rollers.setdefault(node, []).append(normal)
    structure = Structure(
        **{name: given[name] for name in _MEMBERS}, pinned=pinned, rollers=rollers
    )
    if "layout.ties" not in given:
        return structure
    bars, strings, columns = (
        len(structure.bars),
        len(structure.strings),
        len(given["layout.physical"]),
    )
    row, column, value = finite_array("layout.ties", given["layout.ties"], (None, 3)).T
    P = csr_array(
        (value, (row.astype(np.intp), column.astype(np.intp))),
        shape=(columns, int(given["layout.tied"])),
    )
    layout = Layout(
        _indices("layout.physical", given, (columns,), len(structure.nodes)),
        _indices("layout.bar_columns", given, (bars, 2), columns),
        _indices("layout.string_columns", given, (strings, 2), columns),
        finite_array("layout.mass_share", given["layout.mass_share"], (columns,)),
        P,
    )
    fraction = finite_array("string_fraction", given["string_fraction"], (strings,))
    return structure._derived(
        string_parent=_indices("string_parent", given, (strings,), strings),
        string_fraction=fraction,
        _layout=layout,
    )


def model_to_arrays(model: Model, times: Array) -> dict[str, Array]:
    """Convert a model to named arrays.

    Functions of time are sampled at `times` (K,) [s].
    """
    scene = model.scene
    gravity, pressure, forces, supports = (
        scene.gravity,
        scene.pressure,
        scene.forces,
        scene.supports,
    )
    nodes = len(scene.structure.nodes)
    loads = {
        **_load_to_arrays("gravity", gravity, (3,), times),
        **_load_to_arrays("pressure", pressure, (), times),
        **_load_to_arrays("forces", forces, (nodes, 3), times),
        "forces.bars": forces and list((forces.bars or {}).items()),
    }
    called = {
        "gravity": gravity and gravity.is_function,
        "pressure": pressure and pressure.is_function,
        "forces": forces and forces.is_function,
    }
    functions = [name for name, given in (called | {"supports": supports}).items() if given]
    content: dict[str, Any] = {
        "functions": np.asarray(functions, dtype=str),
        "clock": times if functions else None,
        "segments": scene.segments,
        "ends": scene.ends,
        "fractions": scene.fractions,
        "slack": [scene.slack.width] if isinstance(scene.slack, Smooth) else None,
        "slack.laws": _laws_to_array(scene),
        **loads,
        "grounds": len(scene.grounds),
        **_ground_to_arrays("ground", None),
        **{
            name: value
            for k, ground in enumerate(scene.grounds)
            for name, value in _ground_to_arrays(f"ground{k or ''}", ground).items()
        },
        "pressure.faces": pressure and np.reshape(pressure.faces, (-1, 3)),
        "supports": supports
        and [rates(t)[0].full() for rates in [supports.rates()] for t in times],
        "supports.nodes": supports and supports.nodes,
        "parameters": scene.parameters and _parameters_to_text(scene.parameters),
    }
    told = {
        f"scene.{name}": _NOTHING if value is None else np.asarray(value)
        for name, value in content.items()
    }
    own = {
        "model.coordinates": model.coordinates,
        "model.bar_length": "constant" if model.mechanism.constant_length else "current",
    }
    own |= {"model.control": type(scene.control).__name__}
    return (
        structure_to_arrays(scene.structure)
        | told
        | {name: np.asarray(value) for name, value in own.items()}
    )


def model_from_arrays(content: Content) -> Model | None:
    """Restore the model of `model_to_arrays`. Raises ValueError.

    Older files have force-density control. Returns None if there are functions of time, or no
    model.
    """
    if "model.coordinates" not in content or content["scene.functions"].size:
        return None
    told = _checked(Fields(content).within("scene."))
    for name in (
        _LATER if any(name in told for name in _LATER) else ()
    ):  # a file with a missing field must not count as an older one
        told[name]

    def some(name: str, build: Callable[[Any], Any]) -> Any:
        return (
            build(told[name]) if (name not in _LATER or name in told) and told[name].size else None
        )

    control = str(content.get("model.control", "ForceDensity"))
    if control not in _CONTROLS:
        raise ValueError(f"field 'model.control' is {control!r}")
    scene = Scene(
        structure_from_arrays(content),
        control=_CONTROLS[control],
        segments=told["segments"].tolist(),
        ends=told["ends"].item(),
        fractions=some("fractions", np.ndarray.tolist),
        gravity=some("gravity", lambda values: Gravity(values, some("gravity.times", np.asarray))),
        ground=_grounds_from_arrays(told),
        pressure=some(
            "pressure",
            lambda values: _pressure(
                told["pressure.faces"].tolist(), values, some("pressure.times", np.asarray)
            ),
        ),
        forces=some(
            "forces",
            lambda values: NodalForce(
                values,
                some("forces.times", np.asarray),
                bars=some("forces.bars", lambda pairs: dict(pairs.reshape(-1, 2).tolist())),
            ),
        ),
        parameters=_parameters_from_text(told["parameters"].tolist())
        if told.get("parameters", _NOTHING).size
        else None,
        slack=some("slack.laws", _laws_from_array)
        or some("slack", lambda width: Smooth(width.item()))
        or Clip(),
    )
    return Model(scene, content["model.coordinates"].item(), content["model.bar_length"].item())


def find_differences(content: Content, model: Model) -> list[str]:
    """List fields in which a model differs from stored arrays.

    An example is "Structure.bar_mass". Fields that older files lack are ignored.
    """
    own = model_to_arrays(model, content.get("scene.clock", _NOTHING))
    told = own.keys() & content.keys() - {"scene.clock", "scene.functions"}
    return [
        name[0].upper() + name[1:]
        for name in own
        if name in told and not _same(content[name], own[name])
    ]


def _parameters_to_text(parameters: Parameters) -> list[str]:
    groups = [
        f"groups {name} " + (" ".join(",".join(map(str, group)) for group in groups) or "all")
        for name, groups in parameters.groups
    ]
    return [
        *(f"name {name}" for name in parameters.names),
        *(f"scale {name}" for name in parameters.scale),
        *groups,
    ]


def _parameters_from_text(lines: list[str]) -> Parameters:
    said: dict[str, dict[str, Any]] = {"name": {}, "scale": {}, "groups": {}}
    for line in lines:
        what, name, *rest = line.split(" ")
        if what not in said:
            raise ValueError(f"field 'parameters' has {line!r}")
        said[what][name] = (
            "all"
            if rest == ["all"]
            else [[int(index) for index in group.split(",")] for group in rest]
        )
    return Parameters(*said["name"], scale=said["scale"], groups=said["groups"])


def _checked(given: Fields) -> Fields:
    """Check the types of all fields. Raises ValueError."""
    for name, value in given.items():
        if value.shape != _NOTHING.shape or name in _DIMENSIONS:
            known = re.sub(r"^ground\d+\.", "ground.", name)
            given.array(name, _KINDS.get(known, "fi"), _DIMENSIONS.get(known))
    return given


def _ground_to_arrays(prefix: str, ground: Surface | None) -> dict[str, Any]:
    values = {name: getattr(ground, name, None) for name in _GROUND}
    if ground is not None and ground.friction is None:
        values["friction"] = np.nan
    return {f"{prefix}.{name}": value for name, value in values.items()}


def _grounds_from_arrays(told: Fields) -> list[Surface]:
    """Restore the grounds; older files have at most one."""
    grounds: list[Surface] = []
    for k in range(
        told["grounds"].item() if "grounds" in told else int(told["ground.stiffness"].size > 0)
    ):
        names = {name: f"ground{k or ''}.{name}" for name in _GROUND}
        given: dict[str, Any] = {
            name: told[key]
            for name, key in names.items()
            if name == "stiffness" or (key in told and told[key].size)
        }
        if np.isnan(given.get("friction", 0.0)):
            del given["friction"]
        if "nodes" in given:
            given["nodes"] = given["nodes"].ravel().tolist()
        grounds.append(Terrain(**given) if "heights" in given else Ground(**given))
    return grounds


def _indices(name: str, given: Content, shape: tuple[int, ...], count: int) -> Indices:
    value = given[name]
    if value.dtype.kind != "i" or value.shape != shape or np.any((value < 0) | (value >= count)):
        raise ValueError(f"field {name!r} does not hold indices below {count} in the shape {shape}")
    return np.asarray(value)


def _laws_to_array(scene: Scene) -> list[str] | None:
    """Convert the law of each string to text.

    Returns None if one law that older files support applies to all strings.
    """
    laws = (
        (scene.slack,) * len(scene.structure.strings)
        if isinstance(scene.slack, StringLaw)
        else tuple(scene.slack)
    )
    if isinstance(scene.slack, Smooth) or scene.slack == Clip():
        return None
    return [
        " ".join([type(law).__name__, *(str(value) for value in vars(law).values())])
        for law in laws
    ]


def _laws_from_array(told: Array) -> tuple[StringLaw, ...]:
    laws: list[StringLaw] = []
    for text in told.tolist():
        name, *given = text.split()
        if (name, len(given)) == ("Smooth", 1):
            laws.append(Smooth(float(given[0])))
        elif (name, len(given)) == ("Clip", 1):
            laws.append(Clip(given[0]))
        elif (name, len(given)) == ("Linear", 0):
            laws.append(Linear())
        else:
            raise ValueError(f"field 'slack.laws' holds {text!r}, which names no law of a string")
    return tuple(laws)


def _pressure(faces: Any, values: Array, times: Array | None) -> Pressure:
    return Pressure(faces, values.item()) if times is None else Pressure(faces, values, times)


def _load_to_arrays(
    name: str, load: OverTime | None, shape: tuple[int, ...], times: Array
) -> dict[str, Any]:
    """Sample a load at `times` (K,).

    The result includes the times of its table.
    """
    if load is None:
        return {name: None, f"{name}.times": None}
    values = load.quantity
    if load.is_function:
        values = [read_sample(f"{load.field}({t:g})", values(float(t)), shape) for t in times]
    return {name: np.atleast_1d(values), f"{name}.times": load.times}


def _same(one: Any, other: Any) -> bool:
    if one.shape != other.shape or one.dtype.kind != other.dtype.kind:
        return False
    if one.dtype.kind != "f":
        return bool(np.array_equal(one, other))
    return bool(
        np.allclose(
            one,
            other,
            rtol=1e-9,
            atol=1e-9 * np.abs(other[np.isfinite(other)]).max(initial=0.0),
            equal_nan=True,
        )
    )

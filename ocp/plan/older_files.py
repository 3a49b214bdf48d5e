"""Reader of plan files of version 0.1.

They hold models as named arrays.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ocp.io.plan_section import read_solution
from tenscasadi.scene.control import Control
from tenscasadi.scene.ground import Ground, Surface
from tenscasadi.scene.interpolants import Samples
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, Linear, Smooth, StringLaw
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.scene.terrain import Terrain
from tenscasadi.schema.reading import Document
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.structure import PARAMETERS, Structure
from tenscasadi.util.archive import Fields

_LAWS: Mapping[str, Any] = {
    "Smooth": lambda width: Smooth(float(width)),
    "Clip": Clip,
    "Linear": Linear,
}


def upgrade(content: Fields, trajectory: Trajectory) -> dict[str, Any]:
    """Convert a file of version 0.1 to plan fields.

    `content` are the arrays of the file, `trajectory` is the motion in it. The fields are
    structure, model, problem, transcription and solver. The model is None if the file has none, or
    if its scene has functions of time. Raises ValueError for damaged content.
    """
    none = dict.fromkeys(("model", "problem", "transcription", "solver"))
    unknown = {"not_restored": "its file is of an older version"}
    try:
        structure = read_structure(content)
        if "model.coordinates" not in content:
            return {**none, **unknown, "structure": structure}
        scene = _read_scene(content.within("scene."), structure, content)
        sampled = tuple(content["scene.functions"].tolist())
        own = {"trajectory": replace(trajectory, scene=scene, sampled=sampled)}
        if sampled:
            return {**none, **unknown, "structure": structure, **own}
        table = {name: content[f"model.{name}"].item() for name in ("coordinates", "bar_length")}
        solved = _read_solved(str(content.get("solved", "{}")))
        table |= solved.pop("problem", {})
        left_out = {} if "duration" in table else {"problem": unknown["not_restored"]}
        item = Document("solved", {"plan": table | solved}).root.child("plan")
        return {"not_restored": "", **own, **read_solution(scene, item, left_out)}
    except (TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        raise ValueError(f"its scene is damaged ({error})") from None


def _read_solved(text: str) -> dict[str, Any]:
    """Parse the JSON text of problem, transcription and solver.

    The result is {} if the text is not JSON.
    """
    try:
        parts = json.loads(text)
        return {name: tree for name, own in parts.items() if (tree := _convert(own)) is not None}
    except (ValueError, AttributeError):
        return {}


def _convert(tree: Any) -> Any:
    """Convert a parsed JSON value to scene-file format.

    Returns None for functions.
    """
    if not isinstance(tree, dict):
        return tree
    (form, content), *_ = tree.items()
    if form == "array":
        return np.reshape(content, tree["shape"]).tolist()
    if form in ("list", "tuple"):
        return ["free" if entry is None else _convert(entry) for entry in content]
    if form not in ("class", "mapping"):  # functions
        return None
    pairs = tree["fields"].items() if form == "class" else content
    table = {str(key): own for key, value in pairs if (own := _convert(value)) is not None}
    return {"kind": content.partition(" ")[0], **table} if form == "class" else table


def read_structure(content: Fields) -> Structure:
    """Restore a structure from the arrays of a file.

    Raises ValueError, TypeError.
    """
    told = content.within("structure.")
    given = {name: told[name] for name in PARAMETERS if name in told and name != "rollers"}
    axes = np.array(list("xyz"))
    fixed = told.array("fixed", "b", 2)
    given["pinned"] = {k: "".join(axes[own]) for k, own in enumerate(fixed) if own.any()}
    rollers: dict[int, list[Any]] = {}
    nodes = told.get("rollers.nodes", np.zeros(0)).ravel()
    for node, normal in zip(nodes.tolist(), told.get("rollers", []), strict=True):
        rollers.setdefault(int(node), []).append(normal)
    derived = {}
    if "layout.ties" in told:
        derived = {name: told[name] for name in ("string_parent", "string_fraction")}
        layout = told.within("layout.")
        layout.pop("tied")
        derived |= layout
    return Structure.from_fields(**given, rollers=rollers, derived=derived)


def _read_scene(told: Fields, structure: Structure, content: Fields) -> Scene:
    functions = told["functions"].tolist()

    def get(name: str) -> Any:
        value = told.get(name, np.zeros(0))
        return value if value.size else None

    def load(kind: Any, name: str, *first: Any, **more: Any) -> Any:
        times = get("clock") if name in functions else get(f"{name}.times")
        value = get(name)
        if value is None:
            return None
        plain = value.item() if name == "pressure" and times is None else value
        return kind(*first, plain, times=times, **more)

    faces, bars, nodes = get("pressure.faces"), get("forces.bars"), get("supports.nodes")
    control = str(content.get("model.control", "ForceDensity"))
    motions = {} if nodes is None else dict(zip(nodes.tolist(), told["supports"].T, strict=True))
    positions = {node: Samples(get("clock"), rows.T) for node, rows in motions.items()}
    laws = get("slack.laws")
    return Scene(
        structure,
        control=None if control == "NoneType" else Control.members[control](),
        segments=told["segments"].tolist(),
        ends=told["ends"].item(),
        fractions=None if get("fractions") is None else told["fractions"].tolist(),
        gravity=load(Gravity, "gravity"),
        ground=_read_grounds(told),
        pressure=load(Pressure, "pressure", None if faces is None else faces.tolist()),
        forces=load(
            NodalForce,
            "forces",
            bars=None if bars is None else dict(bars.reshape(-1, 2).tolist()),
        ),
        supports=SupportMotion(positions) if positions else None,
        parameters=None if get("parameters") is None else _read_parameters(told["parameters"]),
        slack=_read_law(get("slack")) if laws is None else [_read_law(law) for law in laws],
    )


def _read_law(given: Any) -> StringLaw:
    if not isinstance(given, str):
        return Clip() if given is None else Smooth(given.item())
    name, *options = given.split()
    return _LAWS[name](*options)  # type: ignore[no-any-return]


def _read_grounds(told: Fields) -> list[Surface]:
    one = int(told["ground.stiffness"].size > 0)
    grounds: list[Surface] = []
    for k in range(int(told.get("grounds", one))):
        own = told.within(f"ground{k or ''}.")
        given = {name: value for name, value in own.items() if value.size and "." not in name}
        if np.isnan(given.get("friction", 0.0)):
            del given["friction"]
        if "nodes" in given:
            given["nodes"] = given["nodes"].ravel().tolist()
        grounds.append((Terrain if "heights" in given else Ground)(**given))
    return grounds


def _read_parameters(told: Any) -> Parameters:
    names: dict[str, list[str]] = {"name": [], "scale": []}
    groups: dict[str, Any] = {}
    for text in told.tolist():
        what, name, *rest = text.split()
        if what == "groups":
            pairs = [group.split(",") for group in rest]
            groups[name] = "all" if rest == ["all"] else [list(map(int, pair)) for pair in pairs]
        else:
            names[what].append(name)
    return Parameters(*names["name"], scale=names["scale"], groups=groups)

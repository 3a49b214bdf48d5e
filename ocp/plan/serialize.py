"""A plan as arrays by name, and back; how it was solved as text: options as names and numbers, rebuilt through a fixed table of classes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np

from ocp.problem.bounds.bound import Bound
from ocp.problem.control import winds
from ocp.problem.costs import Cost, CostAt
from ocp.problem.goals.goal import Goal
from ocp.problem.phase import Phase
from ocp.problem.problem import Problem
from ocp.problem.start import FreeStart
from ocp.sampling.solver import Sampling
from ocp.solvers.base import NamedSolver
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.multipliers import Duals
from ocp.transcription.base import Transcription
from ocp.transcription.mesh import NamedProfile
from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.serialize import (
    model_from_arrays,
    model_to_arrays,
    structure_from_arrays,
    structure_to_arrays,
)
from tenscasadi.integrators.scheme import NamedScheme
from tenscasadi.scene.ground import Surface
from tenscasadi.schema.arrays import NotStored, pack, unpack
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.archive import Fields
from tenscasadi.util.validate import LARGEST, Array, instance

_FAMILIES = (Goal, Bound, Cost, Phase, FreeStart, Transcription, NamedProfile, NamedSolver, Surface)


def _kinds() -> dict[str, type]:
    """Return the classes that files of plans may name; the two families of collocation share a name."""
    table: dict[str, Any] = {"CostAt": CostAt}
    for family in (NamedScheme, *_FAMILIES):
        table |= family.members
    table |= {f"{kind} (scheme)": own for kind, own in NamedScheme.members.items()}
    return {name: own for name, own in table.items() if isinstance(own, type)}


_PARTS: dict[str, tuple[type, ...]] = {
    "problem": (Problem,),
    "transcription": (Transcription,),
    "solver": (Ipopt, Fatrop, CondensedNewton, Sampling),
}
_ASKED = (
    "duration",
    "start",
    "goals",
    "bounds",
    "costs",
    "phases",
)  # the fields of a problem but for its model


FORMAT = "tenscasadi plan 1"
_VALUES = {  # in NumPy's letters what they are
    "success": "b",
    "status": "U",
    "message": "U",
    "objective": "f",
    "iterations": "i",
    "seconds": "f",
    "replay_error": "f",
    "replay_speed_error": "f",
    "tracked": "b",
}
_ADDED = {"tracked": False}  # what older files do not hold


def plan_arrays(plan: Mapping[str, Any]) -> dict[str, Array]:
    """Return a plan's fields as arrays by name."""
    model, duals, motion = plan["model"], plan["duals"], plan["trajectory"]
    plan = {**_ADDED, **plan}
    content = {name: np.asarray(plan[name]) for name in (*_VALUES, "time", "force_density")}
    content |= {
        f"trajectory.{field.name}": np.asarray(getattr(motion, field.name))
        for field in fields(Trajectory)
    }
    content |= (
        structure_to_arrays(plan["structure"])
        if model is None
        else model_to_arrays(model, motion.states[:, -1])
    )
    if plan.get("rest_length") is not None:
        content["rest_length"] = np.asarray(plan["rest_length"])
    if plan.get("starts") is not None:
        content["starts"] = np.asarray(plan["starts"])
    if duals is not None:
        content |= {
            f"duals.{field.name}": np.asarray(getattr(duals, field.name)) for field in fields(Duals)
        }
    return content | _told(plan)


def plan_fields(content: Fields) -> dict[str, Any]:
    """Return the fields of a plan that `plan_arrays` told, but for how it was solved. Raises ValueError."""
    values = {
        name: content.array(name, kind, 0).item()
        if name in content or name not in _ADDED
        else _ADDED[name]
        for name, kind in _VALUES.items()
    }
    trajectory = Trajectory.from_arrays(content.within("trajectory."))
    _check_segments(content, trajectory.nodes.shape[1])
    model = model_from_arrays(content)
    structure = structure_from_arrays(content) if model is None else model.scene.structure
    if model is not None and trajectory.states.shape[1] != model.nx:
        raise ValueError(
            f"field 'trajectory.states' has {trajectory.states.shape[1]} columns, not {model.nx}"
        )
    intervals, strings = len(trajectory.time) - 1, len(structure.strings)
    time, gamma = content.array("time", "f", 1), content.array("force_density", "f", 2)
    rows = intervals + (len(gamma) == intervals + 1)
    wound = content.array("rest_length", "f", 2) if "rest_length" in content else None
    shapes = [("time", time, (intervals + 1,)), ("force_density", gamma, (rows, strings))]
    shapes += [] if wound is None else [("rest_length", wound, (rows, strings))]
    for name, value, shape in shapes:
        if value.shape != shape:
            raise ValueError(f"field {name!r} has shape {value.shape}, not {shape}")
        if values["success"] and not np.all(np.abs(value) <= LARGEST):
            raise ValueError(
                f"field {name!r} is not finite or above {LARGEST:g}, although the plan succeeded"
            )
    _check_values(values, time, trajectory, model)
    duals = None
    if "duals.names" in content:
        duals = Duals(
            tuple(content.array("duals.names", "U", 1).tolist()),
            *(content.array(f"duals.{name}", "f", 1) for name in ("values", "point")),
        )
        if len(duals.values) != len(duals.names):
            raise ValueError(
                f"field 'duals.values' has {len(duals.values)} entries, not {len(duals.names)} as 'duals.names'"
            )
    if model is not None and winds(model) is (wound is None):
        raise ValueError("field 'rest_length' does not fit the model's control")
    values |= {
        "rest_length": wound,
        "starts": content.array("starts", "f", 1) if "starts" in content else None,
    }
    return {
        **values,
        "time": time,
        "force_density": gamma,
        "trajectory": trajectory,
        "structure": structure,
        "model": model,
        "duals": duals,
    }


def _check_segments(content: Fields, nodes: int) -> None:
    """ValueError unless a scene's segments make as many nodes as moved: a damaged number of them would make more than memory holds."""
    if "scene.segments" not in content or content["structure.nodes"].ndim == 0:
        return
    strings, segments = (
        len(content.array("structure.strings", "i", 2)),
        content.array("scene.segments", "i"),
    )
    if segments.shape not in ((), (strings,)):  # the scene refuses them by name
        return
    count = len(content["structure.nodes"]) + np.broadcast_to(segments - 1.0, strings).sum()
    if count != nodes:
        raise ValueError(
            f"field 'scene.segments' makes {count:g} nodes of the structure's, and 'trajectory.nodes' has {nodes}"
        )


def _check_values(
    values: Mapping[str, Any], time: Array, trajectory: Trajectory, model: Model | None
) -> None:
    """ValueError naming the first field whose numbers no plan can have, or that does not fit the others; what is not finite is not known."""
    if np.any(np.diff(time) <= 0):
        raise ValueError("field 'time' must increase")
    if not np.allclose(time, trajectory.time, equal_nan=True):
        raise ValueError("field 'trajectory.time' is not the plan's 'time'")
    for name in ("iterations", "seconds", "replay_error", "replay_speed_error"):
        if values[name] < 0:
            raise ValueError(f"field {name!r} is {values[name]:g}: it must be at least 0")
    if values["success"] and not (trajectory.success and np.isfinite(values["objective"])):
        name = "objective" if trajectory.success else "trajectory.success"
        raise ValueError(
            f"field {name!r} is {values.get(name, False)}, although the plan succeeded"
        )
    if model is None:  # its scene may be subdivided
        return
    for name in ("bars", "strings"):
        if not np.array_equal(getattr(trajectory, name), getattr(model.structure, name)):
            raise ValueError(f"field 'trajectory.{name}' does not hold those of the model")
    if trajectory.nodes.shape[1] != len(model.structure.nodes):
        raise ValueError(
            f"field 'trajectory.nodes' is of {trajectory.nodes.shape[1]} nodes, not of the model's {len(model.structure.nodes)}"
        )


def _told(parts: Mapping[str, Any]) -> dict[str, Array]:
    """Return text fields from which `rebuilt` makes the problem, but for its model, the transcription and the solver, but for who watches it.

    Where something is no option of this package, such as an own function or scheme, or was not
    known, the text says so instead.
    """
    texts = {}
    for name in _PARTS:
        part = parts[name]
        try:
            if part is None:
                raise NotStored(parts["unknown"])
            if isinstance(part, Problem):
                part = {field: getattr(part, field) for field in _ASKED}
            texts[name] = pack(
                replace(part, watch=None) if isinstance(part, (Ipopt, Sampling)) else part,
                name.capitalize(),
                _kinds(),
            )
        except NotStored as error:
            texts[name] = {"unknown": str(error)}
    return {"solved": np.asarray(json.dumps(texts))}


def rebuilt(
    content: Mapping[str, Any], model: Model | None, problem: Problem | None
) -> dict[str, Any]:
    """Return how a plan was asked for and solved, as fields of it; of what cannot be rebuilt, `unknown` says why.

    problem: the one that is given; None: that of the file, for `model`.
    """
    found: dict[str, Any] = {"problem": problem, "unknown": ""}
    try:
        texts = json.loads(str(content["solved"]))
    except (KeyError, ValueError, RecursionError):
        return {**found, "unknown": "its file is of an older version"}
    for name in _PARTS:
        if found.get(name) is not None:
            continue
        try:
            part = unpack(texts[name], _kinds())
            found[name] = (
                part if name != "problem" else None if model is None else Problem(model, **part)
            )
            instance(name, found[name], _PARTS[name], f"a {name}")
        except (
            ValueError,
            TypeError,
            KeyError,
            AttributeError,
            OverflowError,
            RecursionError,
        ) as error:
            found |= {name: None, "unknown": str(error)}
    return found

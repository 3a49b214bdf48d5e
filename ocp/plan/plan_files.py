"""Models, problems, transcriptions and solvers in plan files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ocp.io.plan_section import METHOD, PLAN, read_solution, write_plan
from ocp.results.result import PlanResult
from tenscasadi.io.document import format_tables
from tenscasadi.io.scene_files import read_scene, write_scene
from tenscasadi.io.structure_section import StructureSection
from tenscasadi.schema.definitions import definition
from tenscasadi.schema.field_types import InPython
from tenscasadi.schema.reading import Document, NotWritten
from tenscasadi.schema.value import Value


def write_parts(plan: PlanResult) -> str:
    """Format model, problem, transcription and solver as a scene file.

    A part that files cannot hold is replaced by the reason.
    """
    left_out: dict[str, str] = {}

    def attempt(part: str, write: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        try:
            return write()
        except NotWritten as error:
            left_out[part] = str(error)
            return {}

    model, problem = plan.model, plan.problem
    tables = {"structure": StructureSection().write(plan.structure)}
    asked = attempt("problem", partial(write_plan, problem, {})) if problem else {}
    if not problem:
        left_out["problem"] = plan.not_restored
    source: Any = model if "problem" in left_out else problem  # a problem's scene has the strength
    scene = attempt("model", partial(write_scene, source.scene)) if model else {}
    if model and scene:
        own = PLAN.write(model.to_fields())
        for name in METHOD:
            value = _drop_functions(getattr(plan, name))
            own |= attempt(name, partial(PLAN.write, {name: value}))
        tables = {**scene, "plan": own | asked}
    return format_tables({"left_out": left_out, **tables})


def _drop_functions(value: Any) -> Any:
    """Remove the fields of a value that files cannot hold.

    These are Python functions.
    """
    if not isinstance(value, Value):
        return value
    known = definition(type(value)).fields.items()  # type: ignore[arg-type]  # classes hash
    functions = {name: own.default for name, own in known if type(own.type) is InPython}
    return replace(value, **functions) if functions else value  # type: ignore[type-var]


def read_parts(document: Document) -> dict[str, Any]:
    """Read model, problem, transcription and solver of a plan file.

    It is the inverse of `write_parts`. Parts that the file does not hold are None.
    """
    left_out = {name: item.text() for name, item in document.root.child("left_out").table().items()}
    item = document.section("plan")
    if item is None:
        structure = StructureSection().read(document.root.child("structure"))
        reason = {"not_restored": left_out["model"]} if "model" in left_out else {}
        return {**dict.fromkeys(("model", "problem", *METHOD)), "structure": structure, **reason}
    return read_solution(read_scene(document), item, left_out)


def find_differences(one: Any, other: Any, name: str) -> Iterator[str]:
    """Yield the names of fields in which two values differ.

    Rounding errors are no differences. `name` is that of the two values `one` and `other`.
    """
    if isinstance(one, Value) and type(one) is type(other):
        fields, others = one.to_fields(), other.to_fields()
        for field in {**fields, **others}:
            label = f"{type(one).__name__}.{field}"
            yield from find_differences(fields.get(field), others.get(field), label)
    elif isinstance(one, Mapping) and isinstance(other, Mapping) and one.keys() == other.keys():
        for key in one:
            yield from find_differences(one[key], other[key], name)
    elif isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)):
        if len(one) != len(other):
            yield name
        for pair in zip(one, other, strict=False):
            yield from find_differences(*pair, name)
    elif not _is_same(one, other):
        yield name


def _is_same(one: Any, other: Any) -> bool:
    a, b = np.asarray(one), np.asarray(other)
    if a.shape != b.shape or a.dtype.kind not in "iuf" or b.dtype.kind not in "iuf":
        return bool(np.array_equal(a, b))
    size = np.abs(b[np.isfinite(b)]).max(initial=0.0)
    return bool(np.allclose(a, b, rtol=1e-9, atol=1e-9 * size, equal_nan=True))

"""Public names are documented in numpydoc form, completely, and their examples run."""

from __future__ import annotations

import ast
import dataclasses
import doctest
import importlib
import inspect
from collections import ChainMap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numpydoc.docscrape import ClassDoc, get_doc_object
from numpydoc.validate import validate

import ocp
import tenscasadi
import tenscasadi.envs
import tenscasadi.viewer
from ocp.results.planned_forces import PlannedForces
from tenscasadi.schema.value import Value
from tenscasadi.util.tables import Tabular

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {"tenscasadi": tenscasadi, "ocp": ocp}

# numpydoc's own codes: sections in order, a one-line summary with a period, every parameter with
# type and description, results, examples
REQUIRED = {
    "GL07",
    "GL08",
    "SS01",
    "SS02",
    "SS03",
    "SS04",
    "SS06",
    "PR01",
    "PR02",
    "PR03",
    "PR04",
    "PR07",
    "RT01",
    "RT03",
    "YD01",
    "EX01",
}
METHODS = REQUIRED - {"EX01"}  # the class shows one


def public() -> dict[str, Any]:
    packages = {
        **PACKAGES,
        "tenscasadi.envs": tenscasadi.envs,
        "tenscasadi.viewer": tenscasadi.viewer,
    }
    return {
        f"{name}.{item}": getattr(package, item)
        for name, package in packages.items()
        for item in package.__all__
    }


def fields(cls: type) -> set[str]:
    if dataclasses.is_dataclass(cls):
        return {
            field.name
            for field in dataclasses.fields(cls)
            if not field.name.startswith("_") and field.init
        }
    return set(getattr(cls, "_fields", ()))


def faults(name: str, codes: set[str]) -> list[str]:
    return [f"{name}: {code} {text}" for code, text in validate(name)["errors"] if code in codes]


def methods(name: str, cls: type) -> Iterator[str]:
    inherited = [vars(base) for base in (Tabular, PlannedForces) if issubclass(cls, base)]
    for own, value in ChainMap(vars(cls), *inherited).items():
        if (
            not own.startswith("_")
            and own not in vars(Value)
            and (inspect.isfunction(value) or isinstance(value, (classmethod, staticmethod)))
        ):
            yield f"{name}.{own}"


@pytest.mark.parametrize(
    "name", [name for name, value in public().items() if not isinstance(value, ModuleType)]
)
def test_public_names_are_documented(name):
    value = public()[name]
    if not isinstance(value, type):
        if not callable(value):
            return  # a union of types
        found = faults(name, REQUIRED)
    elif issubclass(value, (Exception, Warning)):
        found = faults(name, {"GL08", "SS01", "SS03", "SS06"})
    else:
        found = faults(name, REQUIRED - {"PR01", "PR02", "PR03"} if fields(value) else REQUIRED)
        document = ClassDoc(value)
        told = {
            part.strip()
            for section in ("Parameters", "Attributes")
            for entry in document[section]
            for part in entry.name.split(",")
        }
        found += [
            f"{name}: {missing} is not documented" for missing in sorted(fields(value) - told)
        ]
        found += [fault for method in methods(name, value) for fault in faults(method, METHODS)]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("name", ["tenscasadi.shapes", "tenscasadi.plots", "tenscasadi.animation"])
def test_functions_of_public_modules_are_documented(name):
    module = importlib.import_module(name) if name != "tenscasadi.shapes" else tenscasadi.shapes
    functions = [
        item
        for item in getattr(module, "__all__", dir(module))
        if inspect.isfunction(getattr(module, item)) and item[0] != "_"
    ]
    own = [
        item
        for item in functions
        if getattr(module, item).__module__.startswith(module.__name__.rpartition(".")[0])
    ]
    found = [fault for item in own for fault in faults(f"{module.__name__}.{item}", REQUIRED)]
    assert functions
    assert not found, "\n".join(found)


def examples() -> list[doctest.DocTest]:
    finder = doctest.DocTestFinder(exclude_empty=True)
    found = []
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            if path.name not in ("__init__.py", "__main__.py"):
                module = importlib.import_module(
                    ".".join(path.relative_to(ROOT).with_suffix("").parts)
                )
                found += [test for test in finder.find(module) if test.examples]
    return found


@pytest.mark.parametrize("example", examples(), ids=lambda test: test.name)
def test_examples_run(example, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    told: list[str] = []
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    doctest.DocTestRunner(optionflags=flags, verbose=False).run(example, out=told.append)
    assert not told, "".join(told)


def test_no_docstring_opens_with_what():
    faults = [
        f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'the module')}"
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        and (ast.get_docstring(node) or "").startswith("What ")
    ]
    assert not faults, "\n".join(faults)


def test_a_missing_parameter_would_be_seen():
    def undocumented(step: float) -> float:
        """Return the step."""
        return step

    assert {"PR01", "RT01", "EX01"} <= {
        code for code, _ in validate(get_doc_object(undocumented))["errors"]
    }

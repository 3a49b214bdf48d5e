"""Data flows one way: a package imports only packages to its left, and no circle runs inside one."""

from __future__ import annotations

import ast
import graphlib
import runpy
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import ocp
import tenscasadi

ROOT = Path(__file__).resolve().parents[1]

# From left to right; names in one set do not import each other.
_MODEL = ("util", "structure", "scene", "dynamics", "integrators", "simulation")
TENSCASADI = (
    *_MODEL,
    {"design", "ensemble", "sweeps", "files"},
    {"exchange", "plots", "envs"},
    "analysis",
    "viewer",
    "cli",
)
OCP = (
    "problem",
    "boundary",
    "transcription",
    {"solvers", "presolve"},
    "sampling",
    "plan",
    {"program", "phases", "condensed", "verdict"},
    {"choice", "starts", "reduced_twin"},
    {"control", "solve", "files"},
    "export",
)

OPEN_TO_OCP = {*_MODEL, "design", "ensemble", "files"}
# Methods that lead on to what is made of a value, such as `value.view()` and `plan.refine()`: it is
# imported when they are called, and only there.
ONWARD = {
    ("tenscasadi.util.viewable", "tenscasadi.viewer.view"),
    ("ocp.plan.exhibit", "tenscasadi.viewer.exhibit"),
    ("ocp.plan.exhibit", "tenscasadi.viewer.motion"),
    ("ocp.plan.plan", "ocp.control.lqr"),
    ("ocp.plan.plan", "ocp.solve"),
}
ENTRANCES = {
    "tenscasadi.__main__",
    "tenscasadi.animation",
}  # documented paths that only lead into a room
LINES = 530


def modules() -> dict[str, Path]:
    """All modules by dotted name; packages by their __init__.py."""
    paths = [
        path for package in ("tenscasadi", "ocp") for path in sorted((ROOT / package).rglob("*.py"))
    ]
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
        for path in paths
    }


MODULES = modules()


def imported(path: Path) -> Iterator[tuple[str, bool]]:
    """(module, at module level) of each import of the two packages."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    top = set(map(id, tree.body))
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else str(node.module) for name in inside]
        for name in names:
            if name.partition(".")[0] in ("tenscasadi", "ocp"):
                yield name, id(node) in top


def place(module: str) -> tuple[str, int]:
    """The room of a module and its place in the order."""
    package, *rest = module.split(".")
    room = rest[0]
    order = TENSCASADI if package == "tenscasadi" else OCP
    found = [
        k for k, names in enumerate(order) if room in (names if isinstance(names, set) else {names})
    ]
    assert len(found) == 1, (
        f"{module} is in no room: give {room} its place in tests/test_architecture.py"
    )
    return room, found[0]


@pytest.mark.parametrize(
    "module", [name for name in MODULES if "." in name and name not in ENTRANCES]
)
def test_a_package_imports_only_packages_to_its_left(module):
    package = module.partition(".")[0]
    room, own = place(module)
    for other, at_top in imported(MODULES[module]):
        assert "." in other or (room == "cli" and other == "ocp"), (
            f"{module} imports the whole package: name the module"
        )
        other_room, level = place(other) if "." in other else ("", 0)
        if (module, other) in ONWARD:
            assert not at_top, (
                f"{module} imports {other} where it is loaded: what is made of a value is loaded when it is asked for"
            )
            continue
        if package == "tenscasadi" and other.startswith("ocp"):
            assert room == "cli", f"{module} imports {other}: only the command line may"
            assert not at_top, (
                f"{module} imports {other} where it is loaded: the command line imports ocp inside functions"
            )
        elif package == "ocp" and other.startswith("tenscasadi."):
            assert other_room in OPEN_TO_OCP, (
                f"{module} imports {other}: ocp uses {sorted(OPEN_TO_OCP)} only"
            )
        else:
            assert level < own or other_room == room, (
                f"{module} imports {other}, which is not to its left"
            )


@pytest.mark.parametrize(("package", "order"), [("tenscasadi", TENSCASADI), ("ocp", OCP)])
def test_the_document_tells_this_order(package, order):
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    (line,) = [line for line in text.splitlines() if line.startswith(f"    {package} ")]
    told = [
        set(level.split(", "))
        for level in line.removeprefix(f"    {package} ").strip().split(" < ")
    ]
    assert told == [level if isinstance(level, set) else {level} for level in order]


def test_the_picture_shows_every_folder():
    picture = runpy.run_path(str(ROOT / "docs" / "draw_architecture.py"))
    for package, drawn in (("tenscasadi", picture["ROOMS"]), ("ocp", picture["PLANNING"])):
        assert {path.parent.name for path in (ROOT / package).glob("*/__init__.py")} == set(drawn)


def test_no_circle_of_modules():
    modules = {name: path for name, path in MODULES.items() if path.name != "__init__.py"}
    graph = {
        name: {other for other, at_top in imported(path) if at_top or (name, other) not in ONWARD}
        for name, path in modules.items()
    }
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


@pytest.mark.parametrize(
    "module", [name for name, path in MODULES.items() if path.name == "__init__.py"]
)
def test_packages_only_re_export(module):
    for node in ast.parse(MODULES[module].read_text(encoding="utf-8")).body:
        kinds = (ast.Import, ast.ImportFrom, ast.Expr)
        assert isinstance(node, kinds) or ast.unparse(node).startswith("__all__"), (
            f"{module} holds more than imports: {ast.unparse(node)[:80]}"
        )


@pytest.mark.parametrize("module", MODULES)
@pytest.mark.parametrize(("library", "room"), [("matplotlib", "plots"), ("viser", "viewer")])
def test_what_draws_is_imported_in_its_room_only(module, library, room):
    if not module.startswith(f"tenscasadi.{room}"):
        text = MODULES[module].read_text(encoding="utf-8")
        assert f"import {library}" not in text
        assert f"from {library}" not in text


@pytest.mark.parametrize("module", MODULES)
def test_files_hold_one_concept(module):
    lines = len(MODULES[module].read_text(encoding="utf-8").splitlines())
    assert lines <= LINES, f"{module} has {lines} lines: is there a second concept inside?"


def test_importing_loads_nothing_that_draws():
    code = "import sys, tenscasadi, ocp; sys.exit(bool({'matplotlib', 'viser', 'tenscasadi.viewer'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize("package", [tenscasadi, ocp], ids=["tenscasadi", "ocp"])
def test_public_names_exist_once_and_are_documented(package):
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__doc__

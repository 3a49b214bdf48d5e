"""Data flows one way: a package imports only packages to its left, and no circle runs inside one."""

from __future__ import annotations

import ast
import functools
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
_MODEL = (
    *("version", "util", "schema", "structure", "scene", "io"),
    *("dynamics", "integrators", "simulation"),
)
TENSCASADI = (
    *_MODEL,
    {"statics", "sweeps", "drawing"},
    {"design", "exchange", "plots"},
    "analysis",
    "viewer",
    {"envs", "cli"},
)
OCP = (
    "problem",
    "targets",
    "transcription",
    {"solvers", "guess"},
    "sampling",
    "results",
    "phases",
    "control",
    "search",
    "io",
    "plan",
    "solve",
    {"acados", "export", "renamed"},
)

OPEN_TO_OCP = {*_MODEL, "statics", "drawing"}
# Methods that lead on to what is made of a value, such as `value.view()` and `plan.refine()`: it is
# imported when they are called, and only there.
ONWARD = {
    ("tenscasadi.util.viewable", "tenscasadi.viewer.view"),
    ("tenscasadi.statics.load_path", "tenscasadi.plots.load_paths"),
    ("tenscasadi.util.viewable", "tenscasadi.plots.figures"),
}
# documented paths that only lead into a room
ENTRANCES = {"tenscasadi.__main__", "tenscasadi.animation"}
LINES = 510  # of a file
CHAIN = 20  # modules that import each other in a row
LATE_IMPORTS = 8  # of own modules, within functions


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


@functools.cache
def trees() -> dict[str, ast.Module]:
    """Syntax trees of all modules: one worker of a run needs them."""
    return {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}


def imported(module: str) -> Iterator[tuple[str, ast.stmt]]:
    """(module of the two packages, statement) of each import of a module."""
    for node in ast.walk(trees()[module]):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if name in MODULES else str(node.module) for name in inside]
        else:
            continue
        for name in names:
            if name.partition(".")[0] in ("tenscasadi", "ocp"):
                yield name, node


def at_top(module: str, node: ast.stmt) -> bool:
    """Return whether a statement runs where the module is loaded."""
    return node in trees()[module].body


def late_imports() -> list[str]:
    """Imports of own modules within functions, as "module.function: statement"."""
    return sorted(
        {
            f"{name}.{function.name}: {ast.unparse(node)}"
            for name, tree in trees().items()
            for function in ast.walk(tree)
            if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef))
            for node in ast.walk(function)
            if isinstance(node, (ast.Import, ast.ImportFrom))
            and any(node is found for _, found in imported(name))
        }
    )


def longest_chain() -> list[str]:
    """The longest row of modules of which each imports the next where it is loaded."""
    graph = {
        name: {other for other, node in imported(name) if at_top(name, node)}
        for name, path in MODULES.items()
        if path.name != "__init__.py"
    }
    chains: dict[str, list[str]] = {}
    for name in graphlib.TopologicalSorter(graph).static_order():
        below = (chains[other] for other in sorted(graph.get(name, ())) if other in graph)
        chains[name] = [name, *max(below, key=len, default=[])]
    return max(chains.values(), key=len)


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


def misplaced_import(module: str, other: str, top: bool) -> str:
    """Explain why a module may not import another; "" where it may."""
    package = module.partition(".")[0]
    room, own = place(module)
    if "." not in other:
        return "" if room == "cli" and other == "ocp" and not top else "name the module"
    other_room, level = place(other)
    if (module, other) in ONWARD:
        return "import it where it is used: it is made of the value" if top else ""
    if package == "tenscasadi" and other.startswith("ocp"):
        return "" if room == "cli" and not top else "only functions of the command line may"
    if package == "ocp" and other.startswith("tenscasadi."):
        return "" if other_room in OPEN_TO_OCP else f"ocp uses {sorted(OPEN_TO_OCP)} only"
    return "" if level < own or other_room == room else "it is not to its left"


def test_rooms_import_only_rooms_to_their_left():
    faults = [
        f"{module} imports {other}: {why}"
        for module in MODULES
        if "." in module and module not in ENTRANCES
        for other, node in imported(module)
        if (why := misplaced_import(module, other, at_top(module, node)))
    ]
    assert not faults, "\n".join(faults)


def test_import_chain_is_short():
    chain = longest_chain()
    print(f"longest import chain, {len(chain)} modules:", *chain, sep="\n    ")
    assert len(chain) <= CHAIN


def test_late_imports_are_few():
    late = late_imports()
    print(f"{len(late)} late imports of own modules:", *late, sep="\n    ")
    assert len(late) <= LATE_IMPORTS


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
    graph = {
        name: {
            other
            for other, node in imported(name)
            if at_top(name, node) or (name, other) not in ONWARD
        }
        for name, path in MODULES.items()
        if path.name != "__init__.py"
    }
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_packages_only_re_export():
    kinds = (ast.Import, ast.ImportFrom, ast.Expr)
    lazy = ("__all__ =", "if TYPE_CHECKING:", "__getattr__ = find_attribute(", "def __dir__()")
    faults = [
        f"{module} holds more than imports: {ast.unparse(node)[:80]}"
        for module, path in MODULES.items()
        if path.name == "__init__.py"
        for node in trees()[module].body
        if not isinstance(node, kinds) and not ast.unparse(node).startswith(lazy)
    ]
    assert not faults, "\n".join(faults)


def test_drawing_libraries_are_imported_in_their_rooms():
    faults = [
        f"{module} imports {name}: only tenscasadi.{room} may"
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for name in (
            [node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
        )
        for library, room in (("matplotlib", "plots"), ("viser", "viewer"))
        if str(name).split(".")[0] == library and not module.startswith(f"tenscasadi.{room}")
    ]
    assert not faults, "\n".join(faults)


def test_files_hold_one_concept():
    lines = {
        module: len(path.read_text(encoding="utf-8").splitlines())
        for module, path in MODULES.items()
    }
    long = {module: count for module, count in lines.items() if count > LINES}
    assert not long, f"{long}: is there a second concept inside?"


def test_importing_loads_nothing_that_draws():
    code = "import sys, tenscasadi, ocp; sys.exit(bool({'matplotlib', 'viser', 'tenscasadi.viewer'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize("package", [tenscasadi, ocp], ids=["tenscasadi", "ocp"])
def test_public_names_exist_once_and_are_documented(package):
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__doc__

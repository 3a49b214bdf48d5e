"""Data flows one way: a module imports only what lies below it."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import ocp
import tenscasadi

ROOT = Path(__file__).resolve().parents[1]

# From the bottom up; a module imports from the levels below its own, never sideways.
TENSCASADI = (
    {"archive", "precision", "validate"},
    {
        "algebra",
        "class_one",
        "compiled",
        "convergence",
        "loads",
        "signals",
        "stage",
        "strings",
        "subdivision",
        "tableaux",
        "trajectory",
        "work_precision",
    },
    {"structure"},
    {"dynamics", "shapes", "statics", "supports"},
    {"scene"},
    {"forces", "redundancy"},
    {"state_space"},
    {"model"},
    {"correction", "events", "linear", "record", "schemes", "stored"},
    {"adaptive", "loop", "rattle", "stability", "triangular"},
    {"collocation", "correction_effect", "sundials"},
    {"runners"},
    {"diagnosis", "export"},
    {"simulate", "table"},
    {"mode_motion", "plots", "reference"},
    {"animation", "demos", "tradeoff"},
    {"recommend"},
    {"commands"},
    {"cli"},
    {"__main__"},
)
OCP = (
    {"best", "blocks", "checks", "direct", "duals", "grid", "instant", "interior", "momentum"},
    {"bounds", "costs", "goals", "reduction", "refine"},
    {"expressions", "invariants", "motions", "places", "search"},
    {"problem"},
    {"cycle", "limits", "rerun"},
    {"report", "target"},
    {"finder", "misses", "plan"},
    {"conflicts", "guess", "linearized", "path", "winding"},
    {"closed_loop", "guesses", "horizon", "reach", "reference", "track"},
    {"mpc", "stages"},
    {"program"},
    {"multipliers", "transcription"},
    {"implicit", "solver", "staged"},
    {"collocation", "fatrop", "ipopt", "variational"},
    {"correct", "explain"},
    {"solve"},
    {"export"},
)
PICTURES = {"convergence", "stage", "work_precision", "plots", "animation", "demos", "commands", "cli", "__main__"}


def modules(package: str) -> dict[str, Path]:
    return {path.stem: path for path in sorted((ROOT / package).glob("*.py")) if path.stem != "__init__"}


def imported(path: Path) -> Iterator[tuple[str, str, bool]]:
    """(package, module, at module level) of each import of the two packages; the module is "" for the package itself."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    top = set(map(id, tree.body))
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} imports relatively"
            names = [f"{node.module}.{alias.name}" for alias in node.names] if node.module in ("tenscasadi", "ocp") else [str(node.module)]
        for name in names:
            package, _, module = name.partition(".")
            if package in ("tenscasadi", "ocp"):
                yield package, module.partition(".")[0], id(node) in top


def level(levels: tuple[set[str], ...], module: str) -> int:
    found = [k for k, names in enumerate(levels) if module in names]
    assert len(found) == 1, f"{module} is in {len(found)} levels: give it its place in tests/test_architecture.py"
    return found[0]


@pytest.mark.parametrize("module", modules("tenscasadi"))
def test_tenscasadi_imports_downwards_and_never_ocp(module):
    own = level(TENSCASADI, module)
    for package, other, at_top in imported(modules("tenscasadi")[module]):
        if package == "ocp":
            assert module == "commands", f"{module} imports ocp"
            assert not at_top, "commands import ocp where they are loaded, not where they plan"
        else:
            assert other, f"{module} imports the whole package: name the module"
            assert level(TENSCASADI, other) < own, f"{module} imports {other}, which is not below it"


@pytest.mark.parametrize("module", modules("ocp"))
def test_ocp_imports_downwards_and_no_pictures(module):
    own = level(OCP, module)
    for package, other, _ in imported(modules("ocp")[module]):
        if package == "tenscasadi":
            assert other not in PICTURES, f"ocp.{module} imports {other}"
        else:
            assert level(OCP, other) < own, f"{module} imports {other}, which is not below it"


def test_levels_name_only_what_exists():
    assert set().union(*TENSCASADI) == set(modules("tenscasadi"))
    assert set().union(*OCP) == set(modules("ocp"))


def test_importing_loads_no_matplotlib():
    code = "import sys, tenscasadi, ocp; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize("package", [tenscasadi, ocp], ids=["tenscasadi", "ocp"])
def test_public_names_exist_once_and_are_documented(package):
    assert len(set(package.__all__)) == len(package.__all__)
    for name in package.__all__:
        assert getattr(package, name).__doc__

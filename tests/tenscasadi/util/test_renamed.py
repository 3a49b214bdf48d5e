"""Lazy names and modules, and old names."""

from __future__ import annotations

import inspect
import math
import subprocess
import sys

import pytest

import tenscasadi
from tenscasadi.util.renamed import RenamedAttribute, find_attribute, lazy_module, rename_keywords


@rename_keywords(colour="color")
def paint(thing: str, *, color: str = "red") -> str:
    """Paint a thing."""
    return f"{color} {thing}"


def test_old_keyword_warns_and_works():
    with pytest.warns(DeprecationWarning, match=r"paint\(colour=\) is deprecated: use color="):
        assert paint("bar", colour="blue") == "blue bar"
    assert paint("bar", color="blue") == "blue bar"
    assert list(inspect.signature(paint).parameters) == ["thing", "color"]


def test_old_and_new_keyword_together_are_rejected():
    with pytest.raises(TypeError, match="leave colour out"):
        paint("bar", colour="blue", color="red")


def test_old_name_warns_and_unknown_name_is_rejected():
    find = find_attribute("math", {}, {"circumference_ratio": "pi"})
    with pytest.warns(DeprecationWarning, match=r"math\.circumference_ratio is deprecated: use"):
        assert find("circumference_ratio") == math.pi
    with pytest.raises(AttributeError, match="has no attribute 'other'"):
        find("other")


def test_lazy_name_is_imported_at_first_use():
    find = find_attribute("tenscasadi.util", {"math": ["tau"]}, {})
    assert find("tau") == tenscasadi.util.tau == math.tau  # type: ignore[attr-defined]
    del tenscasadi.util.tau  # type: ignore[attr-defined]


def test_simulations_import_no_analysis():
    code = "import sys, tenscasadi; print([name for name in sys.modules if name in (%r)])"
    unneeded = [f"tenscasadi.{part}" for part in ("analysis", "exchange", "statics", "sweeps")]
    command = [sys.executable, "-c", code % (unneeded,)]
    assert subprocess.run(command, capture_output=True, text=True).stdout == "[]\n"
    assert set(tenscasadi.__all__) <= set(dir(tenscasadi))


def test_old_attribute_warns_and_works():
    class Cup:
        color = "red"
        colour = RenamedAttribute("color")

    with pytest.warns(DeprecationWarning, match=r"Cup\.colour is deprecated: use color"):
        assert Cup().colour == "red"


def test_lazy_module_is_executed_at_first_use():
    code = """
from tenscasadi.util.renamed import lazy_module
import sys
linalg = lazy_module("scipy.sparse.linalg")
assert "scipy.linalg._basic" not in sys.modules
assert callable(linalg.eigs) and "scipy.linalg._basic" in sys.modules
assert lazy_module("scipy.sparse.linalg") is linalg
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_missing_module_is_reported_at_once():
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        lazy_module("no_such_module")


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("certify", "reference_solution"),
        ("Reference", "ReferenceSolution"),
        ("NoReference", "NoReferenceError"),
        ("NoScheme", "NoSchemeError"),
        ("Row", "TradeoffRow"),
        ("projection", "build_projection"),
    ],
)
def test_old_public_name_warns_and_gives_the_new_one(old, new):
    with pytest.warns(DeprecationWarning, match=f"tenscasadi.{old} is deprecated: use tenscasadi"):
        assert getattr(tenscasadi, old) is getattr(tenscasadi, new)

"""Lazy modules are executed at first use."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tenscasadi.util.lazy import lazy_module


def test_lazy_module_is_executed_at_first_use():
    code = """
from tenscasadi.util.lazy import lazy_module
import sys
linalg = lazy_module("scipy.sparse.linalg")
assert "scipy.linalg" not in sys.modules
assert callable(linalg.eigs) and "scipy.linalg" in sys.modules
assert lazy_module("scipy.sparse.linalg") is linalg
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_missing_module_is_reported_at_once():
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        lazy_module("no_such_module")

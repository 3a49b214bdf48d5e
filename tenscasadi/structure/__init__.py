"""Structures, the paper's matrices, and standard shapes."""

from __future__ import annotations

from tenscasadi.structure import shapes
from tenscasadi.structure.class_one import ClassOne, connectivity
from tenscasadi.structure.structure import Structure

__all__ = ["ClassOne", "Structure", "connectivity", "shapes"]

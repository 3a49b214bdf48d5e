"""Documented path of `tenscasadi.animation.animate`."""

from __future__ import annotations

from tenscasadi.plots.animation import animate

__all__ = ["animate"]

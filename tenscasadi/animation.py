"""`tenscasadi.animation.animate`, the path that is documented for animations."""

from __future__ import annotations

from tenscasadi.plots.animation import animate

__all__ = ["animate"]

"""Motions in a browser: played, compared, saved as pages, and driven while they are computed."""

from __future__ import annotations

from tenscasadi.viewer.view import View, view

__all__ = ["View", "view"]

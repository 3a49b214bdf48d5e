"""Motions in a browser: played, compared, saved as pages, and driven while they are computed."""

from __future__ import annotations

from tenscasadi.viewer.live_mode.live import Live, live
from tenscasadi.viewer.live_mode.simulation import LiveSimulation, Stepping
from tenscasadi.viewer.view import View, view

__all__ = ["Live", "LiveSimulation", "Stepping", "View", "live", "view"]

"""Browser viewer: playback, comparison, saved pages, interactive simulation."""

from __future__ import annotations

from tenscasadi.viewer.convergence_page import ConvergencePage
from tenscasadi.viewer.live_mode.live import Live, live
from tenscasadi.viewer.live_mode.options import LiveOptions
from tenscasadi.viewer.live_mode.simulation import LiveSimulation
from tenscasadi.viewer.renamed import __getattr__ as __getattr__
from tenscasadi.viewer.view import View, view

__all__ = ["ConvergencePage", "Live", "LiveOptions", "LiveSimulation", "View", "live", "view"]

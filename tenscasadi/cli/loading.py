"""Late imports of packages that only some commands need."""

from __future__ import annotations

from typing import Any


def load_ocp() -> Any:
    """Import the planning package `ocp`."""
    import ocp.io.plan_section

    return ocp


def load_viewer() -> Any:
    """Import the viewer package."""
    import tenscasadi.viewer

    return tenscasadi.viewer


def load_plots() -> Any:
    """Import the package of figures and animations, with matplotlib."""
    import tenscasadi.plots.animation

    return tenscasadi.plots

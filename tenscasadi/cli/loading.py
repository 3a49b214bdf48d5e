"""Packages that are loaded by the commands that need them."""

from __future__ import annotations

from typing import Any


def load_ocp() -> Any:
    """Load the package of planning."""
    import ocp.io.plan_section

    return ocp


def load_viewer() -> Any:
    """Load the package of the viewer."""
    import tenscasadi.viewer

    return tenscasadi.viewer


def load_plots() -> Any:
    """Load the package of figures and animations, with matplotlib."""
    import tenscasadi.plots.animation

    return tenscasadi.plots

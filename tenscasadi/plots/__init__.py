"""Figures and animations by matplotlib, drawn without pyplot."""

from __future__ import annotations

from tenscasadi.plots.diagrams import Convergence, work_precision
from tenscasadi.plots.energies import energies, phase_portrait
from tenscasadi.plots.figures import structure, time_lapse
from tenscasadi.plots.histories import (
    ForceHistory,
    errors,
    force_densities,
    node_histories,
    tensions,
)
from tenscasadi.plots.load_paths import load_path
from tenscasadi.plots.robustness import ReplayErrors, robustness
from tenscasadi.plots.rollouts import fan, histogram
from tenscasadi.plots.statics import forces, mode_shapes

__all__ = [
    "Convergence",
    "ForceHistory",
    "ReplayErrors",
    "energies",
    "errors",
    "fan",
    "force_densities",
    "forces",
    "histogram",
    "load_path",
    "mode_shapes",
    "node_histories",
    "phase_portrait",
    "robustness",
    "structure",
    "tensions",
    "time_lapse",
    "work_precision",
]

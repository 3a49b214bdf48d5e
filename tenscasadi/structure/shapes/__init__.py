"""Standard structures: functions that accept all keywords of `Structure`."""

from __future__ import annotations

from tenscasadi.structure.shapes.balls import (
    expanded_octahedron,
    six_bar_ball,
    truncated_icosahedron,
    truncated_tetrahedron,
)
from tenscasadi.structure.shapes.cantilevers import arm, michell_cantilever
from tenscasadi.structure.shapes.domes import bicycle_wheel, geiger_dome, levy_dome
from tenscasadi.structure.shapes.family import ShapeFamily, shape
from tenscasadi.structure.shapes.nets import hyperbolic_paraboloid, membrane, membrane_faces
from tenscasadi.structure.shapes.pendulums import double_pendulum, pendulum
from tenscasadi.structure.shapes.plane_units import d_bar, t_bar
from tenscasadi.structure.shapes.prisms import prism
from tenscasadi.structure.shapes.towers import prism_tower, spine
from tenscasadi.util.renamed import find_attribute

__all__ = [
    "ShapeFamily",
    "shape",
    "pendulum",
    "double_pendulum",
    "prism",
    "prism_tower",
    "d_bar",
    "t_bar",
    "six_bar_ball",
    "expanded_octahedron",
    "truncated_tetrahedron",
    "truncated_icosahedron",
    "membrane",
    "membrane_faces",
    "hyperbolic_paraboloid",
    "geiger_dome",
    "levy_dome",
    "bicycle_wheel",
    "michell_cantilever",
    "spine",
    "arm",
]

__getattr__ = find_attribute("tenscasadi.structure.shapes", {}, {"Shape": "ShapeFamily"})

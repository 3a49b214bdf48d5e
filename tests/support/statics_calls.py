"""Public names of statics and design with input that is right, whose calls take milliseconds."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

import tenscasadi as tc

Call = tuple[Callable[..., Any], dict[str, Any]]


@cache
def _prism() -> tc.Structure:
    return tc.shapes.prism(3, stiffness=1000.0, prestress=30.0, pinned=[0, 1, 2])


@cache
def _scene() -> tc.Scene:
    return tc.Scene(_prism(), control=tc.RestLength(), parameters=tc.Parameters("stiffness"))


def statics_calls() -> dict[str, Call]:
    """Names of `tenscasadi.statics` and `tenscasadi.design`."""
    prism, scene = _prism(), _scene()
    load = np.zeros((6, 3))
    load[3:, 2] = -1.0
    given = {"control": np.array(prism.rest_length), "parameters": np.full(9, 1000.0)}
    row = np.concatenate([np.full(9, 30.0), np.full(3, 50.0)])
    steel = tc.Material(210e9, 7850.0, 235e6)
    return {
        "find_equilibrium": (tc.find_equilibrium, {"scene": scene, "start": prism.nodes, **given}),
        "stability": (tc.stability, {"source": prism, "force_density": row, "count": 3}),
        "buckling_factor": (tc.buckling_factor, {"scene": scene, "load": load, **given}),
        "load_path": (
            tc.load_path,
            {"scene": scene, "load": load, "factors": (0.0, 2.0), "start": prism.nodes},
        ),
        "form_find": (
            tc.form_find,
            {
                "structure": prism,
                "force_density": np.full(9, np.nan),
                "lengths": {8: 1.0},
                "positions": {3: (None, None, 1.0)},
                "groups": [[3, 4, 5]],
                "equal_tension": [[6, 7]],
                "loads": load,
            },
        ),
        "find_prestress": (
            tc.find_prestress,
            {
                "structure": prism,
                "goal": tc.Least(),
                "load_cases": [load],
                "minimum": np.full(9, 1.0),
                "maximum": np.full(9, 1e4),
                "groups": [[3, 4, 5]],
            },
        ),
        "Material": (tc.Material, {"modulus": 210e9, "density": 7850.0, "strength": 235e6}),
        "size": (
            tc.size,
            {
                "structure": prism,
                "load_cases": [load],
                "string": steel,
                "bar": steel,
                "tube": 0.5,
                "self_weight": tc.Gravity(),
                "minimum_area": np.full(12, 1e-6),
            },
        ),
    }

"""Scenes of every kind, drawn by hypothesis."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

import tenscasadi as tc
from tenscasadi.schema.time_formula import TimeFormula

NODES = np.array(
    [
        (0.1, 0, 0),
        (0, 1, 0.3),
        (1 / 3, 0.2, 1),
        (1.7, -0.4, 0.9),
        (0.6, 0.8, -0.7),
        (-1.1, 0.3, 0.2),
    ]
)


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_subnormal=False)


def per_item(count: int, low: float, high: float) -> st.SearchStrategy[Any]:
    return st.one_of(
        numbers(low, high), st.lists(numbers(low, high), min_size=count, max_size=count)
    )


def vectors() -> st.SearchStrategy[tuple[float, ...]]:
    return st.tuples(*[numbers(-5, 5)] * 3)


@st.composite
def structures(draw: Any) -> tc.Structure:
    shift = np.array(draw(st.lists(numbers(-0.04, 0.04), min_size=18, max_size=18))).reshape(6, 3)
    bars = draw(st.sampled_from([[(0, 1), (2, 3)], [(0, 1), (1, 2), (4, 5)], [(3, 2)]]))
    strings = draw(
        st.lists(st.sampled_from([(0, 2), (1, 3), (4, 2), (5, 0), (4, 1), (5, 3)]), max_size=6)
    )
    pinned = draw(
        st.dictionaries(st.integers(0, 3), st.sampled_from(["x", "xy", "xyz", "z"]), max_size=2)
    )
    rollers = draw(
        st.one_of(st.just({}), st.just({4: (1, 2, 3)}), st.just({5: [(1, 0, 1), (0, 1, 1)]}))
    )
    a, b = len(bars), len(strings)
    return tc.Structure(
        NODES + shift,
        bars,
        strings,
        bar_mass=draw(per_item(a, 0.1, 10)),
        bar_radius=draw(per_item(a, 0, 0.2)),
        node_mass=draw(per_item(6, 0.01, 2)),
        pinned=pinned,
        rollers=rollers,
        stiffness=draw(per_item(b, 1, 1e4)),
        damping=draw(per_item(b, 0, 10)),
        rest_length=draw(st.one_of(st.none(), per_item(b, 0.1, 3))),
        string_mass=draw(per_item(b, 0.01, 1)),
    )


def over_time(value: st.SearchStrategy[Any], formula: Any) -> st.SearchStrategy[dict[str, Any]]:
    """Keywords of a load: constant, a table, or formulas of time."""
    table = st.lists(value, min_size=2, max_size=3)
    return st.one_of(
        value.map(lambda found: {"quantity": found}),
        table.map(lambda found: {"quantity": found, "times": [0.1 * k for k in range(len(found))]}),
        st.just({"quantity": TimeFormula(formula, (("amount", 0.1),)), "breakpoints": [0.05]}),
    )


def load(kind: Any, name: str, given: dict[str, Any], **others: Any) -> Any:
    return kind(
        **{name if key == "quantity" else key: value for key, value in given.items()}, **others
    )


SURFACE = st.fixed_dictionaries(
    {"stiffness": numbers(1, 1e4), "damping": numbers(0, 10), "slip_speed": numbers(1e-3, 1)},
    optional={
        "friction": numbers(0.1, 1),
        "nodes": st.just([0, 3]),
        "bars": st.sampled_from(["all", [0]]),
    },
)
GROUND = st.builds(
    lambda normal, height, others: tc.Ground(normal=normal, height=height, **others),
    vectors().filter(any),
    numbers(-2, 2),
    SURFACE,
)
TERRAIN = st.builds(
    lambda heights, others: tc.Terrain(np.reshape(heights, (2, 3)), (-1, -2), (1, 2), **others),
    st.lists(numbers(-1, 1), min_size=6, max_size=6),
    SURFACE,
)
LAW = st.one_of(
    st.just(tc.Linear()),
    st.builds(tc.Clip, st.sampled_from(["clamped", "unclamped"])),
    st.builds(tc.Smooth, numbers(1e-3, 0.1)),
)


@st.composite
def scenes(draw: Any) -> tc.Scene:
    structure = draw(structures())
    count = len(structure.strings)
    held = [node for node, axes in structure.pinned.items() if axes == "xyz"]
    rows = st.lists(vectors(), min_size=6, max_size=6)
    wave = ("amount * sin(3 * t)", 0.0, "1 / (1 + t**2)")
    forces = over_time(rows, (wave,) * 6)
    gravity, pressure = (
        draw(over_time(vectors(), wave)),
        draw(over_time(numbers(-9, 9), "amount * cos(2 * pi * t)")),
    )
    scene = {
        "control": draw(
            st.sampled_from(
                [
                    *(None, None, tc.ForceDensity(), tc.RestLength(), tc.RestLengthRate()),
                    tc.Winch(0.02, 1e-3, torque=2.0),
                ]
            )
        ),
        "segments": draw(
            st.one_of(
                st.integers(1, 2), st.lists(st.integers(1, 3), min_size=count, max_size=count)
            )
        ),
        "ends": draw(st.sampled_from(["interior", "lumped"])),
        "gravity": draw(st.one_of(st.none(), st.just(load(tc.Gravity, "acceleration", gravity)))),
        "ground": draw(
            st.one_of(st.none(), GROUND, st.lists(st.one_of(GROUND, TERRAIN), max_size=2))
        ),
        "pressure": draw(
            st.one_of(
                st.none(),
                st.just(load(tc.Pressure, "difference", pressure, faces=[(0, 1, 2), (2, 3, 4)])),
            )
        ),
        "forces": draw(
            st.one_of(st.none(), forces.map(lambda given: load(tc.NodalForce, "values", given)))
        ),
        "slack": draw(st.one_of(LAW, st.lists(LAW, min_size=count, max_size=count))),
    }
    if held:
        x, y, z = structure.nodes[held[0]].tolist()
        moved = TimeFormula(
            (f"({x!r}) + amount * sin(t)", y, f"({z!r}) - t**3"), (("amount", 0.2),)
        )
        scene["supports"] = draw(st.one_of(st.none(), st.just(tc.SupportMotion({held[0]: moved}))))
    if (
        draw(st.booleans())
        and not structure.rollers
        and not structure.fixed[structure.bars[0]].all()
    ):
        shared = (
            [{"bar_mass": "all"}] if len(set(structure.bar_mass.tolist())) == 1 else []
        )  # one entry for all needs one value
        groups = draw(st.sampled_from([{}, {"bar_mass": [[0]]}, *shared]))
        scene["parameters"] = tc.Parameters(
            "bar_mass",
            "node_mass",
            scale=("stiffness",) if count and scene["control"] != tc.ForceDensity() else (),
            groups=groups,
        )
    return tc.Scene(structure, **scene)

"""Options that a scene does not use add no instruction to its Functions."""

from __future__ import annotations

import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.dynamics.instruction_count import count_instructions


def make_scenes() -> dict[str, tc.Scene]:
    ground = tc.Ground(stiffness=1e4, damping=10.0)
    pendulum = tc.shapes.double_pendulum()
    prism = tc.shapes.prism(prestress=10.0)
    return {
        "prism": tc.Scene(prism, control=tc.RestLength()),
        "ball": tc.Scene(
            tc.shapes.six_bar_ball(), control=tc.ForceDensity(), gravity=tc.Gravity(), ground=ground
        ),
        "chain": tc.Scene(pendulum, gravity=tc.Gravity((0, -9.81, 0))),
    }


@pytest.mark.parametrize(
    ("name", "nx", "counts"),
    [
        ("prism", 36, (471, 584, 1912)),
        ("ball", 72, (910, 792, 3668)),
        ("chain", 12, (171, 97, 712)),
    ],
)
def test_scenes_keep_their_instruction_counts(name, nx, counts):
    model = tc.Model(make_scenes()[name])
    functions = model.ode, model.observe, tc.RungeKutta4().advance(model)
    assert model.nx == nx
    assert tuple(count_instructions(function) for function in functions) == counts


@pytest.mark.parametrize("name", ["prism", "ball"])
def test_strings_that_cannot_break_write_the_same_code(name, tmp_path):
    scene = make_scenes()[name]
    texts = []
    for k, strength in enumerate(
        (None, tc.Breaking(np.full(len(scene.structure.strings), np.inf)))
    ):
        model = tc.Model(tc.Scene(**{**vars_of(scene), "strength": strength}))
        tc.export_c(model, tmp_path / str(k))
        texts.append((tmp_path / str(k) / "tensegrity.c").read_text(encoding="utf-8"))
    assert texts[0] == texts[1]


def vars_of(scene: tc.Scene) -> dict[str, object]:
    return {name: getattr(scene, name) for name in scene.__dataclass_fields__}

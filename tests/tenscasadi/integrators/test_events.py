"""Events: switching functions, and the motion between two events."""

from __future__ import annotations

import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.events import build_mode_ode, build_switching
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, Linear, RestLength, Smooth, StringLaw
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure


@pytest.mark.parametrize(
    "slack",
    [Clip(), Clip("unclamped"), {0: Linear(), 5: Clip("unclamped"), 9: Smooth(0.01)}],
    ids=["clip", "unclamped", "mixed"],
)
def test_between_events_the_motion_is_that_of_the_ode(
    slack: StringLaw | dict[int, StringLaw],
) -> None:
    ball = shapes.six_bar_ball(prestress=10.0, damping=2.0)
    scene = Scene(
        ball,
        gravity=Gravity(),
        control=RestLength(),
        ground=Ground(damping=5.0, friction=0.4, height=-0.2),
        slack=slack,
    )
    rng = np.random.default_rng(1)
    for coordinates in ("reduced", "full"):
        model = Model(scene, coordinates)  # type: ignore[arg-type]
        gap, held = build_switching(model), build_mode_ode(model)
        assert gap is not None
        seen = set()
        for _ in range(10):
            x, u = model.initial_state + 0.2 * rng.normal(size=model.nx), model.initial_control
            mode = (gap(x, u) > 0).full().ravel()
            seen.update(mode.tolist())
            assert held(x, np.concatenate([u, mode])).full() == pytest.approx(
                model.ode(x, u).full(), rel=1e-9, abs=1e-9
            )
        assert seen == {0.0, 1.0}


def test_scenes_without_events_have_no_switching_function() -> None:
    prism = shapes.prism(prestress=10.0)
    for scene in (
        Scene(prism, control=ForceDensity()),
        Scene(prism, slack=Smooth(1e-3)),
        Scene(shapes.pendulum(), gravity=Gravity()),
    ):
        assert build_switching(Model(scene)) is None
    assert build_switching(Model(Scene(shapes.pendulum(), ground=Ground()))) is not None


def test_a_mode_counts_whatever_lengths_and_depths_say() -> None:
    slack = Structure(
        [(0, 0, 0), (1, 0, 0)],
        strings=[(0, 1)],
        node_mass=[0, 2.0],
        pinned=[0],
        stiffness=100.0,
        rest_length=1.25,
    )
    model = Model(Scene(slack, ground=Ground(stiffness=1e3, height=-0.5)))
    held = build_mode_ode(model)
    for taut, touching, expected in (
        (0, 0, (0, 0)),
        (1, 0, (12.5, 0)),
        (0, 1, (0, -250)),
        (1, 1, (12.5, -250)),
    ):
        mode = [taut, 0, touching]  # of the string, of the pinned node and of the other
        acceleration = held(model.initial_state, mode).full().ravel()[3:]
        assert acceleration == pytest.approx([expected[0], 0, expected[1]], rel=1e-12, abs=1e-12)

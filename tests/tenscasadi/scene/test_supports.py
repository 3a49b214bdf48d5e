"""Moved supports: exact acceleration terms, the same motion in both coordinates, their work in the energy balance."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import Projection
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure.structure import Structure

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])
CHAIN = Structure(
    [(0, 0, 0), (0.6, 0, -0.8), (1.0, 0, -1.6)],
    [(0, 1), (1, 2)],
    [(0, 2)],
    pinned=(0,),
    stiffness=50.0,
    rest_length=1.5,
)


def shaking(t: float) -> list[float]:
    return [0.1 * np.sin(5 * t), 0.05 * (1 - np.cos(3 * t)), 0.02 * t]


@BOTH
def test_an_accelerating_support_acts_like_gravity_the_other_way(coordinates: str) -> None:
    thrust = np.array([1.0, -2.0, 3.0])
    moving = Scene(
        CHAIN,
        gravity=Gravity((0, 0, -9.81)),
        supports=SupportMotion({0: lambda t: [a * t**2 / 2 for a in thrust]}),
    )
    standing = Scene(CHAIN, gravity=Gravity(np.array([0, 0, -9.81]) - thrust))
    paths = [
        simulate(Model(scene, coordinates), 1.0, 1e-3, correction=Projection())
        for scene in (moving, standing)
    ]  # type: ignore[arg-type]
    offset = thrust * paths[0].time[:, None] ** 2 / 2
    assert abs(paths[0].nodes - offset[:, None] - paths[1].nodes).max() < 1e-9
    assert (
        abs(
            paths[0].velocities - (thrust * paths[0].time[:, None])[:, None] - paths[1].velocities
        ).max()
        < 1e-8
    )


def test_both_coordinates_agree_on_a_shaken_chain_and_account_for_the_work() -> None:
    scene = Scene(
        CHAIN.replace(damping=0.2), gravity=Gravity(), supports=SupportMotion({0: shaking})
    )
    runs = [
        simulate(Model(scene, c), 1.0, 2e-4, correction=Projection()) for c in ("reduced", "full")
    ]  # type: ignore[arg-type]
    assert abs(runs[0].nodes - runs[1].nodes).max() < 1e-11
    for run in runs:
        assert np.allclose(run.nodes[-1, 0], shaking(1.0), atol=1e-12)
        assert run.bar_length_error.max() < 1e-15
        assert run.joint_error.max() < 1e-15
        assert np.ptp(run.energy) > 0.1  # the support works,
        assert abs(run.energy_error).max() < 1e-4  # and the balance knows


def test_states_take_the_velocity_of_the_support_and_symbols_see_it_move() -> None:
    model = Model(Scene(CHAIN, supports=SupportMotion({0: shaking})))
    x = model.initial_state
    assert np.allclose(model.velocities(x)[0], [0.5, 0, 0.02])
    stretching = np.sum(
        np.diff(model.nodes(x)[CHAIN.bars], axis=1)
        * np.diff(model.velocities(x)[CHAIN.bars], axis=1),
        axis=(1, 2),
    )
    assert abs(stretching).max() < 1e-15
    later = np.append(x[:-1], 0.7)
    assert np.allclose(model.nodes(np.stack([x, later]))[1, 0], shaking(0.7))
    symbol = ca.MX.sym("x", model.nx)
    assert np.allclose(
        ca.Function("N", [symbol], [model.nodes(symbol)])(later).full()[0], shaking(0.7)
    )


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: SupportMotion({}), r"SupportMotion\.positions"),
        (lambda: SupportMotion(shaking), r"SupportMotion\.positions"),
        (lambda: SupportMotion({0: (0, 0)}), r"SupportMotion\.positions\[0\]"),
        (lambda: Scene(CHAIN, supports=shaking), r"Scene\.supports"),
        (lambda: Scene(CHAIN, supports=SupportMotion({1: shaking})), r"node 1 is not pinned"),
        (lambda: Scene(CHAIN, supports=SupportMotion({7: shaking})), r"node 7"),
        (
            lambda: Scene(CHAIN, supports=SupportMotion({0: lambda t: [t + 1, 0, 0]})),
            r"positions\[0\]\(0\.0\)",
        ),
        (
            lambda: Scene(CHAIN, supports=SupportMotion({0: lambda t: [t, 0]})),
            r"positions\[0\] returns",
        ),
        (
            lambda: Scene(CHAIN, supports=SupportMotion({0: lambda t: [0 if t > 1 else 1, 0, 0]})),
            r"positions\[0\]\(0\.0\) is \[1\. 0\. 0\.\]: start at",
        ),
    ],
)
def test_bad_supports_are_refused_by_name(make: object, field: str) -> None:
    with pytest.raises((ValueError, TypeError), match=field):
        make()  # type: ignore[operator]

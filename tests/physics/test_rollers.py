"""Nodes that roll along any direction: closed forms, Lagrange's equations, and scenes that are turned as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from flights import G
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import ocp
import tenscasadi as tc

TURN = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
NODES = np.array([(0, 0, 0), (1, 0.2, -1), (2, 0.5, 0.3), (0.4, 1, 0.2)])
WEIGHT = np.array([0.5, -1.0, -9.0])


def turned(
    pinned: Any, turn: Any = None, coordinates: Any = "full", control: Any = None
) -> tc.Model:
    """Two joined bars and strings whose supports are along axes, or all of it turned."""
    given: dict[str, Any] = {
        "bars": [(0, 1), (1, 2)],
        "strings": [(0, 3), (2, 3)],
        "node_mass": [0, 0, 0.1, 0.5],
        "rest_length": 0.5,
        "damping": 1.0,
    }
    if turn is None:
        structure, gravity = tc.Structure(NODES, pinned=pinned, **given), WEIGHT
    else:
        normals = {
            node: [turn[:, "xyz".index(axis)] for axis in axes] for node, axes in pinned.items()
        }
        structure, gravity = tc.Structure(NODES @ turn.T, rollers=normals, **given), turn @ WEIGHT
    return tc.Model(tc.Scene(structure, gravity=tc.Gravity(gravity), control=control), coordinates)


SCHEMES = [
    (tc.RungeKutta4(), None, 1e-11),
    (tc.RungeKutta4(), tc.Projection(), 1e-11),
    (tc.RungeKutta4(), tc.BarLengthCorrection(), 1e-11),
    (tc.Rattle(), None, 1e-9),
    (tc.Collocation(2), None, 1e-8),
    (tc.DormandPrince54(rtol=1e-9), None, 1e-8),
    (tc.Cvodes(rtol=1e-9, atol=1e-9), None, 1e-6),
    (tc.Idas(rtol=1e-9, atol=1e-9), None, 1e-6),
]


@pytest.mark.parametrize(
    ("pinned", "scheme", "correction", "bound"),
    [({0: "z", 2: "xy"}, *scheme) for scheme in SCHEMES] + [({3: "xz"}, *SCHEMES[0])],
)
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_what_is_turned_moves_turned(
    pinned: dict[int, str], scheme: Any, correction: Any, bound: float, coordinates: Any
) -> None:
    if coordinates == "reduced" and isinstance(correction, tc.BarLengthCorrection):
        with pytest.raises(ValueError, match="BarLengthCorrection moves bars one by one"):
            tc.simulate(turned(pinned, TURN, coordinates), 0.1, 2e-3, scheme, correction=correction)
        return
    plain, other = (
        tc.simulate(
            turned(pinned, turn, coordinates),
            0.3,
            2e-3,
            scheme,
            correction=correction,
            compiled=False,
        )
        for turn in (None, TURN)
    )
    assert other.success, other.message
    assert np.abs(plain.nodes @ TURN.T - other.nodes).max() < bound
    assert np.abs(plain.nodes - plain.nodes[0]).max() > 0.1
    start = NODES @ TURN.T
    for node, axes in pinned.items():
        normals = TURN[:, ["xyz".index(axis) for axis in axes]]
        assert np.abs((other.nodes[:, node] - start[node]) @ normals).max() < max(
            1e-9, 2 * plain.joint_error.max()
        )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_reactions_vibrations_and_linearised_steps_are_turned_too(coordinates: Any) -> None:
    pinned = {0: "z", 2: "xy"}
    plain, other = turned(pinned, None, coordinates), turned(pinned, TURN, coordinates)
    one, two = (model.multipliers(model.initial_state) for model in (plain, other))
    assert np.abs(one.bar_force_density - two.bar_force_density).max() < 1e-12
    assert np.abs(TURN @ one.joint_force - two.joint_force).max() < 1e-12
    assert np.abs(one.joint_force[:, -2:]).max() > 1
    assert np.abs(tc.modes(plain).frequency - tc.modes(other).frequency).max() < 1e-9
    assert tc.stable_step(other) == pytest.approx(tc.stable_step(plain), rel=1e-9)
    assert plain.nx == other.nx


def test_rollers_carry_their_share_of_an_equilibrium() -> None:
    nodes = np.array([(0, 0, 0), (2, 0, 0), (1, 0, -1.0)])
    loads = np.array([(0, 0, 0.5), (0, 0, 0.5), (0, 0, -1.0)])
    for turn in (np.eye(3), TURN):
        rollers = {0: turn[:, :2].T, 1: turn[:, :2].T, 2: turn[:, 1]}
        hung = tc.Structure(
            nodes @ turn.T, strings=[(0, 2), (1, 2)], node_mass=1.0, rollers=rollers
        )
        assert tc.equilibrium_force_density(
            hung, loads=loads @ turn.T, minimum=0.1
        ) == pytest.approx([0.5, 0.5], abs=1e-12)
        free = hung.replace(rollers={}, pinned={})
        with pytest.raises(tc.EquilibriumError):
            tc.equilibrium_force_density(free, loads=loads @ turn.T, minimum=0.1)


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
@pytest.mark.parametrize("degrees", [20.0, 65.0])
def test_a_bead_on_an_inclined_line_falls_as_on_a_slope(degrees: float, coordinates: Any) -> None:
    angle = np.radians(degrees)
    across = [(np.sin(angle), 0, -np.cos(angle)), (0, 1, 0)]
    bead = tc.Structure([(1, 2, 3)], node_mass=2.5, rollers={0: across})
    model = tc.Model(tc.Scene(bead, gravity=tc.Gravity((0, 3.0, -G))), coordinates)
    run = tc.simulate(model, 1.5, 1e-2, compiled=False)
    along = np.array([np.cos(angle), 0, np.sin(angle)])
    fallen = -G * np.sin(angle) * run.time**2 / 2
    assert np.abs(run.nodes[:, 0] - [1, 2, 3] - np.outer(fallen, along)).max() < 1e-12
    assert model.nx == {"reduced": 2, "full": 6}[coordinates]
    if coordinates == "reduced":  # where a structure has no bars it has no class-one nodes
        return
    reaction = model.multipliers(run.states[-1]).joint_force[:, 0]
    assert reaction == pytest.approx(
        2.5 * (np.array([0, -3.0, G]) - G * np.sin(angle) * along), abs=1e-12
    )


@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_a_pendulum_whose_pivot_slides_down_an_incline_follows_lagrange(coordinates: Any) -> None:
    angle, cart, mass, length, end = np.radians(25.0), 0.7, 1.3, 0.8, 1.5
    slope = np.array([np.cos(angle), 0, np.sin(angle)])
    swing = 0.9
    foot = length * np.array([np.sin(swing), 0, -np.cos(swing)])
    structure = tc.Structure(
        [(0, 0, 0), foot],
        bars=[(0, 1)],
        bar_mass=mass,
        node_mass=[cart, 0],
        rollers={0: (-np.sin(angle), 0, np.cos(angle))},
    )
    model = tc.Model(tc.Scene(structure, gravity=tc.Gravity((0, 0, -G))), coordinates)
    run = tc.simulate(model, end, 1e-3, tc.DormandPrince853(rtol=1e-12), compiled=False)

    def lagrange(
        t: float, y: Any
    ) -> (
        Any
    ):  # way s up the slope and angle φ of a thin rod: T = ½(M+m)ṡ² + ½ m l ṡ φ̇ e·d' + m l² φ̇²/6
        phi = y[1]
        first, second = (
            np.array([np.cos(phi), 0, np.sin(phi)]),
            np.array([-np.sin(phi), 0, np.cos(phi)]),
        )
        coupling = mass * length / 2 * (slope @ first)
        matrix = [[cart + mass, coupling], [coupling, mass * length**2 / 3]]
        forces = [
            -(cart + mass) * G * np.sin(angle) - mass * length / 2 * (slope @ second) * y[3] ** 2,
            -mass * G * length / 2 * np.sin(phi),
        ]
        return [y[2], y[3], *np.linalg.solve(matrix, forces)]

    s, phi = solve_ivp(lagrange, (0, end), (0, swing, 0, 0), "DOP853", rtol=1e-12, atol=1e-13).y[
        :2, -1
    ]
    assert run.nodes[-1, 0] == pytest.approx(s * slope, abs=1e-9)
    assert run.nodes[-1, 1] - run.nodes[-1, 0] == pytest.approx(
        length * np.array([np.sin(phi), 0, -np.cos(phi)]), abs=1e-9
    )
    assert np.abs(run.energy_error).max() < 1e-10


def test_a_plan_with_rollers_is_that_of_the_scene_before_it_was_turned() -> None:
    plans = []
    for turn in (None, TURN):
        model = (
            turned({0: "xyz", 1: "y", 2: "yz"}, turn, "reduced", tc.ForceDensity())
            if turn is None
            else _pinned_and_rolling(turn)
        )
        problem = ocp.Problem(
            model,
            0.3,
            goals=[ocp.StringLengths({0: 1.0})],
            bounds=[ocp.ForceDensityLimits(0.0, 200.0)],
            costs=[ocp.Effort()],
        )
        plans.append(ocp.solve(problem, ocp.Variational(15), ocp.Ipopt(tolerance=1e-9)))
    assert all(plan.success for plan in plans), [plan.message for plan in plans]
    assert plans[1].objective == pytest.approx(plans[0].objective, rel=1e-4)
    assert np.abs(plans[0].trajectory.nodes @ TURN.T - plans[1].trajectory.nodes).max() < 1e-5


def _pinned_and_rolling(turn: Any) -> tc.Model:
    """The scene of the test above, turned: what is pinned along all axes stays pinned."""
    plain = turned({0: "xyz", 1: "y", 2: "yz"}).scene.structure
    structure = plain.replace(
        nodes=NODES @ turn.T, pinned=[0], rollers={1: turn[:, 1], 2: turn[:, 1:].T}
    )
    return tc.Model(
        tc.Scene(structure, gravity=tc.Gravity(turn @ WEIGHT), control=tc.ForceDensity())
    )

"""Prestress design: optima, limits under load cases, and clear failures."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import gamma_of, unbalanced
from scipy.optimize import minimize_scalar

import tenscasadi as tc


def stiffness(s: tc.Structure, q: np.ndarray) -> float:
    """Least tangent stiffness on motions that keep rigid bars, with dense matrices."""
    pairs = np.concatenate([s.strings, s.bars])
    n = len(s.nodes)
    K, J = np.zeros((3 * n, 3 * n)), []
    for k, (a, b) in enumerate(pairs):
        d = np.zeros((3, 3 * n))
        d[:, 3 * a : 3 * a + 3], d[:, 3 * b : 3 * b + 3] = -np.eye(3), np.eye(3)
        u = s.nodes[b] - s.nodes[a]
        u = u / np.linalg.norm(u)
        K += q[k] * d.T @ d
        if k < len(s.strings):
            K += (s.stiffness[k] - q[k]) * np.outer(u @ d, u @ d)
        else:
            J.append(u @ d)
    free = np.flatnonzero(~s.fixed.ravel())
    rows = [row[free] for row in J]
    if not s.fixed.any():
        arms = s.nodes - s.nodes.mean(axis=0)
        rows += [np.tile(axis, n) for axis in np.eye(3)]
        rows += [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    Z = np.linalg.svd(np.array(rows).reshape(-1, len(free)))[2]
    Z = Z[np.linalg.matrix_rank(np.array(rows)) if rows else 0 :].T
    return float(np.linalg.eigvalsh(Z.T @ K[np.ix_(free, free)] @ Z)[0])


@pytest.mark.parametrize("goal", [tc.Stiffest(), tc.Even(), tc.Least()])
def test_prism_has_one_prestress(goal) -> None:
    s = tc.shapes.prism(stiffness=1000.0)
    pre = tc.find_prestress(s, goal, minimum=20.0, maximum=60.0)
    assert pre.success, pre.message
    np.testing.assert_allclose(pre.force_density[6:] / pre.force_density[0], np.sqrt(3), rtol=1e-7)
    np.testing.assert_allclose(pre.tension, pre.force_density * s.string_lengths)
    np.testing.assert_allclose(pre.bar_force / s.bar_lengths, -pre.force_density[6:], rtol=1e-7)
    end = 60.0 if isinstance(goal, tc.Stiffest) else 20.0
    reached = pre.tension.max() if isinstance(goal, tc.Stiffest) else pre.tension.min()
    assert reached == pytest.approx(end, rel=1e-9)
    q = np.concatenate([pre.force_density, pre.bar_force / s.bar_lengths])
    assert pre.least_stiffness == pytest.approx(stiffness(s, q), rel=1e-7)
    np.testing.assert_allclose(gamma_of(pre.structure), pre.force_density, rtol=1e-9)
    assert unbalanced(pre.structure, pre.force_density) < 1e-7


def test_least_prestress_of_a_symmetric_dome_settles_under_load() -> None:
    """Its program has many solutions, which respond to the load in different ways."""
    dome = tc.shapes.levy_dome(12, 3)
    load = np.zeros(dome.nodes.shape)
    load[:, 2] = -10.0
    pre = tc.find_prestress(dome, tc.Least(), load_cases=[load], minimum=10.0)
    assert pre.success, pre.message
    pulls = np.concatenate([pre.force_density, -pre.bar_force / dome.bar_lengths])
    moved = tc.stability(dome, force_density=pulls).displacement(load)
    a, b = dome.strings.T
    along = (dome.nodes[b] - dome.nodes[a]) / dome.string_lengths[:, None]
    longer = np.sum((moved[b] - moved[a]) * along, axis=1)
    tension = pre.tension + dome.stiffness * longer
    assert min(tension.min(), pre.tension.min()) == pytest.approx(10.0, rel=1e-5)


def test_load_that_needs_an_unstable_prestress_is_named() -> None:
    arm = tc.shapes.arm()
    load = np.zeros(arm.nodes.shape)
    load[:, 2] = -1.0
    pre = tc.find_prestress(arm, tc.Even(), load_cases=[load], minimum=5.0)
    assert not pre.success
    assert "unstable" in pre.message


def test_stiffest_prestress_of_a_symmetric_dome_tells_its_gap() -> None:
    """Accumulating all motions takes minutes; its stiffness is 9.4354 N/m then."""
    dome = tc.shapes.levy_dome(12, 3)
    pre = tc.find_prestress(dome, tc.Stiffest(), maximum=1000.0)
    assert pre.success, pre.message
    assert pre.least_stiffness == pytest.approx(9.4354, rel=1e-4)
    assert "of the largest" in pre.message
    assert pre.tension.min() > -1e-6
    assert pre.tension.max() <= 1000.0 * (1 + 1e-9)


@pytest.mark.slow
def test_stiffest_prestress_settles_under_a_load() -> None:
    ball = tc.shapes.truncated_tetrahedron(pinned=[0, 1, 2])
    load = np.zeros(ball.nodes.shape)
    load[:, 2] = -1.0
    pre = tc.find_prestress(ball, tc.Stiffest(), load_cases=[load], minimum=5.0, maximum=300.0)
    assert pre.success, pre.message
    assert pre.tension.max() <= 300.0 * (1 + 1e-6)


def test_stiffest_prestress_beats_all_others_of_a_tower() -> None:
    s = tc.shapes.prism_tower(2, height=0.6, stiffness=300.0)
    maximum = np.where(np.arange(15) < 6, 40.0, 100.0)
    pre = tc.find_prestress(s, tc.Stiffest(), maximum=maximum)
    assert pre.success, pre.message
    basis = tc.self_stress(s) * np.repeat([1.0, -1.0], [15, 6])
    assert len(basis) == 2

    def least(angle: float) -> float:
        q = np.array([np.cos(angle), np.sin(angle)]) @ basis
        tension = q[:15] * s.string_lengths
        if tension.max() <= 0.0 or tension.min() < -1e-9:
            return 0.0
        return -stiffness(s, q * np.min(maximum / np.maximum(tension, 1e-9)))

    grid = np.linspace(-np.pi, np.pi, 721)
    start = grid[np.argmin([least(angle) for angle in grid])]
    best = minimize_scalar(least, bounds=(start - 0.01, start + 0.01), method="bounded")
    assert pre.least_stiffness >= -best.fun * (1 - 1e-6)


def test_even_prestress_has_least_deviation() -> None:
    s = tc.shapes.prism_tower(3, stiffness=1000.0)
    pre = tc.find_prestress(s, tc.Even(), minimum=10.0)
    basis = tc.self_stress(s)[:, : len(s.strings)] * s.string_lengths
    rng = np.random.default_rng(0)
    for _ in range(200):
        other = pre.tension + 0.5 * rng.normal(size=len(basis)) @ basis
        if other.min() >= 10.0:
            assert np.var(other) >= np.var(pre.tension) * (1 - 1e-9)
    assert pre.tension.min() == pytest.approx(10.0)


def test_even_prestress_of_a_net_is_uniform_in_the_least_scale() -> None:
    pre = tc.find_prestress(tc.shapes.hyperbolic_paraboloid(5), tc.Even(), minimum=3.0)
    np.testing.assert_allclose(pre.tension, 3.0, rtol=1e-9)


def test_least_prestress_keeps_strings_taut_under_loads() -> None:
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (3, 0, 0)],
        strings=[(0, 1), (1, 2)],
        pinned=[0, 2],
        node_mass=1.0,
        stiffness=[300.0, 100.0],
    )
    push = np.zeros((3, 3))
    push[1, 0] = 40.0
    pre = tc.find_prestress(s, tc.Least(), [push, -push])
    assert pre.success, pre.message
    np.testing.assert_allclose(pre.tension, 30.0)  # what the stiffer string unloads by
    pre = tc.find_prestress(s, tc.Least(), [push], minimum=5.0)
    np.testing.assert_allclose(pre.tension, 15.0)  # the softer string unloads by 10 N
    pre = tc.find_prestress(s, tc.Stiffest(), [push, -push], minimum=5.0, maximum=100.0)
    np.testing.assert_allclose(pre.tension, 70.0)  # 30 N are left for the load


@pytest.mark.parametrize("minimum", [0.0, 10.0, 1000.0])
@pytest.mark.parametrize("goal", [tc.Least(), tc.Even()])
def test_prestress_of_a_dome_settles_under_snow(goal, minimum: float) -> None:
    dome = tc.shapes.levy_dome(segments=8, hoops=1, stiffness=1e6)
    for factor in (0.1, 0.9, 1.0, 1.1):
        snow = np.where(dome.fixed, 0.0, [0.0, 0.0, -500.0 * factor])
        pre = tc.find_prestress(dome, goal, [snow], minimum=minimum)
        assert pre.success, pre.message


def test_load_on_pins_alone_changes_no_tension() -> None:
    held = tc.shapes.prism(pinned=range(6))
    pre = tc.find_prestress(held, tc.Least(), [np.ones((6, 3))], minimum=2.0)
    assert pre.success, pre.message
    np.testing.assert_allclose(pre.tension, 2.0)


def test_limits_hold_at_the_equilibrium_under_load() -> None:
    s = tc.shapes.prism(diagonals=True, stiffness=1e5, pinned=[0, 1, 2])
    load = np.zeros((6, 3))
    load[3:] = (3.0, -5.0, -10.0)
    pre = tc.find_prestress(s, tc.Least(), [load, -load], minimum=2.0)
    assert pre.success, pre.message
    lowest = np.inf
    for sign in (1, -1):
        eq = tc.find_equilibrium(tc.Scene(pre.structure, forces=tc.NodalForce(sign * load)))
        assert eq.success, eq.message
        lowest = min(lowest, float(eq.tension.min()))
    free = [k for k, pair in enumerate(s.strings.tolist()) if not set(pair) <= {0, 1, 2}]
    assert lowest == pytest.approx(2.0, abs=0.01)
    assert pre.tension[free].min() > 2.5


def test_groups_share_their_force_density() -> None:
    s = tc.shapes.prism(diagonals=True, stiffness=1000.0)
    groups = [range(6), range(6, 9), range(9, 12)]
    pre = tc.find_prestress(s, tc.Even(), minimum=1.0, groups=groups)
    assert pre.success, pre.message
    for group in groups:
        np.testing.assert_allclose(pre.force_density[group], pre.force_density[group[0]], rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "given", "message"),
    [
        (tc.shapes.membrane, {"goal": tc.Even(), "minimum": 1.0}, "no self-stress: add members"),
        (tc.shapes.membrane, {"maximum": 1.0}, "no self-stress: add members"),
        (
            tc.shapes.prism,
            {"goal": tc.Least(), "minimum": 5.0, "maximum": 6.0},
            "no self-stress keeps all strings within the limits",
        ),
        (tc.shapes.geiger_dome, {}, "without limit: give a maximum"),
        (
            tc.shapes.prism,
            {"goal": tc.Least(), "minimum": 1.0, "load_cases": [np.eye(6)[:, :3]]},
            "load case 0 moves the structure as a whole",
        ),
    ],
)
def test_prestress_that_does_not_exist_has_a_reason(make, given, message: str) -> None:
    pre = tc.find_prestress(make(stiffness=1000.0), **given)
    assert not pre.success
    assert message in pre.message
    assert np.all(np.isfinite(pre.tension))
    assert np.isfinite(pre.least_stiffness)


def test_unstable_prestress_is_no_success() -> None:
    pre = tc.find_prestress(tc.shapes.d_bar(), tc.Even(), minimum=1.0)
    assert not pre.success
    assert pre.tension.min() >= 1.0 - 1e-9
    assert pre.least_stiffness < 0
    assert "unstable" in pre.message


def test_stiffest_prestress_without_motions_is_within_limits() -> None:
    pre = tc.find_prestress(tc.shapes.prism(pinned=range(6)), minimum=1.0, maximum=5.0)
    assert pre.success, pre.message
    assert pre.least_stiffness == np.inf
    assert 1.0 - 1e-9 <= pre.tension.min() <= pre.tension.max() <= 5.0 + 1e-9


def test_stiffness_within_rounding_is_none() -> None:
    nodes = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1, 0)]
    loose = tc.Structure(nodes, bars=[(1, 3)], strings=[(0, 1), (1, 2)], pinned=[0, 2])
    pre = tc.find_prestress(loose, tc.Even(), minimum=1.0)  # the bar turns about its node
    assert not pre.success
    assert abs(pre.least_stiffness) < 1e-9
    pinned = loose.replace(pinned=[0, 2, 3])
    assert tc.find_prestress(pinned, tc.Even(), minimum=1.0).success


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"goal": tc.Even()}, "minimum is 0: Even needs a minimum above 0 N"),
        ({"goal": "Even"}, r"goal is 'Even': give Stiffest\(\), Even\(\) or Least\(\)"),
        ({"minimum": -1.0}, "minimum of string 0 is -1: it must be at least 0"),
        ({"minimum": 3.0, "maximum": 2.0}, "maximum of string 0 is 2 N: it must be at least"),
        ({"load_cases": [np.zeros((5, 3))]}, r"load_cases\[0\] has shape \(5, 3\)"),
        ({"load_cases": 3}, "load_cases is 3: give a list"),
        ({"minimum": np.nan}, "minimum is nan"),
    ],
)
def test_wrong_input_is_named(given, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        tc.find_prestress(tc.shapes.prism(), **given)


def plate_on_strings(cables=()) -> tc.Structure:
    """Twelve strings hold a triangular plate from above and below."""
    angle = np.deg2rad([90, 210, 330])
    around = [
        np.column_stack([r * np.cos(angle + turn), r * np.sin(angle + turn), np.full(3, z)])
        for r, turn, z in ((0.4, 0.0, 0.0), (0.8, np.pi / 3, 1.0), (0.8, np.pi / 3, -1.0))
    ]
    strings = [(k, 3 + k) for k in range(3)] + [(0, 5), (1, 3), (2, 4)]
    strings += [(a, b + 3) for a, b in strings]
    plate = tc.RigidBody((0, 1, 2), mass=3.0, inertia=(0.1, 0.1, 0.2))
    return tc.Structure(
        np.vstack(around),
        strings=strings,
        pinned=range(3, 9),
        stiffness=2000.0,
        bodies=[plate],
        cables=cables,
    )


@pytest.mark.parametrize("goal", [tc.Stiffest(), tc.Even(), tc.Least()])
@pytest.mark.parametrize(
    "s",
    [
        tc.shapes.prism(stiffness=1e3, cables=[[0, 1]]),
        plate_on_strings(),
        plate_on_strings(cables=[[0, 3], [1, 4], [2, 5]]),
    ],
    ids=["prism", "plate", "plate on cables"],
)
def test_prestress_of_cables_and_bodies(goal, s: tc.Structure) -> None:
    pre = tc.find_prestress(s, goal, minimum=5.0, maximum=60.0)
    assert pre.success, pre.message
    for cable in s.cables:
        np.testing.assert_allclose(pre.tension[list(cable)], pre.tension[cable[0]])
    st = tc.stability(pre.structure)
    assert st.residual < 1e-6 * pre.tension.max()
    assert pre.least_stiffness == pytest.approx(st.eigenvalues[0], rel=1e-6)
    eq = tc.find_equilibrium(tc.Scene(pre.structure))
    assert eq.success, eq.message
    np.testing.assert_allclose(eq.tension, pre.tension, rtol=1e-6)


def test_prestress_keeps_strings_of_a_loaded_plate_taut() -> None:
    s = plate_on_strings()
    load = np.zeros((9, 3))
    load[0] = (1.0, 0.5, -3.0)
    pre = tc.find_prestress(s, tc.Least(), [load], minimum=0.5)
    assert pre.success, pre.message
    eq = tc.find_equilibrium(tc.Scene(pre.structure, forces=tc.NodalForce(load)))
    assert eq.tension.min() == pytest.approx(0.5, abs=1e-3)


def test_groups_with_strings_of_a_cable_are_rejected() -> None:
    s = tc.shapes.prism(cables=[[0, 1]])
    with pytest.raises(ValueError, match="groups has string 0, and strings of a cable"):
        tc.find_prestress(s, tc.Least(), minimum=1.0, groups=[[0, 2]])


def test_friction_of_cables_is_rejected() -> None:
    s = tc.shapes.prism(cables=[[0, 1]], cable_friction=0.1)
    with pytest.raises(
        ValueError, match=r"cable_friction of cable 0 is 0\.1, which find_prestress"
    ):
        tc.find_prestress(s, tc.Least(), minimum=1.0)


def test_stiffest_without_any_stiffness_fails_at_once() -> None:
    s = tc.shapes.prism(stiffness=1e3, cables=[[0, 1, 2], [3, 4, 5]])
    pre = tc.find_prestress(s, tc.Stiffest(), maximum=50.0)
    assert not pre.success
    assert "unstable within the limits" in pre.message


def test_stiffest_prestress_without_limit_asks_for_a_maximum():
    for dome in (tc.shapes.levy_dome(8, 2), tc.shapes.levy_dome(12, 3)):
        found = tc.find_prestress(dome, goal=tc.Stiffest())
        assert not found.success
        assert "give a maximum" in found.message


@pytest.mark.parametrize("pinned", [(), (0, 1, 2)])
def test_separate_parts_are_named(pinned: tuple[int, ...]) -> None:
    prism = tc.shapes.prism()
    two = tc.Structure(
        np.vstack([prism.nodes, prism.nodes + 5]),
        np.vstack([prism.bars, prism.bars + 6]),
        np.vstack([prism.strings, prism.strings + 6]),
        pinned=pinned,
    )
    pre = tc.find_prestress(two, tc.Even(), minimum=1.0)
    assert not pre.success
    assert "no member connects one part" in pre.message
    held = tc.find_prestress(two.replace(pinned=[0, 1, 2, 6, 7, 8]), tc.Even(), minimum=1.0)
    assert held.success, held.message

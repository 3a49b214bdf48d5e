"""Form finding: published forms, prescribed properties, and clear failures."""

from __future__ import annotations

import numpy as np
import pytest
from equilibrium import unbalanced
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st

import tenscasadi as tc


def polygon(n: int) -> tc.Structure:
    """Regular polygon of n cables, with its diameters as struts."""
    angles = 2 * np.pi * np.arange(n) / n
    nodes = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)])
    return tc.Structure(
        nodes,
        bars=[(i, i + n // 2) for i in range(n // 2)],
        strings=[(i, (i + 1) % n) for i in range(n)],
    )


def disturb(structure: tc.Structure, size: float, seed: int = 0) -> tc.Structure:
    change = np.random.default_rng(seed).normal(size=structure.nodes.shape) * size
    return structure.replace(nodes=structure.nodes + np.where(structure.fixed, 0.0, change))


def residual(form: tc.Form) -> float:
    """Largest unbalanced force of a form, from its own numbers."""
    s = form.structure
    q = np.concatenate([form.force_density, form.bar_force / s.bar_lengths])
    C = np.vstack([s.C_s, s.C_b])
    return float(np.abs((C.T @ (q[:, None] * (C @ s.nodes)))[~s.fixed]).max())


@pytest.mark.parametrize(("bars", "ratio"), [(3, 1.0), (4, 1.0), (6, 0.7), (9, 1.4)])
def test_prism_finds_its_twist_and_radii(bars: int, ratio: float) -> None:
    edge = 2 * np.sin(np.pi / bars)
    density = np.repeat([ratio / edge, 1 / (ratio * edge), 1.0], bars)
    start = tc.shapes.prism(bars, twist=np.pi / 2 + np.pi / bars + 0.3)
    form = tc.form_find(start, density)
    assert form.success, form.message
    np.testing.assert_allclose(form.bar_force / form.structure.bar_lengths, -1.0, rtol=1e-9)
    np.testing.assert_allclose(form.structure.bar_lengths, start.bar_lengths, rtol=1e-9)
    np.testing.assert_array_equal(form.force_density, density)
    nodes = form.structure.nodes - form.structure.nodes.mean(axis=0)
    ends = nodes[:bars] - nodes[:bars].mean(axis=0), nodes[bars:] - nodes[bars:].mean(axis=0)
    sizes = [np.linalg.norm(each, axis=1) for each in ends]
    np.testing.assert_allclose(sizes[1] / sizes[0], ratio, rtol=1e-8)
    turn = np.sum(ends[0] * np.roll(ends[1], -1, axis=0), axis=1) / (sizes[0] * sizes[1])
    np.testing.assert_allclose(turn, np.cos(np.pi / 2 + np.pi / bars), atol=1e-8)


@pytest.mark.parametrize("bars", [3, 5])
def test_prism_finds_the_force_density_of_its_verticals(bars: int) -> None:
    start = tc.shapes.prism(bars, twist=np.pi / 2 + np.pi / bars - 0.2)
    form = tc.form_find(start, [2.0] * (2 * bars) + [np.nan] * bars)
    assert form.success, form.message
    np.testing.assert_allclose(form.force_density[2 * bars :], 4 * np.sin(np.pi / bars), rtol=1e-8)
    np.testing.assert_allclose(form.structure.bar_lengths, start.bar_lengths, rtol=1e-9)


@pytest.mark.parametrize("n", [4, 6, 8])
def test_polygon_finds_the_force_of_its_diameters(n: int) -> None:
    form = tc.form_find(polygon(n), np.ones(n))
    assert form.success, form.message
    density = form.bar_force / form.structure.bar_lengths
    np.testing.assert_allclose(density, -(1 - np.cos(2 * np.pi / n)), rtol=1e-9)


@pytest.mark.parametrize(
    ("make", "bar"),
    [
        (tc.shapes.six_bar_ball, -1.5),
        (tc.shapes.truncated_tetrahedron, -0.5746094703),
        (tc.shapes.truncated_icosahedron, -0.3819660113),
    ],
)
def test_ball_of_equal_force_densities_is_found_from_disturbed_nodes(make, bar: float) -> None:
    start = disturb(make(bar_length=2.0), 0.05)
    strings = len(start.strings)
    bars = range(strings, strings + len(start.bars))
    form = tc.form_find(start, np.ones(strings), groups=[bars])
    assert form.success, form.message
    np.testing.assert_allclose(form.bar_force / form.structure.bar_lengths, bar, rtol=1e-8)
    assert residual(form) < 1e-9
    assert np.ptp(form.structure.bar_lengths / start.bar_lengths) < 0.2


def test_affine_form_keeps_bar_lengths_and_stays_near() -> None:
    start = tc.shapes.six_bar_ball()
    lengths = np.array([1.0, 1.0, 1.1, 1.1, 0.9, 0.9])
    middle = start.nodes.reshape(6, 2, 3).mean(axis=1, keepdims=True)
    spread = middle + (start.nodes.reshape(6, 2, 3) - middle) * lengths[:, None, None]
    form = tc.form_find(start.replace(nodes=spread.reshape(-1, 3)), np.ones(24))
    assert form.success, form.message
    np.testing.assert_allclose(form.structure.bar_lengths, lengths, rtol=1e-9)
    assert np.abs(form.structure.nodes - spread.reshape(-1, 3)).max() < 0.06
    np.testing.assert_allclose(form.structure.nodes.mean(axis=0), 0.0, atol=1e-8)


def test_net_follows_the_linear_force_density_method() -> None:
    net = disturb(tc.shapes.hyperbolic_paraboloid(6), 0.1)
    density = np.random.default_rng(1).uniform(0.5, 3.0, len(net.strings))
    form = tc.form_find(net, density)
    assert form.success, form.message
    free = ~net.fixed.all(axis=1)
    D = net.C_s.T @ np.diag(density) @ net.C_s
    expected = np.linalg.solve(D[np.ix_(free, free)], -D[np.ix_(free, ~free)] @ net.nodes[~free])
    np.testing.assert_allclose(form.structure.nodes[free], expected, atol=1e-12)
    np.testing.assert_array_equal(form.structure.nodes[~free], net.nodes[~free])


def test_net_hangs_under_loads() -> None:
    net = tc.shapes.hyperbolic_paraboloid(2, rise=0.0)
    loads = np.zeros((9, 3))
    loads[4, 2] = -6.0
    form = tc.form_find(net, np.full(4, 3.0), loads=loads)
    np.testing.assert_allclose(form.structure.nodes[4], [0.0, 0.0, -0.5], atol=1e-14)


def test_roller_stays_on_its_plane() -> None:
    s = tc.Structure(
        [(0, 0, 0), (2, 0, 0), (1, 1, 1)],
        strings=[(0, 2), (1, 2)],
        pinned=[0, 1],
        node_mass=1.0,
        rollers={2: (0, 1, 1)},
    )
    form = tc.form_find(s, [1.0, 3.0])
    x, y, z = form.structure.nodes[2]
    assert x == pytest.approx(1.5)
    assert y + z == pytest.approx(2.0)
    assert y == pytest.approx(z)  # of all places, where its strings pull along the normal


def test_prescribed_lengths_and_positions_are_met() -> None:
    net = tc.shapes.hyperbolic_paraboloid(6)
    form = tc.form_find(net, lengths={0: 0.4, 7: 0.42})
    assert form.success, form.message
    np.testing.assert_allclose(form.structure.string_lengths[[0, 7]], [0.4, 0.42], rtol=1e-9)
    assert form.force_density.min() >= 0.0
    assert residual(form) < 1e-9
    form = tc.form_find(
        disturb(net, 0.05), positions={24: (0.02, None, 0.01), 17: (None, 0.3, None)}
    )
    assert form.success, form.message
    assert form.structure.nodes[24][[0, 2]] == pytest.approx([0.02, 0.01], abs=1e-9)
    assert form.structure.nodes[17, 1] == pytest.approx(0.3, abs=1e-9)
    assert residual(form) < 1e-9


def test_prescribed_length_shapes_a_free_structure() -> None:
    prism = tc.shapes.prism()
    lengths = dict.fromkeys(range(6), 0.7)
    form = tc.form_find(prism, lengths=lengths)
    assert form.success, form.message
    np.testing.assert_allclose(form.structure.string_lengths[:6], 0.7, rtol=1e-9)
    np.testing.assert_allclose(form.structure.bar_lengths, prism.bar_lengths, rtol=1e-9)
    twist = tc.shapes.prism(radius=0.7 / np.sqrt(3), height=prism.nodes[3, 2])
    assert residual(form) < 1e-9
    assert form.force_density[8] / form.force_density[0] == pytest.approx(np.sqrt(3), rel=1e-8)
    assert len(twist.bars) == 3


def test_groups_share_their_force_density() -> None:
    start = disturb(tc.shapes.prism(4), 0.05)
    form = tc.form_find(start, groups=[range(8), range(8, 12), range(12, 16)])
    assert form.success, form.message
    for part in (form.force_density[:8], form.force_density[8:12]):
        np.testing.assert_allclose(part, part[0], rtol=1e-12)
    assert form.force_density.mean() == pytest.approx(1.0)
    np.testing.assert_allclose(form.bar_force / form.structure.bar_lengths, -form.force_density[8])


def test_equal_tensions_make_a_geodesic_net() -> None:
    net = tc.shapes.hyperbolic_paraboloid(4)
    form = tc.form_find(net, equal_tension=[range(len(net.strings))])
    assert form.success, form.message
    tension = form.force_density * form.structure.string_lengths
    np.testing.assert_allclose(tension, tension[0], rtol=1e-9)


def test_forms_come_prestressed_where_stiffness_allows() -> None:
    form = tc.form_find(tc.shapes.prism(twist=2.4, stiffness=50.0), [10.0] * 6 + [300.0**0.5] * 3)
    s = form.structure
    gamma = s.stiffness * (1 - s.rest_length / s.string_lengths)
    np.testing.assert_allclose(gamma, form.force_density, rtol=1e-9)
    assert unbalanced(s, gamma) < 1e-8
    soft = tc.form_find(tc.shapes.prism(stiffness=5.0), [10.0] * 6 + [300.0**0.5] * 3)
    assert soft.success
    np.testing.assert_array_equal(soft.structure.rest_length, soft.structure.string_lengths)


def test_change_of_bar_lengths_is_reported() -> None:
    form = tc.form_find(tc.shapes.prism(), lengths={0: 100.0})
    assert form.success
    change = form.structure.bar_lengths / tc.shapes.prism().bar_lengths - 1.0
    assert f"bars change their lengths by up to {np.abs(change).max():.2g} times" in form.message
    kept = tc.form_find(tc.shapes.prism(), lengths={0: 0.8})
    assert kept.success
    assert "bars" not in kept.message


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"force_density": np.ones(60), "lengths": {0: 0.1}}, "length of string 0 cannot be"),
        ({"force_density": np.ones(60), "positions": {24: (0, 0, 3)}}, "z of node 24 cannot be"),
    ],
)
def test_contradictory_goals_fail_with_a_reason(given, message: str) -> None:
    form = tc.form_find(tc.shapes.hyperbolic_paraboloid(6), **given)
    assert not form.success
    assert message in form.message
    assert np.all(np.isfinite(form.structure.nodes))


def test_forms_without_equilibrium_fail_with_a_reason() -> None:
    form = tc.form_find(tc.shapes.prism(), [1.0] * 6 + [3.0] * 3)
    assert not form.success
    assert "these force densities have 2 dimensions" in form.message
    prism = tc.form_find(tc.shapes.prism(), force_density=0.0)
    assert not prism.success
    assert "no member carries a force" in prism.message
    zero = tc.form_find(tc.shapes.hyperbolic_paraboloid(4), force_density=0.0)
    assert not zero.success
    assert "no member carries a force" in zero.message
    loose = tc.Structure([(0, 0, 0), (1, 0, 0), (0, 1, 0)], strings=[(0, 1), (1, 2)], node_mass=1.0)
    collapsed = tc.form_find(loose, [1.0, 1.0])
    assert not collapsed.success
    assert np.all(np.isfinite(collapsed.structure.nodes))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"force_density": [1.0, 2.0]}, r"force_density has shape \(2,\)"),
        ({"force_density": np.inf}, "force_density of string 0 is inf"),
        ({"lengths": {9: 1.0}}, "lengths is 9: string indices run from 0 to 8"),
        ({"lengths": {0: -1.0}}, "lengths of string 0 is -1: it must be greater than 0"),
        ({"lengths": [1.0]}, "lengths is \\[1.0\\]: give a mapping"),
        ({"positions": {0: (1.0, 2.0)}}, "positions of node 0"),
        ({"groups": [[0, 9]]}, r"groups\[0\] has strings and bars"),
        ({"groups": [[0, 1], [1, 2]]}, "groups: member 1 is named twice"),
        ({"groups": [[0, 12]]}, "member indices run from 0 to 11"),
        ({"loads": [1.0, 2.0, 3.0]}, "loads has shape"),
        (
            {"force_density": [1.0, 2.0] + [np.nan] * 7, "groups": [[0, 1]]},
            "the group of member 0 has 1 and 2 N/m",
        ),
    ],
)
def test_wrong_input_is_named(given, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        tc.form_find(tc.shapes.prism(), **given)


def test_structure_without_strings_is_rejected() -> None:
    with pytest.raises(ValueError, match="structure has no strings"):
        tc.form_find(tc.shapes.double_pendulum())


def test_one_string_beside_a_loose_node_has_a_verdict() -> None:
    loose = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 1)], strings=[(0, 1)], pinned=[0], node_mass=1.0
    )
    form = tc.form_find(loose)
    assert not form.success
    assert np.all(np.isfinite(form.structure.nodes))


def test_position_of_a_pinned_node_is_rejected() -> None:
    with pytest.raises(ValueError, match="positions of node 0 prescribes x, which a support fixes"):
        tc.form_find(tc.shapes.hyperbolic_paraboloid(3), positions={0: (0, None, None)})


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@drawn(
    density=st.lists(
        st.one_of(st.just(np.nan), st.floats(-10.0, 1e6, allow_subnormal=False)),
        min_size=6,
        max_size=6,
    ),
    length=st.floats(1e-6, 1e6),
)
def test_any_input_gives_finite_numbers(density: list[float], length: float) -> None:
    form = tc.form_find(polygon(6), density, lengths={0: length})
    assert np.all(np.isfinite(form.structure.nodes))
    assert np.all(np.isfinite(form.force_density))
    assert np.all(np.isfinite(form.bar_force))
    assert form.message
    if form.success:
        assert residual(form) <= 1e-6 * max(1.0, np.abs(form.bar_force).max())
        assert form.structure.string_lengths[0] == pytest.approx(length, rel=1e-6)


def platform(more: list[tuple[float, float, float]]) -> tc.Structure:
    """Plate of three nodes and `more` on six strings below a frame."""
    angle = np.deg2rad([90, 210, 330])
    plate = 0.4 * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    frame = np.column_stack([-0.8 * np.cos(angle), -0.8 * np.sin(angle), np.ones(3)])
    return tc.Structure(
        np.vstack([plate, frame, np.reshape(more, (-1, 3))]),
        strings=[(0, 4), (1, 5), (2, 3), (0, 5), (1, 3), (2, 4)],
        pinned=[3, 4, 5],
        bodies=[tc.RigidBody((0, 1, 2, *range(6, 6 + len(more))), 3.0)],
        stiffness=1e3,
    )


@pytest.mark.parametrize("more", [[], [(0, 0, 0)], [(0, 0, -0.3), (0.2, 0.1, -0.1)]])
@pytest.mark.parametrize("known", [6, 4, 0])
def test_body_moves_rigidly_into_equilibrium(more: list, known: int) -> None:
    s = platform(more)
    load = np.zeros_like(s.nodes)
    load[:3, 2] = -5.0, -20.0, -5.0
    given = np.where(np.arange(6) < known, 30.0, np.nan)
    form = tc.form_find(s, given, loads=load)
    assert form.success, form.message
    np.testing.assert_allclose(form.force_density[:known], 30.0)
    own = list(s.bodies[0].nodes)
    for nodes in (s.nodes, form.structure.nodes):
        gaps = np.linalg.norm(nodes[own][:, None] - nodes[own], axis=2)
        np.testing.assert_allclose(
            gaps, np.linalg.norm(s.nodes[own][:, None] - s.nodes[own], axis=2), atol=1e-9
        )
    eq = tc.find_equilibrium(tc.Scene(form.structure, forces=tc.NodalForce(load)))
    assert eq.success
    np.testing.assert_allclose(eq.nodes, form.structure.nodes, atol=1e-7)
    np.testing.assert_allclose(eq.force_density, form.force_density, rtol=1e-6)


def test_goals_that_bend_a_body_fail() -> None:
    s = platform([])
    load = np.zeros_like(s.nodes)
    load[:3, 2] = -10.0
    down = tc.form_find(s, positions={0: (None, None, 0.2)}, loads=load)
    assert down.success, down.message
    assert down.structure.nodes[0, 2] == pytest.approx(0.2)
    form = tc.form_find(s, positions={0: (0, 0, 0.2), 1: (0, 0, -3)}, loads=load)
    assert not form.success
    assert "cannot be as prescribed" in form.message or "rigid" in form.message


def test_thin_bodies_act_as_bars() -> None:
    prism = tc.shapes.prism(twist=2.3)
    rods = [tc.RigidBody(tuple(bar), 1.0) for bar in prism.bars.tolist()]
    free = tc.Structure(prism.nodes, strings=prism.strings, bodies=rods)
    form = tc.form_find(free)
    assert form.success, form.message
    q = form.force_density
    np.testing.assert_allclose(q[6:] / q[:3], 3**0.5, rtol=1e-6)

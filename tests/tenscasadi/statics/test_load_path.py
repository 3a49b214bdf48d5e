"""Load paths against analytic results, equilibria at their factors, and linear buckling."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

import tenscasadi as tc

DOWN = [(0, 0, 0), (0, -1.0, 0), (0, 0, 0)]


def truss(height: float = 0.5, stiffness: float = 1000.0, **options: object) -> tc.Structure:
    """The truss of von Mises: two bilateral members between (±1, 0) and (0, height)."""
    return tc.Structure(
        [(-1, 0, 0), (0, height, 0), (1, 0, 0)],
        bars=[(0, 1), (1, 2)],
        bar_stiffness=stiffness,
        pinned={0: "xyz", 1: "z", 2: "xyz"},
        **options,
    )


def check_rows(path: tc.LoadPath, scene: tc.Scene, load: np.ndarray) -> None:
    """Each row balances the forces of its factor."""
    s = scene.structure
    stiffest = max(s.stiffness.max(initial=0), s.bar_stiffness[s.elastic].max(initial=0))
    for factor, nodes, tension, force in zip(
        path.factor, path.nodes, path.tension, path.bar_force, strict=True
    ):
        total = factor * np.asarray(load, dtype=float)
        for pairs, pull in ((s.strings, tension), (s.bars, force)):
            vectors = nodes[pairs[:, 1]] - nodes[pairs[:, 0]]
            unit = pull[:, None] * vectors / np.linalg.norm(vectors, axis=1)[:, None]
            np.add.at(total, pairs[:, 0], unit)
            np.add.at(total, pairs[:, 1], -unit)
        largest = max(np.abs(tension).max(initial=0), np.abs(force).max(initial=0), 1e-3)
        rounding = 16 * np.finfo(float).eps * stiffest * np.abs(nodes).max()  # of positions
        assert np.abs(total[~s.fixed]).max(initial=0) <= 1e-9 * largest + rounding


def test_pressed_bar_on_one_pin_is_unstable():
    bar = tc.Structure([(0, 0, 0), (0, 0, 1)], bars=[(0, 1)], pinned=[0])
    path = tc.load_path(tc.Scene(bar), [(0, 0, 0), (0, 0, -1.0)])
    assert path.success, path.message
    assert not path.stable[1:].any()
    np.testing.assert_allclose(path.bar_force[:, 0], -path.factor)


@pytest.mark.parametrize("low", [42.9, 42.91432])
@pytest.mark.parametrize("high", [50.0, 1e3, 1e6])
def test_path_turns_at_a_limit_point_within_its_first_step(low, high):
    """It ends at the factor of its start, on the other side of the limit point."""
    path = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(low, high))
    assert path.success, path.message
    np.testing.assert_allclose(path.factor[path.limit_points], [42.914326], atol=5e-7)
    assert path.factor[0] == path.factor[-1] == low
    assert path.nodes[-1, 1, 1] < 0.277880 < path.nodes[0, 1, 1]
    check_rows(path, tc.Scene(truss()), np.array(DOWN))


def test_truss_of_von_mises_snaps_through():
    """Limit load 42.914326 N at height 0.277880."""
    scene = tc.Scene(truss())
    path = tc.load_path(scene, load=DOWN, factors=(-100, 100))
    assert path.success, path.message
    np.testing.assert_allclose(
        path.factor[path.limit_points], [42.914326, -42.914326], rtol=0, atol=5e-7
    )
    heights = path.nodes[path.limit_points, 1, 1]
    np.testing.assert_allclose(heights, [0.277880, -0.277880], atol=5e-7)
    assert len(path.bifurcations) == 0
    assert path.factor[0] == 0.0
    assert path.factor[-1] == 100.0
    check_rows(path, scene, DOWN)
    y = path.nodes[:, 1, 1]
    exact = -2 * 1000 * (np.hypot(1, y) - np.hypot(1, 0.5)) * y / np.hypot(1, y)
    np.testing.assert_allclose(path.factor, exact, atol=1e-8)
    between = np.abs(y) < heights[0] - 1e-6
    assert not path.stable[between].any()
    assert path.stable[np.abs(y) > heights[0] + 1e-6].all()


def test_bilateral_strings_and_bars_agree():
    law = tc.Scene(
        tc.Structure(
            truss().nodes,
            strings=[(0, 1), (1, 2)],
            stiffness=1000.0,
            node_mass=1.0,
            pinned={0: "xyz", 1: "z", 2: "xyz"},
        ),
        slack=tc.Linear(),
    )
    one = tc.load_path(law, load=DOWN, factors=(-100, 100))
    other = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(-100, 100))
    np.testing.assert_allclose(
        one.factor[one.limit_points], other.factor[other.limit_points], rtol=1e-10
    )
    np.testing.assert_allclose(one.tension, other.bar_force, atol=1e-6)


def test_path_ends_where_it_leaves_the_range():
    path = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(0, 60))
    assert path.success
    assert path.factor[-1] == 0.0  # back through the limit point
    assert len(path.limit_points) == 1
    below = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(0, 20))
    assert below.factor[-1] == 20.0
    eq = tc.find_equilibrium(
        tc.Scene(truss(), forces=tc.NodalForce(20 * np.array(DOWN))), start=below.nodes[-1]
    )
    np.testing.assert_allclose(eq.nodes, below.nodes[-1], atol=1e-12)


def test_bifurcation_of_a_steep_truss():
    """It sways where k_xx = 0: l³ − ρ l² + ρ w² = 0."""
    rho = np.sqrt(10.0)
    length = brentq(lambda x: x**3 - rho * x**2 + rho, 2 * rho / 3, rho)
    height = np.sqrt(length**2 - 1)
    expected = 2 * 1000 * (rho / length - 1) * height
    path = tc.load_path(tc.Scene(truss(3.0)), load=DOWN, factors=(0, 900))
    assert path.success
    (row,) = path.bifurcations
    assert path.factor[row] == pytest.approx(expected, rel=1e-9)
    assert path.nodes[row, 1, 1] == pytest.approx(height, rel=1e-9)
    assert path.stable[:row].all()
    assert not path.stable[row + 1 :].any()


def column(offset: float = 0.0) -> tc.Structure:
    """Two rigid bars in line with a lateral spring, whose rest position is aside."""
    return tc.Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 1 + offset, 0), (1, -1, 0)],
        bars=[(0, 1), (1, 2)],
        strings=[(1, 3), (1, 4)],
        stiffness=50.0,
        rest_length=0.5,
        pinned={0: "xyz", 1: "z", 2: "yz", 3: "xyz", 4: "xyz"},
    )


END = [(0, 0, 0), (0, 0, 0), (-1.0, 0, 0), (0, 0, 0), (0, 0, 0)]


def test_perfect_column_bifurcates_at_its_buckling_load():
    path = tc.load_path(tc.Scene(column()), load=END, factors=(0, 80))
    assert path.success
    (row,) = path.bifurcations
    linear = tc.buckling_factor(tc.Scene(column()), END)
    assert path.factor[row] == pytest.approx(linear.factor, rel=1e-8)
    assert np.abs(path.nodes[:, 1, 1]).max() < 1e-9


@pytest.mark.parametrize("offset", [1e-2, 1e-4])
def test_imperfect_column_has_a_limit_point_near_it(offset):
    """The path does not jump to the other branch, however near that is."""
    path = tc.load_path(tc.Scene(column(offset)), load=END, factors=(0, 80))
    assert path.success
    assert 48.0 < path.factor[path.limit_points[0]] < 50.0
    assert len(path.bifurcations) == 0
    moved = path.nodes[1 : path.limit_points[0] + 2, 1, 1]
    assert np.all(np.diff(moved) > 0)  # on the side of the imperfection


def test_path_goes_through_slack_strings():
    s = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)],
        strings=[(0, 1), (1, 2)],
        pinned={0: "xyz", 1: "yz", 2: "xyz"},
        node_mass=1.0,
        stiffness=100.0,
        rest_length=0.9,
    )
    path = tc.load_path(tc.Scene(s), load=[(0, 0, 0), (1.0, 0, 0), (0, 0, 0)], factors=(0, 50))
    assert path.success
    x = path.nodes[:, 1, 0]
    exact = 100 * (np.maximum(0.1 + x, 0) - np.maximum(0.1 - x, 0))
    np.testing.assert_allclose(path.factor, exact, atol=1e-9)
    assert path.tension[-1].round(9).tolist() == [50.0, 0.0]
    assert path.stable.all()


def test_path_in_rest_lengths():
    s = tc.shapes.prism(prestress=10.0)
    scene = tc.Scene(s, control=tc.RestLength())
    change = -0.1 * s.rest_length
    path = tc.load_path(scene, control=change, factors=(0, 1))
    assert path.success
    assert path.stable.all()
    for row in (2, -1):
        control = s.rest_length + path.factor[row] * change
        eq = tc.find_equilibrium(scene, control=control)
        np.testing.assert_allclose(path.tension[row], eq.tension, rtol=1e-8)


def test_path_in_parameters():
    rope = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    scene = tc.Scene(
        rope,
        gravity=tc.Gravity((0, 0, -10)),
        parameters=tc.Parameters("stiffness", "gravity"),
    )
    path = tc.load_path(scene, parameters={"stiffness": 50.0}, factors=(-1, 4))
    np.testing.assert_allclose(-path.nodes[:, 1, 2], 1 + 10 / (100 + 50 * path.factor), rtol=1e-10)
    both = tc.load_path(scene, parameters={"gravity": [0, 0, -1]}, factors=(0, 5))
    np.testing.assert_allclose(both.tension[:, 0], 10 + both.factor, rtol=1e-9)


def test_path_begins_at_an_equilibrium_that_is_given():
    upper = tc.Scene(truss())
    lower = tc.find_equilibrium(upper, start=[(-1, 0, 0), (0, -0.4, 0), (1, 0, 0)])
    path = tc.load_path(upper, load=DOWN, factors=(0, 50), start=lower)
    assert path.success
    np.testing.assert_allclose(path.nodes[0], lower.nodes, atol=1e-12)
    assert len(path.limit_points) == 0
    assert path.stable.all()


def test_path_begins_at_the_nearest_factor_of_the_range():
    path = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(10, 30))
    assert path.factor[0] == pytest.approx(10.0)
    assert path.factor[-1] == 30.0
    back = tc.load_path(tc.Scene(truss()), load=DOWN, factors=(-30, -10))
    assert back.factor[0] == pytest.approx(-10.0)
    assert back.factor[-1] == -30.0


def test_rigid_bars_keep_their_lengths_along_the_path():
    s = tc.shapes.prism(prestress=30.0, pinned=[0, 1, 2])
    load = np.zeros((6, 3))
    load[3:, 2] = -1.0
    path = tc.load_path(tc.Scene(s), load=load, factors=(0, 60))
    assert path.success, path.message
    bars = np.linalg.norm(path.nodes[:, s.bars[:, 1]] - path.nodes[:, s.bars[:, 0]], axis=2)
    np.testing.assert_allclose(bars, np.tile(s.bar_lengths, (len(bars), 1)), rtol=1e-11)
    check_rows(path, tc.Scene(s), load)
    assert (path.tension >= 0).all()


def test_free_structures_do_not_drift():
    s = tc.shapes.six_bar_ball(prestress=30.0)
    load = np.zeros((12, 3))
    load[s.strings[0]] = s.nodes[s.strings[0]] - s.nodes[s.strings[0]][::-1]
    path = tc.load_path(tc.Scene(s), load=load, factors=(0, 10))
    assert path.success
    check_rows(path, tc.Scene(s), load)
    np.testing.assert_allclose(path.nodes.mean(axis=1), 0, atol=1e-6)


def test_friction_holds_along_a_path():
    """A block that is pulled aside sticks until the limit of friction, μ = 0.5."""
    block = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.3, 1)],
        bars=[(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)],
    )
    load = np.zeros((4, 3))
    load[3] = (1, 0, 0)
    scene = tc.Scene(block, gravity=tc.Gravity((0, 0, -10)), ground=tc.Ground(friction=0.5))
    path = tc.load_path(scene, load=0.1 * load, factors=(0, 100))
    assert path.success, path.message
    assert np.abs(path.nodes[:, :3, :2] - block.nodes[:3, :2]).max() < 0.02


def test_path_draws_itself(tmp_path):
    path = tc.load_path(tc.Scene(truss(3.0)), load=DOWN, factors=(-50, 900))
    figure = path.plot(tmp_path / "path.png", title="truss")
    assert (tmp_path / "path.png").stat().st_size > 1000
    labels = [text.get_text() for ax in figure.axes for text in ax.get_legend().get_texts()]
    assert labels == ["bifurcation", "bars"]


def test_no_first_equilibrium_is_told():
    scene = tc.Scene(tc.shapes.prism(prestress=10.0), gravity=tc.Gravity())
    path = tc.load_path(scene, load=np.ones((6, 3)))
    assert not path.success
    assert "no equilibrium at factor 0" in path.message
    assert path.nodes.shape == (0, 6, 3)
    assert len(path.limit_points) == 0
    path.plot()


def test_motions_without_stiffness_end_a_path():
    slack = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (1, 0, 0)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0,
        rest_length=1.5,
    )  # fmt: skip
    path = tc.load_path(tc.Scene(slack), load=[(0, 0, 0), (1, 0, 0), (0, 0, 0)])
    assert not path.success
    assert "motions without stiffness" in path.message


def test_end_of_a_path_is_told():
    """A pendulum between gravity and a pull upwards has no equilibrium beyond its rope."""
    free = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=1.0)
    scene = tc.Scene(free, gravity=tc.Gravity((0, 0, -10)))
    path = tc.load_path(scene, load=[(0, 0, 0), (0, 0, 20.0)], factors=(0, 2))
    assert np.isfinite(path.nodes).all()
    assert path.message


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"scene": 3}, TypeError, "scene"),
        ({"load": None}, ValueError, "load, control and parameters are None"),
        ({"load": np.ones((2, 3))}, ValueError, "load"),
        ({"factors": (1, 1)}, ValueError, "factors"),
        ({"factors": (0, np.inf)}, ValueError, "factors"),
        ({"control": [1.0]}, ValueError, "control"),
        ({"parameters": {"mass": 1.0}}, ValueError, "parameters"),
        ({"start": np.ones((3, 3))}, ValueError, "start"),
    ],
)
def test_wrong_arguments_are_rejected_by_name(arguments, error, text):
    with pytest.raises(error, match=text):
        tc.load_path(**{"scene": tc.Scene(truss()), "load": DOWN, **arguments})


def test_rest_lengths_that_vanish_are_rejected():
    s = tc.shapes.prism(prestress=10.0)
    with pytest.raises(ValueError, match=r"control of string 0 .* at factor 2"):
        tc.load_path(tc.Scene(s, control=tc.RestLength()), control=-s.rest_length)


@settings(deadline=None, max_examples=8)
@given(seed=st.integers(0, 10**6), size=st.sampled_from([0.1, 10.0]))
def test_random_paths_are_exact(seed, size):
    rng = np.random.default_rng(seed)
    s = tc.Structure(
        rng.normal(size=(6, 3)),
        bars=[(0, 3), (1, 4)],
        strings=[(0, 4), (0, 5), (1, 3), (1, 5), (2, 3), (2, 4), (2, 5), (3, 5), (4, 5)],
        node_mass=1.0,
        pinned=[0, 1, 2],
        bar_stiffness=500.0 if seed % 2 else None,
    )
    s = s.replace(rest_length=0.8 * s.string_lengths)
    load = size * rng.normal(size=(6, 3))
    scene = tc.Scene(s, slack=tc.Linear() if seed % 3 else tc.Clip())
    path = tc.load_path(scene, load=load, factors=(-1, 1))
    assert np.isfinite(path.nodes).all()
    check_rows(path, scene, load)
    assert path.message
    if path.success:
        assert abs(path.factor[-1]) == 1.0

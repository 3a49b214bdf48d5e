"""Grounds: their push and friction, planes, height fields, and what is no ground."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.interpolate import RegularGridInterpolator

import tenscasadi as tc
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Ground, Surface
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.terrain import Terrain
from tenscasadi.structure.structure import Structure

LOWER, UPPER = (-1.0, 2.0), (3.0, 5.0)
RNG = np.random.default_rng(5)
HILLS = RNG.normal(size=(5, 4))
POINTS = np.column_stack([RNG.uniform(-1, 3, 40), RNG.uniform(2, 5, 40), RNG.uniform(-2, 2, 40)])


def terrain(**changes: object) -> Terrain:
    return Terrain(
        **{"heights": HILLS, "lower": LOWER, "upper": UPPER, "stiffness": 100.0, **changes}
    )  # type: ignore[arg-type]


def tilted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A plane's heights."""
    return 0.3 * x - 0.2 * y + 0.7


def both(**law: object) -> tuple[Terrain, Ground]:
    """The same plane as a height field and as a plane."""
    x, y = (
        np.linspace(low, high, count) for low, high, count in zip(LOWER, UPPER, (5, 4), strict=True)
    )
    field = Terrain(tilted(x[:, None], y[None, :]), LOWER, UPPER, **law)  # type: ignore[arg-type]
    normal = np.array([-0.3, 0.2, 1.0])
    return field, Ground(normal=normal, height=0.7 / float(np.linalg.norm(normal)), **law)  # type: ignore[arg-type]


def test_ground_pushes_below_its_plane_and_never_pulls() -> None:
    ground = Ground(stiffness=100.0, damping=10.0, height=0.5)
    N = ca.DM([[0, 0, 0], [0, 0, 0], [0.6, 0.4, 0.4]])
    V = ca.DM([[0, 1, 1], [0, 0, 0], [-1, -1, 5]])
    W = ground.forces(N, V).full()
    assert np.allclose(
        W, [[0, 0, 0], [0, 0, 0], [0, 20, 0]]
    )  # apart; 100·0.1 + 10·1; leaving fast: no pull
    assert float(ground.energy(N)) == pytest.approx(2 * 100 * 0.01 / 2)
    assert not ground.conservative
    assert Ground().conservative


def test_friction_opposes_slip_and_is_bounded_by_coulomb() -> None:
    ground = Ground(stiffness=100.0, friction=0.5, slip_speed=1e-3)
    N = ca.DM([0, 0, -0.1])
    sliding = ground.forces(N, ca.DM([3, 4, 0])).full().ravel()
    assert np.allclose(sliding, [-3, -4, 10], rtol=1e-6)  # μ f = 5 N against the direction (3, 4)/5
    creeping = ground.forces(N, ca.DM([1e-5, 0, 0])).full().ravel()
    assert creeping[0] == pytest.approx(-5 * 1e-2, rel=1e-3)


@pytest.mark.parametrize("size", [1e-320, 3e-162, 1.0, 1e12])
def test_normals_of_any_length_are_made_one_long(size: float) -> None:
    ground = Ground(normal=(0.0, 0.0, size))
    assert ground.normal == (0.0, 0.0, 1.0)
    assert Ground(normal=ground.normal).normal == ground.normal


def test_a_tilted_ground_pushes_along_its_normal() -> None:
    ground = Ground(stiffness=10.0, normal=(3, 0, 4))
    W = ground.forces(ca.DM([-3, 0, -4]), ca.DM.zeros(3)).full().ravel()
    assert np.allclose(W, 10 * 5 * np.array([0.6, 0, 0.8]))


def test_a_height_field_is_bilinear_between_its_points() -> None:
    x, y = (
        np.linspace(low, high, count)
        for low, high, count in zip(LOWER, UPPER, HILLS.shape, strict=True)
    )
    height = RegularGridInterpolator((x, y), HILLS)(POINTS[:, :2])
    depth = terrain().depth(ca.DM(POINTS.T)).full().ravel()
    assert np.array_equal(depth > 0, height > POINTS[:, 2])
    on = np.column_stack([POINTS[:, :2], height])
    assert np.abs(terrain().depth(ca.DM(on.T)).full()).max() < 1e-14


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_a_planar_height_field_is_the_plane(kind: object) -> None:
    field, plane = both(stiffness=100.0, damping=7.0, friction=0.4)
    N, V = kind.sym("N", 3, len(POINTS)), kind.sym("V", 3, len(POINTS))  # type: ignore[attr-defined]
    speeds = RNG.normal(size=POINTS.T.shape)
    deepest = int(np.argmin(POINTS[:, 2] - tilted(*POINTS.T[:2])))
    makes: list[Callable[[Surface], object]] = [
        lambda ground: ground.forces(N, V),
        lambda ground: ground.energy(N),
        lambda ground: ground.switching(N, V),
        lambda ground: ca.jacobian(ground.forces(N, V)[:, deepest], N),
        lambda ground: ca.jacobian(ground.forces(N, V)[:, deepest], V),
    ]
    for make in makes:
        one, other = (
            ca.Function("f", [N, V], [make(ground)])(POINTS.T, speeds).full()
            for ground in (field, plane)
        )
        assert np.abs(other).max() > 0.1
        assert np.abs(one - other).max() < 1e-11


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_the_push_of_a_height_field_is_the_gradient_of_its_energy(kind: object) -> None:
    n = kind.sym("n", 3)  # type: ignore[attr-defined]
    ground = terrain()
    gradient = ca.Function(
        "g", [n], [ground.forces(n, ca.DM.zeros(3)), ca.gradient(ground.energy(n), n)]
    )
    for point in POINTS:
        push, slope = (value.full().ravel() for value in gradient(point))
        assert np.abs(push + slope).max() < 1e-12 * max(1.0, np.abs(slope).max())
        moved = [
            float(ground.energy(ca.DM(point + step)))
            for step in np.vstack([np.eye(3), -np.eye(3)]) * 1e-6
        ]
        assert np.abs((np.array(moved[:3]) - moved[3:]) / 2e-6 - slope).max() < 1e-4


def test_second_derivatives_of_a_height_field_are_those_of_its_cells() -> None:
    x = ca.SX.sym("x", 3)
    energy = terrain().energy(x)
    hessian, gradient = (
        ca.Function("h", [x], ca.hessian(energy, x)[:1]),
        ca.Function("g", [x], [ca.gradient(energy, x)]),
    )
    for point in POINTS[:10]:
        ends = [
            gradient(point + sign * step).full() for step in 1e-6 * np.eye(3) for sign in (1, -1)
        ]
        numeric = np.column_stack(
            [(up - down).ravel() / 2e-6 for up, down in zip(ends[::2], ends[1::2], strict=True)]
        )
        assert np.abs(hessian(point).full() - numeric).max() < 1e-5 * max(
            1.0, np.abs(numeric).max()
        )


@pytest.mark.parametrize(
    ("outside", "border"),
    [((-9, 3), (-1, 3)), ((3.5, 4.4), (3, 4.4)), ((1.2, 1e6), (1.2, 5)), ((-2, 0), (-1, 2))],
)
def test_beyond_the_grid_the_ground_goes_on_as_it_ends(
    outside: tuple[float, float], border: tuple[float, float]
) -> None:
    here, there = (terrain().depth(ca.DM([*place, -3.0])) for place in (outside, border))
    assert float(here) == pytest.approx(float(there), abs=1e-9)
    push = terrain().forces(ca.DM([*outside, -3.0]), ca.DM.zeros(3)).full().ravel()
    assert push[2] > 0
    assert all(
        push[axis] == 0
        for axis in (0, 1)
        if outside[axis] != border[axis] and abs(np.subtract(outside, border)).all()
    )


def test_friction_on_a_height_field_goes_along_the_surface_and_is_bounded_by_coulomb() -> None:
    ground, smooth = terrain(friction=0.5), terrain()
    for point in POINTS:
        N, V = ca.DM(point - [0, 0, 1e-6]), ca.DM(RNG.normal(size=3))
        contact = ground.contact(N)
        push = smooth.forces(N, V).full().ravel()
        rub = ground.forces(N, V).full().ravel() - push
        assert abs(rub @ contact.outward.full().ravel()) < 1e-9 * max(1.0, np.abs(push).max())
        assert np.linalg.norm(rub) == pytest.approx(0.5 * np.linalg.norm(push), rel=1e-5)
        assert rub @ V.full().ravel() <= 0


def test_a_ground_acts_on_the_nodes_that_are_chosen_and_several_add_up() -> None:
    two = Structure([(0, 0, -0.1), (1, 0, -0.1), (2, 0, -0.1)], node_mass=1.0)
    push = (
        Ground(stiffness=50.0, nodes=[2, 0]),
        Ground(stiffness=20.0, height=1.9, normal=(1, 0, 0), nodes=np.array([1])),
    )
    for coordinates in ("reduced", "full"):
        rates = {}
        for name, grounds in {
            "first": push[0],
            "second": push[1:],
            "both": list(push),
            "none": (),
        }.items():
            model = Model(Scene(two, gravity=Gravity((0, 0, -1)), ground=grounds), coordinates)  # type: ignore[arg-type]
            rates[name] = model.velocities(model.ode(model.initial_state, []).full().ravel())
        assert np.allclose(rates["first"], [(0, 0, 4), (0, 0, -1), (0, 0, 4)])
        assert np.allclose(rates["second"], [(0, 0, -1), (18, 0, -1), (0, 0, -1)])
        assert np.allclose(rates["both"], [(0, 0, 4), (18, 0, -1), (0, 0, 4)])
        assert np.allclose(rates["none"], [(0, 0, -1)] * 3)


def test_one_ground_is_itself_and_none_costs_nothing() -> None:
    one = Structure([(0, 0, 0)], node_mass=1.0)
    ground = Ground(friction=0.1)
    alone, listed = (Model(Scene(one, ground=value)) for value in (ground, [ground]))
    assert alone.scene.ground == listed.scene.ground == ground
    assert alone.describe() == listed.describe()
    empty, plain = Model(Scene(one, ground=[])), Model(Scene(one))
    assert empty.scene.ground is None
    assert empty.describe() == plain.describe()
    assert "ground" not in empty.describe()


def test_ends_of_touching_bars_leave_the_nodes() -> None:
    s = tc.shapes.prism(bar_radius=0.02)
    a, b = s.bars[1]
    ground = Ground(bars=[1])
    assert set(ground.select_nodes(s)) == set(range(6)) - {a, b}
    assert Ground(bars=[1], nodes=[a]).select_nodes(s).tolist() == [a]
    assert Ground(bars=[1], nodes=[]).select_nodes(s).tolist() == []
    assert ground.select_bar_points(s).fractions.tolist() == [0, 1]
    depths, ends = ground.find_depths(s, s.nodes - [0, 0, 1])
    np.testing.assert_allclose(depths[-2:], 1 - s.nodes[[a, b], 2] + 0.02)
    assert ends[-1].tolist() == [a, b]


def test_bars_touch_a_height_field_along_their_length() -> None:
    s = tc.shapes.pendulum()
    assert len(terrain(bars="all", bar_points=7).select_bar_points(s).bars) == 7
    found = terrain(bars="all")
    fractions = found.select_bar_points(s).fractions
    assert np.diff(fractions).max() * s.bar_lengths[0] <= found.spacing.min() / 2


@pytest.mark.parametrize("size", [3, 30, 2000])
def test_points_of_bars_share_the_stiffness_of_two_ends(size: int) -> None:
    s = tc.shapes.prism()
    found = terrain(heights=np.zeros((2, size)), bars="all").select_bar_points(s)
    np.testing.assert_allclose(np.bincount(found.bars, found.weights), 2.0)
    assert np.bincount(found.bars).max() <= 101


@pytest.mark.parametrize("kind", ["ground", "terrain"])
@pytest.mark.parametrize("bars", [None, "all", [0]])
def test_scene_files_hold_bars_of_grounds(kind, bars, tmp_path) -> None:
    s = tc.shapes.pendulum()
    make = Ground if kind == "ground" else terrain
    scene = Scene(s, ground=make(bars=bars, nodes=None if bars is None else []))
    tc.save_scene(scene, tmp_path / "scene.toml")
    found = tc.load_scene(tmp_path / "scene.toml").ground
    assert (found.bars, found.nodes) == (scene.ground.bars, scene.ground.nodes)
    if isinstance(bars, list):
        named = Scene(s.replace(bar_names=["log"]), ground=make(bars=bars))
        tc.save_scene(named, tmp_path / "named.toml")
        text = (tmp_path / "named.toml").read_text(encoding="utf-8")
        assert "log" in text
        by_name = text.replace("bars = [0]", 'bars = ["log"]')
        (tmp_path / "named.toml").write_text(by_name, encoding="utf-8")
        assert tc.load_scene(tmp_path / "named.toml").ground.bars == (0,)


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Ground(stiffness=0), r"Ground\.stiffness"),
        (lambda: Ground(damping=-1), r"Ground\.damping"),
        (lambda: Ground(friction=-0.1), r"Ground\.friction"),
        (lambda: Ground(height=float("nan")), r"Ground\.height"),
        (lambda: Ground(normal=(0, 0, 0)), r"Ground\.normal"),
        (lambda: Ground(slip_speed=0), r"Ground\.slip_speed"),
        (
            lambda: Ground(nodes=[]),
            r"Ground\.nodes is \(\): give at least one node, or None for all",
        ),
        (lambda: Ground(nodes=[1, 1]), r"Ground\.nodes is \(1, 1\)"),
        (lambda: Ground(nodes=[-1]), r"Ground\.nodes is -1"),
        (lambda: Ground(nodes=3), r"Ground\.nodes is 3"),
        (lambda: Ground(bars=[]), r"Ground\.bars is \(\): give at least one bar, or None for none"),
        (lambda: Ground(bars="some"), r'Ground\.bars is .*some.*: give indices, "all" or None'),
        (lambda: Ground(bars=[-1]), r"Ground\.bars is -1"),
        (lambda: Ground(bars=[1, 1]), r"Ground\.bars is \(1, 1\): give each bar once"),
        (lambda: terrain(bar_points=5), r"Terrain\.bar_points is 5, but no bars touch"),
        (
            lambda: Scene(Structure([(0, 0, 0)], node_mass=1.0), ground=Ground(bars="all")),
            r"Ground\.bars is 'all', but there are no bars: leave it out",
        ),
        (
            lambda: Scene(tc.shapes.pendulum(), ground=Ground(bars=[1])),
            r"Ground\.bars\[0\] is 1: bar indices run from 0 to 0",
        ),
        (lambda: terrain(bars=[0], bar_points=1), r"Terrain\.bar_points is 1"),
        (
            lambda: terrain(bars=[0], bar_points=10**9),
            r"Terrain\.bar_points is 1e\+09: it must be at most",
        ),
        (
            lambda: Scene(Structure([(0, 0, 0)], node_mass=1.0), ground=Ground(nodes=[1])),
            r"Ground\.nodes\[0\] is 1: node indices run from 0 to 0",
        ),
        (
            lambda: Scene(
                Structure([(0, 0, 0)], node_mass=1.0),
                ground=[terrain(nodes=[0]), terrain(nodes=[7])],
            ),
            r"Terrain\.nodes\[0\] is 7",
        ),
        (
            lambda: Scene(Structure([(0, 0, 0)], node_mass=1.0), ground=[Ground(), "rock"]),
            r"Scene\.ground is \[.*'rock'\]",
        ),
        (lambda: terrain(heights=[1.0, 2.0]), r"Terrain\.heights has shape"),
        (
            lambda: terrain(heights=[[1.0, 2.0]]),
            r"Terrain\.heights has shape \(1, 2\): give at least two",
        ),
        (lambda: terrain(heights=[[1.0, 2.0], [1.0, np.nan]]), r"Terrain\.heights\[1, 1\] is nan"),
        (lambda: terrain(lower=(0, 0, 0)), r"Terrain\.lower has shape"),
        (
            lambda: terrain(lower=(0, 5)),
            r"Terrain\.lower is 5 and \.upper 5 along y: give lower < upper",
        ),
        (lambda: terrain(stiffness=-1.0), r"Terrain\.stiffness"),
        (lambda: terrain(friction=0.0), r"Terrain\.friction"),
    ],
)
def test_what_makes_no_ground_is_refused_by_name(make: Callable[[], object], field: str) -> None:
    with pytest.raises((TypeError, ValueError), match=field):
        make()


NUMBERS = st.floats(-1e3, 1e3) | st.sampled_from([0.0, np.inf, np.nan, 1e300])


@settings(max_examples=60, deadline=None)
@given(
    heights=arrays.arrays(
        float, arrays.array_shapes(min_dims=1, max_dims=3, max_side=4), elements=NUMBERS
    ),
    corners=st.tuples(NUMBERS, NUMBERS, NUMBERS, NUMBERS),
    place=st.tuples(*[st.floats(-1e4, 1e4)] * 3),
)
def test_a_height_field_is_refused_by_name_or_gives_finite_forces(
    heights: np.ndarray,
    corners: tuple[float, float, float, float],
    place: tuple[float, float, float],
) -> None:
    def make() -> Terrain:
        return Terrain(heights, corners[:2], corners[2:], damping=1.0, friction=0.5)

    try:
        ground = make()
    except (TypeError, ValueError):
        with pytest.raises((TypeError, ValueError), match=r"^Terrain\."):
            make()
        return
    assert np.all(np.isfinite(ground.forces(ca.DM(place), ca.DM([1.0, -2.0, 0.5])).full()))
    assert (
        heights.min() - place[2] <= 0 or float(ground.depth(ca.DM(place))) > 0
    )  # below all of it is below it

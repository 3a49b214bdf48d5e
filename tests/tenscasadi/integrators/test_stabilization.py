"""The joint projection: onto every constraint, by the smallest mass-weighted movement, keeping momentum."""

from __future__ import annotations

import numpy as np
import pytest
from references import certified

from tenscasadi.dynamics.model import Model
from tenscasadi.integrators.stabilization import BarLengthCorrection, Projection, build_projection
from tenscasadi.scene.loads import Gravity
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.simulate import simulate
from tenscasadi.structure import shapes
from tenscasadi.structure.structure import Structure

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])
LOOP = Structure([(0, 0, 0), (1, 0.2, 0), (2, 0, 0.3), (1, -0.8, 0), (1, 0, 2)], [(0, 1), (1, 2), (2, 3), (3, 0)], [(0, 2), (1, 3), (2, 4)],
                 node_mass=[0, 1, 0, 0, 0.5], bar_mass=[1, 2, 3, 4])  # fmt: skip


@BOTH
@pytest.mark.parametrize("pinned", [(), (0,), {0: "xyz", 2: "z"}], ids=str)
def test_a_disturbed_loop_of_bars_comes_back_to_rounding(pinned: object, coordinates: str) -> None:
    model = Model(Scene(LOOP.replace(pinned=pinned)), coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    x = model.initial_state + 1e-3 * rng.normal(size=model.nx)
    assert model.bar_length_error(x) > 1e-4
    y = build_projection(model)(x).full().ravel()
    assert model.bar_length_error(y) < 1e-15
    assert model.joint_error(y) < 1e-15
    stretching = np.sum(
        np.diff(model.nodes(y)[LOOP.bars], axis=1)
        * np.diff(model.velocities(y)[LOOP.bars], axis=1),
        axis=(1, 2),
    )
    assert abs(stretching).max() < 1e-15
    assert np.allclose(build_projection(model)(y).full().ravel(), y, atol=1e-15)


@BOTH
def test_projection_keeps_centre_of_mass_and_momenta(coordinates: str) -> None:
    model = Model(Scene(LOOP), coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(1)
    x = (
        build_projection(model)(model.initial_state + 0.1 * rng.normal(size=model.nx))
        .full()
        .ravel()
    )
    M = model.structure.mass_matrix().toarray()

    def invariants(x: np.ndarray, at: np.ndarray) -> np.ndarray:
        N, V = model.nodes(at), model.velocities(x)
        return np.concatenate(
            [M.sum(0) @ model.nodes(x), M.sum(0) @ V, np.cross(N, M @ V).sum(axis=0)]
        )

    disturbed = x.copy()
    disturbed[model.nq :] += 0.1 * rng.normal(size=model.nq)
    if (
        coordinates == "full"
    ):  # copies of a node must start with one velocity for momenta of physical nodes to be defined
        disturbed = model.state(model.nodes(x), model.velocities(disturbed))
    y = build_projection(model)(disturbed).full().ravel()
    assert np.allclose(invariants(y, y), invariants(disturbed, y), atol=1e-13)


def test_projection_is_the_least_mass_weighted_movement() -> None:
    model = Model(Scene(LOOP))
    rng = np.random.default_rng(2)
    x = model.initial_state + 1e-5 * rng.normal(size=model.nx)
    y = build_projection(model)(x).full().ravel()
    M = np.kron(model.structure.mass_matrix().toarray(), np.eye(3))
    moved = (M @ (y - x)[: model.nq]).reshape(-1, 3)
    B = np.diff(model.nodes(y)[LOOP.bars], axis=1)[:, 0]
    rows = np.einsum("ij,ik->ijk", LOOP.C_b, B).reshape(4, -1)
    multiplier = np.linalg.lstsq(rows.T, moved.ravel(), rcond=None)[0]
    assert abs(rows.T @ multiplier - moved.ravel()).max() < 1e-4 * abs(moved).max()


@BOTH
def test_redundant_constraints_are_projected_too(coordinates: str) -> None:
    case = certified("redundant_triangle")
    with pytest.warns(UserWarning, match="depend on each other"):
        model = Model(case.scene, coordinates)  # type: ignore[arg-type]
    rng = np.random.default_rng(3)
    y = (
        build_projection(model)(model.initial_state + 1e-4 * rng.normal(size=model.nx))
        .full()
        .ravel()
    )
    assert model.bar_length_error(y) < 1e-14
    assert model.joint_error(y) < 1e-14


def test_nothing_to_keep_builds_nothing() -> None:
    net = Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0)
    assert Projection().step(Model(Scene(net))) is None
    assert Projection().step(Model(Scene(LOOP))) is not None


@pytest.mark.parametrize(
    "changes",
    [{"every": 0}, {"every": 1.5}, {"every": True}, {"iterations": 0}, {"iterations": "many"}],
)
def test_bad_options_are_refused_by_name(changes: dict[str, object]) -> None:
    with pytest.raises((ValueError, TypeError), match=rf"Projection\.{next(iter(changes))}"):
        Projection(**changes)  # type: ignore[arg-type]


class TestAppendixC:
    """The paper's correction, bar by bar."""

    @pytest.mark.parametrize("weight", [0.1, 1.0, 10.0])
    @pytest.mark.parametrize("speed", [0.0, 1e-8, 1e-3, 1.0, 30.0])
    def test_it_is_the_minimum_of_equation_119(self, weight: float, speed: float) -> None:
        bar = Structure([(0, 0, 0), (1.3, 0, 0)], [(0, 1)], bar_mass=2.0)
        model = Model(Scene(bar))
        rng = np.random.default_rng(4)
        x = model.state([(0, 0, 0), (1.33, 0.2, -0.1)], speed * rng.normal(size=(2, 3)))
        step = BarLengthCorrection(weight).step(model)
        assert step is not None
        y = step(x).full().ravel()

        def parts(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.diff(model.nodes(x), axis=0)[0], np.diff(model.velocities(x), axis=0)[0]

        (b, bd), (c, cd) = parts(x), parts(y)
        assert np.linalg.norm(c) == pytest.approx(1.3, rel=1e-15)
        assert abs(c @ cd) < 1e-14 * (1 + speed)
        cost = weight * np.sum((c - b) ** 2) + np.sum((cd - bd) ** 2)
        for _ in range(200):  # no other direction does better
            v = c / 1.3 + rng.choice([1e-4, 1e-2, 1.0]) * rng.normal(size=3)
            v /= np.linalg.norm(v)
            assert weight * np.sum((1.3 * v - b) ** 2) + (v @ bd) ** 2 >= cost * (1 - 1e-12)
        assert np.allclose(model.nodes(x).mean(axis=0), model.nodes(y).mean(axis=0), atol=1e-15)

    def test_open_chains_close_exactly_and_closed_loops_do_not(self) -> None:
        rng = np.random.default_rng(5)
        chain = Structure(
            [(0, 0, 0), (1, 0.2, 0), (2, 0, 0.3), (1, 0, 2)],
            [(0, 1), (1, 2)],
            [(2, 3)],
            node_mass=[0, 0, 0, 1],
            pinned=(0,),
        )
        for structure, closed in ((chain, False), (LOOP.replace(pinned=(0,)), True)):
            model = Model(Scene(structure), "full")
            x = model.initial_state + 1e-4 * rng.normal(size=model.nx)
            step = BarLengthCorrection().step(model)
            assert step is not None
            y = step(x).full().ravel()
            assert model.bar_length_error(y) < 1e-15
            assert (model.joint_error(y) > 1e-6) == closed
            if not closed:
                assert model.joint_error(y) < 1e-15

    def test_it_keeps_bars_over_a_run_as_the_projection_does(self) -> None:
        case = certified("prism_n1")
        model = Model(case.scene)
        runs = [
            simulate(model, 5.0, 2e-3, correction=correction)
            for correction in (None, BarLengthCorrection(), Projection())
        ]
        assert runs[0].bar_length_error.max() > 1e-7
        for run in runs[1:]:
            assert run.bar_length_error.max() < 1e-14
        assert abs(runs[1].nodes[-1] - runs[2].nodes[-1]).max() < 1e-5

    def test_joints_in_reduced_coordinates_are_refused(self) -> None:
        with pytest.raises(ValueError, match="BarLengthCorrection"):
            BarLengthCorrection().step(Model(Scene(LOOP)))
        with pytest.raises(ValueError, match=r"BarLengthCorrection\.weight"):
            BarLengthCorrection(weight=0.0)


def test_the_printed_multiplier_lets_lengths_drift_where_the_current_one_does_not() -> None:
    ball = shapes.six_bar_ball(prestress=50.0)
    scene = Scene(ball, gravity=Gravity())
    start = Model(scene).initial_state + 1e-8 * np.random.default_rng(6).normal(size=72)
    drift = [
        simulate(Model(scene, bar_length=name), 1.0, 1e-3, state=start).bar_length_error[-1]
        for name in ("current", "constant")
    ]  # type: ignore[arg-type]
    assert drift[1] > 100 * drift[0]
    assert drift[0] < 1e-7
    with pytest.raises(ValueError, match=r"Model\.bar_length"):
        Model(Scene(LOOP), "reduced", "constant")
    assert Model(Scene(LOOP), "full", "constant").ode is not None


@pytest.mark.parametrize(
    "correction", [Projection(), Projection(every=7), BarLengthCorrection(weight=2.0)], ids=str
)
def test_a_trajectory_tells_what_its_correction_did(
    correction: Projection | BarLengthCorrection,
) -> None:
    model = Model(certified("prism_n1").scene)
    effects = {}
    for step in (1e-2, 5e-3):
        run = simulate(model, 1.0, step, correction=correction)
        assert run.correction_shift.shape == run.correction_energy.shape == run.time.shape
        effects[step] = run.correction_shift.max(), abs(run.correction_energy).max()
        assert "correction    moves a node by" in run.summary()
    assert (
        1e-12 < effects[5e-3][0] < effects[1e-2][0] / 10
    )  # what a step does wrong falls like its fifth power
    assert 0 < effects[5e-3][1] < effects[1e-2][1] / 10
    plain = simulate(model, 1.0, 1e-2)
    assert not plain.correction_shift.any()
    if correction == Projection():  # one step, by hand
        x = model.initial_state
        once = simulate(model, 1e-2, 1e-2).states[-1]
        moved = build_projection(model)(once).full().ravel()
        first = simulate(model, 1e-2, 1e-2, correction=correction, state=x).correction_shift[0]
        assert first == pytest.approx(
            np.linalg.norm(model.nodes(moved) - model.nodes(once), axis=1).max(), rel=1e-6
        )


@pytest.mark.parametrize(
    "correction", [Projection(), BarLengthCorrection()], ids=lambda value: type(value).__name__
)
def test_what_is_no_model_is_refused_by_name(correction):
    with pytest.raises(TypeError, match=r"model is 'prism': give a tenscasadi\.Model"):
        correction.step("prism")

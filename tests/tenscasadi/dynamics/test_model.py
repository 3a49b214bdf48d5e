"""The model against peers' accelerations and multipliers, against a plain KKT solve, and against its own promises."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest
from references import CERTIFIED, MOTES, certified, motes
from scenes import every_term

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity, Ground, NodalForce, Pressure
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, RestLength, Slack, Smooth
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError

BOTH = pytest.mark.parametrize("coordinates", ["reduced", "full"])
PRISM = {
    "nodes": [(-0.5, 0, 0), (0.5, 0, 0), (0, 0.866, 0), (0, 0.866, 1), (-0.5, 0, 1), (0.5, 0, 1)],
    "bars": [(0, 3), (1, 4), (2, 5)],
    "strings": [(1, 2), (2, 0), (0, 1), (5, 3), (3, 4), (4, 5), (1, 5), (2, 3), (0, 4)],
    "rest_length": 0.7,
}


def accelerations(model: Model, x: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
    """N̈ (n, 3) of physical nodes."""
    rate = model.ode(x, model.initial_control if u is None else u).full().ravel()
    shifted = np.concatenate([rate[model.nq : 2 * model.nq], np.zeros(model.nx - model.nq)])
    return model.nodes(shifted) - model.nodes(np.zeros(model.nx))


def relative(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The largest difference relative to the largest entry (to 1 where everything vanishes)."""
    return float(abs(ours - theirs).max(initial=0.0) / max(abs(theirs).max(initial=0.0), 1e-12))


def by_kkt(structure: Structure, nodes: np.ndarray, velocities: np.ndarray, F: np.ndarray) -> np.ndarray:
    """N̈ (n, 3) from the textbook saddle-point system on physical coordinates, by a pseudo-inverse: forces F (n, 3)."""
    n = len(nodes)
    M = np.kron(structure.mass_matrix().toarray(), np.eye(3))
    rows, rates = [], []
    for a, b in structure.bars:
        row = np.zeros((n, 3))
        row[b], row[a] = nodes[b] - nodes[a], nodes[a] - nodes[b]
        rows.append(row.ravel())
        rates.append(-np.sum((velocities[b] - velocities[a]) ** 2))
    for k in np.flatnonzero(structure.fixed.ravel()):
        rows.append(np.eye(3 * n)[k])
        rates.append(0.0)
    A = np.array(rows).reshape(-1, 3 * n)
    K = np.block([[M, A.T], [A, np.zeros((len(A), len(A)))]])
    return (np.linalg.pinv(K, rcond=1e-13) @ np.concatenate([F.ravel(), rates]))[: 3 * n].reshape(n, 3)


@BOTH
@pytest.mark.parametrize("name", MOTES)
def test_accelerations_and_multipliers_are_the_peers(name: str, coordinates: mechanism.Coordinates) -> None:
    case = motes(name)
    model = Model(case.scene, coordinates)
    tolerance = 1e-6 if name.startswith("ex03") else 1e-8
    data = case.data
    for k in range(len(data["smp_N"])):
        x = model.state(data["smp_N"][k].T[case.columns], data["smp_Nd"][k].T[case.columns])
        theirs = data["smp_Ndd"][k].T[case.columns]
        if name.startswith("ex01") and not theirs.any():  # the peer's strings at exactly their rest length
            continue
        assert relative(accelerations(model, x), theirs) < tolerance
        assert abs(model.force_density(x) - data["smp_gamma"][k]).max(initial=0) < tolerance * max(1.0, abs(data["smp_gamma"][k]).max(initial=0))
        ours = model.multipliers(x)
        assert relative(ours.bar_force_density, data["smp_lambda"][k].ravel()) < tolerance
        if "smp_Omega" in data:
            assert relative(ours.joint_force, data["smp_Omega"][k]) < tolerance


@BOTH
@pytest.mark.parametrize("name", CERTIFIED)
def test_initial_accelerations_are_certified(name: str, coordinates: mechanism.Coordinates) -> None:
    case = certified(name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(case.scene, coordinates)
    meta = case.info["meta"]
    x = model.state(case.scene.structure.nodes, case.velocities)
    assert relative(accelerations(model, x), np.array(meta["acc0"])[case.columns]) < 1e-11
    assert model.energy(x).total == pytest.approx(meta["energy"][0], abs=1e-9)
    if meta["omega0"] is not None:
        ours = model.multipliers(x)
        assert relative(ours.bar_force_density, np.array(meta["lambda0"])) < 1e-11
        if np.size(meta["omega0"]):
            assert relative(ours.joint_force, np.array(meta["omega0"])) < 1e-11


@BOTH
@pytest.mark.parametrize("pinned", [(), (0,), {0: "xyz", 1: "z"}, {0: "xyz", 3: "xy"}, {0: "x", 1: "y", 2: "z"}], ids=str)
def test_class_k_chain_with_supports_matches_a_saddle_point_solve(pinned: object, coordinates: mechanism.Coordinates) -> None:
    rng = np.random.default_rng(1)
    structure = Structure(
        rng.normal(size=(6, 3)), bars=[(0, 1), (1, 2), (2, 3)], strings=[(0, 4), (3, 4), (4, 5), (1, 5)], node_mass=[0.1, 0, 0.3, 0, 0.2, 0.5],
        bar_mass=[1, 2, 3], bar_radius=0.1, pinned=pinned, rest_length=0.5,
    )  # fmt: skip
    model = Model(Scene(structure, gravity=Gravity((1, 2, -9))), coordinates)
    velocities = np.where(structure.fixed, 0.0, rng.normal(size=(6, 3)))
    x = model.state(structure.nodes, velocities)
    S = np.diff(structure.nodes[structure.strings], axis=1)[:, 0]
    pull = structure.C_s.T @ (-model.force_density(x)[:, None] * S)
    weight = np.outer(structure.mass_matrix().sum(axis=1), (1, 2, -9))
    assert relative(accelerations(model, x), by_kkt(structure, structure.nodes, velocities, pull + weight)) < 1e-10


@BOTH
def test_a_pinned_string_node_needs_no_mass(coordinates: mechanism.Coordinates) -> None:
    mast = Structure([(0, 0, 0), (0, 0, 2), (1, 0, 0)], [(0, 1)], [(1, 2)], pinned=(0, 2), rest_length=1.5)
    model = Model(Scene(mast, gravity=Gravity((1, 2, -9))), coordinates)
    pull = mast.C_s.T @ (-model.force_density(model.initial_state)[:, None] * np.diff(mast.nodes[mast.strings], axis=1)[:, 0])
    weight = np.outer(mast.mass_matrix().sum(axis=1), (1, 2, -9))
    expected = by_kkt(mast, mast.nodes, 0 * mast.nodes, pull + weight)
    assert relative(accelerations(model, model.initial_state), expected) < 1e-12
    assert np.allclose(model.multipliers(model.initial_state).joint_force[:, -1], -(pull + weight)[2])


RING = [(0, 1), (1, 2), (2, 3), (3, 0)]
REDUNDANT = {
    "both ends pinned": Structure([(0, 0, 0), (1, 0, 0), (0.5, 0.7, 0)], [(0, 1), (1, 2)], pinned=(0, 1)),
    "adjacent pins of a D-bar": Structure([(0, 0, 0), (1, 0.2, 0), (2, 0, 0), (1, -0.8, 0)], RING, [(0, 2), (1, 3)], pinned=(0, 1)),
    "triangle on two pins": Structure([(0, 0, 0), (1, 0, 0), (0.4, 0, 0.8)], [(0, 1), (1, 2), (2, 0)], pinned=(0, 1)),
    "planar K4": Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [*RING, (0, 2), (1, 3)]),
    "folded D-bar": Structure([(0, 0, 0), (1, 0, 0), (2, 0, 0), (1, 0, 1e-300)], RING, pinned=(0,)),
}  # fmt: skip


@BOTH
@pytest.mark.parametrize("name", REDUNDANT)
def test_redundant_constraints_are_named_and_solved(name: str, coordinates: mechanism.Coordinates) -> None:
    structure = REDUNDANT[name]
    with pytest.warns(RedundantConstraints, match="bars 0|joints"):
        model = Model(Scene(structure, gravity=Gravity((3, -4, 5))), coordinates)
    rng = np.random.default_rng(2)
    velocities = np.zeros_like(structure.nodes)
    if name == "planar K4":  # consistent rates: a rigid motion
        spin = rng.normal(size=3)
        velocities = np.cross(spin, structure.nodes)
    x = model.state(structure.nodes, velocities)
    weight = np.outer(structure.mass_matrix().sum(axis=1), (3, -4, 5))
    if len(structure.strings):
        S = np.diff(structure.nodes[structure.strings], axis=1)[:, 0]
        weight = weight + structure.C_s.T @ (-model.force_density(x)[:, None] * S)
    expected = by_kkt(structure, structure.nodes, velocities, weight)
    assert abs(accelerations(model, x) - expected).max() < 1e-12 * max(1.0, abs(expected).max())


@BOTH
@pytest.mark.parametrize(("gap", "tolerance"), [(1e-3, 1e-7), (1e-6, 1e-3)])
def test_nearly_aligned_bars_stay_close_to_the_saddle_point_solution(gap: float, tolerance: float, coordinates: mechanism.Coordinates) -> None:
    structure = Structure([(0, 0, 0), (1, gap, 0), (2, 0, 0)], [(0, 1), (1, 2)], pinned=(0, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)
        model = Model(Scene(structure, gravity=Gravity((0, 0, -9.81))), coordinates)
    x = model.initial_state
    F = np.outer(structure.mass_matrix().sum(axis=1), (0, 0, -9.81))
    assert relative(accelerations(model, x), by_kkt(structure, structure.nodes, 0 * structure.nodes, F)) < tolerance


@BOTH
@pytest.mark.parametrize("moved", [False, True], ids=["standing", "moved"])
@pytest.mark.parametrize("slack", [Clip(), Smooth(0.01)], ids=["clip", "smooth"])
def test_ode_derivatives_agree_with_central_differences(slack: Slack, moved: bool, coordinates: mechanism.Coordinates) -> None:
    """Every term at once, away from where strings go slack or nodes touch down."""
    rng = np.random.default_rng(4)
    model = Model(every_term(slack, moved), coordinates)
    fixed = model.structure.fixed
    x = model.state(model.structure.nodes, np.where(fixed, 0, rng.normal(size=fixed.shape)))
    x[-1] = 0.3  # s
    u = model.initial_control * 0.9
    sx, su = ca.MX.sym("x", model.nx), ca.MX.sym("u", model.nu)
    rate = model.ode(sx, su)
    jacobian = ca.Function("jacobian", [sx, su], [ca.jacobian(rate, sx), ca.jacobian(rate, su)])
    A, B = (block.full() for block in jacobian(x, u))

    def slope(k: int, of_control: bool) -> np.ndarray:
        step = 1e-6
        plus, minus = np.zeros(model.nu if of_control else model.nx), np.zeros(model.nu if of_control else model.nx)
        plus[k], minus[k] = step, -step
        values = [model.ode(*((x, u + d) if of_control else (x + d, u))).full().ravel() for d in (plus, minus)]
        return (values[0] - values[1]) / (2 * step)

    numeric_A = np.stack([slope(k, False) for k in range(model.nx)], axis=1)
    numeric_B = np.stack([slope(k, True) for k in range(model.nu)], axis=1)
    assert relative(A, numeric_A) < 1e-7
    assert relative(B, numeric_B) < 1e-7


def test_a_string_of_no_length_has_finite_forces_and_derivatives() -> None:
    structure = Structure([(0, 0, 0), (1, 0, 0), (2, 0, 0)], strings=[(0, 1), (1, 2)], node_mass=1.0, damping=1.0)
    for slack in (None, Smooth(1e-3)):
        model = Model(Scene(structure) if slack is None else Scene(structure, slack=slack))
        x = model.state([(0, 0, 0), (0, 0, 0), (2, 0, 0)])
        symbol = ca.MX.sym("x", model.nx)
        jacobian = ca.Function("j", [symbol], [ca.jacobian(model.ode(symbol, []), symbol)])
        assert np.isfinite(model.ode(x, []).full()).all()
        assert np.isfinite(jacobian(x).full()).all()
        assert model.tension(x)[0] == pytest.approx(0, abs=1e-4)


class TestOnlyWhatTheSceneHas:
    """A term that the scene lacks builds no expression."""

    def test_each_term_is_listed_exactly_when_present(self) -> None:
        bare = Model(Scene(Structure(**PRISM)))
        full = Model(
            Scene(
                Structure(**{**PRISM, "damping": 1.0}), gravity=Gravity(), ground=Ground(), pressure=Pressure([(0, 1, 2)], 1.0),
                forces=NodalForce(np.ones((6, 3))),
            )
        )  # fmt: skip
        assert set(bare.describe()) == {"string elasticity", "bars (λ) and inverse mass", "total"}
        assert set(full.describe()) - set(bare.describe()) == {"string damping", "gravity", "ground", "pressure", "nodal forces"}
        assert all(count > 0 for count in full.describe().values())
        assert "string damping" in str(full.describe())

    def test_the_right_hand_side_has_no_instruction_of_an_absent_term(self) -> None:
        structure = Structure(**PRISM)
        bare = dynamics_instructions(Scene(structure))
        for richer in (
            Scene(structure, gravity=Gravity()),
            Scene(structure, ground=Ground()),
            Scene(structure.replace(damping=1.0)),
            Scene(structure, pressure=Pressure([(0, 1, 2)], 1.0)),
            Scene(structure, forces=NodalForce(np.ones((6, 3)))),
        ):
            assert dynamics_instructions(richer) > bare
        assert dynamics_instructions(Scene(structure.replace(damping=0.0))) == bare

    def test_one_damped_string_costs_less_than_nine(self) -> None:
        structure = Structure(**PRISM)
        one = np.zeros(9)
        one[4] = 1.0
        assert dynamics_instructions(Scene(structure.replace(damping=one))) < dynamics_instructions(Scene(structure.replace(damping=1.0)))

    def test_undamped_strings_do_not_depend_on_velocity_and_string_nets_have_no_multipliers(self) -> None:
        net = Structure([(0, 0, 0), (1, 0, 0), (0, 1, 0)], strings=[(0, 1), (1, 2), (2, 0)], node_mass=1.0, rest_length=0.9)
        model = Model(Scene(net))
        pattern = np.array(ca.DM(model.ode.jac_sparsity(0, 0), 1).full())
        assert not pattern[model.nq :, model.nq :].any()
        assert "inverse mass" in model.describe()
        assert not any("λ" in term or "Ω" in term for term in model.describe())
        division = [k for k in range(model.ode.n_instructions()) if model.ode.instruction_id(k) == ca.OP_DIV]
        assert len(division) == 3  # one ρ/s for each string, none for multipliers

    def test_force_densities_build_no_string_law(self) -> None:
        model = Model(Scene(Structure(**PRISM), control=ForceDensity()))
        kinds = {model.ode.instruction_id(k) for k in range(model.ode.n_instructions())}
        assert ca.OP_SQRT not in kinds
        assert ca.OP_LT not in kinds

    def test_joints_build_omega_in_full_coordinates_only(self) -> None:
        chain = Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [(0, 1), (1, 2)])
        assert any("Ω" in term for term in Model(Scene(chain), "full").describe())
        assert not any("Ω" in term for term in Model(Scene(chain)).describe())
        apart = Structure([(0, 0, 0), (1, 0, 0), (1, 1, 0), (2, 2, 0)], [(0, 1), (2, 3)])
        assert not any("Ω" in term for term in Model(Scene(apart), "full").describe())


def dynamics_instructions(scene: Scene) -> int:
    """Instructions of the right-hand side."""
    return int(Model(scene).ode.n_instructions())


@BOTH
@pytest.mark.parametrize("case", ["every term", "class 1", "force densities"])
def test_the_vector_form_gives_the_same_numbers(case: str, coordinates: mechanism.Coordinates, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    prism = Structure(**{**PRISM, "damping": rng.uniform(0.1, 0.5, 9), "stiffness": 100.0})
    control = ForceDensity() if case == "force densities" else None
    scene = every_term() if case == "every term" else Scene(prism, control=control, gravity=Gravity(), ground=Ground(100.0, 1.0, friction=0.3))
    unrolled = Model(scene, coordinates)
    fixed = unrolled.structure.fixed
    x = unrolled.state(unrolled.structure.nodes, np.where(fixed, 0, rng.normal(size=fixed.shape)))
    u = 0.9 * unrolled.initial_control
    ours = [unrolled.ode(x, u), *unrolled.observe(x, u)]
    monkeypatch.setattr(mechanism, "UNROLL_MEMBERS", 0)
    vector = Model(scene, coordinates)
    assert vector.ode.class_name() == "MXFunction"
    for value, expected in zip([vector.ode(x, u), *vector.observe(x, u)], ours, strict=True):
        assert np.allclose(value.full(), expected.full(), rtol=1e-12, atol=1e-12 * np.abs(expected.full()).max(initial=1.0))


@BOTH
def test_power_is_the_rate_of_change_of_energy(coordinates: mechanism.Coordinates) -> None:
    rng = np.random.default_rng(6)
    structure = Structure(**{**PRISM, "damping": 0.5})
    scene = Scene(structure, gravity=Gravity(), ground=Ground(50.0, 1.0, friction=0.2, height=0.4), forces=NodalForce(rng.normal(size=(6, 3))))
    model = Model(scene, coordinates)
    x = model.state(structure.nodes, rng.normal(size=(6, 3)))
    from tenscasadi.integrators.stabilization import projection

    x = projection(model)(x).full().ravel()
    rate = model.ode(x, []).full().ravel()
    h = 1e-6
    slope = (model.energy(x + h * rate).total - model.energy(x - h * rate).total) / (2 * h)
    assert model.power is not None
    assert float(model.power(x, [])) == pytest.approx(slope, rel=1e-6)
    assert Model(Scene(Structure(**PRISM))).power is None


def test_the_compiled_right_hand_side_gives_the_same_numbers() -> None:
    model = Model(Scene(Structure(**PRISM), control=RestLength(), gravity=Gravity()))
    x, u = model.initial_state, 0.9 * model.initial_control
    try:
        compiled = model.compile()
    except CompileError:
        pytest.skip("no C compiler")
    assert np.allclose(compiled(x, u).full(), model.ode(x, u).full(), rtol=1e-14, atol=1e-13)
    assert compiled.name_in() == ["x", "u"]


def test_parent_strings_are_controlled_as_a_whole() -> None:
    structure = Structure(**{**PRISM, "string_mass": 0.04})
    one = Model(Scene(structure, control=ForceDensity()))
    three = Model(Scene(structure, control=ForceDensity(), segments=3))
    assert three.nu == one.nu == 9
    gamma = np.linspace(10, 50, 9)
    assert np.allclose(three.force_density(three.initial_state, gamma).reshape(9, 3), 3 * gamma[:, None])
    assert np.allclose(three.tension(three.initial_state, gamma).reshape(9, 3), one.tension(one.initial_state, gamma)[:, None])
    rest = Model(Scene(structure, control=RestLength(), segments=3))
    assert np.allclose(rest.tension(rest.initial_state).reshape(9, 3), one.tension(one.initial_state, one.initial_control)[:, None])


def test_forces_that_vary_with_time_put_a_clock_in_the_state() -> None:
    structure = Structure(**PRISM)

    def push(t: float) -> object:
        return [[0, 0, np.sin(3 * t)]] + [[0, 0, 0]] * 5

    model = Model(Scene(structure, forces=NodalForce(push)))
    x = model.initial_state
    assert model.nx == 37
    assert model.ode(x, []).full()[-1] == 1
    x[-1] = 0.4
    still = accelerations(Model(Scene(structure)), x[:-1])
    load = np.zeros((6, 3))
    load[0, 2] = np.sin(1.2)
    assert np.allclose(accelerations(model, x), accelerations(Model(Scene(structure, forces=NodalForce(load))), x[:-1]))
    assert not np.allclose(accelerations(model, x), still)


def test_state_and_nodes_are_inverse_and_take_symbols() -> None:
    structure = Structure(**PRISM, pinned=(0,))
    rng = np.random.default_rng(7)
    for coordinates in ("reduced", "full"):
        model = Model(Scene(structure), coordinates)  # type: ignore[arg-type]
        nodes = np.where(structure.fixed, structure.nodes, structure.nodes + rng.normal(size=(6, 3)))
        velocities = np.where(structure.fixed, 0, rng.normal(size=(6, 3)))
        x = model.state(nodes, velocities)
        assert np.allclose(model.nodes(x), nodes)
        assert np.allclose(model.velocities(np.stack([x, x])), np.stack([velocities, velocities]))
        symbol = ca.MX.sym("x", model.nx)
        N = ca.Function("N", [symbol], [model.nodes(symbol), model.tension(symbol)])(x)
        assert np.allclose(N[0].full().T, nodes)
        assert np.allclose(N[1].full().ravel(), model.tension(x))


def test_bad_input_is_refused_by_name() -> None:
    structure = Structure(**PRISM, pinned=(0,))
    with pytest.raises(TypeError, match=r"Model\.scene"):
        Model(structure)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"Model\.coordinates"):
        Model(Scene(structure), "minimal")  # type: ignore[arg-type]
    model = Model(Scene(structure, control=ForceDensity()))
    with pytest.raises(ValueError, match=r"nodes has shape"):
        model.state(structure.nodes[:5])
    with pytest.raises(ValueError, match=r"nodes\[2, 1\] is nan"):
        model.state(np.where(np.arange(18).reshape(6, 3) == 7, np.nan, structure.nodes))
    with pytest.raises(ValueError, match=r"nodes\[0, 0\].*pinned"):
        model.state(structure.nodes + 0.1)
    with pytest.raises(ValueError, match=r"velocities\[0, 0\].*pinned"):
        model.state(structure.nodes, np.ones((6, 3)))
    with pytest.raises(ValueError, match=r"u has shape"):
        model.force_density(model.initial_state, np.ones(8))
    with pytest.raises(ValueError, match=r"x has shape"):
        model.energy(np.ones(7))
    with pytest.raises(ValueError, match=r"x has shape"):
        model.nodes(np.ones(7))


@BOTH
@pytest.mark.parametrize("moved", [False, True], ids=["standing", "moved"])
def test_constraints_vanish_where_kept_and_their_rates_are_rates(moved: bool, coordinates: mechanism.Coordinates) -> None:
    model = Model(every_term(moved=moved), coordinates)
    assert max(np.abs(rows).max(initial=0.0) for rows in model.constraints(model.initial_state)) < 1e-13
    assert len(model.constraints(model.initial_state).joints) == np.count_nonzero(model.mechanism.active)
    x = model.initial_state + 1e-4 * np.random.default_rng(7).normal(size=model.nx)
    now = model.constraints(x)
    B = model.mechanism.C_b @ np.asarray(model.unpack(ca.DM(x))[0]).T
    assert np.allclose(now.bars, np.linalg.norm(B, axis=1) - model.mechanism.lengths, rtol=0, atol=1e-7)
    if coordinates == "full":
        assert np.abs(now.joints).max() == pytest.approx(model.joint_error(x))
    sx = ca.MX.sym("x", model.nx)
    rows = model.constraints(sx)
    change = [ca.jtimes(value, sx, model.ode(sx, model.initial_control)) for value in (rows.bars, rows.joints)]
    rates = ca.Function("rates", [sx], change)(x)
    for rate, expected in zip(rates, (now.bar_rates, now.joint_rates), strict=True):
        assert np.allclose(rate.full().ravel(), expected, rtol=1e-9, atol=1e-12)


def test_constraints_of_what_has_none_are_empty() -> None:
    model = Model(Scene(Structure([(0, 0, 0), (1, 0, 0)], strings=[(0, 1)], node_mass=1.0)))
    assert [len(rows) for rows in model.constraints(model.initial_state)] == [0, 0, 0, 0]
    with pytest.raises(ValueError, match="x"):
        model.constraints(np.zeros(3))

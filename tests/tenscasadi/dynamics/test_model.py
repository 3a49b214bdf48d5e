"""The model against peers' accelerations and multipliers, and against its own promises."""

from __future__ import annotations

import warnings
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from comparison import BOTH, accelerations, relative
from references import CERTIFIED, MOTES, certified, motes
from scenes import PRISM, every_term

from tenscasadi.dynamics import mechanism
from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, RestLength, Smooth, StringLaw
from tenscasadi.structure.shapes import double_pendulum
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError


@BOTH
@pytest.mark.parametrize("name", MOTES)
def test_accelerations_and_multipliers_are_the_peers(
    name: str, coordinates: mechanism.Coordinates
) -> None:
    case = motes(name)
    model = Model(case.scene, coordinates)
    tolerance = 1e-6 if name.startswith("ex03") else 1e-8
    data = case.data
    for k in range(len(data["smp_N"])):
        x = model.state(data["smp_N"][k].T[case.columns], data["smp_Nd"][k].T[case.columns])
        theirs = data["smp_Ndd"][k].T[case.columns]
        if (
            name.startswith("ex01") and not theirs.any()
        ):  # the peer's strings at exactly their rest length
            continue
        assert relative(accelerations(model, x), theirs) < tolerance
        assert abs(model.force_density(x) - data["smp_gamma"][k]).max(initial=0) < tolerance * max(
            1.0, abs(data["smp_gamma"][k]).max(initial=0)
        )
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
@pytest.mark.parametrize("moved", [False, True], ids=["standing", "moved"])
@pytest.mark.parametrize("slack", [Clip(), Smooth(0.01)], ids=["clip", "smooth"])
def test_ode_derivatives_agree_with_central_differences(
    slack: StringLaw, moved: bool, coordinates: mechanism.Coordinates
) -> None:
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
        plus, minus = (
            np.zeros(model.nu if of_control else model.nx),
            np.zeros(model.nu if of_control else model.nx),
        )
        plus[k], minus[k] = step, -step
        values = [
            model.ode(*((x, u + d) if of_control else (x + d, u))).full().ravel()
            for d in (plus, minus)
        ]
        return (values[0] - values[1]) / (2 * step)

    numeric_A = np.stack([slope(k, False) for k in range(model.nx)], axis=1)
    numeric_B = np.stack([slope(k, True) for k in range(model.nu)], axis=1)
    assert relative(A, numeric_A) < 1e-7
    assert relative(B, numeric_B) < 1e-7


def test_a_string_of_no_length_has_finite_forces_and_derivatives() -> None:
    structure = Structure(
        [(0, 0, 0), (1, 0, 0), (2, 0, 0)], strings=[(0, 1), (1, 2)], node_mass=1.0, damping=1.0
    )
    for slack in (None, Smooth(1e-3)):
        model = Model(Scene(structure) if slack is None else Scene(structure, slack=slack))
        x = model.state([(0, 0, 0), (0, 0, 0), (2, 0, 0)])
        symbol = ca.MX.sym("x", model.nx)
        jacobian = ca.Function("j", [symbol], [ca.jacobian(model.ode(symbol, []), symbol)])
        assert np.isfinite(model.ode(x, []).full()).all()
        assert np.isfinite(jacobian(x).full()).all()
        assert model.tension(x)[0] == pytest.approx(0, abs=1e-4)


@BOTH
@pytest.mark.parametrize("case", ["every term", "class 1", "force densities"])
def test_the_vector_form_gives_the_same_numbers(
    case: str, coordinates: mechanism.Coordinates, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(5)
    prism = Structure(**{**PRISM, "damping": rng.uniform(0.1, 0.5, 9), "stiffness": 100.0})
    control = ForceDensity() if case == "force densities" else None
    scene = (
        every_term()
        if case == "every term"
        else Scene(
            prism, control=control, gravity=Gravity(), ground=Ground(100.0, 1.0, friction=0.3)
        )
    )
    unrolled = Model(scene, coordinates)
    fixed = unrolled.structure.fixed
    x = unrolled.state(unrolled.structure.nodes, np.where(fixed, 0, rng.normal(size=fixed.shape)))
    u = 0.9 * unrolled.initial_control
    ours = [unrolled.ode(x, u), *unrolled.observe(x, u)]
    monkeypatch.setattr(mechanism, "UNROLL_MEMBERS", 0)
    vector = Model(scene, coordinates)
    assert vector.ode.class_name() == "MXFunction"
    for value, expected in zip([vector.ode(x, u), *vector.observe(x, u)], ours, strict=True):
        assert np.allclose(
            value.full(),
            expected.full(),
            rtol=1e-12,
            atol=1e-12 * np.abs(expected.full()).max(initial=1.0),
        )


@BOTH
def test_power_is_the_rate_of_change_of_energy(coordinates: mechanism.Coordinates) -> None:
    rng = np.random.default_rng(6)
    structure = Structure(**{**PRISM, "damping": 0.5})
    scene = Scene(
        structure,
        gravity=Gravity(),
        ground=Ground(50.0, 1.0, friction=0.2, height=0.4),
        forces=NodalForce(rng.normal(size=(6, 3))),
    )
    model = Model(scene, coordinates)
    x = model.state(structure.nodes, rng.normal(size=(6, 3)))
    from tenscasadi.integrators.stabilization import build_projection

    x = build_projection(model)(x).full().ravel()
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
    assert np.allclose(
        three.force_density(three.initial_state, gamma).reshape(9, 3), 3 * gamma[:, None]
    )
    assert np.allclose(
        three.tension(three.initial_state, gamma).reshape(9, 3),
        one.tension(one.initial_state, gamma)[:, None],
    )
    rest = Model(Scene(structure, control=RestLength(), segments=3))
    assert np.allclose(
        rest.tension(rest.initial_state).reshape(9, 3),
        one.tension(one.initial_state, one.initial_control)[:, None],
    )


@pytest.mark.parametrize("control", [ForceDensity(), RestLength()])
def test_one_string_alone_is_controlled_in_segments_too(control) -> None:
    ends = Structure(
        [(0, 0, 0), (2, 0, 0)], strings=[(0, 1)], node_mass=0.5, string_mass=0.1, stiffness=10.0
    )
    model = Model(Scene(ends, control=control, segments=2))
    accelerations = (
        model.ode(model.initial_state, [4.0 if control == ForceDensity() else 1.2])[model.nq :]
        .full()
        .reshape(-1, 3)
    )
    np.testing.assert_allclose(
        accelerations, [(16, 0, 0), (-16, 0, 0), (0, 0, 0)], rtol=1e-12, atol=1e-12
    )  # 8 N on 0.5 kg


def test_forces_that_vary_with_time_put_a_clock_in_the_state() -> None:
    structure = Structure(**PRISM)

    def push(t: float) -> object:
        return [[0, 0, np.sin(3 * t)]] + [[0, 0, 0]] * 5

    model = Model(Scene(structure, forces=NodalForce(push)))
    x = model.initial_state.copy()
    assert model.nx == 37
    assert model.ode(x, []).full()[-1] == 1
    x[-1] = 0.4
    still = accelerations(Model(Scene(structure)), x[:-1])
    load = np.zeros((6, 3))
    load[0, 2] = np.sin(1.2)
    assert np.allclose(
        accelerations(model, x),
        accelerations(Model(Scene(structure, forces=NodalForce(load))), x[:-1]),
    )
    assert not np.allclose(accelerations(model, x), still)


def test_functions_of_a_model_with_parameters_take_them_after_the_control() -> None:
    scene = Scene(
        Structure(**PRISM),
        control=RestLength(),
        gravity=Gravity(),
        parameters=Parameters("bar_mass", scale=["gravity"]),
    )
    model = Model(scene)
    assert (model.np, model.nw) == (4, model.nu + 4)
    x, u, p = model.initial_state, model.initial_control, np.array([1.0, 2.0, 3.0, 0.5])
    for function in (model.ode, model.observe, model.energy_function, model.multiplier_function):
        assert function.name_in() == ["x", "u", "p"]
        held = model.with_stacked_input(function)
        assert held.n_in() == 2
        for value, other in zip(
            function.call([x, u, p]), held.call([x, np.concatenate([u, p])]), strict=True
        ):
            assert np.array_equal(value.full(), other.full())
    own = ca.Function(
        "own", model.ode.sx_in(), [2 * model.ode(*model.ode.sx_in())]
    )  # one that the model did not make
    assert np.allclose(
        model.with_stacked_input(own)(x, np.concatenate([u, p])).full(),
        2 * model.ode(x, u, p).full(),
    )
    assert np.array_equal(model.stack_inputs(u, p), np.concatenate([u, p]))
    compiled = model.compile()
    assert np.allclose(compiled(x, u, p).full(), model.ode(x, u, p).full(), rtol=1e-12, atol=1e-9)


def test_without_parameters_functions_stay_as_they_are() -> None:
    model = Model(Scene(Structure(**PRISM)))
    assert model.with_stacked_input(model.ode) is model.ode
    with pytest.warns(DeprecationWarning, match="use with_stacked_input"):
        assert model.stacked(model.ode) is model.ode
    assert model.with_parameters() is model
    assert model.np == 0
    assert model.ode.n_in() == 2


def test_parameters_may_be_symbols() -> None:
    model = Model(Scene(Structure(**PRISM), parameters=Parameters("stiffness")))
    p = ca.SX.sym("p", model.np)
    tension = ca.Function("tension", [p], [model.tension(model.initial_state, parameters=p)])
    assert np.allclose(
        tension(model.parameters.nominal).full().ravel(), model.tension(model.initial_state)
    )
    with pytest.raises(ValueError, match="parameters has shape"):
        model.tension(model.initial_state, parameters=ca.SX.sym("p", 2))
    driven = Model(
        Scene(Structure(**PRISM), control=RestLength(), parameters=Parameters("stiffness"))
    )
    with pytest.raises(ValueError, match="give the control, too"):
        driven.tension(driven.initial_state, parameters=p)


def test_each_function_is_stacked_for_itself() -> None:
    model = Model(Scene(Structure(**PRISM), parameters=Parameters("stiffness")))
    x, p = model.initial_state, model.parameters.nominal
    for factor in range(1, 20):  # CasADi gives the memory of one that is gone to the next
        own = ca.Function("own", model.ode.sx_in(), [factor * ca.sum1(model.ode.sx_in()[2])])
        assert float(model.with_stacked_input(own)(x, p)) == pytest.approx(factor * p.sum())
        del own


@BOTH
@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
def test_energies_errors_and_multipliers_are_expressions_of_a_symbolic_state(
    kind: type, coordinates: mechanism.Coordinates
) -> None:
    """With the values that numbers give; a bar and a joint are off."""
    model = Model(every_term(), coordinates)
    x, u = kind.sym("x", model.nx), kind.sym("u", model.nu)
    if kind is ca.SX and coordinates == "full":  # joints are solved for by a routine that has no SX
        with pytest.raises(TypeError, match="multipliers got SX for x, u or parameters: give MX"):
            model.multipliers(x, u)
        return
    energy, forces = model.energy(x, u), model.multipliers(x, u)
    asked = [*energy, energy.total, model.bar_length_error(x), model.joint_error(x), *forces]
    state, control = model.initial_state * 1.01, model.initial_control
    values = ca.Function("values", [x, u], asked)(state, control)
    at = model.energy(state, control)
    numbers = [
        *at,
        at.total,
        model.bar_length_error(state),
        model.joint_error(state),
        *model.multipliers(state, control),
    ]
    for value, number in zip(values, numbers, strict=True):
        np.testing.assert_allclose(
            value.full().squeeze(), np.squeeze(number), rtol=1e-12, atol=1e-12
        )
    assert isinstance(model.bar_length_error(state), float)


def test_forces_on_pins_without_bars_are_those_of_full_coordinates() -> None:
    hanging = Structure(
        [(0, 0, 0), (0, 0, -1.1)],
        strings=[(0, 1)],
        node_mass=[0, 1.0],
        pinned=[0],
        stiffness=100.0,
        rest_length=1.0,
    )
    scene = Scene(hanging, gravity=Gravity((0, 0, -10.0)))
    forces = [
        model.multipliers(model.initial_state).joint_force
        for model in (Model(scene), Model(scene, "full"))
    ]
    assert forces[0] == pytest.approx(forces[1])
    assert forces[0][:, 0] == pytest.approx([0, 0, 10.0])


def test_model_of_another_scene_keeps_its_form():
    model = Model(Scene(double_pendulum()), "full", "constant")
    heavy = model.with_scene(replace(model.scene, gravity=Gravity()))
    assert heavy.to_fields() == {**model.to_fields(), "scene": heavy.scene}
    assert heavy.scene.gravity is not None
    assert Model(model.scene, "full").with_scene(model.scene, "reduced").nq < model.nq


def test_repr_names_sizes_and_coordinates():
    parameters = Parameters("bar_mass")
    scene = Scene(double_pendulum(), control=None, parameters=parameters)
    model = Model(scene, coordinates="full")
    assert repr(model) == "Model(24 states, 0 inputs, 2 parameters, full coordinates)"

"""Cables: Atwood's machine, a mass that slides on a cable, friction, slack as a whole."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest

import tenscasadi as tc
from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.scene.cables import SLIP_SPEED

g = 9.81
GRAVITY = tc.Gravity((0, 0, -g))
HEAVY, LIGHT = 3.0, 2.0  # kg


def fall(friction: float) -> float:
    """Acceleration of Atwood's machine, m/s²."""
    ratio = np.exp(friction * np.pi)
    return float(max(g * (HEAVY - LIGHT * ratio) / (HEAVY + LIGHT * ratio), 0.0))


def atwood(friction: float, stiffness: float = 1e5) -> tc.Model:
    """Two masses on a cable over a fixed node, stretched as in its motion."""
    a = fall(friction)
    s = tc.Structure(
        [(0, 0, 0), (0, 0, -1), (0, 0, -1.5)],
        strings=[(1, 0), (0, 2)],
        node_mass=[0, HEAVY, LIGHT],
        pinned=[0],
        stiffness=stiffness,
        cables=[[0, 1]],
        cable_friction=friction,
    )
    pull = (1.0 * HEAVY * (g - a) + 1.5 * LIGHT * (g + a)) / 2.5
    stretched = s.replace(rest_length=s.rest_length - pull / stiffness)
    return tc.Model(tc.Scene(stretched, gravity=GRAVITY))


def sliding(**options: object) -> tc.Structure:
    """A mass of 2 kg that slides on a cable of 2.6 m between (±1, 0, 0)."""
    return tc.Structure(
        [(-1, 0, 0), (0, 0, -0.833059), (1, 0, 0)],
        strings=[(0, 1), (2, 1)],
        node_mass=[0, 2, 0],
        pinned=[0, 2],
        **{"stiffness": 1e4, "rest_length": 1.3, "cables": [[0, 1]], **options},
    )


def pulleys(**options: object) -> tc.Structure:
    """Three masses on one cable of four strings, and a string in no cable."""
    return tc.Structure(
        [(-1, 0, 0), (-0.5, 0.2, -0.6), (0.1, -0.1, -0.2), (0.6, 0.1, -0.7), (1, 0, 0)],
        strings=[(0, 1), (2, 1), (1, 3), (2, 3), (3, 4)],
        node_mass=[0, 1.0, 0.5, 2.0, 0],
        pinned=[0, 4],
        **{
            "stiffness": [500.0, 700.0, 50.0, 900.0, 600.0],
            "rest_length": [0.7, 0.65, 1.2, 0.7, 0.75],
            "cables": [[0, 1, 3, 4]],
            **options,
        },
    )


# --- facts ---


@pytest.mark.parametrize(("friction", "expected"), [(0.0, 1.962), (0.05, 1.2121)])
def test_atwood_machine_accelerates_as_euler_and_eytelwein(friction, expected):
    run = tc.simulate(atwood(friction), 0.5, 1e-4)
    assert run.success, run.message
    found = -2 * (run.nodes[-1, 1, 2] + 1.0) / 0.5**2
    assert found == pytest.approx(fall(friction), rel=2e-3)
    assert fall(friction) == pytest.approx(expected, abs=5e-5)
    ratio = run.tension[-1, 0] / run.tension[-1, 1]
    assert ratio == pytest.approx(np.exp(friction * np.pi), rel=1e-5)


def test_atwood_machine_with_enough_friction_only_creeps():
    friction = 0.2
    run = tc.simulate(atwood(friction), 0.5, 1e-4)
    sign = np.log(HEAVY / LIGHT) / (friction * np.pi)
    creep = SLIP_SPEED * sign / np.sqrt(1 - sign**2)
    assert -run.velocities[-1, 1, 2] == pytest.approx(creep, rel=0.02)
    assert creep < SLIP_SPEED


def test_mass_slides_on_a_cable_as_on_an_ellipse():
    model = tc.Model(tc.Scene(sliding(), gravity=GRAVITY))
    x = model.initial_state
    assert model.ode(x, []).full().ravel()[3:] == pytest.approx([0, 0, 0], abs=1e-4)
    np.testing.assert_allclose(model.tension(x), 15.326688, rtol=1e-5)
    assert tc.modes(model).frequency[0] == pytest.approx(0.349573, rel=1e-5)


def test_cable_is_slack_as_a_whole():
    """A string longer than its own rest length has no tension if the cable has none."""
    s = sliding(rest_length=[1.2, 1.5])
    model = tc.Model(tc.Scene(s))
    long, short = model.state([(-1, 0, 0), (0.5, 0, -0.8), (1, 0, 0)]), model.initial_state
    assert np.linalg.norm([1.5, 0.8]) > 1.2
    assert (model.tension(long) == 0).all()
    assert (model.tension(short) == 0).all()
    taut = model.state([(-1, 0, 0), (0.5, 0, -1.2), (1, 0, 0)])
    tension = model.tension(taut)
    stretch = np.linalg.norm([1.5, 1.2]) + np.linalg.norm([0.5, 1.2]) - 2.7
    np.testing.assert_allclose(tension, 5e3 * stretch, rtol=1e-12)
    np.testing.assert_allclose(
        model.force_density(taut) * [np.hypot(1.5, 1.2), np.hypot(0.5, 1.2)], tension
    )


def test_stiffness_and_rest_lengths_of_a_cable_add_up():
    model = tc.Model(tc.Scene(pulleys(), control=tc.RestLength()))
    assert model.structure.cable_of.tolist() == [0, 0, 1, 0, 0]
    assert model.nu == 2
    np.testing.assert_allclose(model.initial_control, [0.7 + 0.65 + 0.7 + 0.75, 1.2])
    s = model.structure
    compliance = (1 / s.stiffness[[0, 1, 3, 4]]).sum()
    stretch = s.string_lengths[[0, 1, 3, 4]].sum() - 2.5
    tension = model.tension(model.initial_state, [2.5, 2.0])
    np.testing.assert_allclose(tension[[0, 1, 3, 4]], stretch / compliance, rtol=1e-12)
    assert tension[2] == 0.0


# --- laws ---


@pytest.mark.parametrize("slack", [tc.Clip(), tc.Smooth(0.01), tc.Linear(), {2: tc.Linear()}])
@pytest.mark.parametrize("coordinates", ["reduced", "full"])
def test_forces_are_gradients_of_the_energy(slack, coordinates):
    model = tc.Model(tc.Scene(pulleys(), slack=slack), coordinates=coordinates)
    x = model.initial_state
    symbol = ca.MX.sym("x", model.nx)
    gradient = ca.Function("g", [symbol], [ca.gradient(model.energy(symbol).elastic, symbol)])
    N = model.nodes(gradient(x).full().ravel())  # of the positions, node by node
    rate = model.nodes(np.roll(model.ode(x, []).full().ravel(), -model.nq))
    moving = slice(1, 4)
    mass = np.array([1.0, 0.5, 2.0])[:, None]
    np.testing.assert_allclose(mass * rate[moving], -N[moving], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("friction", [0.0, 0.15])
@pytest.mark.parametrize("control", [None, tc.RestLength(), tc.Tension()])
def test_energy_balance_with_damping_and_friction(friction, control):
    s = pulleys(damping=[2.0, 3.0, 0.5, 1.0, 2.0], cable_friction=friction)
    model = tc.Model(tc.Scene(s, control=control, gravity=GRAVITY))
    run = tc.simulate(model, 0.5, 5e-5, verify=False)
    assert run.success, run.message
    assert np.abs(run.energy_error).max() < 2e-6  # of 10 J


@pytest.mark.parametrize("slack", [tc.Clip(), tc.Smooth(0.01), tc.Linear()])
def test_friction_only_dissipates(slack):
    s = pulleys(cable_friction=0.3)
    model = tc.Model(tc.Scene(s, slack=slack, gravity=GRAVITY))
    rng = np.random.default_rng(0)
    for _ in range(50):
        x = model.initial_state + 0.1 * rng.normal(size=model.nx)
        assert float(model.power(x, [])) <= 1e-12


def test_friction_limits_the_ratio_of_tensions():
    s = pulleys(cable_friction=0.3)
    model = tc.Model(tc.Scene(s))
    x = np.array(model.initial_state)
    x[model.nq :] = 100.0 * np.random.default_rng(1).normal(size=model.nq)
    tension = model.tension(x)[[0, 1, 3, 4]]
    path = s.nodes[[0, 1, 2, 3, 4]]
    way = np.diff(path, axis=0)
    way /= np.linalg.norm(way, axis=1)[:, None]
    angle = np.arccos((way[1:] * way[:-1]).sum(axis=1))
    ratios = np.log(tension[:-1] / tension[1:]) / (0.3 * angle)
    np.testing.assert_allclose(np.abs(ratios), 1.0, rtol=1e-6)
    smooth = tc.Model(tc.Scene(s.replace(cable_friction=0.0))).tension(x)[0]
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert tension @ lengths / lengths.sum() == pytest.approx(smooth, rel=1e-12)


def test_tension_control_pulls_with_the_given_force():
    model = tc.Model(tc.Scene(pulleys(), control=tc.Tension()))
    np.testing.assert_allclose(
        model.tension(model.initial_state, [7.0, 3.0]), [7, 7, 3, 7, 7], rtol=1e-12
    )
    own = tc.Model(tc.Scene(pulleys(), control=None))
    np.testing.assert_allclose(
        model.tension(model.initial_state), own.tension(own.initial_state), rtol=1e-12
    )


def test_tension_control_without_cables_equals_force_densities():
    s = tc.shapes.prism(string_mass=0.1)
    by_force, by_density = (
        tc.Model(tc.Scene(s, control=control, segments=3, ends="lumped"))
        for control in (tc.Tension(), tc.ForceDensity())
    )
    tension = np.linspace(5.0, 15.0, 9)
    rate = by_force.ode(by_force.initial_state, tension).full()
    same = by_density.ode(by_density.initial_state, tension / s.string_lengths).full()
    np.testing.assert_allclose(rate, same, atol=1e-9 * np.abs(same).max())


def test_direction_of_strings_and_of_the_cable_has_no_effect():
    s = pulleys(cable_friction=0.2)
    turned = s.replace(strings=s.strings[:, ::-1], cables=[[4, 3, 1, 0]])
    x = np.array(tc.Model(tc.Scene(s)).initial_state)
    x[9:] = np.random.default_rng(2).normal(size=9)
    one, other = (tc.Model(tc.Scene(each)).tension(x) for each in (s, turned))
    np.testing.assert_allclose(one, other, rtol=1e-12)


# --- motions ---


def test_slack_event_is_that_of_the_cable():
    """The mass is thrown up, and the cable catches it again."""
    model = tc.Model(tc.Scene(sliding(damping=20.0), gravity=GRAVITY))
    state = model.state(model.structure.nodes, [(0, 0, 0), (0.3, 0, 2.0), (0, 0, 0)])
    run = tc.simulate(model, 0.8, 1e-3, scheme=tc.DormandPrince853(rtol=1e-9), state=state)
    assert run.success, run.message
    slack = run.tension == 0
    assert slack.any()
    assert not slack.all()
    assert (slack[:, 0] == slack[:, 1]).all()
    assert np.abs(run.energy_error).max() < 1e-6


@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_runge_kutta_has_order_four(friction):
    model = atwood(friction, stiffness=2e3)
    state = model.state(model.structure.nodes, [(0, 0, 0), (0.1, 0, -1), (0, -0.1, 1)])
    ends = [
        tc.simulate(model, 0.2, step, state=state, verify=False).nodes[-1]
        for step in (2e-2, 1e-2, 5e-3, 1e-4)
    ]
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    assert np.log2(errors[0] / errors[1]) > 3.6
    assert np.log2(errors[1] / errors[2]) > 3.6


@cache
def swing(friction, scheme):
    """A motion of the pulleys by one scheme."""
    s = pulleys(damping=1.0, cable_friction=friction)
    model = tc.Model(tc.Scene(s, control=tc.RestLength(), gravity=GRAVITY))
    step = 4e-5 if friction else 2e-4  # friction is regularized below 1 mm/s
    return tc.simulate(model, 0.1, step, scheme=scheme, control=np.array([2.6, 1.1]), verify=False)


@pytest.mark.parametrize(
    "scheme",
    [
        tc.DormandPrince54(rtol=1e-9),
        tc.Rattle(order=4),
        tc.Collocation(2),
        tc.Cvodes(rtol=1e-10, atol=1e-12),
        tc.Idas(rtol=1e-10, atol=1e-12),
    ],
    ids=lambda scheme: type(scheme).__name__,
)
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_all_schemes_agree(scheme, friction):
    run, exact = (swing(friction, own) for own in (scheme, tc.DormandPrince853(rtol=1e-11)))
    assert run.success, run.message
    np.testing.assert_allclose(run.nodes[-1], exact.nodes[-1], atol=2e-6)
    assert run.tension.shape == (len(run.time), 5)


def test_rollouts_follow_simulate():
    model = tc.Model(
        tc.Scene(pulleys(cable_friction=0.1), control=tc.RestLength(), gravity=GRAVITY)
    )
    controls = np.array([[2.6, 1.1], [2.7, 1.2]])
    many = tc.rollouts(model, 0.2, 1e-3, controls=controls)
    for control, end in zip(controls, many.final, strict=True):
        run = tc.simulate(model, 0.2, 1e-3, control=control, verify=False)
        np.testing.assert_allclose(end, run.states[-1], atol=1e-10)


def test_generated_c_has_the_same_values():
    model = tc.Model(tc.Scene(pulleys(cable_friction=0.1), control=tc.Tension(), gravity=GRAVITY))
    x = model.initial_state + 0.05 * np.random.default_rng(3).normal(size=model.nx)
    np.testing.assert_allclose(
        model.compile()(x, [5.0, 2.0]).full(), model.ode(x, [5.0, 2.0]).full(), rtol=1e-12
    )


def test_derivatives_are_those_of_differences():
    model = tc.Model(tc.Scene(pulleys(cable_friction=0.1), control=tc.RestLength()))
    x = np.array(model.initial_state)
    x[model.nq :] = 0.3
    u = np.array([2.5, 1.1])
    found = tc.linearize(model, x, u)
    for matrix, size, at in (
        (found.A, model.nx, lambda e: model.ode(x + e, u)),
        (found.B, model.nu, lambda e: model.ode(x, u + e)),
    ):
        columns = [(at(1e-6 * e) - at(-1e-6 * e)).full().ravel() / 2e-6 for e in np.eye(size)]
        np.testing.assert_allclose(matrix, np.array(columns).T, rtol=1e-5, atol=1e-4)


def test_derivatives_are_finite_at_parallel_directions():
    """The angle of wrap of Atwood's machine is exactly π."""
    model = atwood(0.1)
    assert np.isfinite(tc.linearize(model).A).all()


def test_parameters_of_strings_act_on_the_cable():
    scene = tc.Scene(pulleys(), parameters=tc.Parameters("stiffness", "rest_length"))
    model = tc.Model(scene)
    p = np.array(model.parameters.nominal)
    p[:5] *= 1.5
    p[5:] *= 0.9
    fixed = tc.Model(tc.Scene(pulleys(stiffness=p[:5], rest_length=p[5:])))
    x = model.initial_state
    np.testing.assert_allclose(model.tension(x, parameters=p), fixed.tension(x), rtol=1e-12)


@pytest.mark.parametrize(
    ("scene", "most"),
    [
        (tc.Scene(tc.shapes.prism(damping=1.0)), 574),
        (tc.Scene(tc.shapes.six_bar_ball(), control=tc.RestLength()), 1077),
        (tc.Scene(tc.shapes.d_bar(), control=tc.ForceDensity()), 697),
    ],
    ids=["prism", "ball", "d_bar"],
)
def test_scene_without_cables_has_no_more_instructions(scene, most):
    assert count_instructions(tc.Model(scene).ode) <= most


def test_mujoco_agrees():
    """MuJoCo's spatial tendon through the same sites has the same accelerations."""
    mujoco = pytest.importorskip("mujoco")
    s = pulleys(damping=0.0)
    model = tc.Model(tc.Scene(s, gravity=GRAVITY))
    bodies = "".join(
        f"<body pos='{' '.join(map(str, s.nodes[k]))}'>"
        + "".join(f"<joint type='slide' axis='{axis}'/>" for axis in ("1 0 0", "0 1 0", "0 0 1"))
        + f"<inertial pos='0 0 0' mass='{s.node_mass[k]}' diaginertia='1 1 1'/>"
        f"<site name='s{k}'/></body>"
        for k in (1, 2, 3)
    )
    fixed = "".join(f"<site name='s{k}' pos='{' '.join(map(str, s.nodes[k]))}'/>" for k in (0, 4))

    def tendon(path: list[int], strings: list[int]) -> str:
        k = 1 / (1 / s.stiffness[strings]).sum()
        sites = "".join(f"<site site='s{node}'/>" for node in path)
        rest = s.rest_length[strings].sum()
        return f"<spatial stiffness='{k}' springlength='0 {rest}'>{sites}</spatial>"

    world = mujoco.MjModel.from_xml_string(
        f"<mujoco><option gravity='0 0 -{g}'/><worldbody>{fixed}{bodies}</worldbody>"
        f"<tendon>{tendon([0, 1, 2, 3, 4], [0, 1, 3, 4])}{tendon([1, 3], [2])}</tendon></mujoco>"
    )
    data = mujoco.MjData(world)
    for _ in range(2):  # at the start, and displaced
        mujoco.mj_forward(world, data)
        x = model.state(s.nodes + np.pad(data.qpos.reshape(3, 3), ((1, 1), (0, 0))))
        np.testing.assert_allclose(
            model.ode(x, []).full().ravel()[9:], data.qacc, rtol=1e-6, atol=1e-6
        )
        data.qpos[:] = 0.1 * np.random.default_rng(4).normal(size=9)

"""Rigid bodies against Euler's equations, closed forms and MuJoCo."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import tenscasadi as tc

MASS, CENTER = 2.0, np.array([0.1, -0.05, 0.2])
INERTIA = np.array([[0.30, 0.02, -0.01], [0.02, 0.45, 0.03], [-0.01, 0.03, 0.60]])
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.7, 0.4, -0.3]])
SPIN, DRIFT = np.array([1.0, -2.0, 3.0]), np.array([0.3, 0.1, 0.5])
BODY = {
    "four basic nodes": CORNERS[:4],
    "an attachment": CORNERS,
    "an auxiliary node": CORNERS[:3],
    "an attachment in a plane": np.vstack([CORNERS[:3], [0.3, 0.4, 0.0]]),
}


def free_body(nodes: np.ndarray, **options: object) -> tuple[tc.Model, np.ndarray]:
    """A free body that spins and drifts, with its state."""
    body = tc.RigidBody(range(len(nodes)), MASS, CENTER, INERTIA)
    model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=[body]), **options))
    return model, model.state(nodes, DRIFT + np.cross(SPIN, nodes - CENTER))


def euler(nodes: np.ndarray, time: float, mass_center=CENTER, inertia=INERTIA) -> np.ndarray:
    """Nodes of a free body after a time, by Euler's equations."""

    def rates(_: float, z: np.ndarray) -> np.ndarray:
        R = Rotation.from_quat(z[:4]).as_matrix()
        w, u, s = z[4:], z[:3], z[3]
        own = R.T @ w
        turn = R @ np.linalg.solve(inertia, -np.cross(own, inertia @ own))
        return np.concatenate([0.5 * (s * w + np.cross(w, u)), [-0.5 * w @ u], turn])

    start = np.array([0, 0, 0, 1, *SPIN])
    end = solve_ivp(rates, (0, time), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    R = Rotation.from_quat(end[:4]).as_matrix()
    return mass_center + DRIFT * time + (nodes - mass_center) @ R.T


@pytest.mark.parametrize("nodes", BODY.values(), ids=BODY)
def test_free_body_follows_eulers_equations(nodes):
    model, state = free_body(nodes)
    run = tc.simulate(model, 3.0, 1e-3, scheme=tc.DormandPrince853(), state=state, verify=False)
    assert run.success
    np.testing.assert_allclose(run.nodes[-1], euler(nodes, 3.0), atol=1e-11)
    assert np.ptp(run.energy) < 1e-10
    momenta = [angular_momentum(model, x) for x in run.states[::500]]
    np.testing.assert_allclose(momenta, np.tile(momenta[0], (len(momenta), 1)), atol=1e-10)


def angular_momentum(model: tc.Model, state: np.ndarray) -> np.ndarray:
    """Angular momentum about the origin, from the mass matrix on the columns."""
    N, V, _ = model.unpack(ca.DM(state))
    momenta = V.full() @ model.mechanism.M.toarray()
    return np.cross(N.full().T, momenta.T).sum(axis=0)


SCHEMES = {
    "RungeKutta4": (tc.RungeKutta4(), 1e-3, 1e-9),
    "DormandPrince54": (tc.DormandPrince54(), 1e-3, 1e-11),
    "Rattle": (tc.Rattle(order=4), 1e-3, 1e-7),
    "Collocation": (tc.Collocation(3), 1e-2, 1e-10),
    "Cvodes": (tc.Cvodes(1e-10, 1e-12), None, 1e-7),
    "Idas": (tc.Idas(1e-10, 1e-12), None, 1e-7),
}


@pytest.mark.parametrize(("scheme", "step", "tolerance"), SCHEMES.values(), ids=SCHEMES)
def test_schemes_agree_on_a_body(scheme, step, tolerance):
    model, state = free_body(CORNERS)
    options = {} if step is None else {"step": step}
    run = tc.simulate(model, 1.0, scheme=scheme, state=state, verify=False, **options)
    assert run.success
    np.testing.assert_allclose(run.nodes[-1], euler(CORNERS, 1.0), atol=tolerance)


def test_order_of_runge_kutta_is_four():
    model, state = free_body(CORNERS)
    exact = euler(CORNERS, 1.0)
    errors = []
    for step in (0.02, 0.01, 0.005):
        run = tc.simulate(model, 1.0, step, state=state, verify=False)
        errors.append(np.abs(run.nodes[-1] - exact).max())
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 3.7) & (orders < 5.3)), orders


def test_projection_keeps_a_body_in_coarse_steps():
    model, state = free_body(CORNERS)
    run = tc.simulate(model, 3.0, 0.02, state=state, correction=tc.Projection(), verify=False)
    assert run.bar_length_error.max() < 1e-14


def test_body_flips_about_its_intermediate_axis():
    nodes = np.vstack([np.eye(3), -np.eye(3)])
    body = tc.RigidBody(range(6), 1.0, (0, 0, 0), (1.0, 2.0, 2.5))
    model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=[body])))
    spin = np.array([1e-3, 5.0, 0.0])
    state = model.state(nodes, np.cross(spin, nodes))
    run = tc.simulate(model, 12.0, 2e-3, scheme=tc.DormandPrince853(), state=state, verify=False)
    along = run.nodes[:, 1, 1]  # of the intermediate axis on the constant angular momentum
    assert along.min() < -0.99
    # Euler's equations: the first reversal
    reversal = solve_ivp(
        lambda _, w: [-0.5 * w[1] * w[2], 0.75 * w[2] * w[0], -0.4 * w[0] * w[1]],
        (0, 12),
        spin,
        rtol=1e-12,
        atol=1e-14,
        events=lambda _, w: w[1],
    ).t_events[0][0]
    # the direction lies across the momentum as the spin about it vanishes
    crossing = run.time[np.flatnonzero(along < 0)[0]]
    assert abs(crossing - reversal) < 0.02


def test_bar_as_a_body_moves_like_a_bar():
    nodes = np.array([[0, 0, 0], [0.6, 0, 0.8], [1.5, 0.2, 0.3]])
    strings, own = [(1, 2)], {"pinned": [0, 2], "stiffness": 40.0, "rest_length": 0.4}
    m = 2.0  # of a bar of 1 m
    axis = nodes[1] - nodes[0]
    inertia = m / 12 * (np.eye(3) - np.outer(axis, axis))
    rod = tc.RigidBody((0, 1), m, nodes[:2].mean(axis=0), inertia)
    structures = [
        tc.Structure(nodes, [(0, 1)], strings, bar_mass=m, **own),
        tc.Structure(nodes, (), strings, bodies=[rod], **own),
    ]
    ends = [
        tc.simulate(tc.Model(tc.Scene(s, gravity=tc.Gravity())), 1.0, 1e-3).nodes[-1]
        for s in structures
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)


def test_plate_of_three_nodes_needs_no_auxiliary_node():
    a, b, m = 0.6, 0.4, 3.0
    corners = np.array([(0, 0, 0), (a, 0, 0), (a, b, 0), (0, b, 0)])
    plate = tc.RigidBody(
        range(4), m, (a / 2, b / 2, 0), m / 12 * np.array([b**2, a**2, a**2 + b**2])
    )
    model = tc.Model(tc.Scene(tc.Structure(corners, bodies=[plate])))
    assert (model.nq, model.mechanism.bars) == (9, 3)


def test_physical_pendulum_has_its_period():
    """A box that turns about two pinned nodes, by tc.modes and in large swings."""
    a, b, c, m, g = 0.5, 0.3, 0.2, 4.0, 9.81
    nodes = np.array([(0, 0, 0), (0, b, 0), (a, 0, -c), (a, b, -c), (0.2, 0.1, -0.4)])
    center, inertia = np.array([0.1, b / 2, -0.3]), np.array([0.2, 0.25, 0.15])
    box = tc.RigidBody(range(5), m, center, inertia)
    s = tc.Structure(nodes, pinned=(0, 1), bodies=[box])
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity((0, 0, -g))))
    arm = np.hypot(center[0], center[2])
    total = inertia[1] + m * arm**2
    angle = np.arctan2(center[0], -center[2])
    run = tc.simulate(model, 2.0, 1e-3, verify=False)
    swing = solve_ivp(
        lambda _, z: [z[1], -m * g * arm / total * np.sin(z[0])],
        (0, 2.0),
        [angle, 0.0],
        rtol=1e-12,
        atol=1e-12,
    ).y[0, -1]
    turned = Rotation.from_rotvec([0, angle - swing, 0]).apply(nodes)
    np.testing.assert_allclose(run.nodes[-1], turned, atol=1e-8)
    hanging = s.replace(nodes=Rotation.from_rotvec([0, angle, 0]).apply(nodes))
    modes = tc.modes(tc.Model(tc.Scene(hanging, gravity=tc.Gravity((0, 0, -g)))))
    assert modes.frequency == pytest.approx([np.sqrt(m * g * arm / total) / (2 * np.pi)], rel=1e-9)


def test_two_bodies_with_three_common_nodes_are_one():
    nodes = np.vstack([CORNERS, [-0.4, 0.3, 0.2], [0.5, -0.5, 0.5]])
    first = tc.RigidBody((0, 1, 2, 3, 4), MASS, CENTER, INERTIA)
    other, place, own = 1.5, np.array([0.2, 0.1, 0.4]), np.diag([0.2, 0.3, 0.25])
    second = tc.RigidBody((1, 2, 3, 5, 6), other, place, own)
    total = MASS + other
    center = (MASS * CENTER + other * place) / total
    inertia = np.zeros((3, 3))
    for m, c, moments in ((MASS, CENTER, INERTIA), (other, place, own)):
        arm = c - center
        inertia += moments + m * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=[first, second])))
    state = model.state(nodes, DRIFT + np.cross(SPIN, nodes - center))
    run = tc.simulate(model, 2.0, 1e-3, scheme=tc.DormandPrince853(), state=state, verify=False)
    exact = euler(nodes, 2.0, center, inertia)
    np.testing.assert_allclose(run.nodes[-1], exact, atol=1e-10)


def test_hinge_of_two_bodies_conserves_energy_and_momentum():
    nodes = np.array(
        [(0, 0, 0), (0, 1, 0), (1, 0, 0), (1, 1, 0.2), (-1, 0, 0.3), (-1, 1, 0), (-0.5, 0.5, 0.5)]
    )
    bodies = [
        tc.RigidBody((0, 1, 2, 3), 2.0, (0.5, 0.5, 0.1), (0.3, 0.2, 0.4)),
        tc.RigidBody((0, 1, 4, 5, 6), 1.0, (-0.5, 0.5, 0.1), (0.1, 0.2, 0.15)),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the hinge has no redundant constraint
        model = tc.Model(tc.Scene(tc.Structure(nodes, bodies=bodies)))
    assert model.nq - model.mechanism.bars == 7  # six of a rigid body, and the angle
    speeds = np.cross([0.3, 2.0, 0.5], nodes) + np.where(nodes[:, :1] < 0, 1, 0) * np.cross(
        [0, 3.0, 0], nodes
    )
    state = model.state(nodes, speeds)
    run = tc.simulate(model, 2.0, 1e-3, scheme=tc.DormandPrince853(), state=state, verify=False)
    assert np.ptp(run.energy) < 1e-10
    np.testing.assert_allclose(
        angular_momentum(model, run.states[-1]), angular_momentum(model, state), atol=1e-10
    )


def test_ball_joints_agree_with_mujoco():
    """Two bodies hang on each other and on a pin; MuJoCo's own bodies have the same inertia."""
    mujoco = pytest.importorskip("mujoco")
    first = {"mass": 2.0, "pos": (0.2, 0.1, -0.3), "inertia": (0.05, 0.08, 0.06)}
    second = {"mass": 1.0, "pos": (0.1, 0.2, -0.2), "inertia": (0.02, 0.03, 0.025)}
    joint = np.array([0.4, 0.1, -0.5])
    ends = np.array([(0.3, 0.1, -0.4), (0.0, 0.4, -0.1), (0.1, 0.1, 0.3)])
    xml = f"""<mujoco><option timestep="2e-4" integrator="RK4" gravity="0 0 -9.81"/><worldbody>
      <body><joint type="ball"/>{_inertial(first)}
        <body pos="0.4 0.1 -0.5"><joint type="ball"/>{_inertial(second)}
          <site name="end" pos="0.3 0.1 -0.4"/></body></body></worldbody></mujoco>"""
    peer = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(peer)
    for _ in range(5000):
        mujoco.mj_step(peer, data)
    mujoco.mj_forward(peer, data)
    nodes = np.vstack([np.zeros(3), joint, (0.5, 0, 0), (0, 0.5, -0.2), joint + ends])
    bodies = [
        tc.RigidBody((0, 1, 2, 3), first["mass"], first["pos"], first["inertia"]),
        tc.RigidBody((1, 4, 5, 6), second["mass"], joint + second["pos"], second["inertia"]),
    ]
    s = tc.Structure(nodes, pinned=(0,), bodies=bodies)
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity()))
    run = tc.simulate(model, 1.0, 2e-4, verify=False)
    np.testing.assert_allclose(run.nodes[-1, 4], data.site("end").xpos, atol=1e-7)


def _inertial(body: dict) -> str:
    numbers = {name: " ".join(map(str, body[name])) for name in ("pos", "inertia")}
    return f'<inertial mass="{body["mass"]}" pos="{numbers["pos"]}" diaginertia="{numbers["inertia"]}"/>'


def test_spinning_plate_drops_onto_the_ground_and_loses_energy():
    nodes = np.array([(0, 0, 0.5), (1, 0, 0.5), (1, 1, 0.5), (0, 1, 0.5), (0.5, 0.5, 0.5)])
    plate = tc.RigidBody(range(5), 3.0)
    ground = tc.Ground(stiffness=2e4, damping=60.0, friction=0.5)
    scene = tc.Scene(tc.Structure(nodes, bodies=[plate]), gravity=tc.Gravity(), ground=ground)
    model = tc.Model(scene)
    state = model.state(nodes, np.cross((0.3, 0.2, 1.0), nodes - nodes.mean(axis=0)))
    run = tc.simulate(model, 3.0, 5e-4, state=state)
    assert run.success, run.message
    assert np.abs(run.nodes[-1, :, 2]).max() < 5e-3
    # its weight is carried by all five nodes on a flat ground
    assert run.nodes[-1, :, 2].mean() == pytest.approx(-3.0 * 9.81 / 2e4 / 5, rel=0.05)


def test_support_motion_carries_a_body_with_it():
    nodes = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.5, 0.5, 0.0), (0.3, 0.3, -0.5)])
    body = tc.RigidBody(range(5), 2.0, (0.3, 0.3, -0.2), (0.2, 0.2, 0.3))
    s = tc.Structure(nodes, pinned=(0, 1, 2), bodies=[body])
    motion = {k: lambda t, n=nodes[k]: (n[0] + 0.1 * t**2, n[1], n[2] + 0.2 * t) for k in range(3)}
    model = tc.Model(tc.Scene(s, supports=tc.SupportMotion(motion)))
    run = tc.simulate(model, 1.0, 1e-2, verify=False)
    np.testing.assert_allclose(run.nodes[-1], nodes + [0.1, 0.0, 0.2], atol=1e-10)


def test_supports_that_tear_a_body_apart_are_rejected():
    s = tc.Structure(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)], pinned=(0, 1), bodies=[tc.RigidBody((0, 1, 2), 1.0)]
    )
    model = tc.Model(tc.Scene(s, supports=tc.SupportMotion({1: lambda t: (1 + t, 0, 0)})))
    with pytest.raises(ValueError, match=r"nodes 0 and 1 of bodies\[0\] move apart by 0.1 m"):
        tc.simulate(model, 0.1, 1e-3)


@pytest.mark.parametrize("nodes", BODY.values(), ids=BODY)
def test_linearization_agrees_with_finite_differences(nodes):
    """A body on damped strings, in motion."""
    anchors = np.array([(2, 0, 2), (-2, 1, 2), (0, -2, 2.0)])
    count = len(nodes)
    s = tc.Structure(
        np.vstack([nodes, anchors]),
        strings=[(0, count), (1, count + 1), (2, count + 2), (0, count + 2)],
        pinned=range(count, count + 3),
        bodies=[tc.RigidBody(range(count), MASS, CENTER, INERTIA)],
        stiffness=50.0,
        damping=2.0,
        rest_length=1.0,
    )
    model = tc.Model(tc.Scene(s, gravity=tc.Gravity(), control=tc.RestLength()))
    speeds = np.cross((0.3, -0.5, 0.2), s.nodes)
    speeds[count:] = 0.0
    x, u = model.state(s.nodes, speeds), model.initial_control
    found = tc.linearize(model, x, u)
    T = found.tangent
    allowed = np.block([[T, np.zeros_like(T)], [np.zeros_like(T), T]])
    rates = [
        [model.ode(x + sign * 1e-6 * direction, u).full().ravel() for direction in allowed.T]
        for sign in (1, -1)
    ]
    difference = (np.array(rates[0]) - rates[1]).T / 2e-6
    np.testing.assert_allclose(found.A @ allowed, difference, atol=1e-5)


def test_generated_code_has_the_same_motion(tmp_path):
    model, state = free_body(CORNERS)
    runs = [
        tc.simulate(model, 0.2, 1e-3, state=state, compiled=compiled, verify=False)
        for compiled in (True, False)
    ]
    np.testing.assert_allclose(runs[0].states, runs[1].states, atol=1e-12)
    found = tc.sensitivities(model, state, 0.2, 1e-3, compiled=False)
    moved = state + np.append(np.zeros(model.nx - 1), 1e-6)
    other = tc.simulate(model, 0.2, 1e-3, state=moved, verify=False)
    change = (other.states[-1] - runs[0].states[-1]) / 1e-6
    np.testing.assert_allclose(found.jacobian[:, -1], change, atol=1e-5)

"""Live motions without a browser: against `simulate`, SciPy and the balance of energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import tenscasadi as tc
from tenscasadi.viewer.live_mode.simulation import LiveOptions, LiveSimulation

PRISM = tc.shapes.prism(prestress=50.0, stiffness=1000.0, damping=2.0)
VIRTUAL = LiveOptions(compiled=False)


def mass_on_a_string(**options):
    """1 kg that hangs 1 m below a pin, by a string of 0.9 m and 100 N/m."""
    structure = tc.Structure(
        [(0, 0, 0), (0, 0, -1)],
        strings=[(0, 1)],
        node_mass=[0, 1.0],
        pinned=[0],
        stiffness=100.0,
        rest_length=0.9,
    )
    return tc.Scene(structure, **options)


def test_what_is_done_by_hand_is_what_simulate_does_of_a_table():
    run = LiveSimulation(tc.Scene(PRISM, gravity=tc.Gravity((0, 0, -1.0))), options=VIRTUAL)
    table = []
    for k in range(12):
        run.set_control([k % 9], (0.9 + 0.01 * k) * run.start_control[k % 9])
        table.append(run.control)
        assert run.advance() == 1
    scene = tc.Scene(PRISM, control=tc.RestLength(), gravity=tc.Gravity((0, 0, -1.0)))
    same = tc.simulate(
        tc.Model(scene),
        12 * run.tick,
        run.step,
        control=np.array(table),
        correction=tc.Projection(),
        save_every=run.substeps,
    )
    kept = run.trajectory()
    assert same.step == pytest.approx(run.step)
    np.testing.assert_allclose(kept.nodes, same.nodes, rtol=0, atol=1e-9)
    np.testing.assert_allclose(kept.control[:-1], same.control[:-1], rtol=0, atol=0)
    np.testing.assert_allclose(kept.energy_error, same.energy_error, rtol=0, atol=1e-7)
    np.testing.assert_allclose(
        kept.correction_shift[:-1], same.correction_shift[:-1], rtol=0, atol=1e-9
    )
    assert kept.success
    assert len(kept.parameters) == 0


def test_a_pull_is_the_force_of_a_damped_spring():
    run = LiveSimulation(mass_on_a_string(gravity=tc.Gravity()), options=VIRTUAL)
    target = np.array([0.3, 0.0, -1.2])
    run.grab(1, target)
    pull = run.pull
    forces = []
    for _ in range(30):
        forces.append(run.pull_force)
        run.advance()

    def rate(t, y):
        q, v = y[:3], y[3:]
        length = np.linalg.norm(q)
        string = -100.0 * max(length - 0.9, 0.0) * q / length
        return np.concatenate(
            [v, string + [0, 0, -9.81] + forces[min(int(t / run.tick + 1e-9), 29)]]
        )

    y = np.array([0, 0, -1.0, 0, 0, 0])
    for k in range(30):
        span = (k * run.tick, (k + 1) * run.tick)
        y = solve_ivp(
            lambda t, y, force=forces[k], begin=span[0]: rate(begin, y),
            span,
            y,
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
    np.testing.assert_allclose(run.nodes[1], y[:3], atol=1e-6)
    np.testing.assert_allclose(forces[0], pull.stiffness * (target - [0, 0, -1.0]), rtol=1e-12)
    assert abs(run.trajectory().energy_error).max() < 1e-6  # with the work of the pull
    run.release()
    assert (run.pull_force == 0).all()


def test_a_node_that_is_pulled_comes_to_the_pointer_and_rests_there():
    free = LiveSimulation(tc.Scene(PRISM), options=VIRTUAL)
    target = free.nodes[3] + [0.4, 0.1, 0.2]
    free.grab(3, target)
    free.advance(60 * 20)
    assert free.fault == ""
    assert np.linalg.norm(free.nodes[3] - target) < 0.1
    assert (
        np.linalg.norm(free.nodes.mean(axis=0) - PRISM.nodes.mean(axis=0)) > 0.2
    )  # the others follow


def test_force_densities_are_driven_too():
    run = LiveSimulation(tc.Scene(PRISM, control=tc.ForceDensity()), options=VIRTUAL)
    run.set_control(range(9), 0.0)
    run.advance(3)
    assert (run.observed["force_density"] == 0).all()
    np.testing.assert_allclose(run.nodes, PRISM.nodes, atol=1e-9)  # nothing pulls any more
    run.set_control([0], 80.0)
    run.advance(6)
    assert np.linalg.norm(run.nodes - PRISM.nodes) > 1e-3


def test_reset_goes_back_to_the_start():
    run = LiveSimulation(tc.Scene(PRISM), options=VIRTUAL)
    run.set_control([0], 0.5)
    run.grab(4, (1.0, 1.0, 1.0))
    run.advance(5)
    moved = run.nodes
    run.reset()
    assert run.time == 0
    assert run.pull is None
    assert (run.control == run.start_control).all()
    assert (run.state == run.start_state).all()
    assert len(run.trajectory().time) == 1
    run.set_control([0], 0.5)
    run.grab(4, (1.0, 1.0, 1.0))
    run.advance(5)
    assert (run.nodes == moved).all()


def test_a_motion_that_breaks_down_says_so_and_can_be_reset():
    stiff = tc.Scene(PRISM.replace(stiffness=1e6, damping=0.0))
    run = LiveSimulation(stiff, options=LiveOptions(step=0.01, compiled=False))
    run.set_control([0], 0.5 * run.start_control[0])
    done = run.advance(200)
    assert done < 200
    assert "stopped at t = " in run.fault
    assert "try step=" in run.fault
    assert np.isfinite(run.nodes).all()
    assert run.advance(5) == 0
    kept = run.trajectory()
    assert not kept.success
    assert kept.message == run.fault
    assert np.isfinite(kept.nodes).all()
    run.reset()
    assert run.fault == ""
    assert run.advance(2) == 2


def test_the_default_step_is_stable():
    run = LiveSimulation(tc.Scene(PRISM.replace(stiffness=1e6)), options=VIRTUAL)
    assert run.step <= 0.5 * tc.stable_step(run.model, safety=1.0)
    assert run.advance(30) == 30


@pytest.mark.parametrize(
    "scheme",
    [tc.Rattle(), tc.DormandPrince853(rtol=1e-8), tc.Collocation(2), tc.Cvodes()],
    ids=lambda scheme: type(scheme).__name__,
)
def test_any_scheme_goes(scheme):
    correction = tc.Projection() if not isinstance(scheme, tc.Rattle) else None
    run = LiveSimulation(
        mass_on_a_string(gravity=tc.Gravity()),
        options=LiveOptions(0.002, scheme, correction, compiled=False),
    )
    reference = LiveSimulation(mass_on_a_string(gravity=tc.Gravity()), options=VIRTUAL)
    for one in (run, reference):
        one.set_control([0], 0.8)
        one.grab(1, (0.1, 0.0, -1.0))
        assert one.advance(10) == 10
    np.testing.assert_allclose(run.nodes, reference.nodes, atol=1e-4)
    assert run.trajectory().success


def test_machine_code_does_the_same():
    runs = [
        LiveSimulation(mass_on_a_string(), options=LiveOptions(step=5e-4, compiled=compiled))
        for compiled in (None, False)
    ]
    for run in runs:
        run.set_control([0], 0.7)
        run.advance(20)
    np.testing.assert_allclose(runs[0].nodes, runs[1].nodes, atol=1e-6)


def test_a_trajectory_is_saved_and_read(tmp_path):
    run = LiveSimulation(tc.Scene(PRISM), options=VIRTUAL)
    run.advance(4)
    kept = run.trajectory()
    assert (
        tc.Trajectory.load(kept.save(tmp_path / "live.npz")).nodes.shape
        == kept.nodes.shape
        == (5, 6, 3)
    )
    model = tc.Model(tc.Scene(PRISM))
    assert kept.states.shape[1] == model.nx  # what was recorded fits the scene itself


def test_forces_that_change_over_time_leave_no_pull():
    forces = tc.NodalForce(lambda t: [[0, 0, 0], [np.sin(t), 0, 0]])
    run = LiveSimulation(mass_on_a_string(forces=forces), options=VIRTUAL)
    assert not run.pullable.any()
    with pytest.raises(ValueError, match="node 1 cannot be pulled"):
        run.grab(1, (0, 0, 0))
    assert run.advance(5) == 5


@pytest.mark.parametrize("stiffness", [None, 31.0])
def test_parameters_have_the_values_that_are_given(stiffness):
    scene = mass_on_a_string(parameters=tc.Parameters("stiffness"))
    values = None if stiffness is None else {"stiffness": stiffness}
    built = replace(scene, parameters=None, structure=scene.structure.replace(**(values or {})))
    plain = LiveSimulation(built, options=VIRTUAL)
    runs = [
        LiveSimulation(given, options=VIRTUAL, parameters=values)
        for given in (tc.Model(scene), scene)
    ]
    for one in (plain, *runs):
        one.advance(10)
        np.testing.assert_allclose(one.nodes, plain.nodes, rtol=0, atol=1e-12)


def test_gravity_that_changes_has_its_work_in_the_balance_of_energy():
    run = LiveSimulation(mass_on_a_string(gravity=tc.Gravity()), options=VIRTUAL)
    for k in range(12):
        run.set_parameters("gravity", [0, 0, -9.81 + k])
        assert run.advance() == 1
    scene = mass_on_a_string(
        control=tc.RestLength(), gravity=tc.Gravity(), parameters=tc.Parameters("gravity")
    )
    kept, nodes = run.trajectory(), run.start_state
    for k in range(12):
        piece = tc.simulate(
            tc.Model(scene),
            run.tick,
            run.step,
            state=nodes,
            parameters={"gravity": [0, 0, -9.81 + k]},
        )
        nodes = tc.Model(scene).state(piece.nodes[-1], piece.velocities[-1])
    np.testing.assert_allclose(kept.nodes[-1], piece.nodes[-1], rtol=0, atol=1e-9)
    assert abs(kept.energy_error).max() < 1e-6
    assert np.ptp(kept.energy) > 0.1
    assert kept.success, kept.message
    run.reset()
    assert run.parameters.tolist() == run.model.parameters.nominal.tolist()


def test_parameters_that_do_not_exist_are_refused():
    run = LiveSimulation(mass_on_a_string(), options=VIRTUAL)
    with pytest.raises(ValueError, match="stiffness"):
        run.set_parameters("stiffness", 3.0)
    with pytest.raises(ValueError, match="finite"):
        run.set_parameters("gravity", np.nan)
    assert not run.parameters.any()


def test_odd_input_is_refused_by_name():
    run = LiveSimulation(mass_on_a_string(), options=VIRTUAL)
    for value, words in ((0.0, "rest length 0 m"), (-1.0, "rest length -1"), (np.nan, "value")):
        with pytest.raises(ValueError, match=words):
            run.set_control([0], value)
    assert (run.control == run.start_control).all()
    with pytest.raises(ValueError, match=r"node 0 cannot be pulled: give one of \[1\]"):
        run.grab(0, (0, 0, 0))
    for node, target in ((7, (0, 0, 0)), (1, (np.nan, 0, 0)), (1, (0, 0))):
        with pytest.raises(ValueError, match=r"node|target"):
            run.grab(node, target)
    for wrong in ({"step": 0.0}, {"tick": -1.0}, {"step": np.nan}):
        with pytest.raises(ValueError, match=r"step|tick"):
            LiveOptions(**wrong)
    with pytest.raises(TypeError, match="model is"):
        LiveSimulation("prism")
    with pytest.raises(ValueError, match="state"):
        LiveSimulation(mass_on_a_string(), state=[1.0], options=VIRTUAL)

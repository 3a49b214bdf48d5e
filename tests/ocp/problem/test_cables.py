"""Plans of structures with cables: limits by cable, tension control, replay, files."""

from __future__ import annotations

import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.control import build_force_density_model


def hung(control: tc.RestLength | tc.Tension, **options: object) -> tc.Model:
    """A mass of 2 kg on a cable between (±1, 0, 0), and on a string to (0, 0, −2)."""
    s = tc.Structure(
        [(-1, 0, 0), (0, 0, -0.8), (1, 0, 0), (0, 0, -2)],
        strings=[(0, 1), (1, 3), (2, 1)],
        node_mass=[0, 2, 0, 0],
        pinned={0: "xyz", 1: "y", 2: "xyz", 3: "xyz"},
        stiffness=300.0,
        damping=[2.0, 0.0, 2.0],
        cables=[[0, 2]],
        **options,
    )
    load = np.zeros((4, 3))
    load[1, 2] = -2 * 9.81
    held = s.prestressed(tc.equilibrium_force_density(s, loads=load, minimum=5.0))
    return tc.Model(tc.Scene(held, control=control, gravity=tc.Gravity()))


def lift(model: tc.Model, *bounds: ocp.RestLengthLimits) -> ocp.Problem:
    """Raise the mass by 0.1 m, from rest to rest."""
    goals = [ocp.NodePositions({1: (0, None, -0.7)}), ocp.AtRest()]
    return ocp.Problem(model, 1.0, goals=goals, bounds=bounds, costs=[ocp.Effort(1e-3)])


@pytest.mark.parametrize("control", [tc.RestLength(), tc.Tension()])
@pytest.mark.parametrize(
    "transcription", [ocp.Variational(20), ocp.MultipleShooting(20), ocp.DirectCollocation(20)]
)
def test_plan_of_a_cable_is_replayed(control, transcription):
    model = hung(control)
    plan = ocp.solve(lift(model, ocp.TensionLimits(0.5, [40.0, 60.0])), transcription)
    assert plan.success, plan.message
    assert plan.control.shape == (20, 2)
    assert plan.force_density.shape == (20, 3)
    tension = plan.tension()
    np.testing.assert_allclose(tension[:, 0], tension[:, 2], rtol=1e-6)
    assert tension.min() > 0.5 - 1e-4
    assert (tension.max(axis=0) < np.array([40, 60, 40]) + 1e-4).all()
    given = plan.rest_length if isinstance(control, tc.RestLength) else plan.input_tension
    assert given is plan.control
    replay = plan.replay()
    np.testing.assert_allclose(replay.nodes[-1, 1], [0, 0, -0.7], atol=2e-3)


@pytest.mark.parametrize("control", [tc.RestLength(), tc.Tension()])
def test_automatic_method_plans_cables(control):
    plan = ocp.solve(lift(hung(control), ocp.TensionLimits(0.5)))
    assert plan.success, plan.message
    assert plan.control.shape[1] == 2


def test_force_densities_of_cables_with_friction_are_those_of_lone_strings():
    model = build_force_density_model(hung(tc.RestLength(), cable_friction=0.1))
    assert model.nu == 3
    assert not model.scene.structure.cables


def test_plan_comes_back_from_its_file(tmp_path):
    plan = ocp.solve(lift(hung(tc.Tension()), ocp.TensionLimits(0.5)), ocp.Variational(12))
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert loaded.model.structure.cables == ((0, 2),)
    np.testing.assert_array_equal(loaded.input_tension, plan.input_tension)
    np.testing.assert_array_equal(loaded.replay().nodes[-1], plan.replay().nodes[-1])
    assert "cable 0" in str(plan.report()) or plan.report() is not None
    columns = plan.to_csv(tmp_path / "plan.csv").read_text(encoding="utf-8").splitlines()[0]
    assert "cable 0 rest length (m),string 1 rest length (m)" in columns


def test_limits_have_one_entry_for_each_cable():
    model = hung(tc.RestLength())
    problem = lift(model, ocp.RestLengthLimits([1.0, 0.5], [3.0, 2.0]))
    lower, upper = problem.control_limits
    assert lower.tolist() == [1.0, 0.5]
    assert upper.tolist() == [3.0, 2.0]
    for bound in (ocp.RestLengthLimits([1.0] * 3), ocp.TensionLimits(upper=[1.0] * 3)):
        with pytest.raises(ValueError, match="shape"):
            lift(model, bound)
    assert (
        lift(model, ocp.ForceDensityLimits([1.0] * 3)).force_density_limits[0].tolist() == [1] * 3
    )
    with pytest.raises(ValueError, match="for cable 0: give lower ≤ upper"):
        lift(model, ocp.RestLengthLimits([2.0, 0.5], [1.0, 2.0]))


def test_tension_limits_bound_the_decisions_under_tension_control():
    model = hung(tc.Tension())
    lower, upper = lift(model, ocp.TensionLimits(1.0, [30.0, 50.0])).control_limits
    assert lower.tolist() == [1.0, 1.0]
    assert upper.tolist() == [30.0, 50.0]
    free = lift(model).control_limits
    assert free[0].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("control", [tc.RestLength(), tc.Tension(), tc.RestLengthRate()])
def test_controllers_hold_a_load_by_cables(control):
    rates = [ocp.RestLengthRateLimits(2.0)] * isinstance(control, tc.RestLengthRate)
    problem = lift(hung(control), ocp.TensionLimits(0.5), *rates)
    loop = ocp.run(ocp.Mpc(problem, 0.05, 10, substeps=4), 3.0, steps=20).trajectory
    residual = ocp.run(ocp.track(ocp.solve(problem)), 3.0, steps=20).trajectory
    for run in (loop, residual):
        assert run.success
        assert run.nodes[-1] == pytest.approx(loop.nodes[-1], abs=2e-3)
        assert np.abs(run.velocities[-1]).max() < 2e-3


@pytest.mark.parametrize("control", [tc.RestLength(), tc.Tension()])
def test_robustness_replays_the_plan_of_a_cable(control):
    plan = ocp.solve(lift(hung(control), ocp.TensionLimits(0.5)), ocp.Variational(20))
    exact = plan.robustness({"node_mass": 1e-9}, samples=2)
    np.testing.assert_allclose(exact.error, plan.replay_error, rtol=1e-2)


def test_masses_on_cables_miss_the_goal_less_under_feedback():
    plan = ocp.solve(lift(hung(tc.Tension()), ocp.TensionLimits(0.5)), ocp.Variational(20))
    spread = {"node_mass": 0.05}
    loose, tracked = (plan.robustness(spread, samples=8, tracked=flag) for flag in (False, True))
    assert np.median(tracked.error) < 0.5 * np.median(loose.error)


def test_robustness_of_tensions_rejects_stiffness():
    plan = ocp.solve(lift(hung(tc.Tension()), ocp.TensionLimits(0.5)), ocp.Variational(20))
    with pytest.raises(ValueError, match="tensions do not depend on stiffness or damping"):
        plan.robustness({"stiffness": 0.1}, samples=2)


def test_tracker_of_a_cable_returns_to_the_plan():
    plan = ocp.solve(lift(hung(tc.RestLength()), ocp.TensionLimits(0.5)), ocp.Variational(20))
    tracker = ocp.track(plan)
    np.testing.assert_allclose(
        tracker.control(0.0, plan.trajectory.states[0]), plan.control[0], atol=1e-9
    )
    start = np.array(plan.trajectory.states[0])
    start[1] += 0.02  # m, of height
    followed, loose = (
        tc.rollouts(plan.model, 1.0, 5e-3, states=start[None], controls=controls).final[0]
        for controls in (tracker.feedback, plan.control[None])
    )
    wanted = plan.trajectory.states[-1]
    assert np.abs(followed - wanted).max() < 0.7 * np.abs(loose - wanted).max()

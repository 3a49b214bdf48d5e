"""Plans: replayed, read, saved and loaded."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc

PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)


def test_the_replay_is_what_simulate_computes(plan):
    model = driven(prism(1.0))
    for run in (
        plan.replay(),
        tc.simulate(model, 1.0, 1.0 / 120, control=plan.force_density, compiled=False),
    ):
        assert len(run.time) == 121
        lengths = np.linalg.norm(
            run.nodes[-1][prism(1.0).strings[:, 1]] - run.nodes[-1][prism(1.0).strings[:, 0]],
            axis=1,
        )
        assert np.abs(lengths - prism(1.1).string_lengths).max() <= plan.replay_error * (1 + 1e-9)
        assert np.abs(run.velocities[-1]).max() == pytest.approx(plan.replay_speed_error, rel=1e-6)
    finer = plan.replay(step=1e-3)
    assert finer.step <= 1e-3
    assert finer.nodes[-1] == pytest.approx(run.nodes[-1], abs=1e-6)


def test_tension_is_force_density_times_length(plan):
    assert plan.tension() == pytest.approx(plan.trajectory.tension[:-1], rel=1e-9)
    assert plan.lengths()[-1] == pytest.approx(prism(1.1).string_lengths, abs=1e-7)
    assert plan.tension(end=True) == pytest.approx(plan.force_density * plan.lengths()[1:])


def test_rest_lengths_give_the_force_densities_back(plan):
    k = 500.0
    rest = plan.rest_lengths(k)
    assert rest.shape == (12, 9)
    assert k * (1 - rest / plan.lengths()[:-1]) == pytest.approx(plan.force_density, rel=1e-9)
    assert plan.rest_lengths() == pytest.approx(
        plan.rest_lengths(100.0)
    )  # the structure's own stiffness
    with pytest.raises(ValueError, match="stiffness of string 6 is 8 N/m: it must exceed"):
        plan.rest_lengths([100.0] * 6 + [8.0] * 3)


def test_a_saved_plan_comes_back(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    loaded = ocp.Plan.load(path)
    for name in (
        "success",
        "status",
        "message",
        "objective",
        "iterations",
        "seconds",
        "replay_error",
        "replay_speed_error",
    ):
        assert getattr(loaded, name) == getattr(plan, name)
        assert type(getattr(loaded, name)) is type(getattr(plan, name))
    for name in ("time", "force_density"):
        assert np.array_equal(getattr(loaded, name), getattr(plan, name))
    assert np.array_equal(loaded.trajectory.states, plan.trajectory.states)
    assert np.array_equal(loaded.tension(), plan.tension())
    assert np.array_equal(loaded.replay().states, plan.replay().states)
    assert np.array_equal(loaded.rest_lengths(200.0), plan.rest_lengths(200.0))
    assert loaded.summary() == plan.summary()
    assert "12 intervals" in repr(loaded)


def test_a_saved_plan_knows_its_scene(tmp_path):
    scene = {"gravity": tc.Gravity((0.0, 0.0, -1.0)), "segments": 2, "ends": "lumped"}
    model = driven(prism(1.0, string_mass=0.1, pinned={0: "xyz", 1: "z", 2: "xyz"}), **scene)
    problem = ocp.Problem(model, 0.1, costs=[ocp.Effort()], bounds=[PRESTRESS])
    plan = ocp.solve(problem, ocp.MultipleShooting(2))
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert loaded.model.structure.pinned == model.structure.pinned
    assert loaded.model.scene.gravity == scene["gravity"]
    assert np.array_equal(loaded.replay().states, plan.replay().states)


@pytest.mark.parametrize(
    "model",
    [
        lambda: driven(prism(1.0, string_mass=0.3), segments=2, fractions=(0.2, 0.8)),
        lambda: driven(
            prism(1.0),
            ground=tc.Ground(height=-5.0),
            forces=tc.NodalForce(np.ones((2, 6, 3)), times=[0.0, 1.0]),
        ),
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()), "full"),
    ],
    ids=["segments", "loads", "full coordinates"],
)
def test_a_saved_plan_loads_with_the_model_that_it_was_made_with(model, tmp_path):
    plan = ocp.solve(
        ocp.Problem(model(), 0.1, costs=[ocp.Effort()], bounds=[PRESTRESS]), ocp.MultipleShooting(2)
    )
    loaded = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert np.array_equal(loaded.replay().states, plan.replay().states)
    assert np.array_equal(loaded.bar_forces(), plan.bar_forces())


def test_a_plan_is_not_loaded_for_a_problem_with_another_model(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    others = {
        "Structure.bar_mass": driven(prism(1.0, bar_mass=5.0)),
        "Structure.nodes, Structure.bars": driven(tc.shapes.d_bar()),
        "Scene.gravity": driven(prism(1.0), gravity=tc.Gravity()),
        "Model.coordinates": tc.Model(tc.Scene(prism(1.0), control=tc.ForceDensity()), "full"),
    }
    for name, model in others.items():
        with pytest.raises(
            ValueError,
            match=f"^problem.model is not the plan's, other in {name}.*: give the problem that the plan was made for",
        ):
            ocp.Plan.load(path, ocp.Problem(model))
    assert ocp.Plan.load(path, ocp.Problem(driven(prism(1.0)))).replay().success


def test_a_plan_with_a_field_of_another_kind_is_refused_by_name(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    with np.load(path) as archive:
        content = {
            name: archive[name] for name in archive.files if not name.startswith("trajectory.")
        }
        trajectory = {name: archive[name] for name in archive.files if name not in content}
    messages = []
    for name in content:
        for wrong in (None, np.asarray("x"), np.asarray(np.nan), np.ones(content[name].shape) * 1j):
            np.savez(
                path,
                **{
                    key: value
                    for key, value in {**trajectory, **content, name: wrong}.items()
                    if value is not None
                },
            )
            try:
                ocp.Plan.load(path)
            except ValueError as error:  # anything else would be a fault of ours
                messages.append(str(error))
    assert len(messages) > 2 * len(content)
    assert all(message.startswith(f"{path} is not a plan: ") for message in messages)


NUMBERS = {
    "time": lambda old: old[::-1],
    "force_density": lambda old: old * np.nan,
    "objective": lambda old: np.asarray(np.nan),
    "iterations": lambda old: np.asarray(-1),
    "seconds": lambda old: np.asarray(-1.0),
    "replay_error": lambda old: np.asarray(-1.0),
    "duals.values": lambda old: old[:-1],
    "trajectory.time": lambda old: old * 2,
    "trajectory.success": lambda old: np.asarray(False),
    "trajectory.strings": lambda old: old[::-1],
    "trajectory.bars": lambda old: old[:, ::-1],
}


def test_numbers_that_no_plan_can_have_are_refused_by_name(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    with np.load(path) as archive:
        content = dict(archive)
    for name, change in NUMBERS.items():
        np.savez(path, **content | {name: change(content[name])})
        with pytest.raises(ValueError, match=rf"plan\.npz is not a plan: field '{name}' "):
            ocp.Plan.load(path)
    for name, change in {
        "time": lambda old: old[::-1],
        "nodes": lambda old: old * np.nan,
        "step": lambda old: old * 0,
    }.items():
        np.savez(path, **content | {f"trajectory.{name}": change(content[f"trajectory.{name}"])})
        with pytest.raises(
            ValueError, match=rf"plan\.npz is not a plan: field 'trajectory.{name}' is "
        ):
            ocp.Plan.load(path)
    many = content["plan"].item().replace('"scene": {', '"scene": {"segments": 1000000000, ')
    np.savez(path, **content | {"plan": np.asarray(many)})
    with pytest.raises(ValueError, match=r"field 'plan' is damaged \(plan, scene.segments: "):
        ocp.Plan.load(path)
    np.savez(path, **content)
    assert ocp.Plan.load(path).success


def test_a_plan_that_failed_is_loaded_with_what_is_not_finite(plan, tmp_path):
    failed = replace(
        plan,
        success=False,
        force_density=plan.force_density * np.nan,
        objective=np.nan,
        replay_error=np.nan,
    )
    assert np.isnan(ocp.Plan.load(failed.save(tmp_path / "plan.npz")).force_density).all()


def blown(rate=4.0):
    """A bar on a ball joint, held by four strings, in a wind that changes with time."""
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    arm = tc.Structure(
        nodes, bars=[(0, 1)], strings=[(1, k) for k in range(2, 6)], pinned=[0, 2, 3, 4, 5]
    )
    return driven(
        arm,
        forces=tc.NodalForce(
            lambda t: [[0, 0, 0], [20 * np.sin(rate * t), 0, 0]] + [[0, 0, 0]] * 4
        ),
    )


@pytest.fixture(scope="module")
def late():
    """A plan in the wind from t = 0.7 s on."""
    model = blown()
    start = np.append(model.initial_state[:-1], 0.7)
    goals = [ocp.NodePositions({1: (0.3, 0.1, None)}), ocp.AtRest()]
    problem = ocp.Problem(
        model,
        1.0,
        start,
        goals=goals,
        bounds=[ocp.ForceDensityLimits(1.0, 200.0)],
        costs=[ocp.Effort()],
    )
    return ocp.solve(problem, ocp.MultipleShooting(20, substeps=2))


def test_a_plan_is_replayed_from_the_clock_that_it_starts_at(late):
    assert late.success
    assert late.replay_error < 1e-3
    linear = replace(
        late, force_density=np.concatenate([late.force_density, late.force_density[-1:]])
    )
    for motion in (late.replay(), linear.replay(), ocp.replay_rest_lengths(late, 1000.0, 1.0)):
        assert motion.states[[0, -1], -1] == pytest.approx([0.7, 1.7])
        assert motion.time[[0, -1]] == pytest.approx([0.0, 1.0])
    assert motion.nodes[-1, 1] == pytest.approx(late.trajectory.nodes[-1, 1], abs=5e-3)


def test_a_plan_under_functions_of_time_needs_its_problem(late, tmp_path):
    path = late.save(tmp_path / "plan.npz")
    alone = ocp.Plan.load(path)
    for use in (alone.replay, alone.bar_forces, lambda: ocp.replay_rest_lengths(alone)):
        with pytest.raises(
            ValueError,
            match=r"needs the model, .* functions of time; give Plan.load\(path, problem=...\)",
        ):
            use()
    assert np.array_equal(ocp.Plan.load(path, late.problem).replay().states, late.replay().states)
    for other in (blown(4.1), driven(late.structure)):
        with pytest.raises(ValueError, match=r"other in (NodalForce\.values|Scene\.forces):"):
            ocp.Plan.load(path, ocp.Problem(other))


def test_replays_take_schemes_only(plan):
    linear = replace(
        plan, force_density=np.concatenate([plan.force_density, plan.force_density[-1:]])
    )
    for one in (plan, linear):
        for scheme in ("rk4", tc.RungeKutta4, 0):
            with pytest.raises(
                TypeError,
                match=r"scheme is .*: give an integration scheme, such as RungeKutta4\(\)",
            ):
                one.replay(scheme)
        assert one.replay(tc.DormandPrince853()).success


def test_files_that_are_no_plans_are_refused(plan, tmp_path):
    path = tmp_path / "plan.npz"
    damaged = [b"", b"no archive", plan.save(path).read_bytes()[:2000]]
    for content in damaged:
        path.write_bytes(content)
        with pytest.raises(ValueError, match="is not a plan: it cannot be read"):
            ocp.Plan.load(path)
    plan.trajectory.save(path)
    with pytest.raises(ValueError, match="is not a plan: its field 'format'"):
        ocp.Plan.load(path)
    plan.save(path)
    with np.load(path) as archive:
        content = dict(archive)
    wrong = {
        "force_density": np.zeros((3, 9)),
        "plan": np.asarray("{}"),
        "iterations": np.zeros(3),
    }
    for name, value in {**wrong, "time": None, "plan": None}.items():
        kept = {key: entry for key, entry in content.items() if key != name} | (
            {} if value is None else {name: value}
        )
        np.savez_compressed(path, **kept)
        with pytest.raises(ValueError, match="is not a plan"):
            ocp.Plan.load(path)


def test_plans_do_not_change(plan):
    with pytest.raises(ValueError, match="read-only"):
        plan.force_density[0, 0] = 1.0
    assert not replace(plan, success=False).success


def test_replan_takes_changes_of_the_problem(plan):
    longer = plan.replan(duration=1.1 * plan.time[-1])
    assert longer.success, longer.message
    assert longer.time[-1] == pytest.approx(1.1 * plan.time[-1])
    assert longer.problem.goals == plan.problem.goals
    assert len(longer.time) == len(plan.time)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"goal": []}, TypeError, "replan has no argument 'goal': give a field of ocp.Problem"),
        ({"tolerance": -1.0}, ValueError, "tolerance is -1: it must be greater than 0"),
        ({"goals": 3}, TypeError, "Problem.goals"),
    ],
)
def test_replan_rejects_unknown_changes(plan, changes, error, message):
    with pytest.raises(error, match=re.escape(message)):
        plan.replan(**changes)


def test_replan_changes_parameters_repeatedly():
    """Each plan keeps the parameters and other changes of the previous one."""
    scene = tc.Scene(
        tc.shapes.d_bar(), control=tc.ForceDensity(), parameters=tc.Parameters("bar_mass")
    )
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    costs = [ocp.Effort()]
    problem = ocp.Problem(tc.Model(scene), goals=iter(goals), costs=iter(costs))
    first = ocp.solve(problem, ocp.Variational(6))
    heavy = first.replan(parameters={"bar_mass": 2.0}).replan(duration=1.1)
    assert heavy.success, heavy.message
    assert heavy.problem.model.structure.bar_mass.tolist() == [2.0] * 4
    assert (heavy.problem.goals, heavy.problem.costs) == (tuple(goals), tuple(costs))
    heavier = heavy.replan(parameters={"bar_mass": 4.0})
    assert heavier.success, heavier.message
    assert heavier.time[-1] == pytest.approx(1.1)
    assert heavier.objective == pytest.approx(4 * heavy.objective, rel=1e-3)


def test_replan_starts_another_model_at_its_own_state(plan):
    other = tc.Model(replace(plan.model.scene, structure=plan.structure.replace(bar_mass=2.0)))
    again = plan.replan(model=other)
    assert again.success, again.message
    assert again.problem.start == pytest.approx(other.initial_state)


def test_replan_needs_the_problem(plan):
    with pytest.raises(ValueError, match="replan needs the problem, which the plan does not hold"):
        replace(plan, problem=None).replan()

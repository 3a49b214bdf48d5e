"""Plans end to end: found, replayed, within limits, saved; and what is said when there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ocp
import tenscasadi as tc

BAR = 1.4
PRESTRESS = ocp.ForceDensityLimits(5.0, 100.0)


def prism(height, bars=3, **options):
    """The equilibrium prism of a height whose bars are BAR long."""
    chord = 2 * np.sin(np.pi / 4 + np.pi / (2 * bars))
    return tc.shapes.prism(bars, np.sqrt(BAR**2 - height**2) / chord, height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


def raised(intervals=12, to=1.1, **changes):
    """A prism raised from 1 m, by default within PRESTRESS at the least effort."""
    goals = [ocp.StringLengths(prism(to).string_lengths), ocp.AtRest()]
    given = {"model": driven(prism(1.0)), "goals": goals, "bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}
    return ocp.solve(ocp.Problem(**given), ocp.MultipleShooting(intervals))


@pytest.fixture(scope="module")
def plan():
    return raised()


def heights(nodes):
    """Distance of the top's centre from the bottom's."""
    half = nodes.shape[-2] // 2
    return np.linalg.norm(nodes[..., half:, :].mean(axis=-2) - nodes[..., :half, :].mean(axis=-2), axis=-1)


# --- plans that are found ---


def test_a_prism_rises(plan):
    assert plan.success
    assert plan.status == "Solve_Succeeded"
    assert "27 → 18 rows: 4 bar, 6 momentum, 1 added for the shape" in plan.message
    assert plan.replay_error < 1e-4
    assert plan.replay_speed_error < 1e-3
    assert 0 < plan.iterations < 100
    assert plan.seconds > 0
    assert plan.time == pytest.approx(np.linspace(0.0, 1.0, 13))
    assert plan.force_density.shape == (12, 9)
    assert heights(plan.trajectory.nodes)[[0, -1]] == pytest.approx([1.0, 1.1], abs=1e-7)
    assert np.abs(plan.trajectory.velocities[-1]).max() < 1e-3
    assert plan.trajectory.bar_length_error.max() < 1e-7
    interval = plan.time[1]
    assert plan.objective == pytest.approx(interval * np.sum(plan.force_density**2), rel=1e-6)
    for words in ("iterations", "force density", "replay", "N/m"):
        assert words in plan.summary()


def test_the_replay_is_what_simulate_computes(plan):
    model = driven(prism(1.0))
    for run in (plan.replay(), tc.simulate(model, 1.0, 1.0 / 120, control=plan.force_density, compiled=False)):
        assert len(run.time) == 121
        lengths = np.linalg.norm(run.nodes[-1][prism(1.0).strings[:, 1]] - run.nodes[-1][prism(1.0).strings[:, 0]], axis=1)
        assert np.abs(lengths - prism(1.1).string_lengths).max() <= plan.replay_error * (1 + 1e-9)
        assert np.abs(run.velocities[-1]).max() == pytest.approx(plan.replay_speed_error, rel=1e-6)
    finer = plan.replay(step=1e-3)
    assert finer.step <= 1e-3
    assert finer.nodes[-1] == pytest.approx(run.nodes[-1], abs=1e-6)


def test_more_intervals_or_substeps_replay_better(plan):
    finer, substeps = raised(24), ocp.solve(ocp.Problem(driven(prism(1.0)), **asked()), ocp.MultipleShooting(12, substeps=3))
    assert finer.replay_error < plan.replay_error / 4
    assert substeps.replay_error < plan.replay_error / 20


def asked(**changes):
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    return {"goals": goals, "bounds": [PRESTRESS], "costs": [ocp.Effort()], **changes}


def test_force_densities_stay_within_their_limits(plan):
    assert plan.force_density.min() >= 5.0
    assert plan.force_density.min() < 5.001  # and meet them
    tight = raised(bounds=[ocp.ForceDensityLimits(5.0, 8.75)])
    assert plan.force_density.max() > 8.8
    assert tight.success
    assert 8.7499 < tight.force_density.max() <= 8.75


def test_tensions_stay_within_their_limits():
    loose = [ocp.ForceDensityLimits(1.0, 100.0)]
    free = raised(bounds=loose)
    upper = np.full(9, np.inf)
    upper[6:] = 0.97 * free.tension()[:, 6:].max()
    limited = raised(bounds=[*loose, ocp.TensionLimits(upper=upper)])
    assert limited.success
    for end in (False, True):
        tension = limited.tension(end=end)
        assert tension.shape == (12, 9)
        assert np.all(tension <= upper * (1 + 1e-6))
    assert max(limited.tension()[:, 6:].max(), limited.tension(end=True)[:, 6:].max()) > 0.999 * upper[6]
    assert limited.objective > free.objective
    slack = raised(bounds=[ocp.TensionLimits(lower=4.0)])
    assert min(slack.tension().min(), slack.tension(end=True).min()) == pytest.approx(4.0, abs=1e-4)


def test_tension_is_force_density_times_length(plan):
    assert plan.tension() == pytest.approx(plan.trajectory.tension[:-1], rel=1e-9)
    assert plan.lengths()[-1] == pytest.approx(prism(1.1).string_lengths, abs=1e-7)
    assert plan.tension(end=True) == pytest.approx(plan.force_density * plan.lengths()[1:])


def test_wider_limits_cost_no_more(plan):
    wide, narrow = raised(bounds=[ocp.ForceDensityLimits(4.0, 100.0)]), raised(bounds=[ocp.ForceDensityLimits(6.0, 100.0)])
    assert wide.objective < plan.objective < narrow.objective


def test_smoothness_smooths(plan):
    smooth = raised(costs=[ocp.Effort(1e-3), ocp.Smoothness()])
    jumps = [np.sum(np.diff(found.force_density, axis=0) ** 2) for found in (smooth, plan)]
    assert smooth.success
    assert jumps[0] < 0.7 * jumps[1]


def test_a_free_duration_costs_no_more(plan):
    free = raised(duration=(0.8, 1.3))
    assert free.success
    assert 0.8 <= free.time[-1] <= 1.3
    assert abs(free.time[-1] - 1.0) > 0.05
    assert free.objective < plan.objective
    assert free.replay_error < 1e-3


def test_rest_lengths_give_the_force_densities_back(plan):
    k = 500.0
    rest = plan.rest_lengths(k)
    assert rest.shape == (12, 9)
    assert k * (1 - rest / plan.lengths()[:-1]) == pytest.approx(plan.force_density, rel=1e-9)
    assert plan.rest_lengths() == pytest.approx(plan.rest_lengths(100.0))  # the structure's own stiffness
    with pytest.raises(ValueError, match="stiffness of string 6 is 8 N/m: it must exceed"):
        plan.rest_lengths([100.0] * 6 + [8.0] * 3)


def test_a_whole_state_is_reached():
    start, end = prism(1.0), prism(1.05)
    shift = start.nodes.mean(axis=0) - end.nodes.mean(axis=0)
    found = raised(goals=[ocp.NodePositions(end.nodes + shift), ocp.AtRest()])
    assert found.success
    assert "36 → 21 rows: 6 bar, 9 momentum" in found.message
    assert found.trajectory.nodes[-1] == pytest.approx(end.nodes + shift, abs=1e-6)
    assert found.replay_error < 1e-3


def test_four_bars():
    goals = [ocp.StringLengths(prism(1.05, bars=4).string_lengths), ocp.AtRest()]
    found = raised(10, model=driven(prism(1.0, bars=4)), goals=goals)
    assert found.success
    assert found.replay_error < 1e-3


@pytest.mark.parametrize("mass", [1.0, [1.0, 2.0, 3.0, 4.0]])
def test_a_pinned_d_bar_folds(mass):
    """Class 2. Pinned at a node its place follows from its shape: a goal for the place is out of control, and may be asked where it is met."""
    bar = tc.shapes.d_bar(pinned=[0], bar_mass=mass)
    model = driven(bar)
    lengths = ocp.StringLengths(tc.shapes.d_bar(angle=0.6).string_lengths)
    folded = ocp.solve(ocp.Problem(model, goals=[lengths, ocp.AtRest()], costs=[ocp.Effort()]), ocp.MultipleShooting(20, substeps=2))
    assert folded.success
    assert "11 → 2 rows" in folded.message
    assert folded.replay_error < 1e-4
    assert np.abs(folded.trajectory.nodes[:, 0] - bar.nodes[0]).max() == 0.0
    goals = [ocp.NodePositions(folded.trajectory.nodes[-1]), ocp.AtRest()]
    placed = ocp.solve(ocp.Problem(model, goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(20, substeps=2))
    assert placed.success
    assert "1 out of control" in placed.message
    assert placed.objective == pytest.approx(folded.objective, rel=1e-3)


def test_a_pendulum_swings_between_two_strings_under_its_weight():
    nodes = [(0, 0, 0), (0.3, 0, -0.95), (-1, 0, 0), (1, 0, 0)]
    structure = tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3)], pinned=[0, 2, 3])
    goals = [ocp.NodePositions({1: (-0.3, None, None)}), ocp.AtRest()]
    problem = ocp.Problem(driven(structure, gravity=tc.Gravity()), 0.8, goals=goals, costs=[ocp.Effort()])
    found = ocp.solve(problem, ocp.MultipleShooting(20))
    assert found.success
    assert "plane" in found.message
    assert found.replay().nodes[-1, 1] == pytest.approx([-0.3, 0.0, -0.95], abs=1e-4)
    assert found.force_density.min() >= 0.0


def test_a_falling_prism_changes_shape():
    goals = [ocp.StringLengths(prism(1.05).string_lengths)]
    found = raised(model=driven(prism(1.0), gravity=tc.Gravity((0.0, 0.0, -9.81))), goals=goals, duration=0.5)
    assert found.success
    fallen = found.trajectory.nodes[-1].mean(axis=0) - found.trajectory.nodes[0].mean(axis=0)
    assert fallen == pytest.approx([0.0, 0.0, -9.81 / 8], abs=1e-6)


def test_nothing_to_do_costs_nothing():
    found = raised(to=1.0, bounds=[])
    assert found.success
    assert found.objective < 1e-3
    assert found.replay_error < 1e-6


def test_units_do_not_matter(plan):
    """The same plan in millimetres and grams: γ in N/m is 1e-3 kg/s² there."""
    k = 1e3
    small = tc.Structure(prism(1.0).nodes * k, prism(1.0).bars, prism(1.0).strings, bar_mass=k)
    goals = [ocp.StringLengths(prism(1.1).string_lengths * k), ocp.AtRest()]
    found = raised(model=driven(small), goals=goals, bounds=[ocp.ForceDensityLimits(5.0 * k, 100.0 * k)])
    assert found.success
    assert found.force_density / k == pytest.approx(plan.force_density, rel=1e-3)


def test_full_coordinates_plan_the_same(plan):
    scene = tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity())
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()]
    found = [
        ocp.solve(ocp.Problem(tc.Model(scene, coordinates), goals=goals, costs=[ocp.Effort()]), ocp.MultipleShooting(6))
        for coordinates in ("reduced", "full")
    ]
    assert all(one.success for one in found)
    assert found[0].force_density == pytest.approx(found[1].force_density, abs=1e-3)


@pytest.mark.slow
def test_the_ball_changes_shape():
    ball = tc.shapes.six_bar_ball()
    model = driven(ball)
    shaken = model.state(ball.nodes + 0.03 * np.random.default_rng(0).normal(size=(12, 3)))
    nodes = model.nodes(tc.Projection(iterations=10).step(model)(shaken).full().ravel())
    goals = [ocp.StringLengths(tc.Structure(nodes, ball.bars, ball.strings).string_lengths), ocp.AtRest()]
    found = raised(10, model=model, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    assert found.success
    assert found.replay_error < 1e-3


@pytest.mark.slow
def test_strings_in_segments_plan_too():
    goals = [ocp.StringLengths(prism(1.05).string_lengths)]
    problem = ocp.Problem(driven(prism(1.0, string_mass=0.1), segments=2), goals=goals, bounds=[PRESTRESS], costs=[ocp.Effort()])
    found = ocp.solve(problem, ocp.MultipleShooting(12, substeps=4))
    assert found.success
    assert found.trajectory.nodes.shape == (13, 15, 3)
    assert found.replay_error < 1e-3


# --- plans that are not found ---


def test_too_little_force_is_said(plan):
    found = raised(bounds=[ocp.ForceDensityLimits(5.0, 8.0)])
    assert not found.success
    assert found.status == "Infeasible_Problem_Detected"
    for words in (
        "no plan",
        "misses its goal by",
        "upper limits hold",
        "force density of string",
        "the strings move 18 of 18 rows",
        "longer duration",
    ):
        assert words in found.message
    assert found.replay_error > 1e-3


def test_too_few_iterations_are_said():
    problem = ocp.Problem(driven(prism(1.0)), **asked())
    found = ocp.solve(problem, ocp.MultipleShooting(12), ocp.Ipopt(max_iterations=1))
    assert not found.success
    assert found.iterations == 1
    assert "raise max_iterations" in found.message
    assert "largest violation" in found.message
    assert found.force_density.shape == (12, 9)


def test_what_is_feasible_but_not_settled_is_said():
    found = ocp.solve(ocp.Problem(driven(prism(1.0)), **asked()), ocp.MultipleShooting(12), ocp.Ipopt(max_iterations=3))
    assert not found.success
    assert "all constraints are met, but the cost is not settled" in found.message


def test_a_goal_that_external_forces_keep_away_is_said():
    """Nothing is conserved under a wind, so that nothing is refused beforehand; but no string stops a free prism in it."""
    wind = np.zeros((6, 3))
    wind[:, 0] = 0.5
    found = raised(model=driven(prism(1.0), forces=tc.NodalForce(wind)))
    assert not found.success
    assert "AtRest" in found.message
    assert "no string moves it there" in found.message
    assert found.replay_speed_error == pytest.approx(1.0, abs=0.05)  # 3 N on 3 kg for 1 s


def test_plans_whose_replay_misses_the_tolerance_are_no_success(plan):
    lowered = asked(goals=[ocp.StringLengths(prism(0.6).string_lengths), ocp.AtRest()])
    found = ocp.solve(ocp.Problem(driven(prism(1.0)), **lowered), ocp.ImplicitMidpoint(4))
    assert found.status == "Solve_Succeeded"
    assert not found.success
    assert found.replay_error > 1e-2
    assert found.message.startswith("too coarse: a plan was found after ")
    assert "plan.refine(" in found.message
    problem, allowed = ocp.Problem(driven(prism(1.0)), **asked()), plan.worst_error
    for tolerance, met in ((1.01 * allowed, True), (0.99 * allowed, False)):
        assert ocp.solve(problem, ocp.MultipleShooting(12), tolerance=tolerance).success is met
    with pytest.raises(ValueError, match="tolerance"):
        ocp.solve(problem, tolerance=0.0)


# --- files ---


def test_a_saved_plan_comes_back(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    loaded = ocp.Plan.load(path)
    for name in ("success", "status", "message", "objective", "iterations", "seconds", "replay_error", "replay_speed_error"):
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
        lambda: driven(prism(1.0), ground=tc.Ground(height=-5.0), forces=tc.NodalForce(np.ones((2, 6, 3)), times=[0.0, 1.0])),
        lambda: tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()), "full"),
    ],
    ids=["segments", "loads", "full coordinates"],
)
def test_a_saved_plan_loads_with_the_model_that_it_was_made_with(model, tmp_path):
    plan = ocp.solve(ocp.Problem(model(), 0.1, costs=[ocp.Effort()], bounds=[PRESTRESS]), ocp.MultipleShooting(2))
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
        with pytest.raises(ValueError, match=f"^problem.model is not the plan's, other in {name}.*: give the problem that the plan was made for"):
            ocp.Plan.load(path, ocp.Problem(model))
    assert ocp.Plan.load(path, ocp.Problem(driven(prism(1.0)))).replay().success


def test_a_plan_with_a_field_of_another_kind_is_refused_by_name(plan, tmp_path):
    path = plan.save(tmp_path / "plan.npz")
    with np.load(path) as archive:
        content = {name: archive[name] for name in archive.files if not name.startswith("trajectory.")}
        trajectory = {name: archive[name] for name in archive.files if name not in content}
    messages = []
    for name in content:
        for wrong in (None, np.asarray("x"), np.asarray(np.nan), np.ones(content[name].shape) * 1j):
            np.savez(path, **{key: value for key, value in {**trajectory, **content, name: wrong}.items() if value is not None})
            try:
                ocp.Plan.load(path)
            except ValueError as error:  # anything else would be a fault of ours
                messages.append(str(error))
    assert len(messages) > 2 * len(content)
    assert all(message.startswith(f"{path} is not a plan: ") for message in messages)


# --- time ---


def blown(rate=4.0):
    """A bar on a ball joint, held by four strings, in a wind that changes with time."""
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    arm = tc.Structure(nodes, bars=[(0, 1)], strings=[(1, k) for k in range(2, 6)], pinned=[0, 2, 3, 4, 5])
    return driven(arm, forces=tc.NodalForce(lambda t: [[0, 0, 0], [20 * np.sin(rate * t), 0, 0]] + [[0, 0, 0]] * 4))


@pytest.fixture(scope="module")
def late():
    """A plan in the wind from t = 0.7 s on."""
    model = blown()
    start = np.append(model.initial_state[:-1], 0.7)
    goals = [ocp.NodePositions({1: (0.3, 0.1, None)}), ocp.AtRest()]
    problem = ocp.Problem(model, 1.0, start, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 200.0)], costs=[ocp.Effort()])
    return ocp.solve(problem, ocp.MultipleShooting(20, substeps=2))


def test_a_plan_is_replayed_from_the_clock_that_it_starts_at(late):
    assert late.success
    assert late.replay_error < 1e-3
    linear = replace(late, force_density=np.concatenate([late.force_density, late.force_density[-1:]]))
    for motion in (late.replay(), linear.replay(), ocp.replay_wound(late, 1000.0, 1.0)):
        assert motion.states[[0, -1], -1] == pytest.approx([0.7, 1.7])
        assert motion.time[[0, -1]] == pytest.approx([0.0, 1.0])
    assert motion.nodes[-1, 1] == pytest.approx(late.trajectory.nodes[-1, 1], abs=5e-3)


def test_a_plan_under_functions_of_time_needs_its_problem(late, tmp_path):
    path = late.save(tmp_path / "plan.npz")
    alone = ocp.Plan.load(path)
    for use in (alone.replay, alone.bar_forces, lambda: ocp.replay_wound(alone)):
        with pytest.raises(ValueError, match=r"needs the model, .* functions of time; give Plan.load\(path, problem=...\)"):
            use()
    assert np.array_equal(ocp.Plan.load(path, late.problem).replay().states, late.replay().states)
    for other in (blown(4.1), driven(late.structure)):
        with pytest.raises(ValueError, match=r"other in Scene\.forces:"):
            ocp.Plan.load(path, ocp.Problem(other))


def test_replays_take_schemes_only(plan):
    linear = replace(plan, force_density=np.concatenate([plan.force_density, plan.force_density[-1:]]))
    for one in (plan, linear):
        for scheme in ("rk4", tc.RungeKutta4, 0):
            with pytest.raises(TypeError, match=r"scheme is .*: give an integration scheme, such as RungeKutta4\(\)"):
                one.replay(scheme)
        assert one.replay(tc.DormandPrince853()).success


# --- damaged files ---


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
    wrong = {"force_density": np.zeros((3, 9)), "structure.bars": np.array([[0, 99]]), "iterations": np.zeros(3), "scene.segments": np.zeros(9, int)}
    for name, value in {**wrong, "time": None, "structure.fixed": None, "scene.slack": None}.items():
        kept = {key: entry for key, entry in content.items() if key != name} | ({} if value is None else {name: value})
        np.savez_compressed(path, **kept)
        with pytest.raises(ValueError, match="is not a plan"):
            ocp.Plan.load(path)


def test_plans_do_not_change(plan):
    with pytest.raises(ValueError, match="read-only"):
        plan.force_density[0, 0] = 1.0
    assert not replace(plan, success=False).success

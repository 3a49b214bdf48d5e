"""Sampling: jumps are found from any seed, replays and SciPy agree, the same seed finds the same, stops keep the best."""

from __future__ import annotations

import time

import casadi as ca
import numpy as np
import pytest
from loading import load_example
from planning import folding, integrated

import ocp
import tenscasadi as tc
from ocp.sampling import method
from ocp.sampling.defaults import find_symmetry_groups
from tenscasadi.simulation.engine import native as kernels
from tenscasadi.util.compile import CompileError

contact_problems = load_example("contact_problems")
QUICK = ocp.Sampling(samples=64, rounds=12)


def centre(motion):
    return motion.nodes[:, :, 2].mean(axis=1)


def rise(motion):
    return centre(motion).max() - centre(motion)[0]


@pytest.mark.parametrize(
    "height",
    [0.2, *(pytest.param(height, marks=pytest.mark.slow) for height in (0.1, 0.3, 0.4))],
)
def test_a_prism_jumps_by_default(height):
    plan = ocp.solve(contact_problems.prism_jumps(height))
    assert plan.success, plan.message
    motion = plan.replay(step=2e-5)
    assert motion.nodes[-1, :, 2].min() > 0.015  # off the ground
    assert rise(motion) == pytest.approx(height, abs=0.02)
    assert plan.report().violated == ()
    assert plan.force_density.min() >= 5.0


def test_scipy_agrees():
    plan = ocp.solve(contact_problems.prism_jumps(0.2), solver=QUICK)
    nodes = plan.model.nodes(integrated(plan))
    assert nodes[:, 2].mean() - centre(plan.trajectory)[0] == pytest.approx(0.2, abs=0.01)
    assert np.abs(nodes - plan.trajectory.nodes[-1]).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e4, 1e5])
@pytest.mark.parametrize("height", [0.1, 0.2, 0.3, 0.4])
def test_at_least_seven_of_eight_seeds_find_it(height, stiffness):
    problem = contact_problems.prism_jumps(height, stiffness)
    plans = [ocp.solve(problem, solver=ocp.Sampling(seed=seed)) for seed in range(8)]
    size = np.linalg.norm(np.ptp(problem.model.structure.nodes, axis=0))
    assert sum(
        plan.success and abs(rise(plan.replay(step=2e-5)) - height) < 0.01 * size for plan in plans
    ) >= (8 if height == 0.3 else 7)


@pytest.mark.slow
def test_the_same_seed_finds_the_same_on_any_number_of_threads():
    problem = contact_problems.prism_jumps(0.2)
    first, second, other = (
        ocp.solve(
            problem,
            solver=ocp.Sampling(
                samples=64, rounds=4, iterations=2, attempts=1, seed=seed, threads=threads
            ),
        )
        for seed, threads in ((3, 1), (3, 2), (4, 1))
    )
    assert np.array_equal(first.force_density, second.force_density)
    assert not np.array_equal(first.force_density, other.force_density)


def test_without_a_compiler_motions_go_one_by_one(monkeypatch):
    def none(*_, build):
        raise CompileError("no compiler")

    monkeypatch.setattr(kernels, "compile_library", none)
    solver = ocp.Sampling(
        samples=8, rounds=1, iterations=0, attempts=1, groups=[(0, 1, 2), (3, 4, 5), (6, 7, 8)]
    )
    plan = ocp.solve(
        contact_problems.prism_jumps(0.2, duration=0.1), ocp.MultipleShooting(5), solver
    )
    assert "one by one, not compiled: no compiler" in plan.status


def test_a_limit_of_time_keeps_the_best():
    problem = contact_problems.prism_jumps(3.0)  # too high
    began = time.perf_counter()
    plan = ocp.solve(problem, solver=ocp.Sampling(attempts=1000), time_limit=1.0)
    assert time.perf_counter() - began < 30.0  # compiling counts
    assert not plan.success
    assert "time limit" in plan.message
    assert "CenterOfMass: z misses its goal by" in plan.message
    assert np.all(np.isfinite(plan.trajectory.states))


@pytest.mark.parametrize("interrupted", [False, True])
def test_who_watches_stops_it(interrupted):
    seen = []

    def watch(line):
        seen.append(line)
        if interrupted and len(seen) == 2:
            raise KeyboardInterrupt
        return len(seen) < 2

    plan = ocp.solve(
        contact_problems.prism_jumps(0.4), solver=ocp.Sampling(samples=32, callback=watch)
    )
    assert not plan.success
    assert ("keyboard" if interrupted else "on request") in plan.message
    assert "round 1: residual of the goals" in seen[0]


def test_what_cannot_be_met_is_said():
    plan = ocp.solve(
        contact_problems.prism_jumps(3.0),
        solver=ocp.Sampling(samples=16, rounds=3, iterations=2, attempts=1),
    )
    assert not plan.success
    assert "no plan: " in plan.message
    assert "CenterOfMass: z misses its goal by" in plan.message


@pytest.mark.slow
def test_a_plan_is_polished_where_it_is_a_guess():
    problem = contact_problems.prism_jumps(0.2)
    plan = ocp.solve(problem)
    again = ocp.solve(contact_problems.prism_jumps(0.21), plan.transcription, ocp.Sampling(), plan)
    assert again.success, again.message
    assert rise(again.replay()) == pytest.approx(0.21, abs=0.01)
    assert np.abs(again.force_density - plan.force_density).max() < 20.0


def test_a_search_follows_a_guess_that_leads_nowhere():
    plan = ocp.solve(contact_problems.prism_jumps(0.2), solver=QUICK, guess=ocp.EquilibriumGuess())
    assert plan.success, plan.message
    assert rise(plan.replay()) == pytest.approx(0.2, abs=0.02)


def test_limits_that_leave_one_force_density_are_no_error():
    problem = contact_problems.prism_jumps(0.2)
    fixed = ocp.Problem(
        problem.model, 0.1, goals=problem.goals, bounds=[ocp.ForceDensityLimits(20.0, 20.0)]
    )
    plan = ocp.solve(fixed, ocp.MultipleShooting(5), ocp.Sampling(samples=8, rounds=2, attempts=1))
    assert not plan.success
    assert "misses its goal by" in plan.message
    assert np.all(plan.force_density == 20.0)


@pytest.mark.slow
def test_refining_meets_the_tolerance_or_says_that_it_does_not():
    plan = ocp.solve(
        contact_problems.prism_jumps(0.2),
        solver=ocp.Sampling(samples=64, rounds=12, attempts=1),
        tolerance=0.05,
    )
    assert plan.success, plan.message
    for tolerance in (plan.worst_error / 3, 1e-9):
        fine = plan.refine(tolerance)
        assert fine.success == (fine.worst_error <= tolerance), fine.message
        assert fine.success or "was not met by more samples" in fine.message
    assert not fine.success


@pytest.mark.slow
def test_limits_that_a_bounce_breaks_between_the_nodes_of_the_mesh_are_said():
    """Whatever it does, the prism lands at 1.4 m/s: its feet go deeper than 2 mm, for less than an interval."""
    model = contact_problems.low_prism()
    start = model.structure.nodes + [0, 0, 0.1]
    goal, bounds = (
        ocp.CenterOfMass((None, None, 0.3)),
        [ocp.ForceDensityLimits(5.0, 500.0), ocp.AboveGround(-0.002)],
    )
    plan = ocp.solve(
        ocp.Problem(model, 0.4, start, [goal], bounds),
        ocp.MultipleShooting(6),
        QUICK,
        tolerance=0.05,
    )
    assert plan.success, plan.message
    assert plan.replay(step=2e-5).nodes[:, :, 2].min() < -0.002
    assert "beyond its limit of -0.002: see report()" in plan.message


@pytest.mark.slow
def test_strings_that_share_a_force_density_do():
    groups = ((0, 1, 2), (3, 4, 5), (6, 7, 8))
    transcription = ocp.MultipleShooting(22, control=ocp.PiecewiseConstant(groups))
    plan = ocp.solve(contact_problems.prism_jumps(0.3), transcription, ocp.Sampling())
    for group in groups:
        assert np.ptp(plan.force_density[:, group], axis=1).max() < 1e-6


def test_a_motion_without_ground_and_with_free_duration_and_a_waypoint():
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()))
    lengths = [tc.shapes.d_bar(angle=angle).string_lengths for angle in (0.75, 0.7)]
    goals = [
        ocp.Waypoint([ocp.StringLengths(lengths[0])], share=0.5),
        ocp.StringLengths(lengths[1]),
    ]
    plan = ocp.solve(
        ocp.Problem(model, (0.5, 1.5), goals=goals, bounds=[ocp.ForceDensityLimits(0.0, 50.0)]),
        solver=ocp.Sampling(samples=32),
    )
    assert plan.success, plan.message
    assert 0.5 <= plan.time[-1] <= 1.5


def test_costs_are_those_of_programs():
    costs = [
        ocp.Effort(0.5),
        ocp.Smoothness(0.1),
        ocp.AtEnd("end", lambda now: ca.sumsqr(now.nodes)),
    ]
    for intervals in (6, (1.0, 2.0, 3.0, 1.0)):
        problem = folding(bounds=[ocp.ForceDensityLimits(0.0, 50.0)])
        problem = ocp.Problem(
            problem.model, goals=problem.goals, bounds=problem.bounds, costs=costs
        )
        sampled = ocp.solve(
            problem, ocp.Variational(intervals), ocp.Sampling(samples=32, attempts=1)
        )
        h, gamma = np.diff(sampled.time), sampled.force_density
        wanted = 0.5 * h @ (gamma**2).sum(axis=1) + (sampled.trajectory.nodes[-1] ** 2).sum()
        wanted += 0.1 * ((np.diff(gamma, axis=0) ** 2).sum(axis=1) / ((h[1:] + h[:-1]) / 2)).sum()
        assert sampled.objective == pytest.approx(wanted, rel=1e-9)


def test_what_sampling_does_not_do_is_refused():
    problem = contact_problems.prism_jumps(0.2)
    with pytest.raises(ValueError, match="PiecewiseLinear"):
        ocp.solve(problem, ocp.MultipleShooting(10, control=ocp.PiecewiseLinear()), ocp.Sampling())
    with pytest.raises(ValueError, match=r"Problem\.start is free"):
        ocp.solve(
            ocp.Problem(problem.model, start=ocp.FreeStart()),
            ocp.MultipleShooting(10),
            ocp.Sampling(),
        )
    with pytest.raises(ValueError, match=r"Sampling\.groups\[0\]\[1\] is 9"):
        ocp.solve(problem, solver=ocp.Sampling(groups=[(0, 9)]))


def test_plans_are_kept_in_files(tmp_path):
    plan = ocp.solve(
        contact_problems.prism_jumps(0.2),
        solver=ocp.Sampling(
            samples=16, rounds=2, iterations=1, attempts=1, callback=lambda line: None
        ),
    )
    again = ocp.Plan.load(plan.save(tmp_path / "plan.npz"))
    assert again.solver == ocp.Sampling(samples=16, rounds=2, iterations=1, attempts=1)
    assert np.array_equal(again.force_density, plan.force_density)


def test_intervals_follow_the_duration():
    counts = [
        method.default_intervals(contact_problems.prism_jumps(0.2, duration=duration))
        for duration in (0.1, 0.6, 1.2)
    ]
    assert counts[0] >= 20
    assert counts[2] == pytest.approx(2 * counts[1], abs=2)


def test_ipopt_says_what_contact_does_to_it():
    plan = ocp.solve(
        contact_problems.prism_jumps(0.3), ocp.Variational(10), ocp.Ipopt(max_iterations=3)
    )
    assert not plan.success
    assert (
        "through contact with a ground derivatives mislead the solver: try solver=ocp.Sampling()"
        in plan.message
    )


LONG = [name for name in contact_problems.PROBLEMS if not name.startswith("prism jumps 0")]


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_it_is_found_by_default(name):
    asked = contact_problems.PROBLEMS[name]
    problem = asked.build()
    plan = ocp.solve(problem, tolerance=asked.tolerance)
    assert plan.success, plan.message
    motion = plan.replay(step=5e-5)
    structure = problem.model.scene.structure
    end, velocities, x = (
        ca.SX.sym("N", 3, len(structure.nodes)),
        ca.SX.sym("V", 3, len(structure.nodes)),
        [],
    )
    for goal in problem.terminal_goals:
        rows = goal.rows(structure, end, velocities)
        x.append(
            (
                ca.Function("rows", [end, velocities], [rows.value])(
                    motion.nodes[-1].T, motion.velocities[-1].T
                )
                .full()
                .ravel(),
                rows.units,
            )
        )
    size = np.linalg.norm(np.ptp(structure.nodes, axis=0))
    limit = 2 * (asked.tolerance or 0.01 * size)
    for missed, units in x:
        places = np.array([unit == "m" for unit in units])
        assert np.abs(missed[places]).max(initial=0.0) < limit
        assert np.abs(missed[~places]).max(initial=0.0) < limit / motion.time[-1]


def test_groups_have_the_symmetry_of_start_and_goals():
    """A ball that tips over an edge leaves the vertical axis of its start."""
    problem = contact_problems.ball_tips()
    model, start = problem.model, problem.initial_state
    upright = find_symmetry_groups(problem, start, 0.01)
    ahead = model.state(model.nodes(start) + [0.5, 0.0, 0.0])
    groups = find_symmetry_groups(problem, ahead, 0.01)
    assert len(upright) == 7
    assert len(groups) > len(upright)
    far = model.nodes(start)[model.structure.strings][:, :, 0].sum(axis=1)
    assert all(np.ptp(far[list(group)]) < 1e-9 for group in groups)
    assert not all(np.ptp(far[list(group)]) < 1e-9 for group in upright)
    assert find_symmetry_groups(problem, ahead, 1.0) == upright

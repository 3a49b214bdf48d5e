"""The condensed Newton method: the optimum of IPOPT, for any transcription and structure."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ocp
import tenscasadi as tc
from ocp.problem.constraints import build_constraint
from ocp.search.methods import program_of
from ocp.solvers.condensed_newton import method
from ocp.solvers.condensed_newton.condensed_program import Expansion
from ocp.solvers.condensed_newton.interior_point import InteriorPoint
from tests.support import planning

EVERY = [ocp.Effort(), ocp.Smoothness(0.1), ocp.Prestress(3.0), ocp.Duration(3.0)]
LIMITS = ocp.ForceDensityLimits(1, 200)
RISE = [ocp.StringLengths({6: 0.95}), ocp.AtRest()]
ON_THE_WAY = ocp.Waypoint([ocp.StringLengths({7: 1.0})], share=0.37)
PUSH = tc.NodalForce(lambda t: [(0, 0, 0)] * 5 + [(ca.sin(3 * t), 0, t**3)])


def driven(structure: tc.Structure, **scene: object) -> tc.Model:
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **scene))


BALL = tc.shapes.six_bar_ball()
PRISM = tc.shapes.prism()
D_BAR = tc.shapes.d_bar(pinned=[0])


CASES = {
    "prism": (
        ocp.Problem(driven(PRISM), goals=RISE, bounds=[LIMITS], costs=[ocp.Effort()]),
        ocp.Variational(20),
    ),
    "ball": (
        ocp.Problem(
            driven(BALL),
            goals=[ocp.StringLengths({0: 1.05 * BALL.string_lengths[0]}), ocp.AtRest()],
            bounds=[LIMITS],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(20),
    ),
    "planar, pinned, no limits": (
        ocp.Problem(
            driven(D_BAR),
            goals=[ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths), ocp.AtRest()],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(10),
    ),
    "free duration, waypoint, all costs": (
        ocp.Problem(
            driven(PRISM), (0.5, 1.5), goals=[*RISE, ON_THE_WAY], bounds=[LIMITS], costs=EVERY
        ),
        ocp.Variational(15),
    ),
    "linear profile, groups": (
        ocp.Problem(
            driven(PRISM), (0.5, 1.5), goals=[*RISE, ON_THE_WAY], bounds=[LIMITS], costs=EVERY
        ),
        ocp.Variational(15, control=ocp.PiecewiseLinear(groups=[(0, 1, 2)])),
    ),
    "no goals": (
        ocp.Problem(driven(PRISM), 0.3, bounds=[LIMITS], costs=[ocp.Prestress(5.0)]),
        ocp.Variational(20),
    ),
    "few changes": (
        ocp.Problem(
            driven(PRISM), goals=RISE, bounds=[LIMITS], costs=[ocp.Effort(), ocp.Smoothness(0.01)]
        ),
        ocp.Variational(20, control=ocp.PiecewiseConstant(max_changes=5)),
    ),
    "pins of axes, loads that change": (
        ocp.Problem(
            driven(
                tc.shapes.prism(pinned={0: "xyz", 1: "z", 2: "z"}),
                gravity=tc.Gravity((0, 0, -3.0)),
                forces=PUSH,
            ),
            (0.5, 1.5),
            goals=[ocp.NodePositions({5: (None, None, 1.02)})],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(20),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_finds_what_ipopt_finds(case):
    problem, transcription = CASES[case]
    plan = ocp.solve(problem, transcription, ocp.CondensedNewton())
    known = ocp.solve(problem, transcription, ocp.Ipopt())
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(known.objective, rel=5e-3, abs=1e-2)
    # what is found is a motion of the same rows: IPOPT started there has no goal and no row of the
    # motion to mend
    again = ocp.solve(problem, transcription, ocp.Ipopt(), guess=plan)
    assert again.objective == pytest.approx(plan.objective, rel=5e-3, abs=1e-2)
    assert np.abs(again.trajectory.states - plan.trajectory.states).max() < 0.05


@pytest.mark.parametrize(
    ("duration", "limited"),
    [
        pytest.param(1.0, False, id="fixed"),
        pytest.param((0.4, 2.0), True, id="free duration, limited speed"),
        pytest.param(1.0, True, id="fixed, limited speed", marks=pytest.mark.slow),
        pytest.param((0.4, 2.0), False, id="free duration", marks=pytest.mark.slow),
    ],
)
def test_supports_may_be_moved(duration, limited):
    """As multiple shooting knows them, and exact integration."""
    slow = ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities[:, 5]), upper=0.01)
    problem = planning.shaken(duration, *[slow] * limited)
    plan = ocp.solve(problem, ocp.Variational(24, accuracy=1e-7), ocp.CondensedNewton())
    known = ocp.solve(problem, ocp.MultipleShooting(24))
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(known.objective, rel=2e-3)
    assert plan.time[-1] == pytest.approx(known.time[-1], rel=5e-3)
    end = planning.integrated(plan)
    assert problem.model.nodes(end)[5, 2] == pytest.approx(1.05, abs=1e-6)
    assert problem.model.velocities(end)[4, 2] == pytest.approx(0.0, abs=1e-6)
    if limited:
        assert np.linalg.norm(plan.trajectory.velocities[:, 5], axis=1).max() < 0.1 + 1e-4


def test_multipliers_are_what_costs_change_by():
    def plan_for(length, solver):
        goals = [ocp.StringLengths({6: length}), ocp.AtRest()]
        return ocp.solve(
            ocp.Problem(driven(PRISM), goals=goals, bounds=[LIMITS], costs=[ocp.Effort()]),
            ocp.Variational(15),
            solver,
        )

    found = plan_for(0.95, ocp.CondensedNewton())
    e = 1e-3
    longer, shorter = (plan_for(0.95 + sign * e, ocp.Ipopt()).objective for sign in (1, -1))
    assert found.duals is not None
    assert -(longer - shorter) / (2 * e) == pytest.approx(
        float(found.duals["StringLengths: string 6"].sum()), rel=0.05
    )
    assert found.duals["force density of string 0"].shape == (15,)


def reaching(*bounds, duration=1.0, goals=()):
    """An arm of one bar, hinged on the ground, leans over; the straight way leads through what the bounds forbid."""
    around = [(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 1.0, 0.0)]
    arm = tc.Structure(
        [(0, 0, 0), (0, 0, 1), *around],
        [(0, 1)],
        [(1, k) for k in range(2, 6)],
        pinned=[0, 2, 3, 4, 5],
    )
    asked = [*goals, ocp.NodePositions({1: (0.6, 0.2, None)}), ocp.AtRest()]
    return ocp.Problem(
        driven(arm),
        duration,
        goals=asked,
        bounds=[ocp.ForceDensityLimits(1.0, 300.0), *bounds],
        costs=[ocp.Effort()],
    )


PASSING = ocp.Waypoint([ocp.NodePositions({1: (0.0, 0.3, None)})], share=0.4)
RISING = {"goals": RISE, "costs": [ocp.Effort()]}
BOUNDED = {
    "obstacle": reaching(ocp.Obstacle((0.3, 0.12, 0.95), 0.12, nodes=[1])),
    "obstacle, waypoint, free duration": reaching(
        ocp.Obstacle((0.3, 0.34, 0.92), 0.14, nodes=[1]), duration=(0.8, 1.5), goals=[PASSING]
    ),
    "speed": reaching(ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities), upper=0.6)),
    "tension and rates": reaching(ocp.TensionLimits(upper=4.6), ocp.ForceDensityRateLimits(5.0)),
    "lengths, and bars apart": ocp.Problem(
        driven(PRISM),
        bounds=[
            LIMITS,
            ocp.Constraint("length", lambda now: now.lengths, upper=[0.89] * 6 + [1.2] * 3),
            ocp.BarClearance(0.02),
        ],
        **RISING,
    ),
    "limits that are equal, and others": ocp.Problem(
        driven(PRISM),
        bounds=[
            LIMITS,
            ocp.Constraint(ocp.AtEnd("x", lambda end: end.nodes[0, 4]), lower=-0.2, upper=-0.2),
            ocp.Constraint("length", lambda now: now.lengths, upper=[0.89] * 6 + [1.2] * 3),
        ],
        **RISING,
    ),
    "limits that are equal, at the end": ocp.Problem(
        driven(PRISM),
        bounds=[
            LIMITS,
            ocp.Constraint(ocp.AtEnd("x", lambda end: end.nodes[0, 4]), lower=-0.2, upper=-0.2),
        ],
        **RISING,
    ),
}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, marks=[pytest.mark.slow] * (case == "limits that are equal, and others"))
        for case in BOUNDED
    ],
)
def test_limits_along_the_way_are_kept_at_what_ipopt_pays(case):
    problem = BOUNDED[case]
    plan = ocp.solve(problem, ocp.Variational(24), ocp.CondensedNewton())
    known = ocp.solve(problem, ocp.Variational(24), ocp.Ipopt(), guess=plan)
    free = ocp.solve(
        replace(problem, bounds=problem.bounds[:1]), ocp.Variational(24), ocp.CondensedNewton()
    )
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(known.objective, rel=5e-3)
    assert free.objective < 0.999 * plan.objective  # the limits matter
    for bound in problem.bounds[1:]:
        assert beyond(plan, build_constraint(bound, problem.model)) < 1e-6
    # so do their prices
    own, other = ({one.name: one.dual for one in found.report().active} for found in (plan, known))
    for name in {name for name, price in other.items() if price > 0.05 * max(other.values())}:
        assert own[name] == pytest.approx(other[name], rel=0.1)


def test_limits_that_leave_no_way_are_named():
    problem = reaching(ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities), upper=0.2))
    plan = ocp.solve(problem, ocp.Variational(24), ocp.CondensedNewton())
    assert not plan.success
    assert "largest violation: speed, " in plan.message


@pytest.mark.slow
def test_limits_that_bars_share_are_kept_by_fine_steps_of_scipy():
    """A tower of four prisms that rises: its bars, which come within 3 cm, stay 8 cm apart, and no node is too fast."""
    limits = [
        ocp.BarClearance(0.08),
        ocp.Constraint("speed", lambda now: ca.sum1(now.velocities**2).T, upper=2.0),
    ]
    goals = [ocp.StringLengths(tower_of(4, 0.88).string_lengths), ocp.AtRest()]
    problem = ocp.Problem(
        driven(tower_of(4, 0.8)), goals=goals, bounds=[LIMITS, *limits], costs=[ocp.Effort()]
    )
    plan = ocp.solve(problem, ocp.Variational(30, accuracy=1e-6), ocp.CondensedNewton())
    assert plan.success, plan.message
    state, functions = (
        plan.trajectory.states[0],
        [build_constraint(limit, problem.model) for limit in limits],
    )
    for k, (begin, end) in enumerate(pairwise(plan.time)):
        state = integrated(problem.model, state, begin, end, plan.control[k], plan.control[k])
        for limited in functions:
            value = np.ravel(limited.function(state, plan.control[k], end).full())
            assert np.maximum(limited.lower - value, value - limited.upper).max() < 1e-5


def beyond(plan, limited):
    """By how much a plan oversteps a limit at the ends of its intervals."""
    states, control, time = plan.trajectory.states, plan.control, plan.time
    if len(limited.symbols) == 3:
        first = -1 if limited.ends == ("last",) else 0
        values = [
            limited.function(states[k + 1], control[k], time[k + 1]) for k in range(len(control))
        ][first:]
    else:
        values = [
            limited.function(
                *states[k : k + 1], control[k], *states[k + 1 : k + 2], control[k + 1], time[1]
            )
            for k in range(len(control) - 1)
        ]
    found = np.array([np.ravel(value.full()) for value in values])
    return np.maximum(limited.lower - found, found - limited.upper).max()


def test_goals_that_are_met_at_the_iteration_limit_are_a_plan(monkeypatch):
    monkeypatch.setattr(InteriorPoint, "check_end", lambda search: "")
    plan = ocp.solve(*CASES["ball"], ocp.CondensedNewton(max_iterations=30))
    assert plan.success, plan.message
    assert plan.status == "unsettled"
    assert "the cost is not settled" in plan.message


HUNG = tc.Structure(
    np.vstack([(0, 0, 0), np.eye(3), -np.eye(3)]),
    bars=[],
    strings=[(0, k) for k in range(1, 7)],
    node_mass=0.5,
    pinned=range(1, 7),
)
ANY = {
    "shooting": (ocp.MultipleShooting(20), {}),
    "midpoint": (ocp.ImplicitMidpoint(20), {}),
    "collocation": (ocp.DirectCollocation(10), {}),
    "no bars": (
        ocp.Variational(20),
        {"model": driven(HUNG), "goals": [ocp.NodePositions({0: (0.2, -0.1, 0.2)}), ocp.AtRest()]},
    ),
    "full coordinates": (
        ocp.MultipleShooting(20),
        {"model": tc.Model(driven(PRISM).scene, coordinates="full")},
    ),
    "free start": (ocp.Variational(20), {"start": ocp.FreeStart()}),
    "tracking": (
        ocp.Variational(20),
        {"costs": [ocp.Effort(), ocp.Integral("v", lambda now: ca.sumsqr(now.velocities))]},
    ),
}


@pytest.mark.parametrize("case", ANY)
def test_any_assembled_program_is_solved(case):
    transcription, change = ANY[case]
    given = {"model": driven(PRISM), "goals": RISE, "bounds": [LIMITS], "costs": [ocp.Effort()]}
    program = program_of(ocp.Problem(**{**given, **change}), transcription)
    found, known = (one.solve(program) for one in (ocp.CondensedNewton(), ocp.Ipopt()))
    assert found.success, found.status
    x, f, g = (program.problem[name] for name in "xfg")
    values = ca.Function("values", [x], [f, g])
    costs, (rows, limits) = [float(values(one.w)[0]) for one in (found, known)], found.multipliers
    assert costs[0] == pytest.approx(costs[1], rel=5e-3)
    reached = np.ravel(values(found.w)[1].full())
    assert np.maximum(program.lower - reached, reached - program.upper).max() < 1e-8
    exact = program.derivatives()
    slope, J = exact["nlp_grad_f"](found.w, [])[1], exact["nlp_jac_g"](found.w, [])[1]
    assert np.abs(np.ravel((slope + ca.mtimes(J.T, rows) + limits).full())).max() < 1e-2


def test_growing_errors_are_recognized_before_the_first_step():
    problem = planning.leaning_arm(3, 0.5, weight=True, duration=3.0)
    program = program_of(problem, ocp.Variational(50))
    found = ocp.CondensedNewton().solve(program)
    assert (found.success, found.status, found.iterations) == (False, method.UNSTABLE, 0)
    plan = ocp.solve(problem, ocp.Variational(50), ocp.CondensedNewton())
    assert not plan.success
    assert "give solver=ocp.Ipopt()" in plan.message


def test_limits_of_iterations_and_time_are_kept():
    problem, transcription = CASES["ball"]
    few = ocp.solve(problem, transcription, ocp.CondensedNewton(max_iterations=2))
    assert few.iterations == 2
    assert "stopped at the iteration limit: increase max_iterations" in few.message
    late = ocp.solve(problem, transcription, ocp.CondensedNewton(), time_limit=1e-3)
    assert "increase time_limit" in late.message


def test_corrections_make_the_motion_that_of_fine_steps():
    problem, _ = CASES["ball"]
    plain, fine = (
        ocp.solve(problem, ocp.Variational(15, accuracy=accuracy), ocp.CondensedNewton())
        for accuracy in (None, 1e-6)
    )
    assert fine.success, fine.message
    assert plain.replay_error > 1e-5
    assert fine.replay_error < 2e-6
    assert fine.objective == pytest.approx(
        ocp.solve(problem, ocp.Variational(15, accuracy=1e-6)).objective, rel=5e-3
    )


def test_corrections_share_a_linearization(monkeypatch):
    """Shifted goals and defects are met, as CasADi evaluates them, with derivatives of one point."""
    built = program_of(CASES["ball"][0], ocp.Variational(15))
    solution = ocp.CondensedNewton().solve(built)
    made, rng = [], np.random.default_rng(0)
    begin = Expansion.__init__
    monkeypatch.setattr(Expansion, "__init__", lambda *given: (made.append(1), begin(*given))[1])
    constraints = ca.Function("constraints", [built.problem["x"]], [built.problem["g"]])
    counts, moved = [], built
    for _ in range(3):
        shift = 1e-6 * rng.uniform(-1, 1, len(built.lower))
        shift[np.concatenate([np.arange(len(shift))[rows] for rows in built.rows("dependent")])] = 0
        moved = moved.shift_rows(shift, solution.w, solution.multipliers)
        found = solution.correct(moved, None)
        counts.append(len(made))
        values = constraints(found.w).full().ravel()
        equal = (moved.lower == moved.upper) & (shift != 0)
        assert found.success
        assert values[equal] == pytest.approx(moved.lower[equal], abs=1e-8)
    assert counts == [1, 1, 1]


@pytest.mark.parametrize(
    "case",
    [
        "free duration, waypoint, all costs",
        "linear profile, groups",
        "pins of axes, loads that change",
        "few changes",
    ],
)
def test_few_intervals_are_corrected_to_the_motion_of_fine_steps(case):
    """Fine steps of SciPy under the planned force densities, which know nothing of the program."""
    problem, given = CASES[case]
    plan = ocp.solve(
        problem,
        replace(given, intervals=5 if given.control.max_changes is None else 10, accuracy=1e-8),
        ocp.CondensedNewton(),
    )
    assert plan.success, plan.message
    state = plan.trajectory.states[0]
    for k, (begin, end) in enumerate(pairwise(plan.time)):
        after = plan.control[min(k + plan.linear, len(plan.control) - 1)]
        state = integrated(problem.model, state, begin, end, plan.control[k], after)
    assert np.abs(state - plan.trajectory.states[-1]).max() < 1e-6


def integrated(model, state, begin, end, u, v):
    """The state at the end of an interval in which the force densities run from u to v."""
    found = solve_ivp(
        lambda t, x: np.asarray(model.ode(x, u + (t - begin) / (end - begin) * (v - u)).full()).ravel(),
        (begin, end), state, method="DOP853", rtol=1e-11, atol=1e-12,
    )  # fmt: skip
    return found.y[:, -1]


@pytest.mark.slow
def test_motions_along_which_errors_grow_are_corrected():
    """Two prisms on each other rise under their weight: fine steps under the first force densities end metres away."""
    nodes = dict.fromkeys((6, 7, 8), (None, None, 1.7))
    model = driven(stacked(0.8).replace(pinned=[0, 1, 2]), gravity=tc.Gravity())
    limits = ocp.ForceDensityLimits(1.0, 500.0)
    problem = ocp.Problem(
        model, goals=[ocp.NodePositions(nodes), ocp.AtRest()], bounds=[limits], costs=[ocp.Effort()]
    )
    plain, fine = (
        ocp.solve(problem, ocp.Variational(60, accuracy=accuracy), ocp.CondensedNewton())
        for accuracy in (None, 1e-6)
    )
    assert plain.open_loop_error > 0.1
    assert fine.replay_error < 1e-4
    assert fine.error_growth > 1e3
    replay = fine.replay(step=fine.time[-1] / 2400)
    assert np.abs(replay.states[-1] - fine.trajectory.states[-1])[: model.nq].max() < 1e-5


def test_a_symmetric_guess_does_not_end_in_a_saddle():
    """Two prisms on each other: the motion that keeps their symmetry costs 5 % more than the best."""
    low, high = (stacked(height) for height in (0.8, 0.88))
    goals = [ocp.StringLengths(high.string_lengths), ocp.AtRest()]
    problem = ocp.Problem(driven(low), goals=goals, bounds=[LIMITS], costs=[ocp.Effort()])
    plan = ocp.solve(problem, ocp.Variational(30), ocp.CondensedNewton())
    assert plan.success, plan.message
    assert plan.objective < 1.01 * ocp.solve(problem, ocp.Variational(30), ocp.Ipopt()).objective


def stacked(height):
    """Two three-bar prisms with bars of 1.4 m that share a ring of nodes, one turned the other way."""
    return tower_of(2, height)


def tower_of(count, height, **options):
    """The same of any number of prisms."""
    radius, levels = np.sqrt(1.4**2 - height**2) / (2 * np.sin(5 * np.pi / 12)), range(count + 1)
    angles = (
        np.array([0.0, np.pi / 6] * count + [0.0])[: count + 1, None] + 2 * np.pi * np.arange(3) / 3
    )
    nodes = [
        (radius * np.cos(a), radius * np.sin(a), j * height) for j in levels for a in angles[j]
    ]
    rings = [(3 * j + i, 3 * j + (i + 1) % 3) for j in levels for i in range(3)]
    upright = [(3 * j + i, 3 * j + 3 + i) for j in range(count) for i in range(3)]
    bars = [
        (3 * j + i, 3 * j + 3 + (i + (1, -1)[j % 2]) % 3) for j in range(count) for i in range(3)
    ]
    return tc.Structure(nodes, bars, rings + upright, **options)


def scattered(bars):
    """Bars at random, each end held by strings to its nearest neighbours; an end of the first is pinned."""
    drawn = np.random.default_rng(0)
    middles, ways = drawn.uniform(-1.5, 1.5, (bars, 3)), drawn.normal(size=(bars, 3))
    ways /= 2 * np.linalg.norm(ways, axis=1)[:, None]
    nodes = np.vstack([middles - ways, middles + ways])
    apart = np.linalg.norm(nodes[:, None] - nodes, axis=2)
    pairs = {
        (min(a, b), max(a, b))
        for a in range(2 * bars)
        for b in np.argsort(apart[a])[1:5].tolist()
        if abs(a - b) != bars
    }
    return tc.Structure(nodes, [(k, k + bars) for k in range(bars)], sorted(pairs), pinned=[0])


def test_steps_are_taken_whose_corrections_lead_out_of_the_funnel():
    structure = scattered(6)
    goals = [
        ocp.NodePositions({5: (None, None, structure.nodes[5, 2] + 0.3)}),
        ocp.NodeVelocities({5: (0.3, -0.2, 0.1)}),
    ]
    limits, costs = [ocp.ForceDensityLimits(0.05, 400.0)], [ocp.Effort(), ocp.Duration(100.0)]
    problem = ocp.Problem(driven(structure), (0.08, 12.0), goals=goals, bounds=limits, costs=costs)
    plan = ocp.solve(problem, ocp.Variational(20), ocp.CondensedNewton())
    assert plan.success, plan.message
    end = planning.integrated(plan)
    missed = np.append(
        plan.model.nodes(end)[5, 2] - structure.nodes[5, 2] - 0.3,
        plan.model.velocities(end)[5] - [0.3, -0.2, 0.1],
    )
    assert abs(missed).max() < 1.01 * max(plan.replay_error, plan.replay_speed_error) + 1e-6

"""Limits and costs along a plan: each holds, binds where it should, and says what is wrong with it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.problem.bounds import PathBound
from ocp.problem.geometric_bounds import segment_distance
from ocp.problem.instant import Instant, symbolic
from ocp.problem.path_constraints import path_constraints

BAR = 1.4
PRESTRESS = ocp.ForceDensityLimits(1.0, 100.0)


def prism(height, **options):
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


MODEL = driven(prism(1.0, bar_radius=0.01, stiffness=1000.0))
GOALS = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())


def raised(*bounds, costs=(ocp.Effort(),), duration=1.0, intervals=10, model=MODEL):
    return ocp.solve(ocp.Problem(model, duration, goals=GOALS, bounds=[PRESTRESS, *bounds], costs=costs), ocp.MultipleShooting(intervals))


@pytest.fixture(scope="module")
def free():
    return raised()


def along(plan, read, model=MODEL):
    """`read` of an instant at the start of every interval, (K, entries)."""
    now = symbolic(model)
    function = ca.Function("read", [now.state, now.control, now.time], [read(now)])
    states = plan.trajectory.states[:-1]
    return np.array([function(x, u, t).full().ravel() for x, u, t in zip(states, plan.force_density, plan.time[:-1], strict=True)])


def binds(plan, free, read, limit, upper=True):
    """The limit is broken without it, and met with it."""
    sign = 1.0 if upper else -1.0
    before, after = ((sign * along(one, read)).max() for one in (free, plan))
    assert plan.success, plan.message
    assert before > sign * limit
    assert after <= sign * limit + 1e-6 * abs(limit)
    assert plan.objective > free.objective


def test_bar_force_is_what_holds_the_bars(free):
    force = along(free, lambda now: now.bar_force)
    x, u = free.trajectory.states[3], free.force_density[3]
    assert force[3] == pytest.approx(MODEL.multipliers(x, u).bar_force_density * BAR, rel=1e-6)
    assert free.bar_forces() == pytest.approx(force, rel=1e-9)
    assert np.all(force > 0)  # strings in tension hold bars in compression


def test_bars_carry_no_more_than_allowed(free):
    most = 0.98 * along(free, lambda now: now.bar_force).max()
    binds(raised(ocp.BarForceLimits(compression=most)), free, lambda now: now.bar_force, most)


def test_bars_do_not_buckle(free):
    force = along(free, lambda now: now.bar_force).max()
    modulus = 0.98 * force * BAR**2 / (np.pi**3 * 0.01**4 / 4)
    bound = ocp.Buckling(2 * modulus, safety=2.0)
    assert bound.loads(MODEL.structure) == pytest.approx(0.98 * force)
    binds(raised(bound), free, lambda now: now.bar_force, 0.98 * force)


def test_rest_lengths_have_limits(free):
    most = 0.9995 * free.rest_lengths().max()
    plan = raised(ocp.RestLengthLimits(upper=most))
    assert plan.success
    assert plan.rest_lengths().max() <= most * (1 + 1e-6)
    k = 0.98 * free.force_density.max()
    soft = raised(ocp.RestLengthLimits(stiffness=k))  # without the limit its strings would need rest lengths below 0
    assert soft.success
    assert soft.force_density.max() <= k * (1 + 1e-6)


def test_motors_have_a_speed(free):
    speed = 0.98 * np.abs(np.diff(free.rest_lengths(), axis=0)).max() * 10
    plan = raised(ocp.RestLengthRateLimits(speed))
    assert plan.success
    assert np.abs(np.diff(plan.rest_lengths(), axis=0)).max() * 10 == pytest.approx(speed, rel=5e-3)


def rates(plan):
    """Of the rest lengths, from each time that has force densities to the next, m/s."""
    rest = plan.rest_lengths()
    return np.abs(np.diff(rest, axis=0)).max(axis=1) / np.diff(plan.time)[: len(rest) - 1]


def test_motors_have_a_speed_up_to_the_end_of_linear_profiles():
    linear = ocp.MultipleShooting(12, control=ocp.PiecewiseLinear())
    asked = ocp.Problem(MODEL, 1.0, goals=GOALS, bounds=[PRESTRESS], costs=[ocp.Effort()])
    unlimited = ocp.solve(asked, linear)
    speed = 0.9 * rates(unlimited)[-1]
    plan = ocp.solve(replace(asked, bounds=[PRESTRESS, ocp.RestLengthRateLimits(speed)]), linear)
    assert plan.success
    assert len(rates(plan)) == 12
    assert rates(plan).max() <= speed * (1 + 1e-5)
    assert not plan.report().violated
    fast = replace(asked, bounds=[PRESTRESS, ocp.RestLengthRateLimits(2 * rates(unlimited).max())])
    assert ocp.solve(fast, linear, ocp.Fatrop()).objective == pytest.approx(unlimited.objective, rel=1e-5)


def test_one_interval_of_a_linear_profile_has_a_rate():
    limited = ocp.Problem(MODEL, 0.1, bounds=[PRESTRESS, ocp.RestLengthRateLimits(0.1)], costs=[ocp.Prestress(np.arange(9.0, 18.0)), ocp.Duration()])
    plan = ocp.solve(limited, ocp.MultipleShooting(1, control=ocp.PiecewiseLinear()))
    assert rates(plan).max() <= 0.1 * (1 + 1e-5)
    assert not any("rate" in name for name in ocp.solve(limited, ocp.MultipleShooting(1)).duals.names)


def test_a_report_calls_rates_beyond_their_limit_violated(free):
    limit = 0.5 * rates(free).max()
    report = replace(free, problem=replace(free.problem, bounds=[PRESTRESS, ocp.RestLengthRateLimits(limit)])).report()
    worst = max(report.violated, key=lambda one: abs(one.worst))
    assert worst.name.startswith("rest length rate of string")
    assert abs(worst.worst) == pytest.approx(2 * limit, rel=1e-9)
    assert worst.time in free.time[1:-1]
    assert not {(one.name, one.side) for one in report.violated} & {(one.name, one.side) for one in report.active}


def test_bars_keep_clear_of_each_other(free):
    def gap(plan):
        return min(true_distance(*state[[0, 4]], *state[[1, 5]]) for state in plan.trajectory.nodes)

    least = true_distance(*MODEL.structure.nodes[[0, 4]], *MODEL.structure.nodes[[1, 5]])
    plan = raised(ocp.BarClearance(0.5 * least))
    assert plan.success
    assert gap(plan) > 0.5 * least
    with pytest.raises(ValueError, match=r"Problem.start has clearance of bars \d and \d"):
        raised(ocp.BarClearance(1.1 * least))


def true_distance(a, b, c, d):
    """By trying points along both segments."""
    s = np.linspace(0, 1, 201)
    return np.linalg.norm((a + s[:, None] * (b - a))[:, None] - (c + s[:, None] * (d - c))[None], axis=2).min()


@pytest.mark.parametrize("seed", range(20))
def test_the_distance_of_segments(seed):
    a, b, c, d = np.random.default_rng(seed).normal(size=(4, 3))
    symbols = [ca.SX.sym("p", 3) for _ in range(4)]
    value = float(ca.Function("d", symbols, [segment_distance(*symbols)])(a, b, c, d))
    exact = true_distance(a, b, c, d)
    assert exact * 0.999 - 1e-3 < value < exact + 0.03


def test_parallel_bars_have_a_distance():
    symbols = [ca.SX.sym("p", 3) for _ in range(4)]
    slope = ca.Function("d", symbols, [segment_distance(*symbols), ca.jacobian(segment_distance(*symbols), symbols[0])])
    value, gradient = slope([0, 0, 0], [1, 0, 0], [0, 0.3, 0], [1, 0.3, 0])
    assert float(value) == pytest.approx(0.3, rel=1e-3)
    assert np.all(np.isfinite(gradient.full()))


def arm():
    """A bar on a hinge between two strings, in the plane."""
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    return tc.Structure(nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5])


def swung(*bounds):
    start = arm().nodes.copy()
    start[1] = (-0.6, 0.1, np.sqrt(1 - 0.37))
    goals = [ocp.NodePositions({1: (0.6, 0.1, None)}), ocp.AtRest()]
    problem = ocp.Problem(driven(arm()), 1.0, start, goals=goals, bounds=bounds, costs=[ocp.Effort(), ocp.Smoothness(1e-3)])
    return ocp.solve(problem, ocp.MultipleShooting(16))


@pytest.fixture(scope="module")
def over():
    return swung()


def test_an_arm_goes_round_an_obstacle(over):
    centre = np.array([0.0, -0.05, 0.9])
    round_it = swung(ocp.Obstacle(centre, 0.2))
    assert over.success
    assert round_it.success, round_it.message
    least = [min(true_distance(*state[[0, 1]], centre, centre + 1e-9) for state in plan.trajectory.nodes) for plan in (over, round_it)]
    assert least[0] < 0.19
    assert least[1] > 0.199


def test_bounds_of_one_kind_are_told_apart():
    tight, close = ocp.Obstacle((0.0, -0.05, 0.9), 0.25), ocp.Obstacle((0.0, 0.55, 0.83), 0.38)
    plan = swung(tight, close)
    assert plan.success, plan.message
    found = {one.name: one for one in plan.report().active if one.name.startswith("obstacle")}
    names = [f"obstacle clear of bar 0 (bounds[{k}])" for k in (0, 1)]
    assert [found[name].limit for name in names] == [0.25, 0.38]
    for name in names:
        assert found[name].price == pytest.approx(-plan.duals[name].sum(), rel=1e-3)
        assert found[name].price > 1.0
    with pytest.raises(KeyError, match=r"bounds\[0\].* or .*bounds\[1\]"):
        plan.duals["obstacle clear of bar 0"]


def test_only_what_several_bounds_limit_is_numbered():
    boxes = [ocp.InsideBox((-9.0, None, None), nodes=[0, 1]), ocp.InsideBox(upper=(9.0, 9.0, None), nodes=[1])]
    asked = ocp.Problem(MODEL, bounds=[*boxes, ocp.TensionLimits(upper=90.0)])
    found = [one.names for one in path_constraints(asked, PathBound)]
    assert found[:2] == [("x of node 0", "x of node 1 (bounds[0])"), ("x of node 1 (bounds[1])", "y of node 1")]
    assert found[2][0] == "tension of string 0"


def test_an_arm_stays_in_its_box(over):
    low = swung(ocp.InsideBox(upper=(None, None, 0.95), nodes=[1]))
    assert low.success, low.message
    assert over.trajectory.nodes[:, 1, 2].max() > 0.98
    assert low.trajectory.nodes[:, 1, 2].max() == pytest.approx(0.95, abs=1e-6)


def test_the_ground_is_a_box():
    assert ocp.AboveGround(0.1, nodes=[2]).corners()[0] == pytest.approx([-np.inf, -np.inf, 0.1])


# --- costs ---


def test_a_weight_on_time_shortens_the_plan(free):
    quick = raised(ocp.ForceDensityLimits(5.0, 15.0), costs=[ocp.Duration(100.0), ocp.Effort(1e-4)], duration=(0.5, 1.5))
    assert quick.success
    assert quick.time[-1] < 0.7


def test_prestress_keeps_to_its_level():
    plan = raised(costs=[ocp.Prestress(12.0)])
    assert plan.success
    assert abs(plan.force_density.mean() - 12.0) < 1.0
    assert plan.objective == pytest.approx(0.1 * np.sum((plan.force_density - 12.0) ** 2), rel=1e-6)


def test_work_is_what_the_strings_do(free):
    """Over a motion from rest to rest the strings' power sums to nothing, and what they do is what they take."""
    plan = raised(costs=[ocp.Work(smoothing=0.5), ocp.Effort(1e-3)])
    assert plan.success, plan.message

    def done(one):
        power = -along(one, lambda now: now.control * now.lengths * now.rates)
        return np.maximum(power, 0.0).sum() * 0.1

    assert done(plan) < done(free)


def test_tracking_pulls_nodes_to_their_places(free):
    far = ocp.Tracking({0: (0.3, None, None), 3: (lambda t: (0.1 * t, None, None))}, 200.0)
    plan = raised(costs=[far, ocp.Effort()], intervals=20)
    assert plan.success, plan.message
    assert abs(plan.trajectory.nodes[:, 0, 0] - 0.3).mean() < abs(free.trajectory.nodes[:, 0, 0] - 0.3).mean()


def test_running_costs_are_integrals():
    plan = raised(costs=[ocp.Effort(), ocp.Integral("clock", lambda now: now.time**2, 3.0), ocp.AtEnd("top", lambda end: end.nodes[2, 3], 2.0)])
    assert plan.success
    parts = 0.1 * np.sum(plan.force_density**2), 3.0 / 3, 2.0 * plan.trajectory.nodes[-1, 3, 2]
    assert plan.objective == pytest.approx(sum(parts), rel=1e-6)


def test_own_constraints_hold(free):
    def rise(now):
        return now.velocities[2, 3:].T

    fastest = 0.95 * along(free, rise).max()
    binds(raised(ocp.Constraint("top speed", rise, upper=fastest)), free, rise, fastest)
    hold = ocp.Constraint("early pull", lambda now: now.control[0] - 6.0 * (now.time < 0.15), lower=0.0)
    plan = raised(hold)
    assert plan.success
    assert plan.force_density[:2, 0].min() > 6.0 - 1e-5 > free.force_density[:2, 0].min()


def test_instants_are_numbers_too():
    now = Instant(MODEL, ca.MX(MODEL.initial_state), ca.MX(np.ones(9)), 0)
    assert ca.evalf(now.lengths).full().ravel() == pytest.approx(MODEL.structure.string_lengths)
    assert np.abs(ca.evalf(now.rates).full()).max() == 0.0


def test_segments_add_up_to_a_rest_length():
    model = driven(prism(1.0, string_mass=0.1), segments=2)
    now = Instant(model, ca.MX(model.initial_state), ca.MX(np.full(9, 5.0)), 0)
    rest = ca.evalf(now.rest_lengths(np.full(9, 500.0))).full().ravel()
    assert rest == pytest.approx(model.scene.structure.string_lengths * (1 - 5.0 / 500.0))


# --- what is refused ---

BAD = {
    "no limit": (lambda: ocp.BarForceLimits(), ValueError, "BarForceLimits.compression and .tension"),
    "negative compression": (lambda: ocp.BarForceLimits(-1.0), ValueError, "BarForceLimits.compression"),
    "wrong number of bars": (lambda: raised(ocp.BarForceLimits([1.0, 2.0])), ValueError, "BarForceLimits.compression"),
    "no radius": (lambda: raised(ocp.Buckling(1e9), model=driven(prism(1.0))), ValueError, "Buckling needs the radius of bar 0"),
    "limit in words": (lambda: ocp.ForceDensityLimits(0.0, "200"), TypeError, "ForceDensityLimits.upper is not a real number"),
    "limits in words": (lambda: ocp.ForceDensityLimits(0.0, ["200"] * 9), TypeError, "ForceDensityLimits.upper is not an array of real numbers"),
    "limit of truth": (lambda: ocp.TensionLimits(upper=True), TypeError, "TensionLimits.upper is not a real number"),
    "speed in words": (lambda: ocp.RestLengthRateLimits("12"), TypeError, "RestLengthRateLimits.speed is not a real number"),
    "compression in words": (lambda: ocp.BarForceLimits("5"), TypeError, "BarForceLimits.compression is not a real number"),
    "groups without common ground": (
        lambda: ocp.solve(
            ocp.Problem(MODEL, bounds=[ocp.ForceDensityLimits([5, 20] + 7 * [5], [10, 50] + 7 * [100])]),
            ocp.MultipleShooting(8, control=ocp.PiecewiseLinear(((2, 0, 1),))),
        ),
        ValueError,
        r"PiecewiseLinear.groups: strings 0, 1, 2 share a force density.*string 1 at 20 N/m or more.*string 0 at 10 N/m or less",
    ),
    "modulus zero": (lambda: ocp.Buckling(0.0), ValueError, "Buckling.modulus"),
    "safety zero": (lambda: ocp.Buckling(1.0, 0.0), ValueError, "Buckling.safety"),
    "speed zero": (lambda: ocp.RestLengthRateLimits(0.0), ValueError, "RestLengthRateLimits.speed"),
    "no stiffness": (
        lambda: raised(ocp.RestLengthLimits(), model=driven(prism(1.0, stiffness=0.0))),
        ValueError,
        "RestLengthLimits.stiffness of string 0",
    ),
    "box open": (lambda: ocp.InsideBox(), ValueError, "InsideBox.lower and .upper are open"),
    "box inside out": (lambda: ocp.InsideBox((1, None, None), (0, None, None)), ValueError, "InsideBox.lower is 1"),
    "box of two": (lambda: ocp.InsideBox((1, None)), ValueError, "InsideBox.lower"),
    "box of a number": (lambda: ocp.InsideBox(1.0), TypeError, "InsideBox.lower"),
    "box without a node": (lambda: raised(ocp.AboveGround(-1.0, nodes=[7])), ValueError, "InsideBox.nodes is 7"),
    "start below ground": (lambda: raised(ocp.AboveGround(0.5)), ValueError, "Problem.start has z of node 0 at 0"),
    "pin below ground": (lambda: raised(ocp.AboveGround(0.5), model=driven(prism(1.0, pinned=[0]))), ValueError, "leaves out node 0"),
    "clearance negative": (lambda: ocp.BarClearance(-0.1), ValueError, "BarClearance.distance"),
    "clearance of no bar": (lambda: raised(ocp.BarClearance(0.1, [(0, 3)])), ValueError, "BarClearance.pairs names bar 3"),
    "clearance of one bar": (lambda: ocp.BarClearance(0.1, (0, 1)), TypeError, r"BarClearance.pairs\[0\] is 0: give a list"),
    "clearance of three bars": (lambda: ocp.BarClearance(0.1, [(0, 1, 2)]), ValueError, r"BarClearance.pairs\[0\] is \(0, 1, 2\): give two bars"),
    "box of one node": (lambda: ocp.AboveGround(-1.0, nodes=3), TypeError, "InsideBox.nodes is 3: give a list"),
    "obstacle of one bar": (lambda: ocp.Obstacle((9, 0, 0), 1.0, bars=3), TypeError, "Obstacle.bars is 3: give a list"),
    "clearance at a joint": (
        lambda: ocp.Problem(driven(tc.shapes.d_bar()), bounds=[ocp.BarClearance(0.1, [(0, 1)])]),
        ValueError,
        "bars 0 and 1 share a node",
    ),
    "obstacle of no size": (lambda: ocp.Obstacle((0, 0, 0), 0.0), ValueError, "Obstacle.radius"),
    "obstacle of no bar": (lambda: raised(ocp.Obstacle((9, 0, 0), 1.0, bars=[5])), ValueError, "Obstacle.bars is 5"),
    "start in obstacle": (lambda: raised(ocp.Obstacle(prism(1.0).nodes[0], 0.1)), ValueError, "Problem.start has obstacle clear of bar"),
    "constraint without name": (lambda: ocp.Constraint("", lambda now: now.time, 0.0), TypeError, "Constraint.name"),
    "constraint without limit": (lambda: ocp.Constraint("a", lambda now: now.time), ValueError, "Constraint 'a': lower and upper"),
    "constraint without expression": (lambda: ocp.Constraint("a", 1.0, 0.0), TypeError, "Constraint 'a': expression"),
    "constraint of a number": (lambda: raised(ocp.Constraint("a", lambda now: 1.0, 0.0)), TypeError, "'a' gives float"),
    "constraint of wrong size": (
        lambda: raised(ocp.Constraint("a", lambda now: now.nodes[2, :], [0.0, 1.0])),
        ValueError,
        "'a': lower has 2 entries",
    ),
    "constraints of one name": (
        lambda: raised(*(ocp.Constraint("a", lambda now, n=n: now.nodes[2, n], -9.0) for n in (0, 1))),
        ValueError,
        "Problem.bounds has two constraints named 'a'",
    ),
    "constraint crossed": (lambda: raised(ocp.Constraint("a", lambda now: now.time, 1.0, 0.0)), ValueError, "'a': lower is above upper"),
    "integral of a column": (lambda: raised(costs=[ocp.Integral("a", lambda now: now.nodes)]), ValueError, "'a' gives 18 entries"),
    "integral weight": (lambda: ocp.Integral("a", lambda now: now.time, 0.0), ValueError, "Integral 'a': weight"),
    "tracking nothing": (lambda: ocp.Tracking({}), ValueError, "Tracking.positions"),
    "tracking two": (lambda: ocp.Tracking({0: (1.0, 2.0)}), ValueError, r"Tracking.positions\[0\]"),
    "tracking a function of two": (lambda: raised(costs=[ocp.Tracking({0: lambda t: (t, t)})]), ValueError, r"Tracking.positions\[0\]\(time\) is"),
    "tracking a function of one": (lambda: raised(costs=[ocp.Tracking({0: lambda t: t})]), ValueError, r"Tracking.positions\[0\]\(time\) is"),
    "tracking a function of a number": (
        lambda: raised(costs=[ocp.Tracking({0: lambda t: 1.0})]),
        TypeError,
        r"Tracking.positions\[0\]\(time\) is 1.0",
    ),
    "tracking no node": (lambda: raised(costs=[ocp.Tracking({9: (0, 0, 0)})]), ValueError, "Tracking.positions: node is 9"),
    "prestress of wrong size": (lambda: raised(costs=[ocp.Prestress([1.0, 2.0])]), ValueError, "Prestress.level"),
    "work without width": (lambda: ocp.Work(smoothing=0.0), ValueError, "Work.smoothing"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_bounds_and_costs_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()

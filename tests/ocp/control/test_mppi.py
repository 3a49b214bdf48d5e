"""Path integral control: weights and optima in closed form, limits, contact, determinism."""

from __future__ import annotations

import ball_travels
import casadi as ca
import numpy as np
import pytest
import scipy.optimize
from controlling import ARM, MODEL, problem
from planning import driven, prism

import ocp
import tenscasadi as tc
from ocp.control.mppi import softmin

CROSS = driven(tc.shapes.d_bar(pinned=[0]))
FOLDED = tc.shapes.d_bar(angle=0.7).string_lengths


def folding(**changes):
    given = {
        "goals": [ocp.StringLengths(FOLDED), ocp.AtRest()],
        "bounds": [ocp.ForceDensityLimits(0.0, 20.0)],
        **changes,
    }
    return ocp.Problem(CROSS, **given)


def folded(trajectory):
    return abs(CROSS.structure.replace(nodes=trajectory.nodes[-1]).string_lengths - FOLDED).max()


def test_weights_are_those_of_the_free_energy():
    weights = softmin(np.array([3.0, 1.0, 2.0, 7.0, np.inf, np.nan]), 0.5)
    by_hand = np.exp(
        -np.array([2.0, 0.0, 1.0, 6.0]) / (0.5 * 1.5)
    )  # the median is 2.5, the least 1
    assert weights == pytest.approx([*(by_hand / by_hand.sum()), 0.0, 0.0])


def test_a_linear_cost_moves_the_mean_of_noise_by_its_slope_over_the_temperature():
    noise = np.random.default_rng(0).standard_normal(200_000)
    costs = 3.0 * noise
    scale = 0.5 * (
        np.median(costs) - costs.min()
    )  # the normal density times exp(−3 e/λ) is one about −3/λ
    assert softmin(costs, 0.5) @ noise == pytest.approx(-3.0 / scale, abs=0.01)


@pytest.mark.parametrize(
    ("costs", "weights"),
    [
        ([2.0, 2.0, 5.0], [0.5, 0.5, 0.0]),
        ([np.nan, np.inf], [0.0, 0.0]),
        ([np.nan, 4.0], [0.0, 1.0]),
    ],
    ids=["no spread", "all diverged", "one left"],
)
def test_weights_of_few_costs(costs, weights):
    assert softmin(np.array(costs), 0.1) == pytest.approx(weights, abs=1e-12)


def test_many_improvements_find_the_optimum():
    asked = folding(goals=(), costs=[ocp.Tracking({2: (0.3, None, None)}, 100.0), ocp.Effort(1e-2)])
    controller = ocp.Mppi(
        asked, 0.2, 0.4, samples=256, noise=ocp.SplineNoise(1.0, 2), iterations=60, temperature=0.05
    )
    controller.control(0.0, CROSS.initial_state)

    def cost(flat):
        gamma = flat.reshape(2, 2)
        motion = tc.simulate(CROSS, 0.4, 0.02, control=gamma, compiled=False)
        return 0.2 * (
            100.0 * ((motion.nodes[[10, 20], 2, 0] - 0.3) ** 2).sum() + 1e-2 * (gamma**2).sum()
        )

    best = scipy.optimize.minimize(cost, np.full(4, 5.0), method="SLSQP", bounds=[(0.0, 20.0)] * 4)
    assert best.success
    first = cost(controller._initial.ravel())
    assert best.fun < 0.8 * first
    assert cost(controller._plan.ravel()) < best.fun + 0.02 * (first - best.fun)


def test_a_structure_is_brought_to_another_shape():
    held = ocp.run(ocp.Mppi(folding(), 0.1, 0.5, samples=32), 2.0)
    assert held.trajectory.success
    assert folded(held.trajectory) < 0.05
    assert len(held.seconds) == 20


def test_the_same_seed_decides_the_same_and_another_run_begins_anew():
    first, again, other = (
        ocp.Mppi(folding(), 0.1, 0.5, samples=16, seed=seed) for seed in (0, 0, 1)
    )
    runs = [
        ocp.run(controller, 0.5).trajectory.control for controller in (first, first, again, other)
    ]
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])
    assert not np.array_equal(runs[0], runs[3])


def test_limits_of_force_densities_are_kept():
    lower, upper = np.array([1.0, 2.0]), np.array([4.0, 3.0])
    controller = ocp.Mppi(
        folding(bounds=[ocp.ForceDensityLimits(lower, upper)]), 0.1, 0.5, samples=16, noise=50.0
    )
    control = ocp.run(controller, 0.5).trajectory.control
    assert np.all((control >= lower) & (control <= upper))
    assert np.ptp(control, axis=0).min() > 0.1


def test_a_group_pulls_together():
    asked = ocp.Problem(
        MODEL,
        1.0,
        bounds=[ocp.ForceDensityLimits(1.0, 100.0)],
        costs=[ocp.Tracking({3: (None, None, 1.3)})],
    )
    noise = ocp.SplineNoise(10.0, groups=[[0, 1, 2], [6, 7, 8]])
    decided = ocp.Mppi(asked, 0.05, 0.2, samples=16, noise=noise, initial=30.0).control(
        0.0, MODEL.initial_state
    )
    assert max(np.ptp(decided[:3]), np.ptp(decided[6:])) < 1e-12
    assert decided[3:6].tolist() == pytest.approx([30.0] * 3)
    assert abs(decided[[0, 6]] - 30.0).min() > 0.01


def test_an_arm_is_held_under_a_weight_that_is_not_known():
    goals = [ocp.NodePositions({1: (0.4, 0.0, None)}), ocp.AtRest()]
    asked = ocp.Problem(driven(ARM), 1.0, goals=goals, bounds=[ocp.ForceDensityLimits(1.0, 100.0)])
    held = ocp.run(ocp.Mppi(asked, 0.05, 0.3), 2.0, driven(ARM, gravity=tc.Gravity((0, 0, -1.0))))
    assert held.trajectory.nodes[-1, 1] == pytest.approx([0.4, 0.0, np.sqrt(1 - 0.16)], abs=0.08)


def test_a_moving_place_is_followed():
    asked = ocp.Problem(
        driven(ARM),
        1.0,
        bounds=[ocp.ForceDensityLimits(1.0, 100.0)],
        costs=[ocp.Tracking({1: lambda t: (0.4 * ca.sin(3 * t), None, None)})],
    )
    motion = ocp.run(ocp.Mppi(asked, 0.05, 0.4, noise=10.0), 2.0).trajectory
    late = motion.time > 0.5
    assert abs(motion.nodes[late, 1, 0] - 0.4 * np.sin(3 * motion.time[late])).max() < 0.15


@pytest.mark.slow
def test_limits_of_the_path_are_kept():
    free, held = (
        ocp.run(ocp.Mppi(problem(*bounds), 0.05, 0.4), 1.0).trajectory
        for bounds in ((), (ocp.TensionLimits(upper=3.0),))
    )
    assert free.tension.max() > 3.3
    assert held.tension.max() < 3.1


def test_motors_wind_no_faster_than_they_can():
    bound = ocp.RestLengthRateLimits(0.2, stiffness=1000.0)
    rates = []
    for bounds in ((), (bound,)):
        motion = ocp.run(
            ocp.Mppi(problem(*bounds), 0.05, 0.4, noise=ocp.SplineNoise(5.0, 3)), 0.5
        ).trajectory
        ends = motion.nodes[:-1:10][:, motion.strings]
        rest = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2) * (
            1 - motion.control[:-1:10] / 1000.0
        )
        rates.append(abs(np.diff(rest, axis=0)).max() / 0.05)
    assert rates[1] < 0.25 < 0.3 < rates[0]


def test_a_prism_hops_off_the_ground():
    low = prism(1.0, bar_mass=0.3)
    model = driven(
        low,
        gravity=tc.Gravity(),
        ground=tc.Ground(stiffness=3e3, damping=10.0, friction=0.6, slip_speed=1e-2),
    )
    start = model.state(low.nodes - [0, 0, 0.9 * 9.81 / 3 / 3e3])
    high = ocp.AtEnd("height", lambda end: -ca.sum2(end.nodes)[2] / 6)
    asked = ocp.Problem(
        model, 0.4, start, bounds=[ocp.ForceDensityLimits(5.0, 500.0)], costs=[high]
    )
    noise = ocp.SplineNoise(60.0, 4, groups=[[0, 1, 2], [3, 4, 5], [6, 7, 8]])
    motion = ocp.run(
        ocp.Mppi(asked, 0.05, 0.4, samples=64, noise=noise, initial=20.0, steps=25), 0.4, steps=50
    ).trajectory
    assert motion.nodes[:, :, 2].min(axis=1).max() > 0.02  # off the ground
    assert motion.nodes[-1, :, 2].mean() > low.nodes[:, 2].mean() + 0.1


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.0, 10.0, -10.0])
def test_a_ball_travels_over_ground_that_is_other_than_believed(slope):
    row = ball_travels.travel(slope, ball_travels.standing_still(), 4.0)
    assert row.motion.success
    assert row.ahead > 1.5
    assert row.aside < 0.5


def test_the_last_decision_goes_on_where_all_motions_diverge():
    controller = ocp.Mppi(folding(), samples=8, initial=[3.0, 7.0])
    assert controller.control(0.0, 1e90 * CROSS.initial_state).tolist() == [3.0, 7.0]
    assert controller.effective_samples == 0.0


def test_it_says_how_many_samples_count():
    controller = ocp.Mppi(folding(), 0.1, 0.5, samples=32)
    controller.control(0.0, CROSS.initial_state)
    assert 1.0 <= controller.effective_samples < 32.0


# --- what is asked ---


X, U, T = ca.SX.sym("x", CROSS.nx), ca.SX.sym("u", CROSS.nu), ca.SX.sym("t")
ASIDE = (CROSS.nodes(X)[2, 0] - 0.3) ** 2  # a CasADi expression
OWN = {
    "Function of state and control": ca.Function("aside", [X, U], [ASIDE]),
    "Function of time, too": ca.Function("aside", [X, U, T], [ASIDE]),
    "function of an instant": lambda now: (now.nodes[0, 2] - 0.3) ** 2,
    "cost": ocp.Tracking({2: (0.3, None, None)}),
}


@pytest.mark.parametrize("name", OWN)
def test_a_cost_alone_is_as_a_problem_of_it(name):
    asked = ocp.Problem(CROSS, costs=[OWN["cost"], ocp.Effort(1e-3)])
    problem, costs = (
        ocp.Mppi(given, 0.1, 0.4, 32, noise=3.0, **kind)
        for given, kind in ((asked, {}), ([OWN[name], ocp.Effort(1e-3)], {"model": CROSS}))
    )
    runs = [ocp.run(controller, 1.0).trajectory for controller in (problem, costs)]
    assert runs[1].nodes[-1] == pytest.approx(runs[0].nodes[-1], abs=1e-6)
    assert abs(runs[1].nodes[-1, 2, 0] - 0.3) < 0.5 * abs(runs[1].nodes[0, 2, 0] - 0.3)


def test_motions_whose_bars_break_do_not_count():
    away = ocp.AtEnd(
        "away", lambda end: -ca.sumsqr(end.nodes)
    )  # what flies apart is the best of all
    asked = ocp.Problem(CROSS, bounds=[ocp.ForceDensityLimits(0.0, 3000.0)], costs=[away])
    controller = ocp.Mppi(asked, 0.1, 0.5, samples=32, steps=2, noise=500.0)
    tried = controller._draw()
    off = np.array([bars_off_by(gamma) for gamma in tried])
    broken, whole = off > 0.5, off < 0.05
    assert broken.sum() > 3
    assert whole.sum() > 3
    costs = controller._evaluate(0.0, CROSS.initial_state, tried)
    assert np.all(np.isinf(costs[broken]))
    assert np.all(np.isfinite(costs[whole]))


def bars_off_by(force_density, period=0.1, steps=2):
    """The largest relative error of a bar at the ends of the periods, of the motion in steps of RK4."""
    x, h, worst, lengths = CROSS.initial_state, period / steps, 0.0, CROSS.structure.bar_lengths
    for gamma in force_density:
        for _ in range(steps):
            k1 = CROSS.ode(x, gamma).full().ravel()
            k2 = CROSS.ode(x + h / 2 * k1, gamma).full().ravel()
            k3 = CROSS.ode(x + h / 2 * k2, gamma).full().ravel()
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + CROSS.ode(x + h * k3, gamma).full().ravel())
        ends = CROSS.nodes(x)[CROSS.structure.bars]
        found = abs(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / lengths - 1).max()
        worst = max(worst, found if np.isfinite(found) else np.inf)
    return worst


STATE = CROSS.initial_state


BAD = {
    "of no problem": (lambda: ocp.Mppi(CROSS), TypeError, "problem is"),
    "of a cost without a model": (
        lambda: ocp.Mppi(OWN["cost"]),
        TypeError,
        "model is None: give an ocp.Problem, or with model= a cost",
    ),
    "of nothing": (lambda: ocp.Mppi([], model=CROSS), TypeError, r"problem is \[\]"),
    "of an expression": (
        lambda: ocp.Mppi([OWN["cost"], ASIDE], model=CROSS),
        TypeError,
        r"problem\[1\] is SX.*a casadi.Function \(x, u\)",
    ),
    "of a goal": (
        lambda: ocp.Mppi(ocp.AtRest(), model=CROSS),
        TypeError,
        r"problem is AtRest\(\): give an ocp.Problem",
    ),
    "of a Function of other arguments": (
        lambda: ocp.Mppi(ca.Function("f", [U, X], [ASIDE]), model=CROSS),
        ValueError,
        r"problem\[0\] is f.*: give a casadi.Function \(x\[18\], u\[2\]\)",
    ),
    "of a Function that is no scalar": (
        lambda: ocp.Mppi(ca.Function("f", [X, U], [X]), model=CROSS, noise=1.0),
        ValueError,
        "gives 18 entries",
    ),
    "of two models": (
        lambda: ocp.Mppi(folding(), model=MODEL),
        ValueError,
        "model is given, and the problem has one",
    ),
    "at a state too short": (
        lambda: ocp.Mppi(folding()).control(0.0, STATE[:3]),
        ValueError,
        r"state has shape \(3,\)",
    ),
    "at a state that is no number": (
        lambda: ocp.Mppi(folding()).control(0.0, STATE * np.nan),
        ValueError,
        r"state\[0\] is nan",
    ),
    "before the beginning": (
        lambda: ocp.Mppi(folding()).control(-1.0, STATE),
        ValueError,
        "time is -1",
    ),
    "period zero": (lambda: ocp.Mppi(folding(), 0.0), ValueError, "period"),
    "horizon zero": (lambda: ocp.Mppi(folding(), horizon=0.0), ValueError, "horizon is 0"),
    "one sample": (lambda: ocp.Mppi(folding(), samples=1), ValueError, "samples is 1"),
    "samples beyond memory": (
        lambda: ocp.Mppi(folding(), samples=10**9),
        ValueError,
        "samples is 1e\\+09: it must be at most",
    ),
    "temperature zero": (lambda: ocp.Mppi(folding(), temperature=0.0), ValueError, "temperature"),
    "steps zero": (lambda: ocp.Mppi(folding(), steps=0), ValueError, "steps"),
    "iterations zero": (lambda: ocp.Mppi(folding(), iterations=0), ValueError, "iterations"),
    "seed no number": (lambda: ocp.Mppi(folding(), seed="a"), TypeError, "seed"),
    "place zero": (lambda: ocp.Mppi(folding(), position_scale=0.0), ValueError, "position_scale"),
    "noise of other strings": (
        lambda: ocp.Mppi(folding(), noise=[1.0] * 5),
        ValueError,
        "noise has shape",
    ),
    "noise below zero": (
        lambda: ocp.Mppi(folding(), noise=-1.0),
        ValueError,
        "noise of string 0 is -1",
    ),
    "a horizon of ages": (
        lambda: ocp.Mppi(folding(), horizon=1e9),
        ValueError,
        "horizon is 1e.09: that is 2e.10 periods",
    ),
    "initial of other strings": (
        lambda: ocp.Mppi(folding(), initial=[1.0] * 5),
        ValueError,
        "initial has shape",
    ),
    "no noise and no limits": (
        lambda: ocp.Mppi(folding(bounds=())),
        ValueError,
        "noise is None, and the force density of string 0 has no upper limit",
    ),
    "a waypoint": (
        lambda: ocp.Mppi(folding(goals=[ocp.Waypoint([ocp.AtRest()], share=0.5)])),
        ValueError,
        "problem has Waypoint, which Mppi does not support",
    ),
    "a free start": (
        lambda: ocp.Mppi(folding(start=ocp.FreeStart(), goals=())),
        ValueError,
        "problem has FreeStart",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments_are_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()

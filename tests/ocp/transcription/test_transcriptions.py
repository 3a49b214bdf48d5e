"""All transcriptions: exact derivatives, the same optimum at their order, bars and momenta kept, unequal grids, linear and grouped γ."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.boundary.find_target import find_target
from ocp.problem.instant import symbolic
from ocp.problem.scaling import Scales
from ocp.transcription.initial_guess import make_guess

BAR = 1.4
GROUPS = ((0, 1, 2), (3, 4, 5), (6, 7, 8))


def prism(height, **options):
    """The equilibrium prism of a height whose bars are BAR long."""
    return tc.shapes.prism(3, np.sqrt(BAR**2 - height**2) / (2 * np.sin(np.radians(75))), height, **options)


def driven(structure, **options):
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **options))


def raising(**changes):
    goals = [ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest()]
    given = {"model": driven(prism(1.0)), "goals": goals, "bounds": [ocp.ForceDensityLimits(5.0, 100.0)], "costs": [ocp.Effort()], **changes}
    return ocp.Problem(**given)


def folding(**changes):
    """Class 2: a D-bar pinned at a node."""
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.6).string_lengths), ocp.AtRest()]
    return ocp.Problem(driven(tc.shapes.d_bar(pinned=[0])), goals=goals, costs=[ocp.Effort()], **changes)


def program(problem, transcription):
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    return transcription.program(problem, target, scales, make_guess(problem, target, transcription.count))


LINEAR = ocp.PiecewiseLinear()
METHODS = [
    ocp.MultipleShooting(3),
    ocp.ImplicitMidpoint(3),
    ocp.Variational(3),
    ocp.Collocation(3, degree=2),
    ocp.MultipleShooting((1, 2, 1), control=LINEAR),
    ocp.ImplicitMidpoint((1, 2, 1), control=LINEAR),
    ocp.Variational((1, 2, 1), control=ocp.PiecewiseLinear(GROUPS)),
    ocp.Collocation(3, degree=1, control=ocp.PiecewiseConstant(GROUPS)),
]
ASKED = {
    "duration": (0.8, 1.2),
    "costs": [ocp.Effort(2.0), ocp.Smoothness(0.1), ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities)), ocp.Duration(1.0)],
    "bounds": [ocp.ForceDensityLimits(5.0, 100.0), ocp.TensionLimits(upper=50.0)],
}


@pytest.mark.parametrize("transcription", METHODS, ids=lambda value: f"{type(value).__name__}-{type(value.control).__name__}")
def test_derivatives_put_together_from_blocks_are_those_of_the_whole(transcription):
    built = program(raising(model=driven(prism(1.0), forces=tc.NodalForce(lambda t: np.full((6, 3), 0.1) * t)), **ASKED), transcription)
    w, f, g = (built.problem[name] for name in "xfg")
    rng = np.random.default_rng(0)
    at, weights = built.first + 0.1 * rng.normal(size=w.shape[0]), rng.normal(size=g.shape[0])
    lam = ca.MX.sym("lam", g.shape[0])
    whole = ca.Function("whole", [w, lam], [ca.gradient(f, w), ca.jacobian(g, w), ca.triu(ca.hessian(0.7 * f + ca.dot(lam, g), w)[0])])(at, weights)
    exact = built.derivatives()
    parts = exact["nlp_grad_f"](at, [])[1], exact["nlp_jac_g"](at, [])[1], exact["nlp_hess_l"](at, [], 0.7, weights)
    for one, other in zip(parts, whole, strict=True):
        size = np.abs(other.full()).max()
        assert one.full() == pytest.approx(other.full(), rel=1e-9, abs=1e-12 * size)
    assert len(built.names) == g.shape[0]
    assert len(built.w_names) == w.shape[0]


@pytest.mark.parametrize("make", [ocp.MultipleShooting, ocp.ImplicitMidpoint, ocp.Variational, ocp.Collocation], ids=lambda kind: kind.__name__)
def test_all_find_the_same_plan(make):
    """On one grid the planned force densities differ by the methods' errors only."""
    problem = raising()
    found = ocp.solve(problem, make(24))
    assert found.success
    assert found.objective == pytest.approx(375.07, abs=0.002)
    assert found.replay_error < (1e-4 if make in (ocp.ImplicitMidpoint, ocp.Variational) else 2e-6)
    assert found.trajectory.bar_length_error.max() < 1e-9


def end_error(make, intervals):
    """How far the plan ends from what its force densities do."""
    plan = ocp.solve(raising(), make(intervals))
    assert plan.success
    return plan.replay_error


@pytest.mark.parametrize(
    ("make", "order", "grids"),
    [
        (ocp.ImplicitMidpoint, 2, (10, 20, 40)),
        (ocp.Variational, 2, (10, 20, 40)),
        (ocp.MultipleShooting, 4, (8, 12, 16)),
        (lambda n: ocp.Collocation(n, degree=2), 4, (8, 12, 16)),
    ],
    ids=["ImplicitMidpoint", "Variational", "MultipleShooting", "Collocation"],
)
@pytest.mark.slow
def test_replay_errors_fall_at_the_order(make, order, grids):
    found = [end_error(make, n) for n in grids]
    rate = np.log(found[0] / found[-1]) / np.log(grids[-1] / grids[0])
    assert rate > order - 0.5


@pytest.mark.parametrize(
    "transcription", [ocp.ImplicitMidpoint(30), ocp.Variational(30), ocp.Collocation(15, degree=2)], ids=lambda v: type(v).__name__
)
def test_joined_and_pinned_bars(transcription):
    found = ocp.solve(folding(), transcription)
    assert found.success
    assert found.replay_error < 5e-3
    assert found.trajectory.bar_length_error.max() < 1e-8
    assert np.abs(found.trajectory.nodes[:, 0] - found.trajectory.nodes[0, 0]).max() == 0.0


def test_leapfrog_keeps_momenta():
    """A prism that falls and turns changes its shape: the planned motion keeps angular momentum to the solver's tolerance."""
    structure = prism(1.0)
    model = driven(structure, gravity=tc.Gravity())
    turning = np.cross([0.3, 0.2, 0.5], structure.nodes - structure.nodes.mean(axis=0))
    goals = [ocp.StringLengths({6: 0.95 * structure.string_lengths[6]})]
    problem = ocp.Problem(model, 0.5, start=model.state(structure.nodes, turning), goals=goals, costs=[ocp.Effort()])
    found = ocp.solve(problem, ocp.Variational(10))
    assert found.success
    M = structure.mass_matrix().toarray()
    nodes, rates = found.trajectory.nodes[[0, -1]], found.trajectory.velocities[[0, -1]]
    momenta = [np.cross(N - N.mean(axis=0), M @ (V - V.mean(axis=0))).sum(axis=0) for N, V in zip(nodes, rates, strict=True)]
    assert momenta[0] == pytest.approx(momenta[1], abs=1e-7)
    assert rates[1].mean(axis=0) - rates[0].mean(axis=0) == pytest.approx([0.0, 0.0, -9.81 * 0.5], abs=1e-7)


def test_velocities_are_unknowns_only_where_they_are_asked_for():
    bare, asked = (
        program(raising(costs=costs), ocp.Variational(4))
        for costs in ([ocp.Effort()], [ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities))])
    )
    count = [sum("velocity" in name for name in built.w_names) for built in (bare, asked)]
    assert count == [18, 4 * 18]
    slow = ocp.solve(raising(costs=[ocp.Effort(), ocp.Integral("speed", lambda now: ca.sumsqr(now.velocities), 1e3)]), ocp.Variational(12))
    fast = ocp.solve(raising(), ocp.Variational(12))
    assert slow.success
    assert np.sum(slow.trajectory.velocities**2) < np.sum(fast.trajectory.velocities**2)


@pytest.mark.parametrize("make", [ocp.MultipleShooting, ocp.ImplicitMidpoint, ocp.Variational], ids=lambda kind: kind.__name__)
def test_linear_force_densities(make):
    problem = raising(costs=[ocp.Effort(), ocp.Smoothness(1e-3)])
    found = ocp.solve(problem, make(12, control=LINEAR))
    assert found.success
    assert found.linear
    assert found.force_density.shape == (13, 9)
    assert found.tension(end=True)[:-1] == pytest.approx(found.tension()[1:])
    assert found.rest_lengths(500.0).shape == (13, 9)
    assert found.replay_error < 2e-3
    assert found.replay(step=1e-3).nodes[-1] == pytest.approx(found.replay().nodes[-1], abs=1e-4)


def test_costs_of_rates_are_no_smaller_beside_the_tolerance_on_finer_grids():
    found, tight = (ocp.solve(raising(costs=[ocp.Smoothness()]), ocp.Variational(60), ocp.Ipopt(tolerance=each)) for each in (1e-8, 1e-12))
    assert found.success
    assert found.objective == pytest.approx(tight.objective, rel=1e-4)


@pytest.mark.parametrize("make", [ocp.MultipleShooting, ocp.Variational], ids=lambda kind: kind.__name__)
def test_unequal_intervals(make, tmp_path):
    shares = np.linspace(1.0, 3.0, 12)
    found = ocp.solve(raising(), make(shares))
    assert found.success
    assert np.diff(found.time) == pytest.approx(shares / shares.sum())
    assert found.replay_error < 1e-3
    effort = np.sum(np.diff(found.time)[:, None] * found.force_density**2)
    assert found.objective == pytest.approx(effort, rel=1e-6)
    loaded = ocp.Plan.load(found.save(tmp_path / "plan.npz"))
    assert np.array_equal(loaded.replay().states, found.replay().states)


def test_equal_shares_are_equal_intervals():
    even, shares = ocp.solve(raising(), ocp.Variational(10)), ocp.solve(raising(), ocp.Variational([2.0] * 10))
    assert shares.force_density == pytest.approx(even.force_density, rel=1e-9)


def test_groups_share_their_force_density():
    found = ocp.solve(raising(), ocp.Variational(12, control=ocp.PiecewiseConstant(GROUPS)))
    assert found.success
    for group in GROUPS:
        assert np.ptp(found.force_density[:, group], axis=1).max() == 0.0
    assert found.objective == pytest.approx(ocp.solve(raising(), ocp.Variational(12)).objective, rel=1e-4)  # which is symmetric by itself
    assert "out of control" in found.message  # rows that only single strings could move are not imposed on groups
    assert "out of control" not in ocp.solve(raising(), ocp.Variational(12)).message
    with pytest.raises(ValueError, match=r"PiecewiseConstant.groups has string 9: strings run from 0 to 8"):
        ocp.solve(raising(), ocp.Variational(12, control=ocp.PiecewiseConstant(((0, 9),))))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ocp.Variational(0), "Variational.intervals is 0: it must be at least 1"),
        (lambda: ocp.Variational([]), "Variational.intervals is empty"),
        (lambda: ocp.Variational([1.0, -1.0]), r"Variational.intervals\[1\] is -1"),
        (lambda: ocp.Collocation(5, degree=0), "Collocation.degree is 0"),
        (lambda: ocp.Collocation(5, degree=12), "Collocation.degree is 12: give at most 9"),
        (lambda: ocp.PiecewiseLinear(((0, 1), (1, 2))), "PiecewiseLinear.groups has string 1 twice"),
    ],
)
def test_wrong_values_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_wrong_types_are_refused():
    with pytest.raises(TypeError, match=r"Variational.control is 'linear'"):
        ocp.Variational(5, control="linear")
    with pytest.raises(TypeError, match=r"PiecewiseConstant\.groups"):
        ocp.PiecewiseConstant(5)


@pytest.mark.parametrize("control", [ocp.PiecewiseConstant(), LINEAR], ids=["constant", "linear"])
@pytest.mark.parametrize("make", [ocp.ImplicitMidpoint, ocp.Variational, ocp.MultipleShooting], ids=lambda kind: kind.__name__)
def test_work_is_not_hidden_by_force_densities_that_jump(make, control):
    """Seen at nodes alone, or by central differences, strings seem to work less where γ and motion swing from interval to interval."""
    plan = ocp.solve(raising(costs=[ocp.Work(), ocp.Effort(1e-4)]), make(24, control=control))
    assert plan.success, plan.message
    assert plan.objective == pytest.approx(2.171, rel=1e-3)
    assert np.abs(np.diff(plan.force_density, axis=0)).max() < 5.0  # to and fro by 30 where it pays


def test_work_is_what_the_replay_works():
    problem = raising(costs=[ocp.Work(), ocp.Effort(1e-4)])
    plan = ocp.solve(problem, ocp.Variational(24))
    now = symbolic(problem.model)
    rate = ca.Function("rate", [now.state, now.control], [ocp.Work().rate(now)])
    fine = plan.replay(step=plan.time[-1] / (24 * 40)).states
    work = 0.0
    for k, gamma in enumerate(plan.force_density):
        states = fine[40 * k : 40 * k + 41]
        work += np.trapezoid(rate(states.T, np.tile(gamma[:, None], 41)).full().ravel(), dx=plan.time[-1] / len(fine[1:]))
    effort = 1e-4 * (plan.force_density**2).mean(axis=0).sum()
    assert work + effort == pytest.approx(plan.objective, rel=1e-3)


@pytest.mark.parametrize("intervals", [24, (1,) * 12 + (2,) * 8], ids=["equal", "unequal"])
def test_limits_of_velocities_hold_in_the_replay(intervals):
    quick = ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities[:, 3]), upper=0.006)
    problem = raising(bounds=[ocp.ForceDensityLimits(5.0, 100.0), quick])
    leapfrog, reference = (ocp.solve(problem, make(intervals)) for make in (ocp.Variational, ocp.MultipleShooting))
    assert leapfrog.success
    assert leapfrog.objective == pytest.approx(reference.objective, rel=5e-3)
    highest = (leapfrog.replay().states[:, 27:30] ** 2).sum(axis=1).max()
    assert highest < 0.0075  # without the limit 0.0109


@pytest.mark.parametrize("make", [ocp.ImplicitMidpoint, ocp.Variational, ocp.Collocation], ids=lambda kind: kind.__name__)
def test_full_coordinates_are_refused_by_name(make):
    model = tc.Model(tc.Scene(tc.shapes.d_bar(pinned=[0]), control=tc.ForceDensity()), "full")
    goals = [ocp.StringLengths(tc.shapes.d_bar(angle=0.7).string_lengths)]
    with pytest.raises(ValueError, match=f"{make.__name__} keeps bars, not joints"):
        ocp.solve(ocp.Problem(model, goals=goals), make(10))

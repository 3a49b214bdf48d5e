"""Derivatives of goals and costs by force densities and duration, against finite differences of motions that are met."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc
from ocp.condensed.interior_point import point_at
from ocp.condensed.motions import first_motion
from ocp.condensed.path_rows import Limited
from ocp.condensed.reduced import ReducedProblem
from ocp.problem.bounds.bound import Bound
from ocp.problem.scaling import Scales
from ocp.targets.find_target import find_target
from ocp.transcription.initial_guess import evaluate_guess

EVERY = [ocp.Effort(), ocp.Smoothness(0.1), ocp.Prestress(3.0), ocp.Duration(3.0)]
LIMITS = ocp.ForceDensityLimits(1, 200)
RISE = [ocp.StringLengths({6: 0.95}), ocp.AtRest()]
ON_THE_WAY = ocp.Waypoint([ocp.StringLengths({7: 1.0})], share=0.37)
PUSH = tc.NodalForce(lambda t: [(0, 0, 0)] * 5 + [(ca.sin(3 * t), 0, t**3)])


def driven(structure: tc.Structure, **scene: object) -> tc.Model:
    return tc.Model(tc.Scene(structure, control=tc.ForceDensity(), **scene))


def class_two() -> tc.Structure:
    """A prism, and above it three bars that share its upper nodes."""
    prism = tc.shapes.prism(bars=3, radius=0.5, height=1.0)
    nodes = np.vstack([prism.nodes, prism.nodes[3:] * [0.6, 0.6, 1.0] + [0, 0, 0.5]])
    bars = np.vstack([prism.bars, [(3, 7), (4, 8), (5, 6)]])
    strings = np.vstack([prism.strings, [(6, 7), (7, 8), (8, 6), (3, 6), (4, 7), (5, 8)]])
    return tc.Structure(nodes, bars, strings)


def shaken(**scene: object) -> tc.Model:
    """A prism with three pinned feet, of which two are moved."""
    (a, b, c), (d, e, f) = tc.shapes.prism().nodes[:2].tolist()
    moved = {0: lambda t: (a + 0.1 * ca.sin(3 * t), b, c), 1: lambda t: (d, e, f + 0.1 * t**3)}
    return driven(
        tc.shapes.prism(pinned=[0, 1, 2], string_mass=0.05),
        supports=tc.SupportMotion(moved),
        **scene,
    )


CASES = {
    "class two": (
        ocp.Problem(
            driven(class_two()),
            goals=[ocp.StringLengths({0: 0.83}), ocp.AtRest()],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(8),
    ),
    "free duration, waypoint": (
        ocp.Problem(
            driven(tc.shapes.prism()),
            (0.5, 1.5),
            goals=[*RISE, ON_THE_WAY],
            bounds=[LIMITS],
            costs=EVERY,
        ),
        ocp.Variational([1, 2, 1, 1, 1.5, 1, 1, 0.5]),
    ),
    "linear profile, groups": (
        ocp.Problem(
            driven(tc.shapes.prism()),
            (0.5, 1.5),
            goals=[*RISE, ON_THE_WAY],
            bounds=[LIMITS],
            costs=EVERY,
        ),
        ocp.Variational(8, control=ocp.PiecewiseLinear(groups=[(0, 1, 2)])),
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
        ocp.Variational(8),
    ),
    "moved supports": (
        ocp.Problem(
            shaken(gravity=tc.Gravity((0, 0, -3.0)), segments=2),
            (0.5, 1.5),
            goals=[
                ocp.NodePositions({5: (None, None, 1.02)}),
                ocp.NodeVelocities({4: (0.0, None, None)}),
                ON_THE_WAY,
            ],
            bounds=[LIMITS],
            costs=EVERY,
        ),
        ocp.Variational([1, 2, 1, 1, 1.5, 1, 1, 0.5]),
    ),
    "a roller": (
        ocp.Problem(
            driven(tc.shapes.prism(pinned=[0], rollers={1: (0, 0.6, 0.8)})),
            goals=[ocp.NodePositions({5: (None, None, 1.03)})],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(8),
    ),
    "segments with masses": (
        ocp.Problem(
            tc.Model(
                tc.Scene(tc.shapes.prism(string_mass=0.05), control=tc.ForceDensity(), segments=2)
            ),
            goals=[ocp.NodePositions({5: (None, None, 1.02)})],
            costs=[ocp.Effort()],
        ),
        ocp.Variational(8),
    ),
}


def meet(reduced: ReducedProblem, w, motion):
    """Newton's method on the motion alone."""
    slack = np.zeros(reduced.paths.count)
    point = point_at(reduced, w, motion, slack)
    for _ in range(30):
        step = reduced.about(w, point.motion).follow(None, point.left.rows)
        point = point_at(
            reduced,
            w,
            point.motion.moved(
                type(motion)(*(a.reshape(b.shape) for a, b in zip(step, motion, strict=True)))
            ),
            slack,
        )
        if max(np.abs(one).max(initial=0.0) for one in step) < 1e-13:
            return point
    raise AssertionError("the motion was not found")


@pytest.mark.parametrize("case", CASES)
def test_goals_and_costs_have_exact_first_and_second_derivatives(case):
    problem, transcription = CASES[case]
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    reduced = ReducedProblem(problem, transcription, target, scales, 2.0, 10.0)
    rng = np.random.default_rng(0)
    w = 0.6 + 0.1 * rng.uniform(size=reduced.size)
    if reduced.free_duration:
        w[-1] = 0.5
    count = transcription.count
    still = np.repeat(target.start[None], count + 1, axis=0)
    if problem.model.scene.has_clock:
        still[:, -1] += reduced.split(w)[1] * reduced.chain.time
    known = meet(
        reduced, w, first_motion(reduced.chain, reduced.strings(w), reduced.split(w)[1], still)
    ).motion
    direction, y, e = rng.normal(size=reduced.size), rng.normal(size=reduced.goals.count), 1e-5

    def at(share):
        moved = w + share * direction
        point = meet(reduced, moved, known)
        return (
            point.left.goals,
            reduced.about(moved, point.motion).jacobian.T @ y + reduced.slope(moved),
            point.cost,
        )

    (goals, slope, cost), (goals_before, slope_before, cost_before) = at(e), at(-e)
    expansion = reduced.about(w, known)
    assert (goals - goals_before) / (2 * e) == pytest.approx(
        expansion.jacobian @ direction, abs=1e-6 * np.abs(expansion.jacobian).max()
    )
    assert (cost - cost_before) / (2 * e) == pytest.approx(reduced.slope(w) @ direction, rel=1e-6)
    expansion.weigh(y, np.zeros(0), np.zeros(0))
    curved = expansion.curvature(direction, expansion.follow(direction, None))
    assert (slope - slope_before) / (2 * e) == pytest.approx(
        curved, abs=1e-6 * np.abs(curved).max()
    )


def heavy_limits() -> list[Bound]:
    """Of each kind: places, force densities, velocities, forces of bars, rates of change, the end alone."""
    return [
        ocp.Obstacle((0.0, 0.0, 2.0), 0.2),
        ocp.BarClearance(0.02),
        ocp.InsideBox(upper=(None, None, 5.0)),
        ocp.TensionLimits(upper=300.0),
        ocp.BarForceLimits(compression=300.0),
        ocp.RestLengthRateLimits(5.0, stiffness=1000.0),
        ocp.Constraint("speed", lambda now: ca.sumsqr(now.velocities) + now.time, upper=10.0),
        ocp.Constraint(ocp.AtEnd("height", lambda end: end.nodes[2, 4]), upper=3.0),
    ]


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize(
    ("duration", "moved"),
    [(1.0, False), ((0.5, 1.5), False), ((0.5, 1.5), True)],
    ids=["fixed", "free duration", "free duration, moved supports"],
)
def test_limits_along_the_way_have_exact_first_and_second_derivatives(duration, moved, linear):
    model = (
        shaken(gravity=tc.Gravity())
        if moved
        else driven(tc.shapes.prism(), gravity=tc.Gravity(), forces=PUSH)
    )
    problem = ocp.Problem(
        model,
        duration,
        goals=RISE[: 1 if moved else 2],
        bounds=[LIMITS, *heavy_limits()],
        costs=EVERY,
    )
    control = ocp.PiecewiseLinear(groups=[(0, 1, 2)]) if linear else ocp.PiecewiseConstant()
    transcription = ocp.Variational([1, 2, 1, 1, 1.5, 1], control=control)
    scales = Scales.of(problem)
    target = find_target(problem, scales)
    guess = evaluate_guess(None, problem, target, transcription.count)
    limited = Limited(problem, transcription, target, scales, guess)
    reduced = ReducedProblem(problem, transcription, target, scales, 2.0, 10.0, limited)
    rng = np.random.default_rng(0)
    w = 0.6 + 0.1 * rng.uniform(size=reduced.size)
    if reduced.free_duration:
        w[-1] = 0.5
    still = np.repeat(target.start[None], transcription.count + 1, axis=0)
    still[:, -1] += reduced.split(w)[1] * reduced.chain.time
    known = meet(
        reduced, w, first_motion(reduced.chain, reduced.strings(w), reduced.split(w)[1], still)
    ).motion
    direction, y, e = rng.normal(size=reduced.size), rng.normal(size=reduced.paths.count), 1e-5

    def at(share):
        moved = w + share * direction
        point = meet(reduced, moved, known)
        return point.left.paths, reduced.about(moved, point.motion).of_paths(y[:, None])[
            0
        ] + reduced.slope(moved)

    (rows, slope), (rows_before, slope_before) = at(e), at(-e)
    expansion = reduced.about(w, known)
    moved = expansion.follow(direction, None)
    change = expansion.path_change(moved, direction)
    assert (rows - rows_before) / (2 * e) == pytest.approx(change, abs=1e-6 * np.abs(change).max())
    assert expansion.of_paths(y[:, None])[0] @ direction == pytest.approx(y @ change, rel=1e-9)
    stiffness = rng.uniform(size=reduced.paths.count)
    expansion.weigh(np.zeros(reduced.goals.count), y, stiffness)
    curved = (
        expansion.curvature(direction, moved) - expansion.of_paths((stiffness * change)[:, None])[0]
    )
    assert (slope - slope_before) / (2 * e) == pytest.approx(
        curved, abs=1e-6 * np.abs(curved).max()
    )

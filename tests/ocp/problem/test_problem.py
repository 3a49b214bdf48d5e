"""What is asked of a plan: values that hold what was given, and errors that name the field."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import ocp
import tenscasadi as tc

PRISM = tc.shapes.prism()
FORCED = tc.Scene(PRISM, control=tc.ForceDensity())
MODEL = tc.Model(FORCED)


def problem(**changes):
    return ocp.Problem(**{"model": MODEL, "goals": [ocp.AtRest()], **changes})


def spinning(rate=1.0):
    return MODEL.state(PRISM.nodes, rate * np.cross([0, 0, 1.0], PRISM.nodes))


def bad_nodes():
    nodes = PRISM.nodes.copy()
    nodes[0] += 0.1
    return nodes


def stretching():
    return MODEL.state(PRISM.nodes, PRISM.nodes)


def limited(expression, **limits):
    return problem(bounds=[ocp.Constraint("own", expression, **(limits or {"lower": 0.0}))])


def counted(expression):
    return problem(costs=[ocp.Integral("own", expression)])


def followed(place):
    return problem(costs=[ocp.Tracking({0: place})])


BAD = {
    "model is no model": (lambda: ocp.Problem(FORCED), TypeError, "Problem.model"),
    "control is none": (
        lambda: ocp.Problem(tc.Model(tc.Scene(PRISM))),
        ValueError,
        "Problem.model has the control None",
    ),
    "no strings": (
        lambda: ocp.Problem(tc.Model(tc.Scene(tc.shapes.pendulum(), control=tc.ForceDensity()))),
        ValueError,
        "no strings",
    ),
    "no free node": (
        lambda: ocp.Problem(
            tc.Model(tc.Scene(PRISM.replace(pinned=range(6)), control=tc.ForceDensity()))
        ),
        ValueError,
        "all nodes pinned",
    ),
    "elastic bar": (
        lambda: ocp.Problem(
            tc.Model(tc.Scene(PRISM.replace(bar_stiffness=1e4), control=tc.ForceDensity()))
        ),
        ValueError,
        "elastic bar, 0",
    ),
    "duration zero": (lambda: problem(duration=0.0), ValueError, "Problem.duration is 0"),
    "duration nan": (lambda: problem(duration=float("nan")), ValueError, "Problem.duration"),
    "duration text": (lambda: problem(duration="long"), TypeError, "Problem.duration"),
    "duration backwards": (
        lambda: problem(duration=(2.0, 1.0)),
        ValueError,
        r"Problem.duration is \(2, 1\)",
    ),
    "duration of three": (
        lambda: problem(duration=(1.0, 2.0, 3.0)),
        ValueError,
        "Problem.duration",
    ),
    "start of wrong size": (lambda: problem(start=np.zeros((5, 3))), ValueError, "Problem.start"),
    "start state of wrong size": (lambda: problem(start=np.zeros(7)), ValueError, "Problem.start"),
    "start ragged": (lambda: problem(start=[[0, 0, 0], [1, 2]]), TypeError, "Problem.start"),
    "start not finite": (
        lambda: problem(start=np.full((6, 3), np.inf)),
        ValueError,
        "Problem.start",
    ),
    "start with other bars": (
        lambda: problem(start=bad_nodes()),
        ValueError,
        "Problem.start makes bar 0",
    ),
    "start of a model with other bars": (
        lambda: replace(
            problem(), model=tc.Model(replace(FORCED, structure=tc.shapes.prism(height=2.0)))
        ),
        ValueError,
        r"Problem.start makes bar 0 .* m long, .* or start=None, .* of the model$",
    ),
    "start of a model with more bars": (
        lambda: replace(problem(), model=tc.Model(replace(FORCED, structure=tc.shapes.prism(4)))),
        ValueError,
        r"Problem.start has shape \(36,\): .* or start=None, .* of the model$",
    ),
    "start that stretches bars": (
        lambda: problem(start=stretching()),
        ValueError,
        "Problem.start stretches bar 0",
    ),
    "start moves a pin": (
        lambda: ocp.Problem(
            tc.Model(tc.Scene(PRISM.replace(pinned=[0]), control=tc.ForceDensity())),
            start=PRISM.nodes + 1.0,
        ),
        ValueError,
        "Problem.start",
    ),
    "goals no list": (lambda: problem(goals=ocp.AtRest()), TypeError, "Problem.goals"),
    "goals no goals": (lambda: problem(goals=[1.0]), TypeError, r"Problem.goals\[0\]"),
    "bounds no bounds": (lambda: problem(bounds=[ocp.AtRest()]), TypeError, r"Problem.bounds\[0\]"),
    "costs no costs": (lambda: problem(costs=[ocp.Effort]), TypeError, r"Problem.costs\[0\]"),
    "lengths of wrong size": (
        lambda: problem(goals=[ocp.StringLengths([1.0, 2.0])]),
        ValueError,
        "StringLengths.lengths",
    ),
    "lengths ragged": (
        lambda: ocp.StringLengths([[1.0], [1.0, 2.0]]),
        TypeError,
        "StringLengths.lengths",
    ),
    "lengths empty": (lambda: ocp.StringLengths({}), ValueError, "StringLengths.lengths is empty"),
    "length negative": (lambda: ocp.StringLengths({0: -1.0}), ValueError, "StringLengths.lengths"),
    "length nan": (lambda: ocp.StringLengths([1.0, np.nan]), ValueError, "StringLengths.lengths"),
    "string unknown": (
        lambda: problem(goals=[ocp.StringLengths({9: 1.0})]),
        ValueError,
        "StringLengths.lengths: string is 9",
    ),
    "string no index": (
        lambda: problem(goals=[ocp.StringLengths({"a": 1.0})]),
        ValueError,
        "StringLengths.lengths names string 'a'",
    ),
    "positions of wrong size": (
        lambda: problem(goals=[ocp.NodePositions(np.zeros((2, 3)))]),
        ValueError,
        "NodePositions.positions",
    ),
    "positions empty": (
        lambda: ocp.NodePositions({}),
        ValueError,
        "NodePositions.positions is empty",
    ),
    "place of two": (
        lambda: ocp.NodePositions({0: (1.0, 2.0)}),
        ValueError,
        r"NodePositions.positions\[0\]",
    ),
    "place of nothing": (
        lambda: ocp.NodePositions({0: (None, None, None)}),
        ValueError,
        r"NodePositions.positions\[0\]",
    ),
    "place no place": (
        lambda: ocp.NodePositions({0: 1.0}),
        TypeError,
        r"NodePositions.positions\[0\]",
    ),
    "node unknown": (
        lambda: problem(goals=[ocp.NodePositions({6: (0, 0, 0)})]),
        ValueError,
        "NodePositions.positions: node is 6",
    ),
    "pinned node elsewhere": (
        lambda: ocp.Problem(
            tc.Model(tc.Scene(PRISM.replace(pinned=[0]), control=tc.ForceDensity())),
            goals=[ocp.NodePositions({0: (None, 1.0, None)})],
        ),
        ValueError,
        r"NodePositions.positions\[0\] wants y = 1 m of node 0, which is pinned at 0 m",
    ),
    "limits of nothing": (
        lambda: ocp.TensionLimits(),
        ValueError,
        "TensionLimits.lower and .upper",
    ),
    "limits below zero": (
        lambda: ocp.ForceDensityLimits(-1.0, 1.0),
        ValueError,
        "ForceDensityLimits.lower",
    ),
    "limits crossed": (
        lambda: problem(bounds=[ocp.ForceDensityLimits(2.0, 1.0)]),
        ValueError,
        "ForceDensityLimits: lower is 2",
    ),
    "limits crossed in two": (
        lambda: problem(bounds=[ocp.TensionLimits(lower=2.0), ocp.TensionLimits(upper=1.0)]),
        ValueError,
        "Problem.bounds: TensionLimits leave string 0 nothing",
    ),
    "limits of wrong size": (
        lambda: problem(bounds=[ocp.TensionLimits(upper=[1.0, 2.0])]),
        ValueError,
        "TensionLimits.upper",
    ),
    "lower limit infinite": (
        lambda: ocp.ForceDensityLimits(np.inf, np.inf),
        ValueError,
        "ForceDensityLimits.lower",
    ),
    "weight zero": (lambda: ocp.Effort(0.0), ValueError, "Effort.weight is 0"),
    "weight negative": (lambda: ocp.Smoothness(-1.0), ValueError, "Smoothness.weight"),
    "constraint of a node that is none": (
        lambda: limited(lambda now: now.nodes[2, 77]),
        ValueError,
        "Constraint 'own' fails .* Slice .* 3×6",
    ),
    "constraint of shapes that differ": (
        lambda: limited(lambda now: now.nodes + now.tension),
        ValueError,
        "Constraint 'own' fails .* Dimension mismatch",
    ),
    "constraint with an if": (
        lambda: limited(lambda now: now.time if now.time > 0 else 0),
        ValueError,
        "Constraint 'own' fails .* casadi.if_else",
    ),
    "constraint of what is none": (
        lambda: limited(lambda now: now.position),
        ValueError,
        "Constraint 'own' fails .*'position': an instant has nodes",
    ),
    "constraint of nothing": (
        lambda: limited(lambda now: now.nodes[:, []]),
        TypeError,
        "Constraint 'own' gives nothing",
    ),
    "constraint with a symbol": (
        lambda: limited(lambda now: now.time + ca.SX.sym("z")),
        ValueError,
        "Constraint 'own' has the symbol 'z'",
    ),
    "constraint not a number": (
        lambda: limited(lambda now: ca.log(now.nodes[2, 0] - 5)),
        ValueError,
        "Problem.bounds: own is not a number at the start",
    ),
    "cost with a symbol": (
        lambda: counted(lambda now: now.time + ca.SX.sym("z")),
        ValueError,
        "Integral 'own' has the symbol 'z'",
    ),
    "cost of another kind": (
        lambda: counted(lambda now: ca.MX.sym("q")),
        TypeError,
        "Integral 'own' gives MX, and the instant is SX",
    ),
    "cost not a number": (
        lambda: counted(lambda now: 1 / now.nodes[2, 0]),
        ValueError,
        "Problem.costs: Integral 'own' is not a number at the start",
    ),
    "final cost that fails": (
        lambda: problem(costs=[ocp.AtEnd("own", lambda end: end.nodes[7, 7])]),
        ValueError,
        "AtEnd 'own' fails",
    ),
    "path of text": (
        lambda: followed(lambda time: "abc"),
        TypeError,
        r"Tracking.positions\[0\]\(time\) is not a real number",
    ),
    "path that fails": (
        lambda: followed(lambda time: (time.hour, 0, 0)),
        ValueError,
        r"Tracking.positions\[0\]\(time\) fails",
    ),
    "path of other symbols": (
        lambda: followed(lambda time: (ca.MX.sym("q"), 0, 0)),
        TypeError,
        r"Tracking.positions\[0\]\(time\) has the entry q",
    ),
    "path not a number": (
        lambda: followed(lambda time: (np.nan, 0, 0)),
        ValueError,
        r"Tracking.positions\[0\]\(time\) is nan",
    ),
    "path without a start": (
        lambda: followed(lambda time: (1 / time, 0, 0)),
        ValueError,
        "Problem.costs: Tracking is not a number at the start",
    ),
    "intervals zero": (lambda: ocp.MultipleShooting(0), ValueError, "MultipleShooting.intervals"),
    "intervals a fraction": (
        lambda: ocp.MultipleShooting(1.5),
        TypeError,
        "MultipleShooting.intervals",
    ),
    "substeps zero": (
        lambda: ocp.MultipleShooting(substeps=0),
        ValueError,
        "MultipleShooting.substeps",
    ),
    "scheme unknown": (lambda: ocp.MultipleShooting(scheme="rk4"), TypeError, "scheme"),
    "scheme of whole models": (
        lambda: ocp.MultipleShooting(scheme=tc.Rattle()),
        ValueError,
        r"MultipleShooting.scheme is Rattle\(.*\): give RungeKutta4\(\), .* or a scheme with coefficients",
    ),
    "guess of bars without a length": (
        lambda: ocp.solve(
            problem(),
            ocp.MultipleShooting(8),
            guess=ocp.TrajectoryGuess(np.zeros((9, MODEL.nx)), np.ones((8, MODEL.nu))),
        ),
        ValueError,
        "guess has states at 0.125 of the duration with infinite accelerations, as where a bar has no length",
    ),
    "iterations zero": (lambda: ocp.Ipopt(max_iterations=0), ValueError, "Ipopt.max_iterations"),
    "tolerance negative": (lambda: ocp.Ipopt(tolerance=-1.0), ValueError, "Ipopt.tolerance"),
    "verbose a number": (lambda: ocp.Ipopt(verbose=1), TypeError, "Ipopt.verbose"),
    "options no mapping": (lambda: ocp.Ipopt(options=["tol"]), TypeError, "Ipopt.options"),
    "solver library missing": (
        lambda: ocp.Ipopt(options={"linear_solver": "ma57", "hsllib": "none.so"}),
        ValueError,
        "Ipopt.options.*ma57",
    ),
    "option unknown": (
        lambda: ocp.solve(problem(), ocp.MultipleShooting(5), ocp.Ipopt(options={"speed": 11})),
        ValueError,
        "Ipopt.options",
    ),
    "solve no problem": (lambda: ocp.solve(MODEL), TypeError, "problem"),
    "solve swapped": (lambda: ocp.solve(problem(), ocp.Ipopt()), TypeError, "transcription"),
    "solve without solver": (lambda: ocp.solve(problem(), None, "ipopt"), TypeError, "solver"),
    "load nothing": (lambda: ocp.Plan.load("nowhere.npz"), FileNotFoundError, "nowhere"),
    "load for no problem": (
        lambda: ocp.Plan.load("nowhere.npz", problem=MODEL),
        TypeError,
        "problem",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_refused_by_name(name):
    make, error, message = BAD[name]
    with pytest.raises(error, match=message):
        make()


def test_a_problem_keeps_what_it_was_given():
    state = spinning()
    given = ocp.Problem(
        MODEL,
        (1.0, 2.0),
        state,
        goals=iter([ocp.AtRest()]),
        bounds=[ocp.ForceDensityLimits(1.0, np.inf)],
        costs=(ocp.Effort(),),
    )
    assert (given.shortest, given.longest) == (1.0, 2.0)
    assert given.start == pytest.approx(state, abs=1e-14)
    assert len(given.goals) == len(given.bounds) == len(given.costs) == 1
    assert problem(duration=(1.0, 1.0)).duration == 1.0


def test_a_start_off_by_rounding_is_put_right():
    given = problem(start=PRISM.nodes.round(4))
    assert MODEL.bar_length_error(MODEL.state(PRISM.nodes.round(4))) > 1e-6
    assert MODEL.bar_length_error(given.start) < 1e-14
    assert given.start == pytest.approx(MODEL.initial_state, abs=1e-3)


def test_limits_combine_and_strings_never_push():
    bounds = [
        ocp.ForceDensityLimits(upper=5.0),
        ocp.ForceDensityLimits(np.arange(9.0) / 9, 4.0),
        ocp.TensionLimits(upper=7.0),
    ]
    lower, upper = problem(bounds=bounds).force_density_limits
    assert lower == pytest.approx(np.arange(9.0) / 9)
    assert upper == pytest.approx(np.full(9, 4.0))
    lower, upper = problem(bounds=bounds).limits(ocp.TensionLimits)
    assert np.all(np.isneginf(lower))
    assert upper == pytest.approx(np.full(9, 7.0))
    lower, upper = problem().force_density_limits
    assert not lower.any()
    assert np.all(np.isposinf(upper))


def test_changed_limits_leave_the_problem_alone():
    given = problem(bounds=[ocp.ForceDensityLimits(1.0, 5.0)])
    for limit in given.limits(ocp.ForceDensityLimits):
        limit[:] = 3.0
    lower, upper = given.limits(ocp.ForceDensityLimits)
    assert set(lower) == {1.0}
    assert set(upper) == {5.0}


@pytest.mark.parametrize("start", [None, ocp.FreeStart()], ids=["given", "free"])
@pytest.mark.parametrize("duration", [1.0, (0.5, 1.0)], ids=["fixed", "free"])
def test_where_nothing_is_asked_nothing_pulls(duration, start):
    """Without costs and upper limits the least effort is looked for: γ = 0."""
    plan = ocp.solve(ocp.Problem(MODEL, duration, start), ocp.MultipleShooting(8))
    assert plan.success, plan.message
    assert plan.iterations < 40
    assert plan.force_density == pytest.approx(0.0, abs=1e-2)


def test_costs_are_added_only_where_nothing_else_keeps_force_densities_small():
    assert ocp.Problem(MODEL).costs == (ocp.Effort(),)
    assert ocp.Problem(MODEL, bounds=[ocp.ForceDensityLimits(0.0, 50.0)]).costs == ()


@pytest.mark.parametrize(
    ("limits", "typical"), [(2.0, 2.0), ((0.5, 1.5), 1.0), ((0.1, 1.0), 0.55), ((0.01, 100.0), 1.0)]
)
def test_motions_begin_with_a_typical_duration(limits, typical):
    assert ocp.Problem(MODEL, limits, goals=[ocp.AtRest()]).typical_duration == pytest.approx(
        typical
    )


def test_repr_names_goals_limits_and_costs():
    found = ocp.Problem(MODEL, (0.5, 1.0), goals=[ocp.AtRest()], costs=[ocp.Effort()])
    assert repr(found) == "Problem(duration=(0.5, 1.0), AtRest, Effort)"

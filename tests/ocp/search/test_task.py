"""Problems that have no solution are refused before solving: by what, by how much, and why."""

from __future__ import annotations

import re

import numpy as np
import pytest
from planning import driven, prism

import ocp
import tenscasadi as tc
from ocp.problem.limit_conflict import LimitCheck
from ocp.problem.scaling import Scales
from ocp.search.task import check_end
from ocp.targets.find_target import find_target

MODEL = driven(prism(1.0, bar_radius=0.005, stiffness=1000.0))


RISE = (ocp.StringLengths(prism(1.1).string_lengths), ocp.AtRest())


LEAST = ocp.ForceDensityLimits(5.0, 100.0)


def arm():
    nodes = [(0, 0, 0), (0, 0, 1.0), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0)]
    return tc.Structure(
        nodes, bars=[(0, 1)], strings=[(1, 2), (1, 3), (1, 4), (1, 5)], pinned=[0, 2, 3, 4, 5]
    )


def asked(*bounds, goals=RISE, duration=1.0, model=MODEL, start=None):
    return ocp.Problem(
        model, duration, start, goals=goals, bounds=[LEAST, *bounds], costs=[ocp.Effort()]
    )


REFUSED = {
    "bars are too short": (
        lambda: asked(goals=[ocp.StringLengths({0: 3.0})], model=driven(tc.shapes.d_bar())),
        ("string 0 misses its goal by", "bar", "keeps its length", "give goals that fit the bars"),
    ),
    "goals contradict each other": (
        lambda: asked(
            goals=[
                ocp.NodePositions({0: (0.5, None, None)}),
                ocp.NodePositions({0: (0.7, None, None)}),
            ]
        ),
        ("node 0 x misses its goal by",),
    ),
    "the center of mass would move": (
        lambda: asked(goals=[ocp.NodePositions(prism(1.0).nodes + [0.3, 0, 0])]),
        ("misses its goal by 0.3", "center of mass", "pin a node"),
    ),
    "a spin would stop": (
        lambda: asked(
            goals=[ocp.AtRest()],
            start=MODEL.state(prism(1.0).nodes, np.cross([0, 0, 1.0], prism(1.0).nodes)),
        ),
        ("AtRest", "m/s", "angular momentum"),
    ),
    "a flat structure would leave its plane": (
        lambda: asked(
            goals=[ocp.NodePositions({1: (None, None, 0.2)})],
            model=driven(tc.shapes.d_bar(pinned=[0])),
        ),
        ("node 1 z misses its goal by", "plane"),
    ),
    "a waypoint is out of reach": (
        lambda: asked(
            goals=[ocp.Waypoint([ocp.StringLengths({0: 3.0})], time=0.5)],
            model=driven(tc.shapes.d_bar()),
        ),
        ("waypoint at 0.5 of the duration", "string 0 misses", "bar"),
    ),
    "a gait would need a push": (
        lambda: asked(goals=[ocp.Periodic((0.5, 0, 0))]),
        (" x misses its goal by 0.5", "center of mass"),
    ),
    "a falling prism would stay": (
        lambda: asked(goals=[ocp.AtRest()], model=driven(prism(1.0), gravity=tc.Gravity())),
        (
            "AtRest: node",
            "misses its goal by 9.8",
            "m/s",
            "the center of mass keeps its speed along z",
        ),
    ),
    "limits leave nothing": (
        lambda: asked(ocp.ForceDensityLimits(0.0, 4.0)),
        ("ForceDensityLimits leave string 0 nothing", "lower 5 and upper 4"),
    ),
    "the start is out of bounds": (
        lambda: asked(ocp.AboveGround(0.2)),
        ("Problem.start has z of node 0 at 0", "start within them"),
    ),
    "a pin is out of bounds": (
        lambda: asked(ocp.AboveGround(0.2), goals=[], model=driven(arm())),
        ("leaves out node 0, pinned at z = 0",),
    ),
    "a pinned node would move": (
        lambda: asked(goals=[ocp.NodePositions({0: (None, None, 1.0)})], model=driven(arm())),
        ("which is pinned at 0 m", "leave that axis None"),
    ),
    "limits contradict each other at the start": (
        lambda: asked(ocp.BarForceLimits(compression=5.0)),
        (
            "leave no controls at the start: compression of bar",
            "has to be at most 5 N",
            "is 9.17",
            "widen one",
        ),
    ),
    "a constraint is broken at the start": (
        lambda: asked(
            ocp.Constraint("height", lambda now: now.nodes[2, 3] - now.nodes[2, 0], upper=0.5)
        ),
        ("height has to be at most 0.5", "is 1"),
    ),
    "the goal is in the obstacle": (
        lambda: asked(
            ocp.Obstacle((0.6, 0.0, 0.8), 0.2),
            goals=[ocp.NodePositions({1: (0.6, 0.0, 0.8)}), ocp.AtRest()],
            model=driven(arm()),
        ),
        (
            "NodePositions: node 1 x and obstacle clear of node 1 has to be at least 0.2 m, and is",
            "where the goals are met: move the goal",
        ),
    ),
    "the goal of one end of a bar is in the obstacle": (
        lambda: asked(
            ocp.Obstacle((0.5, 0.0, 1.2), 0.05), goals=[ocp.NodePositions({3: (0.5, 0.0, 1.2)})]
        ),
        (
            "NodePositions: node 3 x and obstacle clear of node 3 has to be at least 0.05 m, and is",
            "where the goals are met: move the goal",
        ),
    ),
    "the goal is outside the box": (
        lambda: asked(
            ocp.InsideBox(upper=(0.5, None, None), nodes=[1]),
            goals=[ocp.NodePositions({1: (0.6, 0.0, None)})],
            model=driven(arm()),
        ),
        (
            "NodePositions: node 1 x and x of node 1 has to be at most 0.5 m, and is 0.6 where the goals are met",
        ),
    ),
    "limits contradict each other at the goal": (
        lambda: asked(
            ocp.TensionLimits(upper=8.0),
            goals=[ocp.NodePositions({1: (0.6, 0.0, 0.8)}), ocp.AtRest()],
            model=driven(arm()),
        ),
        (
            "leave no controls where the goals are met: tension of string",
            "has to be at most 8 N",
            "is 8.9",
            "widen one, or move the goal",
        ),
    ),
    "a shape has other bars": (
        lambda: asked(goals=[ocp.Shape(2 * prism(1.0).nodes)]),
        ("Shape.nodes make bar 0 2.8 m long, not 1.4 m",),
    ),
}


ALLOWED = {
    "a shape may be anywhere": lambda: asked(
        ocp.InsideBox(upper=(None, None, 2.0)), goals=[ocp.StringLengths(prism(1.1).string_lengths)]
    ),
    "what the goal leaves open may be elsewhere": lambda: asked(
        ocp.Obstacle((0.4, 0.0, 0.9), 0.2, bars=[], nodes=[1]),
        goals=[ocp.NodePositions({1: (0.4, None, None)}), ocp.AtRest()],
        model=driven(arm()),
    ),
    "the goal leaves a branch outside the obstacle": lambda: asked(
        ocp.Obstacle((0.6, 0.0, 0.8), 0.2),
        goals=[ocp.NodePositions({1: (0.6, 0.0, None)}), ocp.AtRest()],
        model=driven(arm()),
    ),
    "only just": lambda: asked(
        ocp.InsideBox(upper=(0.6, None, None), nodes=[1]),
        goals=[ocp.NodePositions({1: (0.6, 0.0, None)}), ocp.AtRest()],
        model=driven(arm()),
    ),
}


@pytest.mark.parametrize("name", ALLOWED)
def test_what_may_be_is_not_refused(name):
    problem = ALLOWED[name]()
    check_end(LimitCheck(problem), find_target(problem, Scales.of(problem)))


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_before_solving(name):
    make, words = REFUSED[name]
    with pytest.raises(ValueError, match=re.escape(words[0])) as caught:
        ocp.solve(make(), ocp.MultipleShooting(8))
    for word in words:
        assert word in str(caught.value)

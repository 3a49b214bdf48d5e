"""The table of definitions of what [plan] holds: goals, bounds, costs, phases, how it is solved. Reading, writing and the schema come from it."""

from __future__ import annotations

from ocp.files.forms import LIMITS, PLAIN, MovingPlace, OfStructure, Pair
from ocp.problem import costs
from ocp.problem.bounds import bar_bounds, geometric_bounds, string_bounds
from ocp.problem.bounds.ground_bounds import AboveSurface
from ocp.problem.goals import goal, node_goals
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.phase import Phase
from ocp.problem.problem import FreeStart
from ocp.problem.tracking import Tracking
from ocp.sampling.solver import Sampling
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.fatrop import Fatrop
from ocp.solvers.ipopt import Ipopt
from ocp.transcription.collocation import Collocation, ImplicitMidpoint
from ocp.transcription.initial_guess import Arrays, Equilibrium, InverseDynamics
from ocp.transcription.mesh import PiecewiseConstant, PiecewiseLinear
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.variational import Variational
from tenscasadi.files.containers import Either, ListOf, MapOf, TableOf
from tenscasadi.files.definitions import Kind, define
from tenscasadi.files.forms import (
    NUMBER,
    PER_ITEM,
    VECTOR,
    WHOLE,
    Coordinates,
    Flag,
    Form,
    Indices,
    Numbers,
    Which,
    Word,
)
from tenscasadi.files.scene_table import SURFACE
from tenscasadi.files.simulation_table import SCHEME

NODES = OfStructure("nodes", Numbers(((None, 3),)))
SPAN = Numbers(((), (2,)))  # one number, or the least and the greatest
PLACE = Coordinates()
_GROUPS = ListOf(Indices("string"))


def _some(which: Which, form: Form, every: Form) -> Either:
    """Return the form of a table of some, or of values for all."""
    return Either((dict,), MapOf(which, form), every)


_AT_AN_INSTANT = (
    define(
        goal.StringLengths,
        {"lengths": OfStructure("string_lengths", _some("string", NUMBER, PER_ITEM))},
    ),
    define(goal.Shape, {"nodes": NODES}),
    define(
        node_goals.NodePositions,
        {"positions": OfStructure("nodes", _some("node", PLACE, Numbers(((None, 3),))))},
    ),
    define(
        node_goals.NodeVelocities,
        {"velocities": OfStructure("nodes", _some("node", PLACE, Numbers(((None, 3),))))},
    ),
    define(node_goals.CentreOfMass, {"position": PLACE, "masses": PER_ITEM}),
    define(node_goals.AtRest),
    define(Periodic, {"shift": PLACE, "start": Pair(NODES)}),
)
_SOFT = define(goal.SoftGoal, {"goal": Kind(_AT_AN_INSTANT), "weight": NUMBER})
_WAYPOINT = define(
    Waypoint, {"goals": ListOf(Kind((*_AT_AN_INSTANT, _SOFT))), "time": SPAN, "share": NUMBER}
)

GOALS = ListOf(Kind((*_AT_AN_INSTANT, _SOFT, _WAYPOINT)))
BOUNDS = ListOf(
    Kind(
        (
            define(string_bounds.ForceDensityLimits, {"lower": LIMITS, "upper": LIMITS}),
            define(string_bounds.TensionLimits, {"lower": LIMITS, "upper": LIMITS}),
            define(
                string_bounds.RestLengthLimits,
                {"lower": LIMITS, "upper": LIMITS, "stiffness": PER_ITEM},
            ),
            define(string_bounds.RestLengthRateLimits, {"speed": LIMITS, "stiffness": PER_ITEM}),
            define(string_bounds.ForceDensityRateLimits, {"rate": LIMITS}),
            define(bar_bounds.BarForceLimits, {"compression": LIMITS, "tension": LIMITS}),
            define(bar_bounds.Buckling, {"modulus": PER_ITEM, "safety": NUMBER}),
            define(
                geometric_bounds.InsideBox,
                {"lower": PLACE, "upper": PLACE, "nodes": Indices("node")},
            ),
            define(geometric_bounds.AboveGround, {"height": NUMBER, "nodes": Indices("node")}),
            define(AboveSurface, {"ground": SURFACE, "distance": NUMBER, "nodes": Indices("node")}),
            define(
                geometric_bounds.BarClearance, {"distance": NUMBER, "pairs": ListOf(Indices("bar"))}
            ),
            define(
                geometric_bounds.Obstacle,
                {
                    "centre": VECTOR,
                    "radius": NUMBER,
                    "bars": Indices("bar"),
                    "nodes": Indices("node"),
                },
            ),
        )
    )
)
COSTS = ListOf(
    Kind(
        (
            define(costs.Effort, {"weight": NUMBER}),
            define(costs.Smoothness, {"weight": NUMBER}),
            define(costs.Prestress, {"level": PER_ITEM, "weight": NUMBER}),
            define(Tracking, {"positions": MapOf("node", MovingPlace()), "weight": NUMBER}),
            define(costs.Duration, {"weight": NUMBER}),
            define(costs.Work, {"weight": NUMBER, "smoothing": NUMBER}),
        )
    )
)
PHASES = ListOf(
    Kind(
        (
            define(
                Phase,
                {
                    "duration": SPAN,
                    "stands": Indices("node"),
                    "goals": GOALS,
                    "bounds": BOUNDS,
                    "until": SPAN,
                },
            ),
        )
    )
)
_STATE = Numbers(((None, 3), (None,)))
_FREE_START = Kind((define(FreeStart, {"near": OfStructure("nodes", _STATE), "goals": GOALS}),))
START = OfStructure(
    "nodes",
    Either(
        (str,), Word(("structure", "FreeStart")), Either((dict, FreeStart), _FREE_START, _STATE)
    ),
)

_MESH = {
    "intervals": Either((list, tuple), Numbers(((None,),)), WHOLE),
    "control": Kind(
        (
            define(PiecewiseConstant, {"groups": _GROUPS, "changes": WHOLE}),
            define(PiecewiseLinear, {"groups": _GROUPS}),
        )
    ),
    "accuracy": NUMBER,
}
TRANSCRIPTION = Kind(
    (
        define(MultipleShooting, {**_MESH, "scheme": SCHEME, "substeps": WHOLE}),
        define(ImplicitMidpoint, _MESH),
        define(Variational, _MESH),
        define(Collocation, {**_MESH, "degree": WHOLE}),
    )
)
_NEWTON = {"max_iterations": WHOLE, "tolerance": NUMBER, "verbose": Flag()}
_SAMPLES = dict.fromkeys(
    ("knots", "samples", "seed", "rounds", "iterations", "attempts", "threads"), WHOLE
)
SOLVER = Kind(
    (
        define(
            Ipopt,
            {
                **_NEWTON,
                "options": TableOf(PLAIN),
                "seconds": NUMBER,
                "warm": Flag(),
                "restart": Flag(),
            },
        ),
        define(CondensedNewton, _NEWTON),
        define(Fatrop, {**_NEWTON, "options": TableOf(PLAIN)}),
        define(Sampling, {"groups": _GROUPS, **_SAMPLES, "verbose": Flag()}),
    )
)
GUESS = Kind(
    (
        define(
            InverseDynamics, {"path": Numbers(((None, None, 3),)), "noise": NUMBER, "seed": WHOLE}
        ),
        define(Equilibrium),
        define(
            Arrays,
            {
                "states": Numbers(((None, None),)),
                "force_density": Numbers(((None, None),)),
                "duration": NUMBER,
            },
        ),
    )
)

"""Plans of force densities for tensegrity structures: problem → transcription → solver → plan, replayed by tenscasadi.

Goals, bounds, costs, guesses and options are values. Each raises TypeError or ValueError, naming the field and what would be right, where it is
made, or where a `Problem` learns which structure it is for.
"""

from __future__ import annotations

from ocp.best import Progress
from ocp.bounds import BarForceLimits, Buckling, ForceDensityLimits, RestLengthLimits, RestLengthRateLimits, TensionLimits
from ocp.closed_loop import ClosedLoop, run
from ocp.collocation import Collocation
from ocp.costs import Duration, Effort, Prestress, Smoothness, Tracking, Work
from ocp.duals import Duals
from ocp.export import export_mpc, export_program
from ocp.expressions import AtEnd, Constraint, Integral
from ocp.fatrop import Fatrop
from ocp.goals import AtRest, NodePositions, Shape, StringLengths
from ocp.grid import PiecewiseConstant, PiecewiseLinear
from ocp.guesses import Arrays, Equilibrium, InverseDynamics
from ocp.implicit import ImplicitMidpoint
from ocp.instant import Instant
from ocp.invariants import UnreachableGoal
from ocp.ipopt import Ipopt
from ocp.motions import Periodic, Waypoint
from ocp.mpc import Mpc
from ocp.places import AboveGround, BarClearance, InsideBox, Obstacle
from ocp.plan import Plan
from ocp.problem import FreeStart, Problem
from ocp.report import Report
from ocp.solve import solve
from ocp.track import Tracker, track
from ocp.transcription import MultipleShooting
from ocp.variational import Variational
from ocp.winding import reachable, replay_wound

__all__ = [
    # what is asked
    "Problem",
    "FreeStart",
    "StringLengths",
    "NodePositions",
    "Shape",
    "AtRest",
    "Periodic",
    "Waypoint",
    "ForceDensityLimits",
    "TensionLimits",
    "RestLengthLimits",
    "RestLengthRateLimits",
    "BarForceLimits",
    "Buckling",
    "InsideBox",
    "AboveGround",
    "BarClearance",
    "Obstacle",
    "Effort",
    "Smoothness",
    "Prestress",
    "Tracking",
    "Duration",
    "Work",
    "Instant",
    "Constraint",
    "Integral",
    "AtEnd",
    # how it is solved
    "MultipleShooting",
    "ImplicitMidpoint",
    "Variational",
    "Collocation",
    "PiecewiseConstant",
    "PiecewiseLinear",
    "Ipopt",
    "Fatrop",
    "Progress",
    "solve",
    # where it starts
    "InverseDynamics",
    "Equilibrium",
    "Arrays",
    # what comes of it
    "Plan",
    "UnreachableGoal",
    "Duals",
    "Report",
    "replay_wound",
    "reachable",
    # in closed loop
    "Mpc",
    "Tracker",
    "track",
    "run",
    "ClosedLoop",
    # as C
    "export_program",
    "export_mpc",
]

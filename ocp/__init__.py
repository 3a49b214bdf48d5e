"""Optimal control of tensegrity structures.

Data flows one way: problem → transcription → solver → plan → replay by `tenscasadi.simulate`.
Goals, bounds, costs, guesses and options are immutable values. A wrong value raises TypeError or
ValueError when it is created, or when a `Problem` combines it with a structure. The message names
the field, the value and the cure.
"""

from __future__ import annotations

from ocp.acados import export_acados
from ocp.control.closed_loop import ClosedLoop, run
from ocp.control.lqr import Tracker, track
from ocp.control.mpc import Mpc
from ocp.control.mppi import Mppi
from ocp.export import export_mpc, export_program
from ocp.guess.initial_guess import EquilibriumGuess, InverseDynamics, TrajectoryGuess
from ocp.io.problem_files import (
    load_problem,
    load_solve_arguments,
    load_studies,
    save_problem,
)
from ocp.plan.plan import Plan
from ocp.plan.robustness import Robustness
from ocp.problem.bounds.acceleration_bounds import NodeAccelerationLimits
from ocp.problem.bounds.bar_bounds import BarForceLimits, Buckling
from ocp.problem.bounds.geometric_bounds import AboveGround, BarClearance, InsideBox, Obstacle
from ocp.problem.bounds.ground_bounds import AboveSurface
from ocp.problem.bounds.momentum_bounds import AngularMomentumLimits, CenterOfMassVelocityLimits
from ocp.problem.bounds.string_bounds import (
    ForceDensityLimits,
    ForceDensityRateLimits,
    RestLengthLimits,
    RestLengthRateLimits,
    TensionLimits,
)
from ocp.problem.bounds.terminal_bounds import TerminalTensions
from ocp.problem.costs import Duration, Effort, Prestress, Smoothness, Work
from ocp.problem.expressions import AtEnd, Constraint, Integral
from ocp.problem.goals.body_goals import BodyOrientation
from ocp.problem.goals.goal import Shape, SoftGoal, StringLengths
from ocp.problem.goals.momentum_goals import AngularMomentum, CenterOfMassVelocity
from ocp.problem.goals.node_goals import AtRest, CenterOfMass, NodePositions, NodeVelocities
from ocp.problem.goals.orientation_goals import BarOrientation, NodeTripleOrientation
from ocp.problem.goals.periodic import Periodic
from ocp.problem.goals.waypoints import Waypoint
from ocp.problem.instant import Instant
from ocp.problem.instant_formula import InstantFormula
from ocp.problem.phase import Phase
from ocp.problem.problem import Problem
from ocp.problem.start import FreeStart
from ocp.problem.tracking import Tracking
from ocp.renamed import __getattr__ as __getattr__
from ocp.results.actuation import is_realizable, replay_rest_lengths
from ocp.results.report import Report
from ocp.sampling.solver import Sampling
from ocp.sampling.spline_noise import SplineNoise
from ocp.solve import solve
from ocp.solvers.condensed_newton import CondensedNewton
from ocp.solvers.ipopt import Ipopt
from ocp.solvers.monitor import Progress
from ocp.solvers.multipliers import Duals
from ocp.targets.infeasible_goal import Certificate, InfeasibleGoalError, TargetNotFoundWarning
from ocp.transcription.direct_collocation import DirectCollocation, ImplicitMidpoint
from ocp.transcription.mesh import PiecewiseConstant, PiecewiseLinear
from ocp.transcription.multiple_shooting import MultipleShooting
from ocp.transcription.variational import Variational

__all__ = [
    # problem
    "Problem",
    "FreeStart",
    "Phase",
    "StringLengths",
    "NodePositions",
    "NodeVelocities",
    "Shape",
    "BodyOrientation",
    "BarOrientation",
    "NodeTripleOrientation",
    "CenterOfMass",
    "CenterOfMassVelocity",
    "AngularMomentum",
    "AtRest",
    "Periodic",
    "Waypoint",
    "SoftGoal",
    "ForceDensityLimits",
    "ForceDensityRateLimits",
    "TensionLimits",
    "TerminalTensions",
    "RestLengthLimits",
    "RestLengthRateLimits",
    "BarForceLimits",
    "Buckling",
    "InsideBox",
    "CenterOfMassVelocityLimits",
    "AngularMomentumLimits",
    "NodeAccelerationLimits",
    "AboveGround",
    "AboveSurface",
    "BarClearance",
    "Obstacle",
    "Effort",
    "Smoothness",
    "Prestress",
    "Tracking",
    "Duration",
    "Work",
    "Instant",
    "InstantFormula",
    "Constraint",
    "Integral",
    "AtEnd",
    # solution method
    "MultipleShooting",
    "ImplicitMidpoint",
    "Variational",
    "DirectCollocation",
    "PiecewiseConstant",
    "PiecewiseLinear",
    "Ipopt",
    "CondensedNewton",
    "Sampling",
    "Progress",
    "solve",
    # initial guess
    "InverseDynamics",
    "EquilibriumGuess",
    "TrajectoryGuess",
    # result
    "Plan",
    "InfeasibleGoalError",
    "TargetNotFoundWarning",
    "Certificate",
    "Duals",
    "Report",
    "Robustness",
    "replay_rest_lengths",
    "is_realizable",
    # files
    "load_problem",
    "load_solve_arguments",
    "load_studies",
    "save_problem",
    # closed loop
    "Mpc",
    "Mppi",
    "SplineNoise",
    "Tracker",
    "track",
    "run",
    "ClosedLoop",
    # C code
    "export_program",
    "export_mpc",
    "export_acados",
]

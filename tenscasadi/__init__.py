"""Tensegrity dynamics as CasADi Functions: structure → scene → model → simulation → trajectory.

Pictures are in `tenscasadi.plots`, which loads matplotlib and is imported by name.
"""

from __future__ import annotations

from tenscasadi import shapes
from tenscasadi.class_one import ClassOne
from tenscasadi.collocation import Collocation
from tenscasadi.compiled import CompileError
from tenscasadi.correction import BarLengthCorrection, Projection, projection
from tenscasadi.dynamics import Multipliers
from tenscasadi.export import export_c
from tenscasadi.linear import Linearization, Modes, linearize, modes
from tenscasadi.loads import Gravity, Ground, NodalForce, Pressure
from tenscasadi.mode_motion import mode_motion
from tenscasadi.model import Energy, Model
from tenscasadi.precision import Single
from tenscasadi.rattle import Rattle
from tenscasadi.recommend import NoScheme, Recommendation, recommend
from tenscasadi.redundancy import RedundantConstraints
from tenscasadi.reference import NoReference, Reference, certify
from tenscasadi.scene import Scene
from tenscasadi.schemes import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.simulate import simulate
from tenscasadi.stability import stable_step
from tenscasadi.state_space import Constraints
from tenscasadi.statics import EquilibriumError, equilibrium_force_density, self_stress
from tenscasadi.strings import Clip, ForceDensity, RestLength, Smooth
from tenscasadi.structure import Structure
from tenscasadi.sundials import Cvodes, Idas
from tenscasadi.supports import SupportMotion
from tenscasadi.table import Row, Tradeoff
from tenscasadi.tradeoff import tradeoff
from tenscasadi.trajectory import Trajectory

__all__ = [
    # what is modelled
    "Structure",
    "ClassOne",
    "shapes",
    "equilibrium_force_density",
    "self_stress",
    "EquilibriumError",
    # how
    "Scene",
    "ForceDensity",
    "RestLength",
    "Clip",
    "Smooth",
    "Gravity",
    "Ground",
    "Pressure",
    "NodalForce",
    "SupportMotion",
    # as equations
    "Model",
    "Energy",
    "Multipliers",
    "Constraints",
    "RedundantConstraints",
    "export_c",
    "linearize",
    "Linearization",
    "modes",
    "Modes",
    "mode_motion",
    # over time
    "simulate",
    "RungeKutta4",
    "DormandPrince54",
    "DormandPrince853",
    "Rattle",
    "Collocation",
    "Cvodes",
    "Idas",
    "Projection",
    "projection",
    "BarLengthCorrection",
    "Single",
    "stable_step",
    "Trajectory",
    "CompileError",
    # speed against accuracy
    "tradeoff",
    "Tradeoff",
    "Row",
    "certify",
    "Reference",
    "NoReference",
    "recommend",
    "Recommendation",
    "NoScheme",
]

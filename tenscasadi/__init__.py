"""Dynamics of tensegrity structures as CasADi Functions.

A structure in a scene gives a model, and a simulation of the model gives a trajectory. Figures are
in `tenscasadi.plots`, a module that is imported by name and loads matplotlib.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.mechanism import Multipliers
from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.observations import Energy
from tenscasadi.dynamics.state_space import Constraints
from tenscasadi.integrators.collocation import Collocation
from tenscasadi.integrators.rattle import Rattle
from tenscasadi.integrators.runge_kutta import DormandPrince54, DormandPrince853, RungeKutta4
from tenscasadi.integrators.stabilization import BarLengthCorrection, Projection, build_projection
from tenscasadi.integrators.sundials import Cvodes, Idas
from tenscasadi.io.scene_files import load_scene, save_scene
from tenscasadi.scene.bar_contact import BarContact
from tenscasadi.scene.breaking import Breaking, Yielding
from tenscasadi.scene.control_function import ControlFunction
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.parameter_layout import ParameterLayout
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, ForceDensity, Linear, RestLength, Smooth, Tension
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.scene.terrain import Terrain
from tenscasadi.scene.winches import RestLengthRate, Winch
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.simulation.declared import Simulation
from tenscasadi.simulation.inputs.feedback import Feedback
from tenscasadi.simulation.motions import Rollouts
from tenscasadi.simulation.rollouts import rollouts
from tenscasadi.simulation.simulate import simulate
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure import shapes
from tenscasadi.structure.class_one import ClassOne
from tenscasadi.structure.rigid_body import RigidBody
from tenscasadi.structure.structure import Structure
from tenscasadi.util.compile import CompileError, Single
from tenscasadi.util.renamed import find_attribute
from tenscasadi.version import __version__ as __version__

if TYPE_CHECKING:
    from tenscasadi.analysis.mode_motion import mode_motion
    from tenscasadi.analysis.modes import Linearization, Modes, linearize, modes
    from tenscasadi.analysis.recommend import NoSchemeError, Recommendation, recommend
    from tenscasadi.analysis.reference_solution import (
        NoReferenceError,
        ReferenceSolution,
        reference_solution,
    )
    from tenscasadi.analysis.tradeoff import tradeoff
    from tenscasadi.analysis.tradeoff_table import Tradeoff, TradeoffRow
    from tenscasadi.design.find_prestress import PrestressDesign, find_prestress
    from tenscasadi.design.form_find import Form, form_find
    from tenscasadi.design.prestress_goals import Even, Least, Stiffest
    from tenscasadi.design.sizing.material import Material
    from tenscasadi.design.sizing.size import size
    from tenscasadi.design.sizing.sized import Sized
    from tenscasadi.exchange.fmu import export_fmu
    from tenscasadi.exchange.gltf import export_gltf
    from tenscasadi.exchange.jax_function import to_jax
    from tenscasadi.exchange.matlab.save import save_mat
    from tenscasadi.exchange.matlab.structures import load_mat
    from tenscasadi.exchange.matlab.trajectories import load_mat_trajectory
    from tenscasadi.exchange.mjcf import export_mjcf, import_mjcf
    from tenscasadi.exchange.ntrt.load import load_ntrt
    from tenscasadi.exchange.ntrt.save import save_ntrt
    from tenscasadi.exchange.source import InexactImportWarning
    from tenscasadi.exchange.vtk import export_vtk
    from tenscasadi.integrators.stability import stable_step
    from tenscasadi.simulation.export import export_c
    from tenscasadi.simulation.sensitivities import Sensitivities, sensitivities
    from tenscasadi.simulation.simulation_files import load_simulation
    from tenscasadi.statics.buckling import BucklingFactor, buckling_factor
    from tenscasadi.statics.equilibrium import Equilibrium, find_equilibrium
    from tenscasadi.statics.force_density import EquilibriumError, equilibrium_force_density
    from tenscasadi.statics.load_path import LoadPath, load_path
    from tenscasadi.statics.self_stress import self_stress
    from tenscasadi.statics.stability import Stability, stability
    from tenscasadi.sweeps.sweep import sweep
    from tenscasadi.sweeps.sweep_table import Sweep

# modules that simulations do not need are imported at first use
__getattr__ = find_attribute(
    __name__,
    {
        "tenscasadi.analysis.reference_solution": (
            "NoReferenceError",
            "ReferenceSolution",
            "reference_solution",
        ),
        "tenscasadi.analysis.mode_motion": ("mode_motion",),
        "tenscasadi.analysis.modes": ("Linearization", "Modes", "linearize", "modes"),
        "tenscasadi.analysis.recommend": ("NoSchemeError", "Recommendation", "recommend"),
        "tenscasadi.analysis.tradeoff": ("tradeoff",),
        "tenscasadi.analysis.tradeoff_table": ("TradeoffRow", "Tradeoff"),
        "tenscasadi.design.find_prestress": ("PrestressDesign", "find_prestress"),
        "tenscasadi.design.form_find": ("Form", "form_find"),
        "tenscasadi.design.prestress_goals": ("Even", "Least", "Stiffest"),
        "tenscasadi.design.sizing.material": ("Material",),
        "tenscasadi.design.sizing.size": ("size",),
        "tenscasadi.design.sizing.sized": ("Sized",),
        "tenscasadi.exchange.fmu": ("export_fmu",),
        "tenscasadi.exchange.gltf": ("export_gltf",),
        "tenscasadi.exchange.jax_function": ("to_jax",),
        "tenscasadi.exchange.matlab.save": ("save_mat",),
        "tenscasadi.exchange.matlab.structures": ("load_mat",),
        "tenscasadi.exchange.matlab.trajectories": ("load_mat_trajectory",),
        "tenscasadi.exchange.mjcf": ("export_mjcf", "import_mjcf"),
        "tenscasadi.exchange.ntrt.load": ("load_ntrt",),
        "tenscasadi.exchange.ntrt.save": ("save_ntrt",),
        "tenscasadi.exchange.source": ("InexactImportWarning",),
        "tenscasadi.exchange.vtk": ("export_vtk",),
        "tenscasadi.integrators.stability": ("stable_step",),
        "tenscasadi.simulation.export": ("export_c",),
        "tenscasadi.simulation.sensitivities": ("Sensitivities", "sensitivities"),
        "tenscasadi.simulation.simulation_files": ("load_simulation",),
        "tenscasadi.statics.buckling": ("BucklingFactor", "buckling_factor"),
        "tenscasadi.statics.equilibrium": ("Equilibrium", "find_equilibrium"),
        "tenscasadi.statics.force_density": ("EquilibriumError", "equilibrium_force_density"),
        "tenscasadi.statics.load_path": ("LoadPath", "load_path"),
        "tenscasadi.statics.self_stress": ("self_stress",),
        "tenscasadi.statics.stability": ("Stability", "stability"),
        "tenscasadi.sweeps.sweep": ("sweep",),
        "tenscasadi.sweeps.sweep_table": ("Sweep",),
    },
    renamed={
        "certify": "reference_solution",
        "Reference": "ReferenceSolution",
        "NoReference": "NoReferenceError",
        "NoScheme": "NoSchemeError",
        "Row": "TradeoffRow",
        "projection": "build_projection",
    },
)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    # structure and statics
    "Structure",
    "RigidBody",
    "ClassOne",
    "shapes",
    "equilibrium_force_density",
    "self_stress",
    "EquilibriumError",
    "find_equilibrium",
    "Equilibrium",
    "stability",
    "Stability",
    "buckling_factor",
    "BucklingFactor",
    "load_path",
    "LoadPath",
    # design
    "form_find",
    "Form",
    "find_prestress",
    "PrestressDesign",
    "Stiffest",
    "Even",
    "Least",
    "size",
    "Sized",
    "Material",
    # scene
    "Scene",
    "ForceDensity",
    "RestLength",
    "RestLengthRate",
    "Winch",
    "Yielding",
    "Tension",
    "Clip",
    "Linear",
    "Smooth",
    "Gravity",
    "BarContact",
    "Breaking",
    "Ground",
    "Terrain",
    "Pressure",
    "NodalForce",
    "ControlFunction",
    "SupportMotion",
    "Parameters",
    "ParameterLayout",
    # equations
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
    # simulation
    "simulate",
    "RungeKutta4",
    "DormandPrince54",
    "DormandPrince853",
    "Rattle",
    "Collocation",
    "Cvodes",
    "Idas",
    "Projection",
    "build_projection",
    "BarLengthCorrection",
    "Single",
    "stable_step",
    "Trajectory",
    "sensitivities",
    "Sensitivities",
    "CompileError",
    # other programs' files
    "export_gltf",
    "export_fmu",
    "to_jax",
    "export_mjcf",
    "export_vtk",
    "import_mjcf",
    "load_mat",
    "load_mat_trajectory",
    "load_ntrt",
    "save_mat",
    "save_ntrt",
    "InexactImportWarning",
    # batches
    "rollouts",
    "Rollouts",
    "Feedback",
    "sweep",
    "Sweep",
    # scene files
    "load_scene",
    "save_scene",
    "load_simulation",
    "Simulation",
    "SceneFileError",
    # accuracy
    "tradeoff",
    "Tradeoff",
    "TradeoffRow",
    "reference_solution",
    "ReferenceSolution",
    "NoReferenceError",
    "recommend",
    "Recommendation",
    "NoSchemeError",
]

"""Inputs of an interactive simulation: control, forces and gravity."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import Gravity, NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.strings import RestLength

LOADS = "forces", "gravity"


def add_inputs(model: Model, values: Any = None) -> Model:
    """Add a control, forces on nodes and gravity to a model.

    Constant forces and gravity become parameters, as do those of the model, whose values become
    nominal. One compiled loop then serves all their values.
    """
    own = model.scene.parameters
    declared = () if own is None else (*own.names, *own.scale)
    scene = model.with_parameters(values).scene.locked  # sliders set rest lengths
    if scene.control is None and len(scene.structure.strings):
        scene = replace(scene, control=RestLength())
    forces = scene.forces or NodalForce(np.zeros((len(scene.structure.nodes), 3)))
    gravity = scene.gravity or Gravity((0.0, 0.0, 0.0))
    names = [name for name, load in zip(LOADS, (forces, gravity), strict=True) if not load.varies]
    names += [name for name in declared if name not in LOADS]
    parameters = Parameters(*names) if names else None
    scene = replace(scene, forces=forces, gravity=gravity, parameters=parameters)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)  # the given model has warned
        return model.with_scene(scene)

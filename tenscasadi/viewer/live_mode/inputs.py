"""Inputs of an interactive simulation."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from tenscasadi.dynamics.constraint_forces import RedundantConstraints
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.strings import RestLength


def add_inputs(model: Model) -> Model:
    """Add a control and forces on nodes to a model.

    The forces are parameters, so that one compiled loop serves all pulls.
    """
    scene = model.scene
    if scene.control is None and len(scene.structure.strings):
        scene = replace(scene, control=RestLength())
    forces = scene.forces or NodalForce(np.zeros((len(scene.structure.nodes), 3)))
    if not forces.varies:
        scene = replace(scene, forces=forces, parameters=Parameters("forces"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RedundantConstraints)  # the given model has warned
        constant = model.mechanism.constant_length
        return Model(scene, model.coordinates, "constant" if constant else "current")

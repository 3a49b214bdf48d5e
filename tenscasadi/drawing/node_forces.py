"""Forces on nodes for arrows: loads, contact forces and reactions."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.drawing.view_content import Frame, NodeForces
from tenscasadi.dynamics.constraint_forces import nodal_forces
from tenscasadi.dynamics.equation_of_motion import forward_dynamics
from tenscasadi.dynamics.forces import total
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.bar_points import press_spheres
from tenscasadi.scene.binding import fix
from tenscasadi.scene.contact_law import compute_forces
from tenscasadi.scene.scene import Scene
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.util.validate import Array


def describe_scene_forces(scene: Scene, delay: float = 0.0) -> tuple[NodeForces, ...]:
    """List loads and contact forces of a scene without parameters.

    The clock of the scene is `delay` [s] ahead of the time of the frames.
    """
    found = []
    if scene.forces is not None or scene.pressure is not None:
        found.append(NodeForces("load", lambda frame: _find_loads(scene, frame, delay)))
    if scene.grounds:
        found.append(NodeForces("contact", lambda frame: _find_contact_forces(scene, frame)))
    return tuple(found)


def describe_trajectory_forces(trajectory: Trajectory) -> tuple[NodeForces, ...]:
    """List loads, contact forces and reactions of a trajectory.

    There are none if its scene is unknown.
    """
    if trajectory.scene is None:
        return ()
    scene = fix(trajectory.scene, trajectory.parameters)
    clock = trajectory.states[0, -1] if scene.has_clock else trajectory.time[0]
    found = describe_scene_forces(scene, float(clock - trajectory.time[0]))
    if not len(trajectory.pinned):
        return found

    @cache  # models take time to build, and reactions are often not shown
    def build() -> Any:
        return _build_reactions(scene, trajectory.states.shape[1])

    def find(frame: Frame) -> Array:
        reactions = build()
        states, controls = trajectory.states[frame.row], trajectory.control[frame.row]
        return np.zeros_like(frame.nodes) if reactions is None else reactions(states, controls)

    return (*found, NodeForces("reaction", find))


def _find_loads(scene: Scene, frame: Frame, delay: float) -> Array:
    """Compute nodal forces and pressure (n, 3) [N].

    They act at the time of the frame. `delay` [s] is the time of the scene at the frame's time 0.
    """
    time, loads = frame.time + delay, np.zeros_like(frame.nodes)
    if scene.forces is not None:
        given = np.asarray(ca.DM(scene.forces.at(time)))
        loads[: given.shape[1]] += given.T  # nodes inside strings have none
    if scene.pressure is not None:
        loads += np.asarray(ca.DM(scene.pressure.forces(ca.DM(frame.nodes.T), time))).T
    return loads


def _find_contact_forces(scene: Scene, frame: Frame) -> Array:
    """Compute the forces of grounds (n, 3) [N].

    They act on the nodes of the frame.
    """
    found = np.zeros_like(frame.nodes)
    velocities = found if frame.velocities is None else frame.velocities
    N, V = ca.DM(frame.nodes.T), ca.DM(velocities.T)
    for ground in scene.grounds:
        nodes = ground.select_nodes(scene.modelled).tolist()
        if nodes:
            found[nodes] += np.asarray(ca.DM(ground.forces(N[:, nodes], V[:, nodes]))).T
        capsules = ground.select_bar_points(scene.modelled)
        if len(capsules.bars):
            ends = scene.modelled.bars[capsules.bars]
            contact, points = press_spheres(ground, capsules, ends, N)
            F = compute_forces(ground, contact, points.velocities(N, V))
            np.add.at(found, points.columns, np.asarray(ca.DM(points.end_forces(N, F))).T)
    return found


def _build_reactions(scene: Scene, size: int) -> Any:
    """Build the function that computes reactions (n, 3) [N].

    Its arguments are a state of a given size and a control. Returns None if no coordinates of the
    scene have this size.

    Reactions balance the momentum of each node: N̈ M − F − B λ̂ C_b (Eq. 85). Forces between the bars
    of a joint add up to zero.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the simulation has warned
        models = (Model(scene, coordinates) for coordinates in (None, "reduced", "full"))
        model = next((model for model in models if model.nx == size), None)
    if model is None:
        return None
    x, w = model.symbols(False)
    N, V, time = model.unpack(x)
    u = model.extend_inputs(x, w)
    accelerations, multipliers, _ = forward_dynamics(model, N, V, u, time)
    mech = model.with_masses(u, inverse=False)
    pushed = total(scene, mech, N, V, u, time)
    pushed += nodal_forces(mech, mech.bar_vectors(N), multipliers)
    lacking = mech.gather(ca.mtimes(accelerations, ca.DM(mech.M.tocsc())) - pushed)
    function = ca.Function("reactions", [x, w], [lacking])
    held = np.asarray(scene.modelled.held).any(axis=1, keepdims=True)

    def find(state: Array, control: Array) -> Array:
        columns = function(state, control).full().T
        nodes = np.zeros((held.shape[0], 3))
        np.add.at(nodes, mech.physical, columns)
        return np.where(held, nodes, 0.0)

    return find

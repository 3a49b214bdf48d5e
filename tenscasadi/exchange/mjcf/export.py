"""Export of scenes to MuJoCo.

Bars become bodies, and strings become spatial tendons.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET  # to write alone

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.exchange.mjcf.body_tree import build_tree, find_held_directions
from tenscasadi.exchange.mjcf.writer import AXIAL, MjcfWriter
from tenscasadi.scene.ground import Ground
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Smooth
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.structure import Structure
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    Array,
    FilePath,
    choice,
    file_path,
    finite_array,
    flag,
    instance,
    positive_number,
)
from tenscasadi.util.whole_file import whole_file

_LEAST = 1e-15  # kg and kg m²: MuJoCo's minimum for a moving body


def export_mjcf(
    scene: Scene,
    path: FilePath,
    velocities: ArrayLike | None = None,
    joints: Literal["ball", "connect"] = "ball",
    step: float = 1e-3,
    *,
    strict: bool = True,
) -> Path:
    """Write a scene as MuJoCo's XML, MJCF.

    Bars become bodies ``bar0``, ``bar1`` …, nodes become sites ``n0``, ``n1`` …, and strings or
    their segments become spatial tendons ``string0``, ``string1`` … The reference configuration is
    that of the structure.

    Parameters
    ----------
    scene : Scene
        The scene.
    path : str or path
        The file, such as ``"prism.xml"``.
    velocities : array_like, shape (n, 3), optional
        Initial velocities of the modeled nodes [m/s], for the keyframe ``start``; at rest if None.
    joints : {"ball", "connect"}
        "ball" connects bars with shared or pinned nodes by ball joints, which are exact. Loops of
        bars are closed by the equality ``connect``. With "connect" each bar is a free body, and
        ``connect`` holds all shared nodes.
    step : float
        MuJoCo's time step [s]. Equalities have a time constant of two steps, so export again to
        change the step.
    strict : bool
        Whether strings that can fail (`Scene.strength`) are rejected. Otherwise they cannot fail in
        the file, with a warning.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or a feature of the scene has no counterpart in MJCF; the message
        names it.
    OSError
        The file cannot be written.

    Notes
    -----
    The models differ as follows:

    - A bar has the axial inertia m r²/2, and at least 0.01 of its transverse inertia, because
      MuJoCo rejects 0. No force turns a bar about its axis, so only friction on the contact spheres
      changes the trajectory.
    - A damped string in MuJoCo also damps while it is slack, and may then be in compression.
      Strings without damping follow `Clip` exactly, and strings with the law `Linear` are always
      exact. `Smooth` is rejected.
    - Rigid bodies become bodies ``body0``, ``body1`` … that are free, or have a ball joint at a
      pinned node or a hinge at two of them. `connect` joins nodes that they share with each other or
      with bars. Their principal moments of inertia are at least 0.01 of the largest. Their nodes
      touch the ground.
    - `connect` is soft: two ends separate by about 1e-4 of their free separation in two steps.
    - In contact, nodes are spheres with a radius of 0.001 of the mean member length. The plane is
      lower by this radius. The normal force is that of `Ground`, except for 1e-4 of the other
      forces on the body. Friction is Coulomb friction with a slip speed. In MuJoCo the slip speed
      refers to the weight on each of three supporting nodes, in `Ground` to the current normal
      force.
    - Contact of bars becomes pairs of capsules, with the force of `BarContact`. Bars of a ground
      become capsules on a plane of their own. Friction turns capsules about their axes in MuJoCo.
    - A cable without friction is a spatial tendon through the sites of its nodes.
    - Control by rest lengths becomes a position actuator for each string or cable. Control by force
      densities becomes a general actuator with the gain −length, control by tensions one with the
      gain −1. MuJoCo's ``ctrl`` is the control
      of the model in both cases. Its initial value is in the keyframe ``start``: begin with
      ``mujoco.mj_resetDataKeyframe(model, data, 0)``.

    Pressure, nodal forces, moving supports, height fields, time-varying gravity and parameters are
    rejected. Rollers are rejected if MuJoCo's joints cannot represent them.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> scene = tc.Scene(tc.shapes.prism(stiffness=1000.0, prestress=50.0), gravity=tc.Gravity())
    >>> tc.export_mjcf(scene, "prism.xml").name
    'prism.xml'

    >>> import mujoco  # doctest: +SKIP
    >>> model = mujoco.MjModel.from_xml_path("prism.xml")  # doctest: +SKIP
    """
    instance("scene", scene, Scene, "a tenscasadi.Scene")
    choice("joints", joints, "ball", "connect")
    h = positive_number("step", step)
    target = file_path("path", path)
    flag("strict", strict)
    if scene.strength is not None and not strict:
        difference = f"its strings carry any tension, MJCF has no counterpart of {scene.strength}"
        warnings.warn(f"{target.name} differs from the scene: {difference}", stacklevel=2)
        scene = replace(scene, strength=None)
    _check_scene(scene)
    V = None if velocities is None else _check_velocities(scene.modelled, velocities)
    tree = build_tree(scene.modelled, joints == "ball")
    root = MjcfWriter(scene, tree).write(h, V)
    ET.indent(root)
    with whole_file(target) as file:
        ET.ElementTree(root).write(file)
    return target


@name_errors
def _check_scene(scene: Scene) -> None:
    """Reject features of a scene that MJCF lacks.

    Raises ValueError.
    """
    others = {
        "pressure": "leave it out",
        "forces": "leave them out, and give them to MuJoCo through data.xfrc_applied",
        "supports": "leave it out, the nodes are pinned where they are",
        "parameters": "leave it out, the file has the values of the structure",
    }
    for name, cure in others.items():
        if getattr(scene, name) is not None:
            raise add_address(ValueError(f"Scene.{name} has no counterpart in MJCF: {cure}"))
    if scene.structure.cable_friction.any():
        raise add_address(
            ValueError(
                "Structure.cable_friction has no counterpart in MJCF: give structure.replace(cable_friction=0.0)"
            )
        )
    if scene.gravity is not None and scene.gravity.varies:
        raise ValueError(
            "Scene.gravity changes over time, in MJCF it is constant: give one acceleration"
        )
    for ground in scene.grounds:
        instance("Scene.ground", ground, Ground, "planes alone, tenscasadi.Ground: MJCF has them")
    s = scene.modelled
    for law, strings in scene.string_laws:
        if isinstance(law, Smooth):
            raise ValueError(
                f"Scene.slack of string {s.string_parent[strings[0]]} is {law}: MuJoCo's tendons are slack or not, give Clip() or Linear()"
            )
    for corner in (corner for body in s.bodies for corner in body.nodes):
        if corner in s.rollers or s.pinned.get(corner, "xyz") != "xyz":
            raise ValueError(
                f"pinned or rollers of node {corner} of a body: export_mjcf takes nodes of bodies "
                "that are free or pinned along all axes"
            )
    if s.coupled_mass.any():
        raise ValueError('Scene.ends is "consistent", which MuJoCo lacks: give "lumped"')
    for bar in np.flatnonzero(s.elastic):
        raise ValueError(
            f"bar_stiffness of bar {bar} is {s.bar_stiffness[bar]:g} N/m: bars of MuJoCo are rigid, give structure.replace(bar_stiffness=None)"
        )
    if scene.control is not None and len(s.strings) > len(scene.structure.strings):
        raise ValueError(
            "Scene.segments: MuJoCo's actuators drive strings in one piece: give segments=1, or control=None"
        )
    for name, values in (
        ("bar_mass", s.bar_mass),
        ("bar_inertia times length²", s.bar_inertia * s.bar_lengths**2),
    ):
        for bar in np.flatnonzero(values < _LEAST / AXIAL):
            raise ValueError(
                f"{name} of bar {bar} is {values[bar]:g}: MuJoCo needs {_LEAST / AXIAL:g} or more"
            )
    for node in np.flatnonzero((s.node_mass < _LEAST) & (s.node_mass > 0)):
        raise ValueError(
            f"node_mass of node {node} is {s.node_mass[node]:g} kg: MuJoCo needs {_LEAST:g} or more"
        )


@name_errors
def _check_velocities(s: Structure, given: ArrayLike) -> Array:
    """Check that velocities (n, 3) [m/s] satisfy bars and pins.

    Returns `given` as an array. Raises TypeError, ValueError.
    """
    V = finite_array("velocities", given, (len(s.nodes), 3))
    least = 1e-9 * abs(V).max(initial=0.0)
    for node, directions in find_held_directions(s).items():
        if abs(directions @ V[node]).max() > least:
            raise ValueError(
                f"velocities[{node}] moves node {node} along a direction in which it is held: give {node} a velocity across it"
            )
    apart = (
        np.einsum(
            "ij,ij->i", np.diff(s.nodes[s.bars], axis=1)[:, 0], np.diff(V[s.bars], axis=1)[:, 0]
        )
        / s.bar_lengths
    )
    for bar in np.flatnonzero(abs(apart) > 1e-6 * abs(V).max(initial=0.0)):
        raise add_address(
            ValueError(
                f"velocities stretch bar {bar} by {apart[bar]:g} m/s: give velocities that keep its length, such as model.velocities(x)"
            )
        )
    return V

"""Conversion of structures, scenes and results to picture content."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tenscasadi.drawing.node_forces import describe_scene_forces, describe_trajectory_forces
from tenscasadi.drawing.view_content import Motion, ViewContent
from tenscasadi.dynamics.model import Model
from tenscasadi.scene.ground import Grounds, Surface, read_grounds
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import Clip, StringLaw
from tenscasadi.simulation.motions import Rollouts, node_positions
from tenscasadi.simulation.string_breaks import hide_broken
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.cables import add_compliances
from tenscasadi.structure.structure import Structure
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import Indices, format_value, text

_KINDS = "Structure, Scene, Model, Trajectory, Rollouts or ocp.Plan"
MOST_COPIES = 60  # drawn motions of rollouts: more are no longer told apart


def describe_content(things: Any, field: str = "things", ground: Grounds = None) -> ViewContent:
    """Convert structures, scenes or results (`things`) to picture content.

    They can be in a list, or in a mapping of names. Objects of other packages convert themselves by
    a method ``_view_content_()``. `field` names the argument in errors, and `ground` has grounds
    besides those of the scenes.
    """
    if isinstance(things, Mapping):
        named = [(text(field, name), thing) for name, thing in things.items()]
    else:
        named = [("", one) for one in (things if isinstance(things, (list, tuple)) else [things])]
    if not named:
        raise ValueError(f"{field} is empty: give at least one {_KINDS}")
    parts = []
    for name, thing in named:
        part = _describe(thing, name)
        if part is None:
            raise TypeError(
                f"{field} is {format_value(thing)}: give a {_KINDS}, a list or a mapping"
            )
        parts.append(part)
    motions = tuple(motion for part in parts for motion in part.motions)
    if len({motion.name for motion in motions}) < len(motions):
        motions = tuple(
            replace(motion, name=f"{k + 1}: {motion.name}") for k, motion in enumerate(motions)
        )
    grounds = [ground for part in parts for ground in part.grounds]
    grounds += read_grounds(ground, "ground")
    return ViewContent(
        motions,
        tuple({id(ground): ground for ground in grounds}.values()),
        tuple(ball for part in parts for ball in part.obstacles),
        tuple(box for part in parts for box in part.boxes),
        np.concatenate([part.targets for part in parts]),
        tuple(chart for part in parts for chart in part.charts),
        tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def _describe(thing: Any, name: str) -> ViewContent | None:
    """Convert one object to picture content with a name.

    Returns None if its type is unknown.
    """
    if isinstance(thing, Structure):
        return ViewContent((describe_structure(thing, name or "structure"),))
    if isinstance(thing, Model):
        thing = thing.scene
    if isinstance(thing, Scene):
        motion = describe_structure(thing.modelled, name or "scene", thing.string_laws)
        motion = replace(motion, forces=describe_scene_forces(thing))
        return ViewContent((motion,), thing.grounds)
    if isinstance(thing, Trajectory):
        notes = tuple(map(str, [*thing.breaks, *thing.yields][:MOST_LISTED]))
        if not thing.success:
            notes = (f"{name or 'trajectory'}: {thing.message}",)
        motion = describe_trajectory(thing, name or "trajectory")
        return ViewContent((motion,), find_grounds(thing), notes=notes)
    if isinstance(thing, Rollouts):
        failed = np.count_nonzero(~thing.success)
        notes = (f"{failed} of {len(thing.success)} motions failed",) if failed else ()
        motion = describe_rollouts(thing, name or "rollouts")
        return ViewContent((motion,), find_grounds(thing), notes=notes)
    describe = getattr(thing, "_view_content_", None)
    content = describe() if callable(describe) else None
    return content if isinstance(content, ViewContent) else None


def describe_structure(
    structure: Structure, name: str, laws: Iterable[tuple[StringLaw, Indices]] | None = None
) -> Motion:
    """Convert a structure at rest to picture content.

    `name` is its name there. String forces follow from the rest lengths. `laws` are the string laws
    with the indices of their strings; by default all have `Clip`.
    """
    s, every = structure, np.arange(len(structure.strings))
    tension = np.zeros(len(s.strings))
    for law, some in [(Clip(), every)] if laws is None else laws:
        of = s.cable_of[some]
        length, rest = (
            np.bincount(s.cable_of, weights=values)[of]
            for values in (s.string_lengths, s.rest_length)
        )
        stiffness = add_compliances(s.cable_of, s.stiffness)[of]
        found = law.force_density(length**2, rest, stiffness, None, length)
        tension[some] = np.where(length > 0, np.asarray(found).ravel() * length, 0.0)
    density = np.divide(
        tension, s.string_lengths, out=np.zeros_like(tension), where=s.string_lengths > 0
    )
    return Motion(
        name,
        np.zeros(1),
        s.nodes[None],
        s.bars,
        s.strings,
        np.array(sorted({*s.pinned, *s.rollers}), dtype=np.intp),
        tension=tension[None],
        force_density=density[None],
        structure=structure,
    )


def describe_trajectory(trajectory: Trajectory, name: str) -> Motion:
    """Convert a trajectory to picture content with a name."""
    t = trajectory
    tension, density = (
        hide_broken(t.scene, t.states, values) for values in (t.tension, t.force_density)
    )
    values = t.velocities, tension, density
    forces = describe_trajectory_forces(t)
    structure = None if t.scene is None else t.scene.modelled
    members = t.bars, t.strings, t.pinned
    return Motion(name, t.time, t.nodes, *members, *values, forces=forces, structure=structure)


def find_grounds(result: Trajectory | Rollouts) -> tuple[Surface, ...]:
    """Find the grounds of a result's scene."""
    return () if result.scene is None else result.scene.grounds


def describe_rollouts(rollouts: Rollouts, name: str) -> Motion:
    """Convert some rollouts to picture content with a name.

    They are evenly selected, and drawn as copies of one structure.
    """
    total = len(rollouts.states)
    chosen = np.unique(np.linspace(0, total - 1, min(total, MOST_COPIES)).round().astype(int))
    paths = node_positions(rollouts, slice(None), chosen).swapaxes(0, 1)  # (T, copies, n, 3)
    offsets = len(rollouts.place) * np.arange(len(chosen))
    bars, strings, pinned = (
        np.concatenate([indices + offset for offset in offsets])
        for indices in (rollouts.bars, rollouts.strings, rollouts.pinned)
    )
    some = f"{len(chosen)} of {total}" if len(chosen) < total else f"{total}"
    nodes = paths.reshape(len(rollouts.time), -1, 3)
    return Motion(
        f"{name}: {some} motions",
        rollouts.time,
        nodes,
        bars,
        strings,
        pinned,
        copies=len(chosen),
        structure=None if rollouts.scene is None else rollouts.scene.modelled,
    )

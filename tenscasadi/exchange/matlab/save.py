"""Export of structures and trajectories with MOTES' variable names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tenscasadi.exchange.matlab.mat_file import write_mat
from tenscasadi.exchange.matlab.variables import pad_rows
from tenscasadi.schema.stored import array_fields
from tenscasadi.simulation.trajectory import Trajectory
from tenscasadi.structure.cables import find_units, reject_cables
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.rigid_body import RigidBody, reject_bodies
from tenscasadi.structure.structure import Structure
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.validate import Array, FilePath, Indices, flag, instance

STRUCTURE_FORM, TRAJECTORY_FORM = "tenscasadi structure 1", "tenscasadi trajectory 1"
# the names of MOTES; other fields keep their names
HISTORY = {"time": "t", "nodes": "Nhist", "velocities": "Ndhist", "force_density": "gamma"}
LETTERS = {name: str(letters) for name, (letters, _) in array_fields(Trajectory).items()}


@rename_keywords(what="data")
@name_errors
def save_mat(data: Structure | Trajectory, path: FilePath, *, class_one: bool = False) -> Path:
    """Write a structure or a trajectory for MATLAB.

    The names are those of MOTES and TsgFEM.

    Indices count from 1 in the file. A structure becomes the variables N (3×n), C_b, C_s, s_0, k,
    c, m and pinned_nodes. The additional variables pinned_X, pinned_Y, pinned_Z, node_mass,
    string_mass, bar_radius, bar_stiffness (0: rigid), bar_rest_length, roller_nodes and
    roller_normals are unknown to MOTES. Cables become cable_strings, a row of strings for each,
    with cable_friction, and the matrix S of CTSFEM, whose columns are the bars, then the strings.
    Rigid bodies become the struct rigid_bodies, unknown to MOTES and TsgFEM. `load_mat` restores
    the structure exactly.

    With `class_one` the file is valid input of ``tenseg_sim_class1open(load('x.mat'))`` or
    ``tenseg_sim_classkopen`` of MOTES. N then has a column for each end of a bar, P and D hold
    joints and pins, and ms the masses of string nodes.

    A trajectory becomes N, C_b, C_s and MOTES' struct History: Nhist (3×n×T), Ndhist, gamma,
    bar_len, t, and all its other fields.

    Parameters
    ----------
    data : Structure or Trajectory
        The structure or the trajectory.
    path : str or PathLike
        File to write, in MATLAB's format v7; no suffix is added.
    class_one : bool
        Whether to write one node for each end of a bar, as MOTES requires.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    TypeError, ValueError
        An argument is wrong, or MOTES does not model a property: the message names it.
    OSError
        The file cannot be written.

    See Also
    --------
    load_mat : Read a structure.
    load_mat_trajectory : Read a trajectory.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism()
    >>> path = tc.save_mat(prism, "prism.mat")
    >>> bool((tc.load_mat(path).nodes == prism.nodes).all())
    True
    """
    instance("data", data, (Structure, Trajectory), "a Structure or a Trajectory")
    flag("class_one", class_one)
    if isinstance(data, Structure):
        if class_one:
            reject_bodies(data, "save_mat(class_one=True)")
            reject_cables(data, "save_mat(class_one=True)")
        return write_mat(path, _build_split(data) if class_one else _build_physical(data))
    if class_one:
        raise ValueError("class_one is True for a trajectory, which is never split: leave it out")
    return write_mat(path, _build_history(data))


def _build_matrices(nodes: Array, bars: Indices, strings: Indices) -> dict[str, Any]:
    return {
        "N": nodes.T,
        "C_b": connectivity(bars, len(nodes)).toarray(),
        "C_s": connectivity(strings, len(nodes)).toarray(),
    }


def _build_properties(structure: Structure) -> dict[str, Any]:
    """Build member properties in the shapes that MOTES accepts.

    Rest lengths are a column, other values rows.
    """
    rows = {"k": structure.stiffness, "c": structure.damping, "m": structure.bar_mass}
    return {
        "s_0": structure.rest_length[:, None],
        **{key: value[None, :] for key, value in rows.items()},
    }


def _build_physical(structure: Structure) -> dict[str, Any]:
    more: dict[str, Any] = {
        "node_mass": structure.node_mass,
        "string_mass": structure.string_mass,
        "bar_radius": structure.bar_radius,
    }
    if structure.elastic.any():  # 0: rigid
        k = np.where(structure.elastic, structure.bar_stiffness, 0.0)
        more |= {"bar_stiffness": k, "bar_rest_length": structure.bar_rest_length}
    normals = [
        (node + 1, normal) for node, normals in structure.rollers.items() for normal in normals
    ]
    if structure.cables:
        more |= _build_cables(structure)
    if structure.bodies:
        more["rigid_bodies"] = {
            f"body_{k + 1}": _build_body(body) for k, body in enumerate(structure.bodies)
        }
    if normals:
        more |= {
            "roller_nodes": np.array([node for node, _ in normals], dtype=float),
            "roller_normals": np.array([n for _, n in normals]),
        }
    return {
        "format": STRUCTURE_FORM,
        **_build_matrices(structure.nodes, structure.bars, structure.strings),
        **_build_properties(structure),
        "pinned_nodes": _indices_from_one(structure.fixed.all(axis=1)),
        **{
            f"pinned_{axis}": _indices_from_one(structure.fixed[:, k])
            for k, axis in enumerate("XYZ")
        },
        **more,
    }


def _build_cables(structure: Structure) -> dict[str, Any]:
    """Build the cables, and the matrix S of CTSFEM.

    The result has them by the names of variables.
    """
    units = find_units(structure)
    unit = np.roll(units, len(structure.bars))  # of bars, then of strings
    rows = np.roll(np.unique(units), len(structure.bars))
    return {
        "cable_strings": pad_rows(structure.cables),
        "cable_friction": structure.cable_friction,
        "S": (rows[:, None] == unit).astype(float),
    }


def _build_body(body: RigidBody) -> dict[str, Any]:
    """Build the MATLAB struct of a rigid body.

    Center and inertia are included only where they are given.
    """
    given = {"mass": body.mass, "center": body.center, "inertia": body.inertia}
    faces = {} if body.faces is None else {"faces": np.array(body.faces).reshape(-1, 3) + 1.0}
    return {
        "nodes": np.array(body.nodes) + 1.0,
        **faces,
        **{key: value for key, value in given.items() if value is not None},
    }


def _indices_from_one(mask: Any) -> Array:
    return np.flatnonzero(mask).astype(float)[:, None] + 1


def _build_split(structure: Structure) -> dict[str, Any]:
    """Build the input of a MOTES simulation.

    Raises ValueError for properties that MOTES ignores.
    """
    loose = np.ones(len(structure.nodes), dtype=bool)
    loose[structure.bars] = False
    masses = structure.node_mass != 0
    for unknown, name, member, cure in (
        (structure.bar_radius != 0, "bar_radius", "bar", "0.0"),
        (structure.elastic, "bar_stiffness", "bar", "None"),
        (structure.string_mass != 0, "string_mass", "string", "0.0, or subdivide the strings"),
        (~loose & masses, "node_mass", "node", "0.0: MOTES has masses where no bar ends"),
        (loose & ~masses, "node_mass", "node", "a mass: MOTES inverts the mass matrix"),
    ):
        for index in np.flatnonzero(unknown):
            value = getattr(structure, name)[index]
            message = f"class_one: {name} of {member} {index} is {value:g}"
            raise ValueError(f"{message}, which MOTES does not model: give {cure}")
    partly = structure.held.any(axis=1) & ~structure.fixed.all(axis=1)
    for index in np.flatnonzero(partly):
        cure = "give pins along all axes, or class_one=False"
        raise ValueError(f"class_one: node {index} has a roller, unknown to MOTES: {cure}")
    split = structure.class_one()
    on_bar = split.C_nb.any(axis=0)
    # MOTES expects the ends of bars in the first 2β columns
    order = np.concatenate([np.flatnonzero(on_bar), np.flatnonzero(~on_bar)])
    return {
        "N": split.N[:, order],
        "C_b": (split.C_b @ split.C_nb)[:, order],
        "C_s": split.C_s[:, order],
        "P": split.P[order],
        "D": split.D,
        **_build_properties(structure),
        "ms": structure.node_mass[split.physical[np.flatnonzero(~on_bar)]][None, :],
    }


def _build_history(run: Trajectory) -> dict[str, Any]:
    history: dict[str, Any] = {
        "bar_len": np.linalg.norm(
            run.nodes[:, run.bars[:, 1]] - run.nodes[:, run.bars[:, 0]], axis=2
        ).T
    }
    for name, letters in LETTERS.items():
        if name not in ("bars", "strings", "pinned"):
            value = getattr(run, name)
            history[HISTORY.get(name, name)] = (
                value.T if len(letters) > 1 else value[None, :] if letters else value
            )
    return {
        "format": TRAJECTORY_FORM,
        **_build_matrices(run.nodes[0], run.bars, run.strings),
        "pinned_nodes": run.pinned.astype(float)[:, None] + 1,
        "History": history,
    }

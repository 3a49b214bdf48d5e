"""Import of structures with variable names of MOTES and TsgFEM."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import issparse

from tenscasadi.exchange.matlab import tsgfem
from tenscasadi.exchange.matlab.mat_file import read_mat
from tenscasadi.exchange.matlab.variables import (
    Variables,
    is_filled,
    read_indices,
    read_pairs,
    read_rows,
    read_values,
)
from tenscasadi.exchange.source import Source
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.rigid_body import RigidBody
from tenscasadi.structure.structure import PARAMETERS, Structure
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import MAX_BYTES, Array, FilePath, Indices, finite_array, text

_BARS, _STRINGS = ("C_b", "C_b_in", "Cb_in"), ("C_s", "C_s_in", "Cs_in")
_OF_BARS = {"m": "bar_mass"}
_OF_BARS |= {name: name for name in ("bar_radius", "bar_stiffness", "bar_rest_length")}
_OF_STRINGS = {"s_0": "rest_length", "k": "stiffness", "c": "damping"}
_OF_STRINGS["string_mass"] = "string_mass"
_OTHERS = (
    "N P D ms node_mass pinned_X pinned_Y pinned_Z"
    " pinned_nodes Pinned_nodes Ib roller_nodes roller_normals format"
    " cable_strings cable_friction rigid_bodies"
)
_INPUT = "data"  # struct that MOTES and TsgFEM read
_VARIABLES = {*_BARS, *_STRINGS, *_OF_BARS, *_OF_STRINGS, *_OTHERS.split(), *tsgfem.VARIABLES}
_STRING_NODE_MASS = 0.1  # kg, the default of MOTES


class ParsedStructure(NamedTuple):
    """Structure that was read from a MATLAB file.

    Attributes
    ----------
    structure : Structure
        The structure.
    columns : ndarray, shape (n,)
        Column of the file's N for each node.
    """

    structure: Structure
    columns: Indices


def load_mat(
    path: FilePath, name: str | None = None, *, strict: bool = True, **options: Any
) -> Structure:
    """Read a structure from a MATLAB file.

    MOTES, TsgFEM and `save_mat` write such files. They contain N (3×n) with C_b and C_s, dense or
    sparse, or lists of node pairs that count from 1 (``C_b_in``). These are variables or fields of
    a struct, such as the input of a MOTES simulation. From MOTES, ``s_0``, ``k``, ``c``, ``m``,
    ``ms`` (with MOTES' defaults), ``P``, ``D`` and ``pinned_nodes`` are read; nodes that P ties
    together are merged. From TsgFEM, ``C``, ``index_b``, ``index_s``, ``E``, ``A``, ``l0``,
    ``mass``, ``pinned_X``, ``pinned_Y``, ``pinned_Z`` or ``Ib`` are read. Its bars are elastic, of
    stiffness E A/l0; the option ``bar_stiffness=None`` makes them rigid.
    Loads, velocities, times, objects and function handles are not read; nothing is executed.

    Parameters
    ----------
    path : str or PathLike
        File of MATLAB's versions 5, 6 or 7 (``save('x.mat', '-v7')``).
    name : str, optional
        The struct to read if the file contains several. Default: ``data``, the input of MOTES and
        TsgFEM, with a warning if the others differ.
    strict : bool
        Whether properties without a counterpart, such as damping of nodes, and several different
        structures without ``data`` are errors. Otherwise a warning lists the properties and all
        variables that were left out, and the first structure is read.
    **options : array_like
        Keywords of `Structure` that replace values of the file, such as ``damping``.

    Returns
    -------
    Structure
        The structure.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    TypeError, ValueError
        The file cannot be read, or does not contain exactly one valid structure; the message names
        the file, the variable and its value.

    Warns
    -----
    InexactImportWarning
        Something was left out, which it lists.

    See Also
    --------
    save_mat : Write a structure.
    load_mat_trajectory : Read a trajectory.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> tc.save_mat(tc.shapes.prism(stiffness=500.0), "prism.mat").name
    'prism.mat'
    >>> tc.load_mat("prism.mat")
    Structure(6 nodes, 3 bars, 9 strings, 0 pinned)
    >>> tc.load_mat("prism.mat", damping=2.0).damping[0].item()
    2.0
    """
    source = Source(path, strict)
    structure = find_structure(source, read_mat(source), name, options).structure
    source.report()
    return structure


def find_structure(
    source: Source, variables: Variables, name: str | None, options: Variables
) -> ParsedStructure:
    """Build the structure that variables of a MATLAB file describe.

    `name` is the struct variable to read; None selects it automatically. `options` are keywords of
    `Structure`, which replace values of the file. Raises TypeError, SceneFileError.
    """
    allowed = [key for key in PARAMETERS if key not in ("nodes", "bars", "strings")]
    for key in set(options) - set(allowed):
        raise TypeError(f"load_mat got {key!r}: give keywords of Structure ({', '.join(allowed)})")
    try:
        name = _choose(source, variables, name)
        fields = variables[name] if name else variables
        if tsgfem.is_tsgfem(fields):  # TsgFEM stores masses and pins outside its struct
            fields = tsgfem.convert_tsgfem(source, {**variables, **fields}, options)
        unread = ", ".join(sorted({*variables, *fields} - _VARIABLES - {name}))
        if unread and not source.strict:
            source.note(f"the variables {unread} are not read")
        return _build(source, fields, options)
    except (TypeError, ValueError) as error:
        raise SceneFileError(str(error), source.path.name) from error


def _choose(source: Source, variables: Variables, name: str | None) -> str | None:
    """Select the struct of the file that describes a structure.

    `name` is the user's choice; None selects automatically. Returns None if variables outside
    structs describe it.
    """
    structs = [
        key for key, value in variables.items() if isinstance(value, dict) and _describes(value)
    ]
    listed = ", ".join(structs)
    if name is not None:
        if text("name", name) not in structs:
            reason = f"the file's structs with N and C_b or C_s are {listed or 'none'}"
            raise ValueError(f"name is {name!r}: {reason}")
        return name
    if not structs:
        if not _describes(variables):
            needed = "which is N with C_b, C_s or C, in a struct or outside"
            held = ", ".join(variables) or "nothing"
            raise add_address(ValueError(f"it holds no structure, {needed}: it holds {held}"))
        return None
    chosen = _INPUT if _INPUT in structs else structs[0]
    if any(
        not _is_same(variables[chosen].get(key), variables[other].get(key))
        for other in structs
        for key in ("N", "C", *_BARS, *_STRINGS)
    ):
        found = f"it holds the structures {listed}"
        if chosen == _INPUT:
            source.note(f"{found}, of which {_INPUT!r} is read")
        else:
            source.leave_out(ValueError(f"{found}: say which by name={chosen!r}"))
    return chosen


def _describes(variables: Variables) -> bool:
    return "N" in variables and any(key in variables for key in ("C", *_BARS, *_STRINGS))


def _is_same(a: Any, b: Any) -> bool:
    if issparse(a) and issparse(b):
        return a.shape == b.shape and not (a != b).nnz
    return a is b or (isinstance(a, np.ndarray) and np.array_equal(a, b))


def _build(source: Source, variables: Variables, options: Variables) -> ParsedStructure:
    N = finite_array("N", variables["N"], (3, None))
    count = N.shape[1]
    bars, strings = (_read_members(variables, keys, count) for keys in (_BARS, _STRINGS))
    given: dict[str, Any] = {
        name: read_values(source, variables, key, len(members))
        for members, names in ((bars, _OF_BARS), (strings, _OF_STRINGS))
        for key, name in names.items()
        if key in variables and name not in options and len(members)
    }
    if "bar_stiffness" in given:  # 0: rigid
        given["bar_stiffness"] = np.where(
            given["bar_stiffness"] == 0, np.inf, given["bar_stiffness"]
        )
    if is_filled(variables, "mgyro"):
        message = "mgyro is not 0: bars with gyroscopic wheels cannot be modeled"
        source.leave_out(ValueError(message))
    mass = _read_node_mass(source, variables, count, bars)
    if is_filled(variables, "P"):
        if (max(len(bars), len(strings), 1)) * count > MAX_BYTES // 8:
            sizes = f"{len(bars)} and {len(strings)} rows of {count}"
            raise ValueError(f"C_b and C_s have {sizes}: that is too many")
        matrices = connectivity(bars, count), connectivity(strings, count)
        ties = variables["P"], variables.get("D")
        read = Structure.from_matrices(N, *matrices, *ties, node_mass=mass, **given)
        columns = np.unique(read.class_one(sparse=True).physical, return_index=True)[1]
        return ParsedStructure(read.replace(**options), columns)
    supports = {"pinned": _read_pins(variables, count), "rollers": _read_rollers(variables, count)}
    given |= {"node_mass": mass, **supports}
    if "cables" not in options:  # the file's friction is that of its own cables
        given |= _read_cables(source, variables, len(strings))
    given |= {"bodies": _read_bodies(variables, count), **options}
    structure = Structure(N.T, bars, strings, **given)
    return ParsedStructure(_lump_string_mass(source, structure), np.arange(count))


def _lump_string_mass(source: Source, structure: Structure) -> Structure:
    """Move string masses to the ends if free nodes have no other mass.

    A strict import leaves them to the strings.
    """
    s = structure
    has_mass = s.node_mass > 0
    has_mass[s.bars] = True
    massless = np.flatnonzero(~has_mass & ~s.fixed.all(axis=1))
    if source.strict or not len(massless) or not np.any(s.string_mass):
        return structure
    nodes = f"node {massless[0]} has" if len(massless) == 1 else f"{len(massless)} nodes have"
    source.note(f"{nodes} no mass: half the mass of each string is put on either end")
    halves = np.repeat(s.string_mass / 2, 2)
    lumped = np.bincount(s.strings.ravel(), halves, minlength=len(s.nodes))
    return s.replace(node_mass=s.node_mass + lumped, string_mass=0.0)


def _read_members(variables: Variables, keys: tuple[str, ...], count: int) -> Indices:
    """Read bars or strings as pairs (k, 2) of nodes.

    `keys` are possible names of the variable, and `count` is the number of nodes. The result is
    empty if no name is present. Raises TypeError, ValueError.
    """
    for key in keys:
        if key in variables:
            return read_pairs(key, variables[key], count)
    if not {*_BARS, *_STRINGS} & set(variables):
        cure = "say which are bars and which are strings by C_b and C_s, or by index_b and index_s"
        raise ValueError(f"C holds all members: {cure}")
    return np.zeros((0, 2), dtype=np.intp)


def _read_node_mass(source: Source, variables: Variables, count: int, bars: Indices) -> Array:
    """Read the point mass of each column of N.

    The result is (count,) [kg]. In MOTES only nodes without `bars` have one.
    """
    if "node_mass" in variables:
        return read_values(source, variables, "node_mass", count)
    mass = np.zeros(count)
    loose = np.setdiff1d(np.arange(count), bars)
    if "ms" in variables and len(loose):
        mass[loose] = read_values(source, variables, "ms", len(loose))
    elif "s_0" in variables:
        mass[loose] = _STRING_NODE_MASS
    return mass


def _read_pins(variables: Variables, count: int) -> dict[int, str]:
    """Read the pinned axes, such as "xy", by node.

    `count` is the number of nodes. Raises ValueError.
    """
    held = np.zeros((count, 3), dtype=bool)
    axes = ("pinned_X", "pinned_Y", "pinned_Z")
    if set(axes) & set(variables):
        for axis, key in enumerate(axes):
            held[read_indices(key, variables.get(key, np.zeros(0)), count), axis] = True
    elif "pinned_nodes" in variables:
        held[read_indices("pinned_nodes", variables["pinned_nodes"], count)] = True
    elif is_filled(variables, "Pinned_nodes"):  # of MOTES' statics: node, and a flag for each axis
        rows = finite_array("Pinned_nodes", variables["Pinned_nodes"], (None, 4))
        held[read_indices("Pinned_nodes", rows[:, 0], count)] = rows[:, 1:] != 0
    elif "Ib" in variables:  # columns of the identity of all coordinates
        shape = np.shape(variables["Ib"])
        if len(shape) != 2 or shape[0] != 3 * count:
            cure = f"give a row for each of the {3 * count} coordinates"
            raise ValueError(f"Ib has shape {shape}: {cure}")
        held.flat[np.unique(variables["Ib"].nonzero()[0])] = True
    return {
        int(node): "".join(np.array(list("xyz"))[held[node]])
        for node in np.flatnonzero(held.any(axis=1))
    }


def _read_cables(source: Source, variables: Variables, count: int) -> dict[str, Any]:
    """Read cables and their friction, as keywords of `Structure`.

    `count` is the number of strings. Raises TypeError, ValueError.
    """
    if "cable_strings" not in variables:
        return {}
    cables = read_rows("cable_strings", variables["cable_strings"], count)
    given = {"cable_friction": np.zeros(1), **variables}
    return {
        "cables": cables,
        "cable_friction": read_values(source, given, "cable_friction", len(cables)),
    }


def _read_bodies(variables: Variables, count: int) -> list[RigidBody]:
    """Read rigid bodies, the fields of a struct.

    `count` is the number of nodes. Raises TypeError, ValueError.
    """
    bodies = []
    structs = variables.get("rigid_bodies", {})
    for name, body in structs.items() if isinstance(structs, dict) else [("", structs)]:
        if not isinstance(body, dict) or not {"nodes", "mass"} <= body.keys():
            field = f"rigid_bodies.{name}".rstrip(".")
            raise ValueError(f"{field} is no struct of a body: give one with nodes and mass")
        nodes = read_indices(f"rigid_bodies.{name}.nodes", body["nodes"], count).tolist()
        mass = finite_array(f"rigid_bodies.{name}.mass", body["mass"], (1, 1)).item()
        own = {key: np.squeeze(body[key]) for key in ("center", "inertia") if key in body}
        if "faces" in body:
            faces = finite_array(f"rigid_bodies.{name}.faces", body["faces"], (None, 3)).ravel()
            own["faces"] = read_indices(f"rigid_bodies.{name}.faces", faces, count).reshape(-1, 3)
        bodies.append(RigidBody(nodes, mass, **own))
    return bodies


def _read_rollers(variables: Variables, count: int) -> dict[int, Array]:
    """Read the normals (·, 3) of rollers by node.

    `count` is the number of nodes. Raises TypeError, ValueError.
    """
    if "roller_nodes" not in variables:
        return {}
    nodes = read_indices("roller_nodes", variables["roller_nodes"], count)
    normals = finite_array("roller_normals", variables.get("roller_normals"), (len(nodes), 3))
    return {int(node): normals[nodes == node] for node in np.unique(nodes)}

"""Import of structures with names of MOTES and TsgFEM."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import issparse

from tenscasadi.exchange.matlab.mat_file import read_mat
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.structure import PARAMETERS, Structure
from tenscasadi.util.validate import Array, Indices, finite_array, shown, text

_BARS, _STRINGS = ("C_b", "C_b_in", "Cb_in"), ("C_s", "C_s_in", "Cs_in")
_STRING_NODE_MASS = 0.1  # kg, the default of MOTES
_MOST = 125_000_000  # entries of a connectivity matrix: 1 GB
Fields = Mapping[str, Any]


class Found(NamedTuple):
    """Structure of a file.

    Attributes
    ----------
    structure : Structure
        The structure.
    columns : ndarray, shape (n,)
        Column of the file's N for each node.
    """

    structure: Structure
    columns: Indices


def load_mat(path: str | os.PathLike[str], name: str | None = None, **options: Any) -> Structure:
    """Read a structure from a MATLAB file.

    MOTES, TsgFEM and `save_mat` write such files. They contain N (3×n) with C_b and C_s, dense or
    sparse, or lists of node pairs that count from 1 (``C_b_in``). These are variables or fields of
    a struct, such as the input of a MOTES simulation. From MOTES, ``s_0``, ``k``, ``c``, ``m``,
    ``ms`` (with MOTES' defaults), ``P``, ``D`` and ``pinned_nodes`` are read; nodes that P ties
    together are merged. From TsgFEM, ``C``, ``index_b``, ``index_s``, ``E``, ``A``, ``l0``,
    ``mass``, ``pinned_X``, ``pinned_Y``, ``pinned_Z`` or ``Ib`` are read; its bars become rigid.
    Objects and function handles are ignored, and nothing is executed. Loads, velocities and times
    are not read.

    Parameters
    ----------
    path : str or PathLike
        File of MATLAB's versions 5, 6 or 7 (``save('x.mat', '-v7')``).
    name : str, optional
        The struct to read if the file contains several.
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
    return find_structure(path, read_mat(path), name, options).structure


def find_structure(
    path: str | os.PathLike[str], variables: Fields, name: str | None, options: Fields
) -> Found:
    """Build the structure that variables of a file describe.

    Raises TypeError, ValueError, which name the file.
    """
    allowed = [key for key in PARAMETERS if key not in ("nodes", "bars", "strings")]
    for key in set(options) - set(allowed):
        raise TypeError(f"load_mat got {key!r}: give keywords of Structure ({', '.join(allowed)})")
    try:
        return _build(_choose(variables, name), options)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{os.fspath(path)}: {error}") from error


def _choose(variables: Fields, name: str | None) -> Fields:
    """Select the variables of one structure.

    They are the fields of a struct, or the variables of the file.
    """
    structs = {
        key: value
        for key, value in variables.items()
        if isinstance(value, dict) and _describes(value)
    }
    if name is not None:
        if text("name", name) not in structs:
            raise ValueError(
                f"name is {name!r}: the file's structs with N and C_b or C_s are {', '.join(structs) or 'none'}"
            )
        structs = {name: structs[name]}
    if not structs:
        if not _describes(variables):
            held = ", ".join(variables) or "nothing"
            raise ValueError(
                f"it holds no structure, which is N with C_b, C_s or C, in a struct or outside: it holds {held}"
            )
        return variables
    first, *others = structs
    for other in others:
        if any(
            not _same(structs[first].get(key), structs[other].get(key))
            for key in ("N", "C", *_BARS, *_STRINGS)
        ):
            raise ValueError(
                f"it holds the structures {', '.join(structs)}: say which by name={first!r}"
            )
    fields = structs[first]
    return (
        {**variables, **fields} if "index_s" in fields else fields
    )  # TsgFEM stores masses and pins outside its struct


def _describes(fields: Fields) -> bool:
    return "N" in fields and any(key in fields for key in ("C", *_BARS, *_STRINGS))


def _same(a: Any, b: Any) -> bool:
    dense = [
        value.toarray() if issparse(value) and value.shape[0] * value.shape[1] <= _MOST else value
        for value in (a, b)
    ]
    return (a is None and b is None) or (
        isinstance(dense[0], np.ndarray)
        and isinstance(dense[1], np.ndarray)
        and np.array_equal(*dense)
    )


def _build(fields: Fields, options: Fields) -> Found:
    N = finite_array("N", fields["N"], (3, None))
    count = N.shape[1]
    bars, strings, rows = _read_members(fields, count)
    given = _read_bars(fields, len(bars), rows[0], options) | _read_strings(
        fields, len(strings), rows[1], options
    )
    if _filled(fields, "mgyro"):
        raise ValueError("mgyro is not 0: bars with gyroscopic wheels cannot be modelled")
    mass = _read_node_mass(fields, count, bars)
    if _filled(fields, "P"):
        matrices = (
            connectivity(bars, count),
            connectivity(strings, count),
            fields["P"],
            fields.get("D"),
        )
        if (max(len(bars), len(strings), 1)) * count > _MOST:
            raise ValueError(
                f"C_b and C_s have {len(bars)} and {len(strings)} rows of {count}: that is too many"
            )
        read = Structure.from_matrices(N, *matrices, node_mass=mass, **given)
        columns = np.unique(read.class_one(sparse=True).physical, return_index=True)[1]
        return Found(read.replace(**options), columns)
    supports = {"pinned": _read_pins(fields, count), "rollers": _read_rollers(fields, count)}
    structure = Structure(N.T, bars, strings, **{**given, "node_mass": mass, **supports, **options})
    return Found(structure, np.arange(count))


def _read_members(fields: Fields, count: int) -> tuple[Indices, Indices, tuple[Indices, Indices]]:
    """Read bars and strings as pairs of nodes.

    Also returns their rows in TsgFEM's list of all members.
    """
    bars, strings = (
        next((key for key in keys if key in fields), None) for keys in (_BARS, _STRINGS)
    )
    if bars is None and strings is None:
        members = read_pairs("C", fields["C"], count)
        if "index_b" not in fields or "index_s" not in fields:
            raise ValueError(
                "C holds all members: say which are bars and which are strings by C_b and C_s, or by index_b and index_s"
            )
        rows = (
            read_indices("index_b", fields["index_b"], len(members)),
            read_indices("index_s", fields["index_s"], len(members)),
        )
        return members[rows[0]], members[rows[1]], rows
    pairs = [
        np.zeros((0, 2), dtype=np.intp) if key is None else read_pairs(key, fields[key], count)
        for key in (bars, strings)
    ]
    ends = len(pairs[0]), len(pairs[0]) + len(pairs[1])
    return pairs[0], pairs[1], (np.arange(ends[0]), np.arange(*ends))  # TsgFEM's C = [C_b; C_s]


def read_pairs(field: str, value: Any, count: int) -> Indices:
    """Convert a connectivity matrix or list into zero-based pairs.

    A list counts from 1. Raises TypeError, ValueError.
    """
    if isinstance(value, np.ndarray) and value.size == 0:
        return np.zeros((0, 2), dtype=np.intp)
    if issparse(value):
        whole = value.tocoo()
        rows, columns, entries, shape = (
            whole.row,
            whole.col,
            np.asarray(whole.data, dtype=float),
            value.shape,
        )
    else:
        dense = finite_array(field, value, (None, None))
        rows, columns = np.nonzero(dense)
        entries, shape = dense[rows, columns], dense.shape
        if shape[1] == 2 and dense.min() >= 1.0:  # a connectivity matrix has a −1 in each row
            return np.column_stack([read_indices(field, ends, count) for ends in dense.T]).reshape(
                -1, 2
            )
    if shape[1] != count:
        raise ValueError(
            f"{field} has shape {tuple(shape)}: give a column for each of the {count} nodes of N, or pairs of nodes that count from 1"
        )
    order = np.lexsort((entries, rows))
    rows, columns, entries = rows[order], columns[order], entries[order]
    if (
        len(rows) != 2 * shape[0]
        or np.any(rows != np.repeat(np.arange(shape[0]), 2))
        or np.any(entries != np.tile([-1.0, 1.0], shape[0]))
    ):
        raise ValueError(
            f"{field} has a row other than zeros with one −1 and one +1: give that, or pairs of nodes that count from 1"
        )
    return np.asarray(columns.astype(np.intp).reshape(-1, 2))


def read_indices(field: str, value: Any, count: int) -> Indices:
    """Convert indices from one-based to zero-based. Raises TypeError, ValueError."""
    numbers = np.asarray(value, dtype=float).ravel() if isinstance(value, np.ndarray) else None
    if numbers is None:
        raise ValueError(f"{field} is {shown(value)}: give numbers from 1 to {count}")
    for wrong in numbers[~((numbers >= 1) & (numbers <= count) & (numbers % 1 == 0))][:1]:
        raise ValueError(f"{field} holds {wrong:g}: give whole numbers from 1 to {count}")
    return numbers.astype(np.intp) - 1


def _filled(fields: Fields, key: str) -> bool:
    """Return whether a variable has nonzero numbers."""
    value = fields.get(key)
    return bool(
        value is not None
        and not isinstance(value, (str, dict))
        and (value.nnz if issparse(value) else np.any(value))
    )


def read_values(fields: Fields, key: str, count: int) -> Array:
    """Read one number per item, or one for all.

    Raises TypeError, ValueError.
    """
    value = fields[key]
    if not isinstance(value, np.ndarray):
        kind = f"a text, {value!r}, which is not run" if isinstance(value, str) else "no array"
        raise ValueError(f"{key} is {kind}: give {count} numbers or one")
    numbers = finite_array(key, value.ravel(), (None,))
    if len(numbers) not in (1, count):
        over_time = (
            ": rest lengths over time are a control, give rest_length here and them to the simulation"
            if key == "s_0"
            else ""
        )
        raise ValueError(
            f"{key} has shape {value.shape}{over_time or f': give {count} numbers or one'}"
        )
    return np.asarray(np.broadcast_to(numbers, (count,)))


def _read_bars(fields: Fields, count: int, rows: Indices, options: Fields) -> dict[str, Any]:
    own = {"m": "bar_mass", "bar_radius": "bar_radius"}
    given = {
        name: read_values(fields, key, count)
        for key, name in own.items()
        if key in fields and name not in options and count
    }
    if _of_tsgfem(fields) and "bar_mass" not in options:
        given["bar_mass"] = _of_members(fields, "mass", "bar_mass")[rows]
    return given


def _read_strings(fields: Fields, count: int, rows: Indices, options: Fields) -> dict[str, Any]:
    own = {"s_0": "rest_length", "k": "stiffness", "c": "damping", "string_mass": "string_mass"}
    given = {
        name: read_values(fields, key, count)
        for key, name in own.items()
        if key in fields and name not in options and count
    }
    if _of_tsgfem(fields):
        if "damping" not in options and _filled(fields, "D"):
            raise ValueError(
                "D is not 0: damping of nodes, as TsgFEM has it, cannot be modelled; give damping of strings, such as damping=0.0"
            )
        if "rest_length" not in options:
            given["rest_length"] = _of_members(fields, "l0", "rest_length")[rows]
        if "stiffness" not in options:
            E, A, l0 = (_of_members(fields, key, "stiffness") for key in ("E", "A", "l0"))
            given["stiffness"] = (E * A / l0)[rows]
        if "string_mass" not in options:
            given["string_mass"] = _of_members(fields, "mass", "string_mass")[rows]
    return given


def _of_tsgfem(fields: Fields) -> bool:
    return "index_s" in fields and "s_0" not in fields


def _of_members(fields: Fields, key: str, name: str) -> Array:
    """Read one positive number for each of TsgFEM's members."""
    if key not in fields:
        raise ValueError(
            f"{key} is missing, from which {name} follows: give {name}=..., or save {key} too"
        )
    values = read_values(
        fields,
        key,
        sum(np.size(fields[index]) for index in ("index_b", "index_s") if index in fields),
    )
    for member in np.flatnonzero(values <= 0)[:1]:
        raise ValueError(
            f"{key} of member {member + 1} is {values[member]:g}: it must be greater than 0"
        )
    return values


def _read_node_mass(fields: Fields, count: int, bars: Indices) -> Array:
    """Read the point mass of each column of N.

    In MOTES only nodes without bars have one.
    """
    mass = np.zeros(count)
    loose = np.setdiff1d(np.arange(count), bars)
    if "node_mass" in fields:
        return read_values(fields, "node_mass", count)
    if "ms" in fields and len(loose):
        mass[loose] = read_values(fields, "ms", len(loose))
    elif "s_0" in fields:
        mass[loose] = _STRING_NODE_MASS
    return mass


def _read_pins(fields: Fields, count: int) -> dict[int, str]:
    held = np.zeros((count, 3), dtype=bool)
    if {"pinned_X", "pinned_Y", "pinned_Z"} & set(fields):
        for axis, key in enumerate(("pinned_X", "pinned_Y", "pinned_Z")):
            held[read_indices(key, fields.get(key, np.zeros(0)), count), axis] = True
    elif "pinned_nodes" in fields:
        held[read_indices("pinned_nodes", fields["pinned_nodes"], count)] = True
    elif "Ib" in fields:  # columns of the identity of all coordinates
        if fields["Ib"].shape[0] != 3 * count:
            raise ValueError(
                f"Ib has shape {fields['Ib'].shape}: give a row for each of the {3 * count} coordinates"
            )
        held.flat[np.unique(fields["Ib"].nonzero()[0])] = True
    return {
        node: "".join(axis for axis, is_held in zip("xyz", row, strict=True) if is_held)
        for node, row in enumerate(held)
        if row.any()
    }


def _read_rollers(fields: Fields, count: int) -> dict[int, Array]:
    if "roller_nodes" not in fields:
        return {}
    nodes = read_indices("roller_nodes", fields["roller_nodes"], count)
    normals = finite_array("roller_normals", fields.get("roller_normals"), (len(nodes), 3))
    return {int(node): normals[nodes == node] for node in np.unique(nodes)}

"""Constant matrices in reduced and full coordinates, and their selection.

Full coordinates have separate nodes for each bar and joint constraints; reduced ones share nodes.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.dynamics.constraint_forces import assemble_system
from tenscasadi.dynamics.masses import read_masses
from tenscasadi.dynamics.mechanism import BarLength, Coordinates, Mechanism, free_mass_matrix
from tenscasadi.scene.quantities import MASSES
from tenscasadi.scene.scene import Scene
from tenscasadi.structure.body_assembly import BodyAssembly
from tenscasadi.structure.class_one import connectivity
from tenscasadi.structure.pins import Normals
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import block_inverse, drop_rounding, product
from tenscasadi.util.validate import Array, Indices


def scene_mechanism(
    scene: Scene, coordinates: Coordinates, bar_length: BarLength = "current"
) -> Mechanism:
    """Build the constant matrices of a scene's mechanism.

    Masses may be parameters. For `coordinates` and `bar_length` see `build_mechanism`.
    """
    mechanism = build_mechanism(scene.modelled, coordinates, bar_length)
    layout = scene.modelled._layout if coordinates == "full" else None
    if mechanism.turn is not None and _has_open_masses(scene):
        raise ValueError(
            "Scene.parameters contains masses, and a roller is inclined: "
            'give Model(coordinates="full") for both'
        )
    masses = read_masses(scene, mechanism.physical, mechanism.inverse, layout)
    return mechanism if masses is None else replace(mechanism, masses=masses)


def choose_coordinates(scene: Scene, bar_length: BarLength = "current") -> Coordinates:
    """Choose the coordinates whose equations cost fewer operations.

    In reduced coordinates (shared nodes) the multipliers of all connected bars are coupled, because
    the inverse mass matrix of a long chain is full. In full coordinates (separate nodes with joint
    constraints) each joint is coupled only to its neighbors. Reduced coordinates are also rejected
    if they do not support the scene. `bar_length` is that of `build_mechanism`.
    """
    structure = scene.modelled
    if structure.coupled_mass.any() or structure.bodies:
        return "reduced"
    if structure.rollers and _has_open_masses(scene):
        return "full"
    if bar_length == "constant" and build_mechanism(structure, "reduced").system_size:
        return "full"
    return "full" if is_full_cheaper(structure) else "reduced"


def is_full_cheaper(structure: Structure) -> bool:
    """Return whether full coordinates need four times fewer operations.

    In chains of 40 to 400 bars, an operation in full coordinates takes up to three times as long,
    because sparse routines perform it.
    """
    moving = np.flatnonzero(~structure.fixed.all(axis=1))
    mass = structure.mass_matrix()[moving][:, moving]
    connected = np.bincount(sp.csgraph.connected_components(mass, directed=False)[1])
    if connected.max(initial=0) < 30:  # reduced coordinates are always cheaper
        return False
    full = 4 * _count_operations(build_mechanism(structure, "full"))
    # a product with M⁻ alone
    if float(connected @ connected) > full:
        return True
    return _count_operations(build_mechanism(structure, "reduced")) > full


def compare_coordinates(structure: Structure, coordinates: Coordinates) -> str:
    """Recommend full coordinates in a sentence, "" if not cheaper.

    `coordinates` are those in use.
    """
    if coordinates == "full" or not is_full_cheaper(structure):
        return ""
    return 'many bars are connected: Model(scene, coordinates="full") is faster'


def build_mechanism(
    structure: Structure, coordinates: Coordinates, bar_length: BarLength = "current"
) -> Mechanism:
    """Build the constant matrices of a structure's mechanism.

    `coordinates` is "reduced" (bars share nodes) or "full" (each bar has its own nodes, with joint
    constraints). `bar_length` selects the length in the denominator of the bar multipliers λ̂:
    "current" or "constant".
    """
    build = _build_reduced if coordinates == "reduced" else _build_full
    return build(structure, bar_length == "constant")


def _build_reduced(structure: Structure, constant_length: bool) -> Mechanism:
    n, M, free, turn = len(structure.nodes), structure.mass_matrix(), ~structure.fixed, None
    if structure.rollers:
        free, turn = _build_local_coordinates(structure)
    own = {
        "N": structure.nodes.T,
        "physical": np.arange(n),
        "C_s": connectivity(structure.strings, n),
        **_split_bars(structure, connectivity(structure.bars, n), structure.bars),
    }
    if (bodies := structure._assembly) is not None:
        free, turn = _add_auxiliary_columns(bodies, free, turn)
        own |= _add_bodies(bodies, own)
    spread = own.get("spread")
    reduced = M if spread is None else product(spread.T, M, spread)
    if turn is not None:
        inverse = _invert_masses(reduced, turn, np.flatnonzero(free.ravel()))
    else:
        axes = free.T[:1] if (free == free[:, :1]).all() else free.T
        inverse = tuple(block_inverse(reduced, axis) for axis in axes)
    if spread is not None:
        inverse = tuple(product(spread, part, spread.T) for part in inverse)
    return Mechanism(
        free=free,
        first=np.arange(n),
        M=M,
        inverse=inverse,
        P=sp.csr_array((M.shape[0], 0)),
        D=np.zeros((3, 0)),
        active=np.ones((3, 0), bool),
        constant_length=constant_length,
        turn=turn,
        **own,
    )


def _add_auxiliary_columns(
    bodies: BodyAssembly, free: Any, turn: sp.csr_array | None
) -> tuple[Any, sp.csr_array | None]:
    """Add auxiliary nodes of rigid bodies to the free coordinates.

    `free` (n, 3) flags the free coordinates, and `turn` (3n×3n) converts from roller axes to x, y
    and z. Nodes that are combinations of other nodes of their body are not free. Returns both with
    the auxiliary nodes.
    """
    count = len(bodies.hosts)
    free = np.concatenate([free, np.ones((count, 3), dtype=bool)])
    free[bodies.dependent] = False
    if turn is not None and count:
        turn = sp.csr_array(sp.block_diag([turn, sp.eye_array(3 * count)]))
    return free, turn


def _add_bodies(bodies: BodyAssembly, own: dict[str, Any]) -> dict[str, Any]:
    """Add bodies, as auxiliary nodes and bars, to a mechanism's fields.

    `own` are fields of a `Mechanism` without bodies, by name. Returns the changed fields.
    """
    more, size = len(bodies.hosts), len(bodies.nodes)
    widths = {
        name: sp.csr_array(
            (own[name].data, own[name].indices, own[name].indptr), (own[name].shape[0], size)
        )
        for name in ("C_s", "C_b", "C_e")
    }
    last = len(own["bar_ends"]) + np.arange(len(bodies.bars))
    return widths | {
        "N": bodies.nodes.T,
        "physical": np.concatenate([own["physical"], *([host[0]] for host in bodies.hosts[:more])]),
        "C_b": sp.csr_array(sp.vstack([widths["C_b"], connectivity(bodies.bars, size)])),
        "rigid": np.concatenate([own["rigid"], last]),
        "lengths": np.concatenate([own["lengths"], bodies.lengths]),
        "spread": bodies.spread if len(bodies.dependent) else None,
        "body_of_bar": bodies.body,
    }


def _build_full(structure: Structure, constant_length: bool) -> Mechanism:
    if structure.coupled_mass.any():
        raise ValueError(
            'coordinates is "full", where bars have no mass in common: give "reduced" for strings with Scene(ends="consistent")'
        )
    if structure.bodies:
        raise ValueError('coordinates is "full", which has no bodies: give "reduced"')
    split = structure.class_one(sparse=True)
    n = split.N.shape[1]
    first = np.unique(split.physical, return_index=True)[1]
    # Supports that N P = D cannot express have a column each: single axes, then inclined rollers.
    fixed, inclined = structure.fixed, np.array(list(structure.rollers), dtype=np.intp)
    partly = np.flatnonzero(fixed.any(axis=1) & ~fixed.all(axis=1))
    held = np.concatenate([partly, inclined])
    columns = sp.csr_array(
        (np.ones(len(held)), (first[held], np.arange(len(held)))), shape=(n, len(held))
    )
    P = sp.csr_array(sp.hstack([split.P, columns]))
    among = np.array(
        [[k < len(normals) for normals in structure.rollers.values()] for k in range(3)], dtype=bool
    ).reshape(3, -1)
    axes = [np.eye(3)] * (P.shape[1] - len(inclined))
    # A pinned string node may have no mass. It never moves, so any mass is equivalent.
    diagonal = split.M_s.diagonal()
    some = np.where(diagonal == 0, diagonal.max(initial=0.0) or 1.0, 0.0)
    return Mechanism(
        N=split.N,
        free=np.ones((n, 3), dtype=bool),
        physical=split.physical,
        first=first,
        C_s=sp.csr_array(split.C_s),
        M=split.M_s,
        inverse=(block_inverse(split.M_s + sp.diags_array(some), np.ones(n, bool)),),
        P=P,
        D=np.hstack([split.D, structure.nodes[held].T]),
        active=np.hstack([np.ones(split.D.shape, bool), fixed[partly].T, among]),
        constant_length=constant_length,
        frames=np.array([*axes, *map(_frame, structure.rollers.values())])
        if len(inclined)
        else None,
        **_split_bars(
            structure, sp.csr_array(split.C_b @ split.C_nb), structure._layout.bar_columns
        ),
    )


def _split_bars(structure: Structure, C_b: sp.csr_array, ends: Indices) -> dict[str, Any]:
    """Separate rigid from elastic bars.

    C_b is the connectivity (bars × n) of all bars, with the given end columns. Returns fields of
    `Mechanism`, by name.
    """
    rigid = np.flatnonzero(~structure.elastic)
    return {
        "C_b": C_b[rigid],
        "C_e": C_b[np.flatnonzero(structure.elastic)],
        "bar_ends": ends,
        "rigid": rigid,
        "lengths": structure.bar_lengths[rigid],
    }


def _has_open_masses(scene: Scene) -> bool:
    return bool(scene.layout.quantities.keys() & set(MASSES))


def _count_operations(mech: Mechanism) -> int:
    """Count the multiplications for the multipliers and for M⁻.

    `mech` has the coordinates whose cost is estimated.
    """
    if not mech.system_size:
        return 0
    B = mech.bar_vectors(ca.DM(mech.N))
    none = ca.DM.zeros(1, mech.bars), ca.DM.zeros(3, mech.joints)
    columns = np.diff(assemble_system(mech, B, *none)[0].sparsity().ldl()[0].colind())
    solving = (columns**2).sum() + 6 * columns.sum()  # three solutions, see solve_semidefinite
    return int(solving + sum(inverse.nnz for inverse in mech.inverse))


def _build_local_coordinates(structure: Structure) -> tuple[Any, sp.csr_array]:
    """Build coordinates along the directions of inclined rollers.

    Returns the mask (n, 3) of free coordinates, which are along rollers, and `Mechanism.turn`.
    """
    free, frames = ~structure.fixed, [np.eye(3)] * len(structure.nodes)
    for node, normals in structure.rollers.items():
        free[node], frames[node] = np.arange(3) >= len(normals), _frame(normals)
    return free, sp.csr_array(sp.block_diag(frames))


def _invert_masses(M: Any, turn: sp.csr_array, index: Indices) -> tuple[sp.csr_array, ...]:
    """Compute the inverse mass matrix M⁻ for inclined rollers.

    M (n×n) is the mass matrix of the nodes, `turn` (3n×3n) converts from roller axes to x, y and z,
    and `index` are the free coordinates among them. Returns nine blocks (n×n), one for each pair of
    axes.
    """
    free = sp.csr_array(turn[:, index])
    inner = block_inverse(free_mass_matrix(M, turn, index), np.ones(len(index), bool))
    wide = drop_rounding(free @ inner @ free.T)
    return tuple(sp.csr_array(wide[one::3][:, other::3]) for one in range(3) for other in range(3))


def _frame(normals: Normals) -> Array:
    """Complete orthonormal vectors to a basis (3×3), as columns.

    `normals` are one or two vectors normal to the plane or line of a roller.
    """
    directions = np.array(normals)
    return np.column_stack([*directions, *np.linalg.svd(directions)[2][len(directions) :]])

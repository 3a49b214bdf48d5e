"""Mass matrix M and its inverse as functions of the parameters p."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.parameter_layout import Affine
from tenscasadi.scene.quantities import BODIES, MASSES, build_inertia, read_values
from tenscasadi.structure.body_assembly import BodyAssembly
from tenscasadi.structure.class_one import Layout
from tenscasadi.structure.subdivision import cut_strings
from tenscasadi.util.casadi_tools import matrix_with_pattern, sparse
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import Array, Indices

# Unknowns above which a linear system is solved by a routine: unrolled derivatives are longer.
UNROLL_SOLVE = 6


@dataclass(frozen=True, eq=False)
class Masses(ReadOnlyArrays):
    """Mass matrix M and its inverse M⁻ as functions of the parameters.

    Attributes
    ----------
    entries : Affine
        Nonzeros of M, column by column.
    pattern : casadi.Sparsity, (n, n)
        Sparsity of M.
    free : tuple of ndarray of bool (n,)
        For each M⁻, the nodes that can move along its axes.
    held : ndarray (n,)
        Constant inverse mass of columns that never move [1/kg]; 0 for others.
    spread : csr_array (n, n), optional
        Weights of independent nodes on all nodes, see `Mechanism`; None: identity.
    """

    entries: Affine
    pattern: ca.Sparsity
    free: tuple[Any, ...]
    held: Array
    spread: sp.csr_array | None = None

    def weigh(self, p: Any) -> Any:
        """Compute the nonzeros of M and M⁻ as one column.

        p (np) are the parameters, a CasADi column.
        """
        entries = self.entries.expression(p, full=True)
        inverse = self._unrolled if isinstance(p, ca.SX) else self._inverse
        return ca.vertcat(entries, *inverse.call([entries]))

    def matrices(self, weights: Any) -> tuple[Any, tuple[Any, ...]]:
        """Build M and M⁻ (n×n) from their nonzeros.

        `weights` is the column of nonzeros from `weigh`. There is one M⁻ for all axes or one for
        each.
        """
        patterns = [self.pattern, *self.patterns]
        parts = ca.vertsplit(weights, np.cumsum([0, *(part.nnz() for part in patterns)]).tolist())
        M, *inverses = map(matrix_with_pattern, patterns, parts)
        return M, tuple(inverses)

    def mass_matrix(self, p: Any) -> Any:
        """Build the mass matrix M for parameters p.

        It is (n×n), for a CasADi column p (np).
        """
        return matrix_with_pattern(self.pattern, self.entries.expression(p, full=True))

    @cached_property
    def patterns(self) -> list[ca.Sparsity]:
        """Sparsity of each M⁻."""
        n = self.pattern.size1()
        found = []
        for blocks in self._blocks:
            rows = [node for block in blocks for node in np.tile(block, len(block)).tolist()]
            columns = [node for block in blocks for node in np.repeat(block, len(block)).tolist()]
            if self.spread is not None:  # of S M⁻ Sᵀ
                inner = sp.csr_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
                rows, columns = self._expand(inner).nonzero()
            found.append(ca.Sparsity.triplet(n, n, list(map(int, rows)), list(map(int, columns))))
        return found

    def _expand(self, inner: sp.csr_array) -> sp.csr_array:
        """Find the sparsity of S M⁻ Sᵀ from that of M⁻.

        `inner` (n, n) has the nonzeros of M⁻ of independent nodes, and S is `spread`.
        """
        weights = abs(sp.csr_array(self.spread)).sign()
        return sp.csr_array(weights @ inner @ weights.T)

    @cached_property
    def _blocks(self) -> list[list[Indices]]:
        """Groups of nodes that M couples, for each M⁻."""
        ones = np.ones(self.pattern.nnz()), self.pattern.get_triplet()
        coupled = sp.csr_array(ones, shape=(self.pattern.size1(),) * 2)
        if self.spread is not None:  # of Sᵀ M S
            weights = abs(self.spread).sign()
            coupled = sp.csr_array(weights.T @ coupled @ weights)
        found = []
        for free in self.free:
            index = np.flatnonzero(free)
            _, label = sp.csgraph.connected_components(coupled[index][:, index], directed=False)
            found.append([index[label == k] for k in range(label.max(initial=-1) + 1)])
        return found

    @cached_property
    def _inverse(self) -> ca.Function:
        """Function from the nonzeros of M to those of M⁻."""
        small = all(len(block) <= UNROLL_SOLVE for blocks in self._blocks for block in blocks)
        return self._unrolled if small else self._write_inverse(ca.MX)

    @cached_property
    def _unrolled(self) -> ca.Function:
        """`_inverse` as scalar code, for all block sizes."""
        return self._write_inverse(ca.SX)

    def _write_inverse(self, kind: Any) -> ca.Function:
        entries = kind.sym("entries", self.pattern.nnz())
        M = matrix_with_pattern(self.pattern, entries)
        S = None if self.spread is None else sparse(self.spread)
        M = M if S is None else ca.mtimes(ca.mtimes(S.T, M), S)
        n = self.pattern.size1()
        outputs = []
        for pattern, blocks in zip(self.patterns, self._blocks, strict=True):
            inverse = kind(pattern) if S is None else kind(n, n)
            for block in blocks:
                nodes = block.tolist()
                inverse[nodes, nodes] = _invert(M[nodes, nodes], self.held[block])
            if S is not None:
                inverse = ca.project(ca.mtimes(ca.mtimes(S, inverse), S.T), pattern)
            outputs.append(inverse.nz[:])
        return ca.Function("inverse_masses", [entries], outputs)


def _invert(block: Any, held: Array) -> Any:
    """Invert a symmetric positive definite block of M.

    The inverse of a single pinned node is given by `held`. `held` (k,) has the constant inverse
    masses of the k nodes of the block [1/kg], 0 if they can move.
    """
    n = block.shape[0]
    if n == 1:
        return ca.DM(held[0]) if held[0] else 1 / block
    if n == 2:  # a bar of class one
        a, b, c = block[0, 0], block[0, 1], block[1, 1]
        determinant = a * c - b * b
        return ca.vertcat(ca.horzcat(c, -b), ca.horzcat(-b, a)) / determinant
    if isinstance(block, ca.SX):
        D, LT, permutation = ca.ldl(block)
        return ca.ldl_solve(ca.SX.eye(n), D, LT, permutation)
    return ca.solve(block, ca.DM.eye(n), "ldl")


def read_masses(
    scene: Any, physical: Indices, inverse: tuple[Any, ...], layout: Layout | None
) -> Masses | None:
    """Read the parametric masses of a mechanism, if any.

    Parameters
    ----------
    scene : Scene
        The scene.
    physical : ndarray of int, shape (n,)
        Physical node of each column.
    inverse : tuple of sparse array (n, n)
        Nominal M⁻.
    layout : Layout or None
        Layout of full coordinates, None for reduced ones.
    """
    if not scene.layout.quantities.keys() & set(MASSES):
        return None
    structure, n, beta = scene.modelled, len(physical), len(scene.modelled.bars)
    bodies = structure._assembly
    own_masses = [
        *(_affine(scene, "bar_mass"), _node_masses(scene), _compute_coupled_masses(scene)),
        *([] if bodies is None else [(body_masses := _body_masses(scene, bodies)).values]),
    ]
    given = Affine(
        np.concatenate([part.constant for part in own_masses]),
        sp.csr_array(sp.vstack([part.matrix for part in own_masses])),
    )
    columns, share = structure.bars, np.ones(n)
    if layout is not None:
        columns, share = layout.bar_columns, layout.mass_share
    own = structure.bar_inertia / structure.bar_mass  # J/m, Eq. 19
    (a, b), bar, point = columns.T, np.arange(beta), np.arange(n)
    if bodies is not None:  # auxiliary nodes have no mass of their own
        point = point[: len(structure.nodes)]
    c, d = (structure.strings if layout is None else layout.string_columns).T
    string = beta + len(structure.nodes) + np.arange(len(structure.strings))
    sixth = np.full(len(string), 1 / 6 if scene.ends == "consistent" else 0.0)
    row = np.concatenate([a, b, a, b, point, c, d, c, d])
    column = np.concatenate([a, b, b, a, point, c, d, d, c])
    source = np.concatenate([bar] * 4 + [beta + physical[point]] + [string] * 4)
    bars = [0.25 + own, 0.25 + own, 0.25 - own, 0.25 - own]  # Eq. 59
    value = np.concatenate([*bars, share[point], -sixth, -sixth, sixth, sixth])
    if bodies is not None:
        row, column = np.append(row, body_masses.row), np.append(column, body_masses.column)
        last = np.arange(len(given.constant))[-len(body_masses.row) :]
        source, value = np.append(source, last), np.append(value, np.ones(len(last)))
    kept = value != 0
    code, entry = np.unique((column * n + row)[kept], return_inverse=True)
    onto_entries = sp.csr_array(
        (value[kept], (entry, source[kept])), shape=(len(code), len(given.constant))
    )
    pattern = ca.Sparsity.triplet(n, n, (code % n).tolist(), (code // n).tolist())
    free = tuple(np.asarray(matrix.diagonal() > 0) for matrix in inverse)
    held = np.zeros(n)
    if layout is not None:  # a pinned node without bars may have no mass, because it never moves
        pinned = structure.fixed.all(axis=1)[physical]
        pinned[columns] = False
        held[pinned] = inverse[0].diagonal()[pinned]
    if bodies is None or not len(bodies.dependent):
        return Masses(given.then(onto_entries), pattern, free, held)
    for mask in free:
        mask[bodies.dependent] = False
    return Masses(given.then(onto_entries), pattern, free, held, bodies.spread)


class _BodyEntries(NamedTuple):
    """Nonzeros of the mass matrix of rigid bodies.

    `row` and `column` are their node columns, and `values` their dependence on the parameters [kg].
    """

    row: Indices
    column: Indices
    values: Affine


def _body_masses(scene: Any, bodies: BodyAssembly) -> _BodyEntries:
    """Compute the nonzeros of the mass matrix of rigid bodies.

    They are linear in the mass m and the inertia I of each body: m w wᵀ + W (½ tr(I) E − I) Wᵀ. In
    `bodies`, w are the weights of the nodes for the center of mass, and W those for the axes. E is
    the identity.
    """
    own = scene.layout.quantities.keys() & set(BODIES)
    if not own:
        constant = bodies.mass.tocoo()
        matrix = sp.csr_array((constant.nnz, len(scene.layout)))
        return _BodyEntries(constant.row, constant.col, Affine(constant.data, matrix))
    axes = build_inertia(np.eye(6))
    second = np.trace(axes, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - axes  # of each entry
    nominal = read_values(scene.structure, "body_inertia").reshape(-1, 6)
    by_mass, by_inertia, ends = [], [], []
    for body, (nodes, center, W), inertia in zip(
        scene.structure.bodies, bodies.maps, nominal, strict=True
    ):
        entries = np.array([(W @ S @ W.T).ravel() for S in second]).T
        mass = np.outer(center, center).ravel()
        if body.inertia is None and "body_inertia" not in own:  # that of masses on its nodes
            mass, entries = mass + entries @ inertia / body.mass, 0.0 * entries
        by_mass.append(mass[:, None])
        by_inertia.append(entries)
        ends.append(np.array([np.repeat(nodes, len(nodes)), np.tile(nodes, len(nodes))]))
    parts = (
        _affine(scene, "body_mass").then(sp.block_diag(by_mass)),
        _affine(scene, "body_inertia").then(sp.block_diag(by_inertia)),
    )
    row, column = np.concatenate(ends, axis=1)
    total = Affine(
        parts[0].constant + parts[1].constant, sp.csr_array(parts[0].matrix + parts[1].matrix)
    )
    return _BodyEntries(row, column, total)


def node_weights(scene: Any) -> Affine:
    """Compute the mass that each modeled node carries [kg].

    These are the row sums of M.
    """
    bars, count = scene.modelled.bars, len(scene.modelled.nodes)
    ends = bars.ravel(), np.repeat(np.arange(len(bars)), 2)
    halves = sp.csr_array((np.full(bars.size, 0.5), ends), shape=(count, len(bars)))
    own, nodes = _affine(scene, "bar_mass").then(halves), _node_masses(scene)
    parts = [own, nodes]
    if scene.modelled.bodies:
        bodies = _body_masses(scene, scene.modelled._assembly)
        real = np.flatnonzero(bodies.row < count)  # without auxiliary nodes
        shape = count, len(bodies.row)
        parts.append(
            bodies.values.then(
                sp.csr_array((np.ones(len(real)), (bodies.row[real], real)), shape=shape)
            )
        )
    return Affine(
        np.sum([part.constant for part in parts], axis=0),
        sp.csr_array(sum((part.matrix for part in parts[1:]), start=parts[0].matrix)),
    )


def _node_masses(scene: Any) -> Affine:
    """Compute the point masses of modeled nodes as functions of p."""
    s = scene.structure
    on_ends = scene.ends != "interior"
    spread = cut_strings(s.nodes, s.strings, scene.segment_fractions, on_ends)[2]
    points = _affine(scene, "node_mass").then(sp.eye_array(spread.shape[0], len(s.nodes)))
    strings = _affine(scene, "string_mass").then(spread)
    return Affine(points.constant + strings.constant, sp.csr_array(points.matrix + strings.matrix))


def _compute_coupled_masses(scene: Any) -> Affine:
    """Compute the consistent masses of string segments as functions of p."""
    s = scene.modelled
    count = len(s.strings)
    onto_segments = sp.csr_array(
        (s.string_fraction, (np.arange(count), s.string_parent)),
        shape=(count, len(scene.structure.strings)),
    )
    return _affine(scene, "string_mass").then(onto_segments)


def _affine(scene: Any, name: str) -> Affine:
    values = read_values(scene.structure, name)
    constant = Affine(np.asarray(values), sp.csr_array((len(values), len(scene.layout))))
    return scene.layout.quantities.get(name, constant)  # type: ignore[no-any-return]

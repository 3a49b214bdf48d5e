"""Parametric masses: M and its inverse as expressions of p."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.parameter_layout import Affine
from tenscasadi.scene.parameters import MASSES
from tenscasadi.structure.class_one import Layout
from tenscasadi.structure.structure import Structure
from tenscasadi.structure.subdivision import cut_strings
from tenscasadi.util.casadi_tools import matrix_with_pattern
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import Array, Indices

# unknowns above which a linear system is solved by a routine, not unrolled: shorter derivatives
UNROLL_SOLVE = 6


@dataclass(frozen=True, eq=False)
class Masses(ReadOnlyArrays):
    """Dependence of M and M⁻ on the parameters."""

    entries: Affine  # entries of M, column by column
    pattern: ca.Sparsity  # sparsity of M, n×n
    free: tuple[Any, ...]  # (n,) bool for each M⁻: nodes that can move along its axes
    held: Array  # (n,) constant inverse mass of columns that never move [1/kg]; 0 for others

    @property
    def size(self) -> int:
        """Number of entries of M and M⁻."""
        return int(self.pattern.nnz()) + sum(pattern.nnz() for pattern, _ in self._inverses)

    def weigh(self, p: Any) -> Any:
        """Compute the entries of M and M⁻ from CasADi parameters.

        They are one below the other.
        """
        entries = self._column(p)
        inverse = self._scalar_inverse if isinstance(p, ca.SX) else self._inverse
        return ca.vertcat(entries, *inverse.call([entries]))

    def matrices(self, weights: Any) -> tuple[Any, tuple[Any, ...]]:
        """Build M and M⁻ (n×n) from their entries.

        There is one M⁻ for each axis, or one for all three.
        """
        sizes = np.cumsum(
            [0, self.pattern.nnz(), *(pattern.nnz() for pattern, _ in self._inverses)]
        ).tolist()
        patterns = [self.pattern, *(pattern for pattern, _ in self._inverses)]
        M, *inverses = (
            matrix_with_pattern(pattern, weights[a:b])
            for pattern, a, b in zip(patterns, sizes, sizes[1:], strict=False)
        )
        return M, tuple(inverses)

    def mass_matrix(self, p: Any) -> Any:
        """Build M only."""
        return matrix_with_pattern(self.pattern, self._column(p))

    @cached_property
    def patterns(self) -> list[sp.csr_array]:
        """Positive definite matrices with the sparsity of each M⁻.

        No entries cancel in them, as they may for particular masses.
        """
        generator, found = np.random.default_rng(0), []
        for pattern, _ in self._inverses:
            row, column = pattern.get_triplet()
            half = sp.csr_array((generator.random(len(row)), (row, column)), shape=pattern.shape)
            found.append(
                sp.csr_array(
                    half
                    + half.T
                    + sp.diags_array(np.where(half.diagonal() > 0, 2.0 * pattern.size1(), 0.0))
                )
            )
        return found

    def _column(self, p: Any) -> Any:
        entries = self.entries.expression(p)
        return (
            entries
            if entries.shape[0] == self.pattern.nnz()
            else ca.repmat(entries, self.pattern.nnz(), 1)
        )

    @cached_property
    def _inverses(self) -> list[tuple[ca.Sparsity, list[Indices]]]:
        """Sparsity of each M⁻, and blocks of joined nodes."""
        n = self.pattern.size1()
        linked = sp.csr_array(
            (np.ones(self.pattern.nnz()), self.pattern.get_triplet()), shape=(n, n)
        )
        found = []
        for free in self.free:
            index = np.flatnonzero(free)
            count, label = sp.csgraph.connected_components(linked[index][:, index], directed=False)
            blocks = [index[label == k] for k in range(count)] if len(index) else []
            rows = np.concatenate(
                [np.zeros(0, int), *(np.tile(block, len(block)) for block in blocks)]
            )
            columns = np.concatenate(
                [np.zeros(0, int), *(np.repeat(block, len(block)) for block in blocks)]
            )
            found.append((ca.Sparsity.triplet(n, n, rows.tolist(), columns.tolist()), blocks))
        return found

    @cached_property
    def _inverse(self) -> ca.Function:
        """Function from the entries of M to those of M⁻."""
        small = all(len(block) <= UNROLL_SOLVE for _, blocks in self._inverses for block in blocks)
        return self._scalar_inverse if small else self._write_inverse(ca.MX)

    @cached_property
    def _scalar_inverse(self) -> ca.Function:
        """`_inverse` as scalar code for all block sizes."""
        return self._write_inverse(ca.SX)

    def _write_inverse(self, kind: Any) -> ca.Function:
        entries = kind.sym("entries", self.pattern.nnz())
        M = matrix_with_pattern(self.pattern, entries)
        outputs = []
        for _, blocks in self._inverses:
            rows, columns, values = [], [], []
            for block in blocks:
                inverse = ca.densify(_invert(M[block.tolist(), block.tolist()], self.held[block]))
                rows.append(np.tile(block, len(block)))
                columns.append(np.repeat(block, len(block)))
                values.append(ca.vec(inverse))
            order = (
                np.lexsort((np.concatenate(rows), np.concatenate(columns))).tolist() if rows else []
            )
            outputs.append(ca.vertcat(*values)[order] if values else kind(0, 1))
        return ca.Function("inverse_masses", [entries], outputs)


def _invert(block: Any, held: Array) -> Any:
    """Invert a symmetric positive definite matrix, dense.

    The inverse mass of a single node may be `held` constant.
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
    """Read the parametric masses of a mechanism; None if constant.

    `inverse` is the nominal M⁻ of the mechanism. `layout` is that of full coordinates, None for
    reduced ones.
    """
    quantities = scene.layout.quantities
    if not quantities.keys() & set(MASSES):
        return None
    structure, n = scene.modelled, len(physical)
    given = _stack(_bar_masses(scene), _node_masses(scene))
    columns, share = (
        (structure.bars, np.ones(n)) if layout is None else (layout.bar_columns, layout.mass_share)
    )
    beta = len(structure.bars)
    own = structure.bar_inertia / structure.bar_mass  # J/m, Eq. 19
    (a, b), bar = columns.T, np.arange(beta)
    row, column = (
        np.concatenate([a, b, a, b, np.arange(n)]),
        np.concatenate([a, b, b, a, np.arange(n)]),
    )
    source = np.concatenate([bar, bar, bar, bar, beta + physical])
    value = np.concatenate([0.25 + own, 0.25 + own, 0.25 - own, 0.25 - own, share])  # Eq. 59
    kept = value != 0
    row, column, source, value = row[kept], column[kept], source[kept], value[kept]
    code, entry = np.unique(column * n + row, return_inverse=True)
    onto_entries = sp.csr_array(
        (value, (entry, source)), shape=(len(code), beta + len(structure.nodes))
    )
    pattern = ca.Sparsity.triplet(n, n, (code % n).tolist(), (code // n).tolist())
    free = tuple(np.asarray(matrix.diagonal() > 0) for matrix in inverse)
    held = np.zeros(n)
    if layout is not None:  # a pinned node without bars may have no mass, because it never moves
        pinned = structure.fixed.all(axis=1)[physical]
        pinned[columns] = False
        held[pinned] = inverse[0].diagonal()[pinned]
    return Masses(given.then(onto_entries), pattern, free, held)


def _bar_masses(scene: Any) -> Affine:
    return scene.layout.quantities.get("bar_mass") or _constant(scene, scene.structure.bar_mass)


def _node_masses(scene: Any) -> Affine:
    """Compute the masses of modeled nodes, including those of segments."""
    structure, n = scene.structure, len(scene.modelled.nodes)
    points = scene.layout.quantities.get("node_mass") or _constant(scene, structure.node_mass)
    points = points.then(sp.eye_array(n, len(structure.nodes)))
    strings = scene.layout.quantities.get("string_mass") or _constant(scene, structure.string_mass)
    spread = strings.then(_string_shares(structure, scene))
    return Affine(points.constant + spread.constant, sp.csr_array(points.matrix + spread.matrix))


def _string_shares(structure: Structure, scene: Any) -> sp.csr_array:
    """Compute the fraction of each string's mass per node (n×α)."""
    n, count = len(structure.nodes), len(structure.strings)
    found = sp.lil_array((len(scene.modelled.nodes), count))
    modelled, new = scene.modelled, n
    if len(modelled.nodes) == n and scene.ends != "lumped":
        return sp.csr_array(found)
    for i in range(count):
        share = modelled.string_fraction[modelled.string_parent == i] / structure.string_fraction[i]
        mass = cut_strings(
            structure.nodes,
            structure.strings[i : i + 1],
            np.ones(1),
            [share],
            scene.ends == "lumped",
        )[2]
        inner = len(mass) - n
        found[:n, [i]], found[new : new + inner, [i]] = mass[:n, None], mass[n:, None]
        new += inner
    return sp.csr_array(found)


def _constant(scene: Any, values: Array) -> Affine:
    return Affine(np.asarray(values), sp.csr_array((len(values), len(scene.layout))))


def _stack(upper: Affine, lower: Affine) -> Affine:
    return Affine(
        np.concatenate([upper.constant, lower.constant]),
        sp.csr_array(sp.vstack([upper.matrix, lower.matrix])),
    )

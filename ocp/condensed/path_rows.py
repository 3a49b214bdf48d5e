"""The limits along the way, as rows of the condensed problem: values, derivatives, and which of them count among the rows of a step."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ocp.condensed.chain import Chain, Motion
from ocp.condensed.limits import Limits
from ocp.problem.problem import Problem
from ocp.problem.scaling import Scales
from ocp.targets.target import Target
from ocp.transcription.assemble import path_blocks
from ocp.transcription.base import Transcription
from ocp.transcription.initial_guess import Guess
from ocp.transcription.sparse_nlp import Block, symbol_kind
from ocp.transcription.variables import Variables
from tenscasadi.util.validate import Array, Indices

MOST_WORKING = 400  # rows of a step
FELT = 1e-2  # of the metric: what a row adds to it at least
UNMET = 1e-9  # in order-one rows
SAMPLE = 30  # rows, from which is learnt what they add


class Slopes(NamedTuple):
    """Derivatives of r functions by the motion, by force densities (Kc, m, r), and by the duration (r,), each alone."""

    motion: Motion
    controls: Array
    duration: Array


class Limited:
    """All that is limited, as blocks over the entries of `Variables`: unknowns before constants."""

    def __init__(
        self,
        problem: Problem,
        transcription: Transcription,
        target: Target,
        scales: Scales,
        guess: Guess,
    ) -> None:
        v = self.variables = Variables(
            problem, target, scales, guess, transcription.fractions, transcription.control
        )
        given = path_blocks(v)
        unknowns, self.place = v.entries.ordered()
        self.count, self.constants = unknowns.count, unknowns.constants
        self.blocks = _told_once([block.relabelled(self.place) for block in given], self.count)
        used, nq = v.entries.used_by(given), problem.model.nq
        self.taps = np.flatnonzero(
            used[v.states[:, nq : 2 * nq]].any(axis=1)
        )  # nodes of the mesh whose velocities are limited
        self.taps = self.taps[self.taps > 0]


def _told_once(blocks: list[Block], unknowns: int) -> list[Block]:
    """Return the blocks without what is constant, and without what repeats another: what states decide ends one interval and starts the next."""
    seen: set[tuple[str, bytes]] = set()
    found = []
    for block in sorted(blocks, key=lambda one: "start of interval" in one.names[0]):
        columns = np.unique(_pattern(block.function.jac_sparsity(0, 0))[1])
        names = np.array(block.names, dtype=object).reshape(block.count, -1)
        what = ", ".join(name.partition(",")[0] for name in names[0])
        keys = [(what, index.tobytes()) for index in block.index[:, columns]]
        kept = [
            k
            for k, key in enumerate(keys)
            if key not in seen and (block.index[k, columns] < unknowns).any()
        ]
        seen.update(keys)
        if kept:
            limits = {
                field: _of_instances(getattr(block, field), kept)
                for field in ("lower", "upper", "scale")
            }
            found.append(
                replace(block, index=block.index[kept], names=tuple(names[kept].ravel()), **limits)
            )
    return found


def _of_instances(values: Any, kept: list[int]) -> Any:
    return values[kept] if np.ndim(values) == 2 else values


class PathRows:
    """Rows lower ≤ h ≤ upper of order one (p,), of the entries e of a motion: its free places and velocities, γ and the duration."""

    def __init__(self, chain: Chain, limited: Limited | None, begins: Indices) -> None:
        self.chain, self.free_duration = chain, False
        parts = [] if limited is None else [_Part(block, limited.count) for block in limited.blocks]
        ends = np.cumsum([0, *(part.size for part in parts)]).tolist()
        self.parts = [
            (part, slice(*span)) for part, span in zip(parts, pairwise(ends), strict=True)
        ]
        self.count = ends[-1]
        self.names = tuple(name for part in parts for name in part.block.names)
        columns = [np.zeros((3, 0)), *(np.array(part.block.limits()) for part in parts)]
        lower, upper, self.scale = np.concatenate(columns, axis=1)
        self.limits = Limits(lower, upper)
        if limited is None:
            return
        v, nq = limited.variables, chain.model.nq
        states = limited.place[v.states[1:]]
        self.places, self.rates, self.clocks = (
            states[:, :nq],
            states[chain.taps - 1, nq : 2 * nq],
            states[:, 2 * nq :],
        )
        self.held, self.last = limited.place[v.controls[begins]], limited.place[v.duration]
        self.size, self.constants, self.free_duration = (
            limited.count,
            limited.constants,
            v.free_time,
        )

    # --- entries ---

    def entries(self, c: Array, duration: float, motion: Motion) -> Array:
        """Return e, and constants after them, of a motion."""
        chain, e = self.chain, np.append(np.zeros(self.size), self.constants)
        e[self.places] = self._free(motion.places[1:])
        e[self.rates] = self._free(motion.rates) / duration
        e[self.clocks] = chain.clock + duration * chain.time[1:, None]
        e[self.held] = c
        if self.free_duration:
            e[self.last] = duration
        return e

    def change(self, at: Motion, duration: float, moved: Motion, c: Array, longer: float) -> Array:
        """Return the change of e (size,) along a step of a motion (one column), of force densities (Kc, m), and of the duration."""
        chain, e = self.chain, np.zeros(self.size)
        e[self.places] = self._free(moved.places[1:])
        e[self.rates] = self._free(moved.rates) / duration - longer / duration**2 * self._free(
            at.rates
        )
        e[self.clocks] = longer * chain.time[1:, None]
        e[self.held] = c
        if self.free_duration:
            e[self.last] = longer
        return e

    def slopes(self, at: Motion, duration: float, gradient: Array) -> Slopes:
        """Return the derivatives of r functions from those by e (size, r): the transpose of `change`."""
        chain, columns = self.chain, gradient.shape[1]
        result = chain.zero_step(columns)
        result.places[1:] = self._at_nodes(gradient[self.places])
        result.rates[:] = self._at_nodes(gradient[self.rates]) / duration
        longer = (chain.time[1:, None, None] * gradient[self.clocks]).sum(axis=(0, 1))
        longer -= np.einsum("xi,xir->r", self._free(at.rates), gradient[self.rates]) / duration**2
        if self.free_duration:
            longer += gradient[self.last[0]]
        return Slopes(result, gradient[self.held], longer)

    def bent(
        self, at: Motion, duration: float, gradient: Array, moved: Motion, longer: float
    ) -> Slopes:
        """Return how `slopes` of a gradient (size,) by e change along a step: velocities are rates over the duration."""
        chain = self.chain
        result = chain.zero_step(1)
        own = gradient[self.rates]
        result.rates[:] = -longer / duration**2 * self._at_nodes(own[:, :, None])
        along = (
            -(own * self._free(moved.rates)).sum() / duration**2
            + 2 * longer / duration**3 * (own * self._free(at.rates)).sum()
        )
        return Slopes(result, np.zeros((*self.held.shape, 1)), np.array([along]))

    def _free(self, vectors: Array) -> Array:
        """Return free coordinates (P, nq) of vectors (P, …)."""
        mech = self.chain.mech
        return np.asarray(mech.local(vectors.reshape(len(vectors), -1))[:, mech.free_index])

    def _at_nodes(self, free: Array) -> Array:
        """Return vectors (P, 3n, r) of free coordinates (P, nq, r)."""
        mech, (count, _, columns) = self.chain.mech, free.shape
        wide = np.zeros((count, columns, 3 * self.chain.nodes))
        wide[:, :, mech.free_index] = free.transpose(0, 2, 1)
        return np.asarray(mech.world(wide)).transpose(0, 2, 1)

    # --- rows ---

    def value(self, c: Array, duration: float, motion: Motion) -> Array:
        """Return h (p,)."""
        if not self.count:
            return np.zeros(0)
        e = self.entries(c, duration, motion)
        return np.concatenate([part.value(e) for part, _ in self.parts])

    def jacobian(self, e: Array) -> sp.csr_array:
        """Return the derivatives (p, size) of h by e."""
        return sp.csr_array(sp.vstack([part.jacobian(e) for part, _ in self.parts]))

    def hessian(self, e: Array, weights: Array) -> sp.csr_array:
        """Return the second derivatives (size, size) of weightsᵀ h by e."""
        return sum(
            (part.hessian(e, weights[own]) for part, own in self.parts),
            start=sp.csr_array((self.size, self.size)),
        )


class _Part:
    """Rows of all instances of one block, one instance after the other."""

    def __init__(self, block: Block, unknowns: int) -> None:
        self.block, self.size, self.unknowns = block, block.size, unknowns
        z: Any = symbol_kind(block.function).sym("z", block.function.size1_in(0))
        value = block.function(z)
        weight = type(z).sym("weight", value.shape[0])
        slopes, curved = ca.jacobian(value, z), ca.hessian(ca.dot(weight, value), z)[0]
        self._value = block.function.map(block.count)
        self._slopes = ca.Function("slopes", [z], [_entries(slopes)]).map(block.count)
        self._curved = ca.Function("curved", [z, weight], [_entries(curved)]).map(block.count)
        row, column = _pattern(slopes)
        self._slope_places = (
            block.rows * np.arange(block.count)[:, None] + row,
            block.index[:, column],
        )
        self._curved_places = tuple(block.index[:, entry] for entry in _pattern(curved))

    def value(self, e: Array) -> Array:
        return _called(self._value, self._at(e)).ravel()

    def jacobian(self, e: Array) -> sp.csr_array:
        row, column = self._slope_places
        values, kept = _called(self._slopes, self._at(e)), column < self.unknowns
        return sp.csr_array(
            (values[kept], (row[kept], column[kept])), shape=(self.size, self.unknowns)
        )

    def hessian(self, e: Array, weights: Array) -> sp.csr_array:
        row, column = self._curved_places
        values, kept = (
            _called(self._curved, self._at(e), weights.reshape(self.block.count, -1).T),
            np.maximum(row, column) < self.unknowns,
        )
        return sp.csr_array(
            (values[kept], (row[kept], column[kept])), shape=(self.unknowns, self.unknowns)
        )

    def _at(self, e: Array) -> Array:
        return np.asarray(e[self.block.index].T)


def _called(function: ca.Function, *arguments: Array) -> Array:
    """Return the columns of a function's result, one row each."""
    return np.asarray(function(*arguments).full()).T


def _entries(matrix: Any) -> Any:
    return ca.densify(ca.vec(matrix.nz[:])) if matrix.nnz() else type(matrix)(0, 1)


def _pattern(matrix: Any) -> tuple[Indices, Indices]:
    sparsity = matrix if isinstance(matrix, ca.Sparsity) else matrix.sparsity()
    row, column = (np.array(entries, dtype=np.intp) for entries in sparsity.get_triplet())
    return row, column


class WorkingRows:
    """Rows that are met, as their limits are equal, and those whose barriers bend the costs most.

    All others act through products with the second derivatives alone.
    """

    def __init__(self, paths: PathRows) -> None:
        self.free, self.met = paths.limits.free, np.flatnonzero(~paths.limits.free)
        self.size = 0.0  # of B D⁻¹ Bᵀ, typical

    def learn(self, sizes: Array) -> None:
        """Remember how far the metric lets rows give way."""
        if len(sizes):
            self.size = float(np.median(sizes))

    def choose(self, stiffness: Array, left: Array) -> Indices:
        """Return rows (p',), those that are met first, given how stiff their barriers are, and what they leave unmet."""
        felt = (
            stiffness * self.size > FELT
            if self.size
            else stiffness >= np.sort(stiffness)[-SAMPLE:].min(initial=np.inf)
        )
        return np.append(self.met, self.stiffest(stiffness, felt | (np.abs(left) > UNMET)))

    def stiffest(self, stiffness: Array, among: NDArray[np.bool_]) -> Indices:
        """Return those rows that are stiffest, in their order, among some that are not met."""
        rows = np.flatnonzero(among & self.free)
        return np.sort(rows[np.argsort(stiffness[rows], kind="stable")[::-1][:MOST_WORKING]])

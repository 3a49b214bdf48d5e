"""The rows of goals, at the end and on the way, as functions of places and velocities at the taps of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from ocp.condensed.chain import Chain, Motion
from ocp.targets.target import Target
from ocp.transcription.mesh import hermite_state, locate_share
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, Indices


class Slopes(NamedTuple):
    """Derivatives of r functions by the motion, and by the duration (r,)."""

    motion: Motion
    duration: Array


def needed_taps(target: Target, fractions: Array) -> Indices:
    """Return the nodes of the mesh at which velocities are needed: the last, and those round waypoints."""
    found = {len(fractions)}
    for waypoint in target.waypoints:
        k, part = locate_share(fractions, waypoint.share)
        found |= {k + 1} if part == 1.0 else {k, k + 1}
    return np.array(sorted(found - {0}), dtype=np.intp)


class GoalRows:
    """All rows of goals, those of waypoints before those of the end."""

    def __init__(self, chain: Chain, target: Target) -> None:
        self.chain = chain
        every = [(one.share, one.target) for one in target.waypoints] + [(1.0, target)]
        self.parts = [_Part(chain, part, share) for share, part in every if part.count]
        self.count = sum(part.size for part in self.parts)

    def value(self, motion: Motion, duration: float) -> Array:
        """Return the rows (m,)."""
        return np.concatenate(
            [np.zeros(0), *(part.value(part.inputs(motion, duration)) for part in self.parts)]
        )

    def slopes(self, jacobians: Sequence[Array], weights: Array) -> Slopes:
        """Return the derivatives of combinations (m, r) of the rows, of these `jacobians`."""
        chain, columns, start = self.chain, weights.shape[1], 0
        result = chain.zero_step(columns)
        by_duration = np.zeros(columns)
        for part, jacobian in zip(self.parts, jacobians, strict=True):
            gradient = jacobian.T @ weights[start : start + part.size]
            start += part.size
            part.scatter(gradient, result)
            by_duration += gradient[-1]
        return Slopes(result, by_duration)

    def along(self, jacobians: Sequence[Array], step: Motion, duration: float) -> Array:
        """Return the change (m,) of the rows, of these `jacobians`, along a step of one column and of the duration."""
        changes = [
            matrix @ part.gathered(step, duration)
            for part, matrix in zip(self.parts, jacobians, strict=True)
        ]
        return np.concatenate([np.zeros(0), *changes])

    def jacobians(self, motion: Motion, duration: float) -> list[Array]:
        """Return the derivatives of each part's rows by its inputs."""
        return [part.jacobian(part.inputs(motion, duration)) for part in self.parts]

    def hessians(self, motion: Motion, duration: float, weights: Array) -> list[sp.csr_array]:
        """Return the second derivatives of weightsᵀ rows by the inputs of each part."""
        start, found = 0, []
        for part in self.parts:
            found.append(
                part.hessian(part.inputs(motion, duration), weights[start : start + part.size])
            )
            start += part.size
        return found

    def curvature(self, hessians: Sequence[sp.csr_array], step: Motion, duration: float) -> Slopes:
        """Return how the slopes change along a step of one column."""
        result, by_duration = self.chain.zero_step(1), np.zeros(1)
        for part, hessian in zip(self.parts, hessians, strict=True):
            gradient = hessian @ part.gathered(step, duration)
            part.scatter(gradient[:, None], result)
            by_duration += gradient[-1]
        return Slopes(result, by_duration)


@dataclass(eq=False)
class _Tap:
    """Where the free coordinates of one tap stand among the inputs."""

    tap: int
    node: int
    places: slice
    rates: slice


class _Part:
    """Rows of one instant, of z = (places and rates at one or two nodes of the mesh, duration)."""

    def __init__(self, chain: Chain, target: Target, share: float) -> None:
        model, nq, self.chain = chain.model, chain.model.nq, chain
        k, part = locate_share(chain.shares, share)
        nodes = [k + 1] if part == 1.0 else [k, k + 1]
        T = ca.SX.sym("T")
        symbols: list[Any] = []
        states, self.taps = [], []
        for node in nodes:
            if node == 0:
                states.append(ca.SX(ca.DM(chain.start)))
                continue
            q, y = ca.SX.sym("q", nq), ca.SX.sym("y", nq)
            clock = [chain.clock + T * chain.time[node]] if model.scene.has_clock else []
            states.append(ca.vertcat(q, y / T, *clock))
            first = sum(int(symbol.shape[0]) for symbol in symbols)
            tap = int(np.searchsorted(chain.taps, node))
            self.taps.append(
                _Tap(tap, node, slice(first, first + nq), slice(first + nq, first + 2 * nq))
            )
            symbols += [q, y]
        z = ca.vertcat(*symbols, T)
        state = (
            states[0]
            if len(states) == 1
            else hermite_state(model, states[0], states[1], T * chain.shares[k], part)
        )
        self.weights, self.size = target.weights, target.count
        rows = target.single(state)
        slopes = ca.jacobian(rows, z)
        weight = ca.SX.sym("w", rows.shape[0])
        hessian = ca.hessian(ca.dot(weight, rows), z)[0]
        self._value = ArrayFunction(ca.Function("rows", [z], [ca.densify(rows)]))
        self._slopes = ArrayFunction(ca.Function("slopes", [z], [_entries(slopes)]))
        self._hessian = ArrayFunction(ca.Function("hessian", [z, weight], [_entries(hessian)]))
        self._slope_pattern, self._hessian_pattern = _pattern(slopes), _pattern(hessian)

    def inputs(self, motion: Motion, duration: float) -> Array:
        """Return z at a motion."""
        chain = self.chain
        parts = [
            chain.free(values)
            for one in self.taps
            for values in (motion.places[one.node], motion.rates[one.tap])
        ]
        return np.concatenate([*parts, [duration]])

    def gathered(self, step: Motion, duration: float) -> Array:
        """Return the change of z along a step of one column."""
        return self.inputs(Motion(step.places[..., 0], step.rates[..., 0], step.bars), duration)

    def value(self, z: Array) -> Array:
        return np.asarray(self.weights @ self._value(z)[0].ravel())

    def jacobian(self, z: Array) -> Array:
        values = sp.csr_array(
            (self._slopes(z)[0].ravel(), *self._slope_pattern[:1]), shape=self._slope_pattern[1]
        )
        return np.asarray((values.T @ self.weights.T).T)

    def hessian(self, z: Array, weights: Array) -> sp.csr_array:
        place, shape = self._hessian_pattern
        return sp.csr_array(
            (self._hessian(z, self.weights.T @ weights)[0].ravel(), place), shape=shape
        )

    def scatter(self, gradient: Array, result: Motion) -> None:
        """Add derivatives by z (nz, r) to those by the motion."""
        for one in self.taps:
            result.places[one.node] += self.chain.at_nodes(gradient[one.places])
            result.rates[one.tap] += self.chain.at_nodes(gradient[one.rates])


def _entries(matrix: Any) -> Any:
    return ca.densify(ca.vertcat(*[matrix.nz[:]])) if matrix.nnz() else ca.SX(0, 1)


def _pattern(matrix: Any) -> tuple[tuple[Indices, Indices], tuple[int, int]]:
    row, column = (np.array(entries, dtype=np.intp) for entries in matrix.sparsity().get_triplet())
    return (row, column), (int(matrix.shape[0]), int(matrix.shape[1]))

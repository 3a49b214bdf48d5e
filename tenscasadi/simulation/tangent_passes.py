"""Tangent and adjoint passes over a run.

Tangents of its inputs go forward, gradients of its outputs backward, many steps a call.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.simulation.control_input import SampledControl
from tenscasadi.simulation.tangent_loop import CHUNK, Steps
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, Indices


class Task(NamedTuple):
    """Derivatives to compute: of steps between `states` (C, nx) that are CHUNK steps apart, under the held inputs w of `grid`.

    entries: those of w, in each of the intervals that `owner` (steps,) tells of each step; None: by
    the first state.
    """

    steps: Steps
    states: Array
    grid: SampledControl
    owner: Indices
    entries: slice | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the derivatives of one output: (nx,) or (intervals, entries)."""
        if self.entries is None:
            return (self.steps.model.nx,)
        return int(self.owner.max(initial=-1)) + 1, self.entries.stop - self.entries.start


class Found(NamedTuple):
    """Derivatives, the integral of a running output, and the largest distance of an end of CHUNK steps from the run's."""

    jacobian: Array
    integral: float
    apart: float


class _Chunk(NamedTuple):
    """Chunk of the run: z at its start, w (CHUNK, nw), and lengths and corrections (CHUNK, 2) of its steps; the interval (≤ CHUNK,) of each."""

    z: Array
    w: Array
    grid: Array
    owner: Indices


def _chunk(task: Task, number: int) -> _Chunk:
    first, every = (
        number * CHUNK,
        1 if task.steps.correction is None else task.steps.correction.every,
    )
    places = np.arange(first, first + CHUNK)
    lengths = np.where(places < task.grid.steps, task.grid.lengths(first, CHUNK), 0.0)
    z = np.zeros(task.steps.size)
    z[: task.steps.model.nx] = task.states[number]
    owner = task.owner[first : first + CHUNK]
    return _Chunk(
        z,
        task.grid.window(first, CHUNK),
        np.column_stack([lengths, (places + 1) % every == 0]),
        owner,
    )


def push(task: Task, tangent: ArrayFunction, width: int, by_z: Array) -> Found:
    """Push tangents of the inputs, `width` at a time, forward from where each begins to act."""
    nz, columns = task.steps.size, int(np.prod(task.shape))
    jacobian, found = np.zeros((len(by_z), columns)), Found(np.zeros(0), 0.0, 0.0)
    for begin in range(0, columns, width):
        inputs, S, first = np.arange(begin, min(begin + width, columns)), np.zeros((width, nz)), 0
        if task.entries is None:
            S[np.arange(len(inputs)), inputs] = 1.0
        else:
            first = int(np.searchsorted(task.owner, begin // task.shape[1])) // CHUNK
        for number in range(first, len(task.states) - 1):
            chunk = _chunk(task, number)
            (end,) = tangent(
                np.concatenate([chunk.z, S.ravel()]),
                _with_tangents(task, chunk, inputs, width),
                chunk.grid,
            )
            S = end[0, nz:].reshape(width, nz)
            if begin == 0:
                found = _follow(task, number, end[0, :nz], found)
        jacobian[:, inputs] = by_z @ S[: len(inputs)].T
    return found._replace(jacobian=jacobian.reshape(-1, *task.shape))


def pull(task: Task, gradient: ArrayFunction, width: int, by_z: Array) -> Found:
    """Pull gradients of the outputs, `width` at a time, back from the end."""
    nx, nz, nw, rows = task.steps.model.nx, task.steps.size, task.steps.model.nw, len(by_z)
    jacobian, found = np.zeros((rows, *task.shape)), Found(np.zeros(0), 0.0, 0.0)
    for begin in range(0, rows, width):
        outputs = np.arange(begin, min(begin + width, rows))
        L, by_w = np.zeros((width, nz)), np.zeros((task.shape[0], width, nw))
        L[: len(outputs)] = by_z[outputs]
        for number in reversed(range(len(task.states) - 1)):
            chunk = _chunk(task, number)
            end, L, pulled = gradient(chunk.z, L, chunk.w, chunk.grid)
            if task.entries is not None:
                np.add.at(by_w, chunk.owner, pulled[: len(chunk.owner)].reshape(-1, width, nw))
            if begin == 0:
                found = _follow(task, number, end[0], found)
        if task.entries is None:
            jacobian[outputs] = L.reshape(width, nz)[: len(outputs), :nx]
        else:
            jacobian[outputs] = by_w.transpose(1, 0, 2)[: len(outputs), :, task.entries]
    return found._replace(jacobian=jacobian)


def _with_tangents(task: Task, chunk: _Chunk, inputs: Indices, width: int) -> Array:
    """Return w with its tangents (CHUNK, ·): 1 in an input's entry while its interval lasts."""
    if task.entries is None:
        return chunk.w
    W = np.zeros((CHUNK, width, chunk.w.shape[1]))
    intervals, entries = np.divmod(inputs, task.shape[1])
    for k, (interval, entry) in enumerate(zip(intervals.tolist(), entries.tolist(), strict=True)):
        W[: len(chunk.owner), k, task.entries.start + entry] = chunk.owner == interval
    return np.hstack([chunk.w, W.reshape(CHUNK, -1)])


def _follow(task: Task, number: int, end: Array, found: Found) -> Found:
    """Add up what a chunk that ends in z integrates, and compare its end with the run's."""
    nx = task.steps.model.nx
    apart = float(np.abs(end[:nx] - task.states[number + 1]).max(initial=0.0))
    return found._replace(
        integral=found.integral + float(end[-1]) if end.size > nx else 0.0,
        apart=max(found.apart, apart),
    )

"""Tangent and adjoint passes over a run.

Tangents of inputs are propagated forward, gradients of outputs backward.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.simulation.inputs.run_inputs import RunInputs
from tenscasadi.simulation.tangent_loop import CHUNK, TangentSteps
from tenscasadi.util.casadi_tools import ArrayFunction
from tenscasadi.util.validate import Array, Indices


class PassSetup(NamedTuple):
    """Run and inputs of a tangent or adjoint pass.

    `states` (C, nx) are CHUNK steps apart. `entries` selects the entries of w in each interval;
    `owner` (steps,) is the interval of each step. None selects the initial state.
    """

    steps: TangentSteps
    states: Array
    inputs: RunInputs
    owner: Indices
    entries: slice | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the derivatives of one output.

        It is (nx,) or (intervals, entries).
        """
        if self.entries is None:
            return (self.steps.model.nx,)
        return int(self.owner.max(initial=-1)) + 1, self.entries.stop - self.entries.start


class PassResult(NamedTuple):
    """Derivatives from a pass, with a check of its states.

    `jacobian` are those of the outputs. `integral` is the time integral of a running output.
    `apart` is the largest difference between the states that the pass recomputes and those of the
    run.
    """

    jacobian: Array
    integral: float
    apart: float


class _Chunk(NamedTuple):
    """CHUNK successive steps of a run.

    It has the initial z, the inputs w (CHUNK, nw), and the lengths and correction flags of the
    steps (`grid`, (CHUNK, 2)). `owner` (≤ CHUNK,) are their control intervals.
    """

    z: Array
    w: Array
    grid: Array
    owner: Indices


def _chunk(task: PassSetup, number: int) -> _Chunk:
    first, every = (
        number * CHUNK,
        1 if task.steps.correction is None else task.steps.correction.every,
    )
    grid, places = task.inputs.grid, np.arange(first, first + CHUNK)
    lengths = np.where(places < grid.steps, grid.lengths[grid.locate(places)], 0.0)
    z = np.zeros(task.steps.size)
    z[: task.steps.model.nx] = task.states[number]
    owner = task.owner[first : first + CHUNK]
    return _Chunk(
        z,
        task.inputs.stack(0, places),
        np.column_stack([lengths, (places + 1) % every == 0]),
        owner,
    )


def run_forward(task: PassSetup, tangent: ArrayFunction, width: int, by_z: Array) -> PassResult:
    """Propagate tangents of the inputs forward, `width` at a time.

    `tangent` is the Function of `tangent_function` for a chunk of steps. `by_z` (outputs, nz) is
    the Jacobian of the outputs with respect to the final z. Each tangent starts with the chunk of
    steps where its input begins to act.
    """
    nz, columns = task.steps.size, int(np.prod(task.shape))
    jacobian, found = np.zeros((len(by_z), columns)), PassResult(np.zeros(0), 0.0, 0.0)
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


def run_adjoint(task: PassSetup, gradient: ArrayFunction, width: int, by_z: Array) -> PassResult:
    """Propagate gradients of the outputs backward, `width` at a time.

    `gradient` is the Function of `gradient_function` for a chunk of steps. `by_z` (outputs, nz) is
    the Jacobian of the outputs with respect to the final z.
    """
    nx, nz, nw, rows = task.steps.model.nx, task.steps.size, task.steps.model.nw, len(by_z)
    jacobian, found = np.zeros((rows, *task.shape)), PassResult(np.zeros(0), 0.0, 0.0)
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


def _with_tangents(task: PassSetup, chunk: _Chunk, inputs: Indices, width: int) -> Array:
    """Append tangents to the inputs w of a chunk of steps.

    `inputs` (at most `width`) number the pairs of an interval and an entry of w. The result is
    (CHUNK, ·). A tangent is 1 in the entry of its input during its interval.
    """
    if task.entries is None:
        return chunk.w
    W = np.zeros((CHUNK, width, chunk.w.shape[1]))
    intervals, entries = np.divmod(inputs, task.shape[1])
    for k, (interval, entry) in enumerate(zip(intervals.tolist(), entries.tolist(), strict=True)):
        W[: len(chunk.owner), k, task.entries.start + entry] = chunk.owner == interval
    return np.hstack([chunk.w, W.reshape(CHUNK, -1)])


def _follow(task: PassSetup, number: int, end: Array, found: PassResult) -> PassResult:
    """Add the integral of a chunk of steps, and compare its final state.

    `number` is that of the chunk, `end` its final z as the pass computes it, and `found` the result
    so far. The comparison is with the final state in the run.
    """
    nx = task.steps.model.nx
    apart = float(np.abs(end[:nx] - task.states[number + 1]).max(initial=0.0))
    return found._replace(
        integral=found.integral + float(end[-1]) if end.size > nx else 0.0,
        apart=max(found.apart, apart),
    )

"""Check that time steps resolve functions of time."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from tenscasadi.scene.time_functions import outputs_at
from tenscasadi.simulation.inputs.grid import Changing, Grid
from tenscasadi.util.validate import Array

UNRESOLVED = "changes within steps"  # in messages on unresolved functions of time


def describe_unresolved(
    changing: Sequence[Changing], grid: Grid, first: float, step: float, order: int
) -> str:
    """Describe functions of time that the steps do not resolve.

    Each function is sampled at eight points of each step, or of its parts if there are few steps.
    The integral by these points is compared with one by as many points as the stages of a scheme of
    this order.

    Parameters
    ----------
    changing : sequence of Changing
        Time-varying parts of a model.
    grid : Grid
        Steps of the run.
    first : float
        Initial time of the clock [s].
    step : float
        Mean step of the scheme [s].
    order : int
        Order of the scheme.

    Returns
    -------
    str
        A clause for each function, after a semicolon.
    """
    text = ""
    for part in changing:
        function = part.changing()
        if function is None:
            continue
        ends = _refine(first + grid.times(np.arange(grid.steps + 1)), step)
        for unseen, size in _compare_quadratures(function, ends, order):
            if unseen.sum() > 0.01 * size:  # of the impulse over the run
                time = ends[int(unseen.argmax())]
                text += (
                    f"; {part.field} {UNRESOLVED} near t = {time:.6g} s more than their stages "
                    "see: declare breakpoints=(…) there, or try a smaller step"
                )
                break
    return text


def _refine(ends: Array, step: float) -> Array:
    """Divide intervals longer than `step` seconds.

    `ends` are the increasing ends of the intervals [s]. The result contains them.
    """
    parts = np.maximum(1, np.ceil(np.diff(ends) / step - 1e-9)).astype(int)
    owner = np.repeat(np.arange(len(parts)), parts)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
    return np.append(ends[owner] + share * np.diff(ends)[owner], ends[-1])


def _compare_quadratures(
    function: ca.Function, ends: Array, order: int
) -> list[tuple[Array, float]]:
    """Compare coarse and fine quadratures of a Function of time over K steps.

    `ends` (K + 1,) are the ends of the steps [s]. The coarse quadrature is exact for the given
    `order` of an integration scheme. Returns, for each output, the differences (K,) and the
    integral of its absolute value.
    """
    points, weights = np.polynomial.legendre.leggauss(8)
    divisions = -(-2048 // (len(ends) - 1))  # at least 2048 parts in all
    fine = ((np.arange(divisions)[:, None] + (1 + points) / 2) / divisions).ravel()
    fine_weights = np.tile(weights / 2 / divisions, divisions)
    coarse, coarse_weights = _lobatto(max(2, (order + 3) // 2))
    unseen: list[list[Array]] = [[] for _ in range(function.n_out())]
    size = np.zeros(function.n_out())
    block = max(1, 16384 // divisions)  # bounds the memory
    for begin in range(0, len(ends) - 1, block):
        starts = ends[begin : begin + block + 1]
        lengths = np.diff(starts)[:, None]
        sampled = [
            outputs_at(function, (starts[:-1, None] + lengths * places).ravel())
            for places in (fine, coarse)
        ]
        for k, values in enumerate(zip(*sampled, strict=True)):
            own = [each.reshape(len(lengths), -1, each.shape[1]) for each in values]
            exact, seen = (
                np.einsum("kpm,p->km", each, w)
                for each, w in zip(own, (fine_weights, coarse_weights), strict=True)
            )
            unseen[k].append((abs(exact - seen) * lengths).max(axis=1, initial=0.0))
            average = np.einsum("kpm,p->km", abs(own[0]), fine_weights)
            size[k] += float((average * lengths).sum(axis=0).max(initial=0.0))
    return [(np.concatenate(parts), own) for parts, own in zip(unseen, size.tolist(), strict=True)]


def _lobatto(count: int) -> tuple[Array, Array]:
    """Compute points and weights of Gauss-Lobatto quadrature.

    They are (count,), and the points lie in [0, 1].
    """
    inner = np.polynomial.legendre.Legendre.basis(count - 1).deriv().roots()
    places = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    at = np.polynomial.legendre.Legendre.basis(count - 1)(places)
    return (1 + places) / 2, 1 / (count * (count - 1) * at**2)

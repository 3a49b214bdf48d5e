"""Smooth random noise: splines through random knots."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import scipy.interpolate
from numpy.typing import ArrayLike

from ocp.problem.reading import read_groups
from tenscasadi.schema.field_types import PER_ITEM, ListOf, Members
from tenscasadi.schema.value import Value
from tenscasadi.util.renamed import rename_fields
from tenscasadi.util.validate import (
    Array,
    Count,
    IndexOrName,
    Positive,
    check_indices,
    per_item,
    positive_each,
)


@rename_fields(finest="min_scale")
@dataclass(frozen=True, eq=False)
class SplineNoise(Value, kind="SplineNoise"):
    """Smooth random changes of force densities for `Mppi`.

    The changes are cubic splines through a few independent normal knots.

    Parameters
    ----------
    deviation : float or array_like, shape (α,)
        Standard deviation of the largest changes [N/m], the same at all times.
    knots : int
        Number of knots over the horizon, at equal times. Fewer knots make smoother changes.
    groups : sequence of sequence of int or str, optional
        Groups of strings that change together, such as images under a symmetry. Fewer groups need
        fewer samples. Strings in no group do not change. Default: single strings.
    min_scale : float
        Ratio of the smallest to the largest deviation, in (0, 1]. The samples lie between them in
        equal ratios, so that some explore while others refine.

    Raises
    ------
    TypeError, ValueError
        If a value has another type or is out of bounds, a string is in two groups or does not
        exist, or the number of deviations is not that of the strings.

    Examples
    --------
    >>> import ocp
    >>> ocp.SplineNoise(20.0, knots=4, groups=[[0, 1, 2], [3, 4, 5]]).groups
    ((0, 1, 2), (3, 4, 5))
    """

    deviation: Annotated[ArrayLike, PER_ITEM, positive_each("string", zero=True)]
    knots: Count = 4
    groups: Annotated[Iterable[Sequence[IndexOrName]] | None, ListOf(Members("input"))] = None
    min_scale: Positive = 0.03

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_scale > 1:
            raise ValueError(
                f"SplineNoise.min_scale is {self.min_scale:g}: give a fraction of the deviation, at most 1"
            )
        if self.groups is not None:
            groups = read_groups("SplineNoise.groups", self.groups, strict=True)
            object.__setattr__(self, "groups", groups)

    def sizes(self, samples: int) -> Array:
        """Compute the relative size of each sample's changes.

        Parameters
        ----------
        samples : int
            Number of samples.

        Returns
        -------
        ndarray, shape (samples,)
            Ratios to the deviation: 0, then from 1 to `min_scale`.
        """
        return np.concatenate([[0.0], np.geomspace(self.min_scale, 1.0, samples - 1)[::-1]])

    def directions(self, count: int) -> Array:
        """Compute the change of each string per unit change of each group.

        Parameters
        ----------
        count : int
            Number of strings, α.

        Returns
        -------
        ndarray, shape (groups, α)
            Changes [N/m].

        Raises
        ------
        ValueError
            If the number of deviations is not that of the strings, or a string does not exist.
        """
        spread = per_item("SplineNoise.deviation", self.deviation, count)
        if self.groups is None:
            return np.diag(spread)
        matrix = np.zeros((len(tuple(self.groups)), count))
        for k, (row, group) in enumerate(zip(matrix, self.groups, strict=True)):
            check_indices(f"SplineNoise.groups[{k}]", group, count, "string")
            row[list(group)] = spread[list(group)]
        return matrix

    def basis(self, intervals: int) -> Array:
        """Compute the weight of each knot in each interval.

        The noise has the same deviation in all intervals.

        Parameters
        ----------
        intervals : int
            Number of intervals K of the horizon.

        Returns
        -------
        ndarray, shape (K, knots)
            Rows of unit norm.
        """
        knots = min(self.knots, intervals)
        times = np.linspace(0.0, max(intervals - 1, 1), knots)
        if knots == 1:
            return np.ones((intervals, 1))
        spline = scipy.interpolate.make_interp_spline(times, np.eye(knots), k=min(3, knots - 1))
        rows = np.asarray(spline(np.arange(intervals)))
        return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))

"""Closest points of pairs of line segments."""

from __future__ import annotations

from typing import Any, NamedTuple

import casadi as ca

from tenscasadi.scene.contact_law import Contact
from tenscasadi.util.validate import ROUNDING


class Segments(NamedTuple):
    """Ends (3×m) of m pairs of line segments.

    The first segment of a pair is from a to b, the second from c to d.
    """

    a: Any
    b: Any
    c: Any
    d: Any


def find_closest_points(at: Segments) -> tuple[Any, Any]:
    """Find the closest points of segments a–b and c–d.

    Returns their positions (1×m) along both segments, from 0 at a and c to 1 at b and d. The point
    on a–b is computed for infinite lines and clamped to the segment. Then the nearest point on c–d
    is computed, and the nearest one to that on a–b, both clamped.
    """
    first, second, between = at.b - at.a, at.d - at.c, at.a - at.c
    A, E, B = (ca.sum1(x * y) for x, y in ((first, first), (second, second), (first, second)))
    C, F = ca.sum1(first * between), ca.sum1(second * between)
    # parallel bars, with sine² 0 of the angle between them, have closest points, too
    s = _clamp((B * F - C * E) / ((1 + ROUNDING) * A * E - B * B))
    t = _clamp((B * s + F) / E)
    return _clamp((B * t - C) / A), t


def find_contact(at: Segments, radii: Any) -> tuple[Contact, tuple[Any, Any]]:
    """Compute penetration depths and force directions of bars.

    The directions are those of the forces on the first bar of each pair.

    Parameters
    ----------
    at : Segments
        Axes of the bars [m].
    radii : casadi row, shape (1, m)
        Sums of the radii [m].

    Returns
    -------
    tuple
        Contact, and the positions (1×m) of the closest points along both bars.
    """
    s, t = find_closest_points(at)
    weights = [1 - s, s, t - 1, -t]
    gap = sum(end * ca.repmat(weight, 3, 1) for end, weight in zip(at, weights, strict=True))
    distance = ca.sqrt(ca.sum1(gap * gap) + (1e-9 * radii) ** 2)  # no NaN where axes cross
    return Contact(radii - distance, gap / ca.repmat(distance, 3, 1), None), (s, t)


def _clamp(value: Any) -> Any:
    return ca.fmin(ca.fmax(value, 0), 1)

"""Tensegrity prisms."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.structure.shapes.family import build_structure, place_ring, polygon, shape
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_COUNT, flag, number, positive_number, whole_number


@shape
def prism(
    bars: int = 3,
    radius: float = 0.5,
    height: float = 1.0,
    twist: float | None = None,
    prestress: float | None = None,
    diagonals: bool = False,
    top_radius: float | None = None,
    **options: Any,
) -> Structure:
    """Build a prism with inclined bars (class 1).

    Strings form the bottom and top polygons and the verticals. With `diagonals`, there is one more
    string for each bar.

    ::

        top      p ──── p+1 ── …      nodes p … 2p−1, at z = height, node p+i above node i, turned by twist − 2π/p
                 │ ╲  ╱ │
        bottom   0 ──── 1 ──── …      nodes 0 … p−1, at z = 0, node i at (radius, 2π i/p) in polar coordinates

    Bars: i → p+(i+1 mod p). Strings: bottom polygon i → i+1, top polygon, vertical i → p+i, and
    diagonal i → p+(i−1 mod p), p of each. Strings and nodes are named ``bottom[0]`` and so on.

    Parameters
    ----------
    bars : int
        Number p of bars, at least 3.
    radius : float
        Radius of the polygons [m].
    height : float
        Distance between the polygons [m].
    twist : float, optional
        Angle from a bar's bottom end to its top end about the z axis [rad]. Default: π/2 + π/p, the
        only one with a self-stress; with diagonals 5π/4p + π/2, while all between π/2 + π/p and
        π/2 + 2π/p have one.
    prestress : float, optional
        Smallest string force density of the self-stress [N/m], which determines the rest
        lengths. By default strings are unstressed.
    diagonals : bool
        Whether to add diagonal strings.
    top_radius : float, optional
        Radius of the top polygon [m], if it is another one.
    **options : array_like
        Other keywords of `Structure`, such as `bar_mass`, `stiffness` and `pinned`.

    Returns
    -------
    Structure
        The prism with its bottom in the plane z = 0.

    Notes
    -----
    In the self-stress without diagonals the force densities of the bottom, the top and the vertical
    strings are in the ratio ρ : 1/ρ : 2 sin(π/p) for a ratio ρ of the radii. The prism of the paper's
    Sect. 7.1 is ``prism(radius=1/√3, height=1, twist=2π/3)``.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(prestress=10.0)
    >>> gamma = prism.stiffness * (1 - prism.rest_length / prism.string_lengths)
    >>> gamma.round(3).tolist()
    [10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 17.321, 17.321, 17.321]
    """
    p = whole_number("bars", bars, 3, MAX_COUNT)
    radius, height = positive_number("radius", radius), positive_number("height", height)
    upper = radius if top_radius is None else positive_number("top_radius", top_radius)
    flag("diagonals", diagonals)
    balanced = equilibrium_twist(p)
    turn = balanced + 0.25 * np.pi / p * diagonals if twist is None else number("twist", twist)
    i = np.arange(p)
    after = (i + 1) % p
    nodes = np.concatenate(
        [place_ring(p, radius, 0.0, 0.0), place_ring(p, upper, turn - 2 * np.pi / p, height)]
    )
    strings = {"bottom": polygon(i), "top": polygon(p + i), "vertical": np.c_[i, p + i]}
    leaning = {"": np.c_[i, p + after]}
    ends = [("bottom", p), ("top", p)]
    stress = None
    if diagonals:
        strings["diagonal"] = np.c_[after, p + i]
    else:
        check_twist(prestress, p, turn)
        stress = np.repeat([upper / radius, radius / upper, 2.0 * np.sin(np.pi / p)], p)
    return build_structure(nodes, leaning, strings, options, stress, prestress, ends)


def equilibrium_twist(bars: int) -> float:
    """Compute the equilibrium twist of a prism of p bars [rad].

    Without diagonals, the prism has a self-stress only at this twist, the angle between the ends of
    a bar about the axis.
    """
    return np.pi / 2 + np.pi / bars


def check_twist(prestress: float | None, bars: int, twist: float) -> None:
    """Check that a prism without diagonals has a self-stress if prestressed.

    The arguments are those of `prism`. Raises ValueError.
    """
    balanced = equilibrium_twist(bars)
    if prestress is not None and not np.isclose(twist, balanced, rtol=0.0, atol=1e-12):
        raise ValueError(
            f"prestress needs the equilibrium twist, {balanced:g} rad, and twist is {twist:g}: leave one of them out"
        )

"""Rest lengths of members for given force densities (Appendix A)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from tenscasadi.structure.cables import wrap_angles
from tenscasadi.structure.equilibrium_matrix import balance_bars
from tenscasadi.structure.names import name_errors
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    TOLERANCE,
    Array,
    finite_array,
    nesting,
    nonnegative,
    per_item,
    real_array,
)


@name_errors
def find_rest_lengths(
    structure: Any, force_density: Any, compression_strings: Iterable[int | str]
) -> dict[str, Array]:
    """Compute the rest lengths of strings and elastic bars.

    They are ρ = s (1 − γ/k) for strings of length s, force density γ and stiffness k, and ρ = l (1
    + λ/k) for bars of length l and force density λ, positive in compression.

    Parameters
    ----------
    structure : Structure
        The structure, whose nodes determine the lengths.
    force_density : array_like, shape (α,) or (α + β,)
        γ of strings [N/m], then λ of bars, positive in compression.
    compression_strings : iterable of int
        Strings whose γ can be negative.

    Returns
    -------
    dict of str to ndarray
        Keywords of `Structure`: `rest_length`, and `bar_rest_length` if there are elastic bars.

    Raises
    ------
    TypeError, ValueError
        If the force densities are wrong, or no positive rest length gives them.
    """
    gamma, lam = read_force_densities(structure, force_density)
    check_cable_tensions(structure, gamma)
    k = structure.stiffness
    either = structure.names.mask("compression_strings", "string", compression_strings)
    nonnegative("force_density", np.where(either, 0.0, gamma), "string")
    for i in np.flatnonzero((gamma != 0.0) & (gamma >= k)):
        raise add_address(
            ValueError(
                f"force_density of string {i} is {gamma[i]:g} N/m: "
                f"it must be below its stiffness, {k[i]:g} N/m"
            )
        )
    for i in np.flatnonzero((gamma < 0.0) & (k == 0.0)):
        raise ValueError(
            f"force_density of string {i} is {gamma[i]:g} N/m: "
            "its stiffness is 0, so it carries no compression"
        )
    ratio = np.divide(gamma, k, out=np.zeros_like(gamma), where=gamma != 0.0)
    rest = {"rest_length": structure.string_lengths * (1.0 - ratio)}
    if not structure.elastic.any():
        return rest
    lam, k = balance_bars(structure, gamma) if lam is None else lam, structure.bar_stiffness
    for bar in np.flatnonzero(structure.elastic & (lam <= -k)):
        raise ValueError(
            f"force_density of bar {bar} is {lam[bar]:g} N/m: "
            f"it must be above −{k[bar]:g} N/m, where the rest length is 0"
        )
    return rest | {"bar_rest_length": structure.bar_lengths * (1.0 + lam / k)}


def check_cable_tensions(structure: Any, gamma: Array) -> None:
    """Check that the tensions of a cable differ by friction only.

    `gamma` (α,) are the force densities of the strings [N/m]. Raises ValueError.
    """
    tension = gamma * structure.string_lengths
    for k, (cable, friction) in enumerate(
        zip(structure.cables, structure.cable_friction, strict=True)
    ):
        limits = np.exp(friction * wrap_angles(structure, cable)) * (1 + TOLERANCE)
        for one, other, limit in zip(cable, cable[1:], limits, strict=False):
            low, high = sorted((tension[one], tension[other]))
            if high > limit * low and high > 0:
                ratio = f"at most in the ratio {limit:.4g}" if friction else "equal"
                raise ValueError(
                    f"force_density gives strings {one} and {other} of cables[{k}] the tensions "
                    f"{tension[one]:.6g} and {tension[other]:.6g} N: make them {ratio}"
                )


def read_force_densities(structure: Any, given: Any) -> tuple[Array, Array | None]:
    """Read force densities of strings (α,) and bars (β,).

    Parameters
    ----------
    structure : Structure
        The structure.
    given : array_like, shape (α,) or (α + β,)
        Force densities of strings [N/m], then λ of bars [N/m], positive in compression.

    Returns
    -------
    tuple of ndarray
        γ (α,) and λ (β,); None if only those of strings are given.

    Raises
    ------
    TypeError, ValueError
        If the shape is another one or a number is not finite.
    """
    strings, bars = len(structure.strings), len(structure.bars)
    if nesting(given) and bars:
        shape = real_array(
            "force_density", given, f"({strings},) or ({strings + bars},) numbers"
        ).shape
        if shape == (strings + bars,):
            both = finite_array("force_density", given, (strings + bars,))
            return both[:strings], both[strings:]
        if shape != (strings,):
            raise ValueError(
                f"force_density has shape {shape}: "
                f"give ({strings},) for strings or ({strings + bars},) for strings, then bars"
            )
    return per_item("force_density", given, strings), None

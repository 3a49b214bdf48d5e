"""Checks of masses that would make equations of motion singular."""

from __future__ import annotations

from typing import Any

import numpy as np

from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import NEGLIGIBLE, ROUNDING, SMALLEST, Array

MAX_MASS_RATIO = 1 / ROUNDING  # between bars; above, rounding exceeds the lighter bar's forces


def total_mass(structure: Any) -> float:
    """Sum the masses of bars, nodes, strings and bodies [kg]."""
    s = structure
    bodies = sum(body.mass for body in s.bodies)
    return float(s.bar_mass.sum() + s.node_mass.sum() + s.string_mass.sum() + bodies)


def check_node_masses(structure: Any) -> None:
    """Check that each moving node has a bar, a body or mass.

    Otherwise M would be singular. Raises ValueError.
    """
    node_mass, strings = structure.node_mass, structure.strings
    heavy = (node_mass > SMALLEST) | structure.fixed.all(axis=1)
    for held in (structure.bars, *(body.nodes for body in structure.bodies)):
        heavy[np.asarray(held)] = True
    heavy[strings[structure.string_mass > SMALLEST]] = True
    for node in np.flatnonzero(~heavy):
        cure = (
            "give it a mass, pin it in all axes, or give its strings a string_mass, "
            "which the scene lumps there with ends='lumped'"
        )
        raise add_address(
            ValueError(
                f"node_mass of node {node} is {node_mass[node]:g} and no bar ends there: {cure}"
            )
        )


def check_mass_ratio(field: str, structure: Any, bar_mass: Array, node_mass: Array) -> None:
    """Check that masses of moving bars do not differ too much.

    Their end nodes are included. Raises ValueError.

    Parameters
    ----------
    field : str
        Name of the input in the message.
    structure : Structure
        Bars and pins.
    bar_mass, node_mass : ndarray, shape (..., β) and (..., n)
        Masses [kg].
    """
    bars = structure.bars
    moving = np.flatnonzero(~structure.fixed[bars].all(axis=(1, 2)))
    if len(moving) < 2:
        return
    weights = (bar_mass + node_mass[..., bars].sum(axis=-1))[..., moving].reshape(-1, len(moving))
    ratios = weights.max(axis=1) / weights.min(axis=1)
    for row in np.flatnonzero(ratios > MAX_MASS_RATIO)[:1]:
        heavy, light = moving[weights[row].argmax()], moving[weights[row].argmin()]
        raise ValueError(
            f"{field}: bar {heavy} is {ratios[row]:.1g} times as heavy as bar {light}, with the "
            f"nodes at their ends: pin the heavy bar, or give a ratio below {MAX_MASS_RATIO:g}"
        )


def check_inertia(field: str, inertia: Array, nominal: Array) -> None:
    """Check that a mass distribution can have the given inertia.

    `inertia` and `nominal` are inertia matrices (…, 3, 3). Raises ValueError for the first that is
    impossible.

    Parameters
    ----------
    field : str
        Name of the input in the message.
    inertia : ndarray, shape (k, bodies, 3, 3)
        Inertia matrices [kg m²].
    nominal : ndarray, shape (bodies, 3, 3)
        Inertia matrices of the structure. Bodies keep their thickness.
    """
    own, known = find_second_moments(inertia), find_second_moments(nominal)
    thick = known > NEGLIGIBLE * known.sum(axis=-1, keepdims=True)
    size = np.abs(own).sum(axis=-1, keepdims=True)
    wrong = np.where(thick, own <= NEGLIGIBLE * size, np.abs(own) > NEGLIGIBLE * size)
    for row, body in np.argwhere(wrong.any(axis=-1))[:1]:
        moments = np.linalg.eigvalsh(inertia[row, body]).tolist()
        raise ValueError(
            f"{field}: body_inertia of body {body} has the principal moments {moments} kg m²: "
            "each must be greater than 0 and less than the sum of the others"
        )


def find_second_moments(inertia: Array) -> Array:
    """Compute the principal second moments (…, 3) of inertia matrices.

    They are ∫ x² dm, ascending [kg m²].
    """
    principal = np.linalg.eigvalsh(inertia)
    return np.asarray(principal.sum(axis=-1, keepdims=True) / 2 - principal)[..., ::-1]

"""Equilibria with cable friction, in which cables slip as little as needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.scene.binding import fix
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.structure.cables import wrap_angles
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import MAX_ITERATIONS, NEGLIGIBLE, Array, Indices

_STEP = 1e-5  # relative change of rest lengths for derivatives of tensions
_LARGEST_STEP = 0.3  # of a slip per iteration, relative to the rest lengths on both sides


class _Bends(NamedTuple):
    """Nodes at which cables slide, between two strings each.

    Attributes
    ----------
    cable : ndarray of int (c,)
        Cable at each node.
    before, after : ndarray of int (c,)
        Strings on both sides.
    """

    cable: Indices
    before: Indices
    after: Indices


def read_sliding(scene: Scene, control: Any, parameters: Any) -> Scene:
    """Read a scene of cables with friction, with constant parameters.

    Raises ValueError if the rest lengths depend on a control.
    """
    if scene.control is not None or control is not None:
        raise ValueError(
            f"Scene.control is {scene.control}, and statics of cables with friction takes the rest lengths of the structure: give control=None"
        )
    fixed: Scene = fix(scene, scene.layout.values(parameters))
    return fixed


def replace_cables(scene: Scene) -> Scene:
    """Build the scene with separate strings in place of cables.

    Their rest lengths are the control.
    """
    strings = scene.structure.replace(cables=(), cable_friction=0.0)
    return replace(scene, structure=strings, control=RestLength())


def fix_rest_lengths(scene: Scene, found: Any) -> Any:
    """Convert an equilibrium of `replace_cables` to one without control.

    `found` is this equilibrium. Its control values become the rest lengths of strings.
    """
    lengths = found.control
    strings = scene.structure.replace(cables=(), cable_friction=0.0, rest_length=lengths)
    strings_only = replace(scene, structure=strings)
    return replace(found, source=strings_only, control=lengths[:0])


def find_sliding(scene: Scene, search: Callable[[Array, Any], Any], start: Any) -> Any:
    """Find an equilibrium in which cables slip as little as needed.

    Friction keeps the rest length of each string of a cable. Where the tensions of two strings
    differ by more than the factor exp(μ θ), the cable slips over the node between them until they
    differ by this factor. Newton's method finds the slips, with derivatives by differences. A node
    sticks again where its slip would reverse.

    Parameters
    ----------
    scene : Scene
        Scene with rest lengths and without parameters.
    search : callable
        Function of rest lengths (α,) and a start that finds the equilibrium of the scene of
        `replace_cables`.
    start : object
        Start of the first search.

    Returns
    -------
    Equilibrium
        Equilibrium of that scene, with the final rest lengths as control.
    """
    bends = _list_bends(scene.structure)
    slip, side = np.zeros((2, len(bends.cable)))  # side: sign of the slip, 0 where it sticks
    found = search(_rest_lengths(scene, bends, slip), start)
    for _ in range(MAX_ITERATIONS):
        if not found.success:
            return found
        excess, largest = _excess(scene, found), float(found.tension.max(initial=0.0))
        for k, sign in enumerate((1.0, -1.0)):
            side[(side == 0.0) & (excess[k] > NEGLIGIBLE * largest)] = sign
        error = _select(excess, side)
        if np.abs(error).max(initial=0.0) <= NEGLIGIBLE * largest:
            return found

        def slide(moved: Array, begin: Any = found) -> Any:
            return search(_rest_lengths(scene, bends, moved), begin)

        limits = _find_slip_limits(_rest_lengths(scene, bends, slip), bends)
        step = _find_step(lambda moved: _excess(scene, slide(moved)), slip, side, error, limits)
        share = min(1.0, _LARGEST_STEP / float((np.abs(step) / limits).max(initial=_LARGEST_STEP)))
        while share > NEGLIGIBLE:
            moved = slip + share * step
            onward = np.where(side * moved < 0.0, 0.0, side)
            moved[onward == 0.0] = 0.0
            trial = slide(moved)
            wrong = _violation(_excess(scene, trial), onward)
            if trial.success and wrong < (1.0 - 0.1 * share) * _violation(excess, side):
                break
            share *= 0.5
        else:
            break
        found, slip, side = trial, moved, onward
    cable = bends.cable[side != 0.0][int(np.argmax(np.abs(error)))]
    cure = (
        "pin nodes that slide until they meet, give rest lengths at which its tensions differ less, "
        "raise cable_friction, or change supports or loads"
    )
    return replace(
        found,
        success=False,
        message=f"no equilibrium found, the search for slips of cable {cable} stalled: {cure}",
    )


def _find_step(
    excess: Callable[[Array], Array], slip: Array, side: Array, error: Array, limits: Array
) -> Array:
    """Find the Newton step (c,) of the slips at c nodes [m].

    `side` is 1 or −1 for the direction in which a cable slips over a node, 0 where it sticks. The
    function `excess` maps slips to excess tensions [N]. Their value at slipping nodes is `error`
    for the current `slip`. `limits` are the largest slips [m]. The step is zero if the slips do not
    change the tensions.
    """
    slipping = np.flatnonzero(side)
    slopes = np.zeros((len(slipping), len(slipping)))
    for k, bend in enumerate(slipping):
        change = np.zeros(len(slip))
        change[bend] = side[bend] * _STEP * limits[bend]
        slopes[:, k] = (_select(excess(slip + change), side) - error) / change[bend]
    step = np.zeros(len(slip))
    found = -np.linalg.lstsq(slopes, error, rcond=NEGLIGIBLE)[0]
    if np.abs(slopes @ found + error).max() <= 0.5 * np.abs(error).max():
        step[slipping] = found
    return step


def _list_bends(structure: Structure) -> _Bends:
    rows = [
        (k, cable[i], cable[i + 1])
        for k, cable in enumerate(structure.cables)
        for i in range(len(cable) - 1)
    ]
    return _Bends(*np.array(rows, dtype=np.intp).reshape(-1, 3).T)


def _rest_lengths(scene: Scene, bends: _Bends, slip: Array) -> Array:
    """Compute the rest lengths (α,) after slips [m].

    `slip` (c,) are those at the bends of cables [m]. A positive slip lengthens the string before
    the node.
    """
    lengths = np.array(scene.structure.rest_length)
    np.add.at(lengths, bends.before, slip)
    np.subtract.at(lengths, bends.after, slip)
    return lengths


def _find_slip_limits(lengths: Array, bends: _Bends) -> Array:
    """Compute the largest possible slip (c,) at each bend [m].

    Bends are the inner nodes of cables. The limit is the shorter of the rest `lengths` (α,) of the
    two strings [m].
    """
    return np.asarray(np.minimum(lengths[bends.before], lengths[bends.after]))


def _excess(scene: Scene, found: Any) -> Array:
    """Compute by how much tensions exceed the limits of sticking [N].

    It is T₁ − exp(μ θ) T₂ in the equilibrium `found`, for both directions of slip (2, c). The cable
    sticks if neither is positive.
    """
    structure = scene.modelled
    bends = _list_bends(structure)
    angles = [wrap_angles(structure, cable, found.nodes) for cable in structure.cables]
    factor = np.exp(structure.cable_friction[bends.cable] * np.concatenate(angles))
    first, second = found.tension[bends.before], found.tension[bends.after]
    return np.array([first - factor * second, second - factor * first])


def _violation(excess: Array, side: Array) -> float:
    """Compute the norm of violations of the stick and slip conditions.

    `excess` (2, c) are the results of `_excess`. `side` (c,) is 1 or −1 for the direction of slip,
    0 at nodes where the cable sticks.
    """
    stuck = np.maximum(excess.max(axis=0), 0.0)[side == 0.0]
    return float(np.linalg.norm(np.concatenate([stuck, _select(excess, side)])))


def _select(excess: Array, side: Array) -> Array:
    """Select the excess tension in the direction of slip, at slipping nodes.

    `excess` (2, c) is the result of `_excess`. `side` (c,) is 1 or −1 for the direction of slip, 0
    at nodes where the cable sticks.
    """
    return np.asarray(np.where(side > 0.0, excess[0], excess[1])[side != 0.0])

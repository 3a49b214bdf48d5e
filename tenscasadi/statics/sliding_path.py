"""Load paths of cables with friction, whose slip accumulates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.scene.scene import Scene
from tenscasadi.statics.equilibrium import (
    Equilibrium,
    describe_rest,
    newton_system,
    read_load,
    read_problem,
)
from tenscasadi.statics.solver.continuation import LONGEST, SHORTEST, unit_length
from tenscasadi.statics.solver.settling import settle
from tenscasadi.statics.stuck_cables import find_sliding, read_sliding, replace_cables
from tenscasadi.util.validate import Array


class SlidingRow(NamedTuple):
    """Point of a load path: factor of the load, and equilibrium."""

    factor: float
    equilibrium: Equilibrium


class _SlidingPath:
    """Load path of a scene with cable friction.

    At each factor, cables slip from their state at the previous one.

    Attributes
    ----------
    scene : Scene
        Scene of cables with friction, without parameters and control.
    load : array_like, shape (n, 3), mapping of int or str to array_like, or NodalForce
        Change of the nodal forces per unit of the factor [N].
    start : object
        Start of the path, from which the slip on grounds is measured.
    """

    def __init__(self, scene: Scene, load: Any, start: Any) -> None:
        self.scene, self._stuck = scene, replace_cables(scene)
        self._system = newton_system(self._stuck)
        self._load = read_load(self._system, load)
        self._anchor = read_problem(self._stuck, start, scene.structure.rest_length, None)[0]

    def find(self, factor: float, start: Any, rest_length: Array) -> Equilibrium:
        """Find the equilibrium at a factor.

        The search begins at `start`. The cables slip no further than needed from given rest lengths
        (α,) [m].
        """
        begun = self.scene.structure.replace(rest_length=rest_length)

        def search(lengths: Array, begin: Any) -> Equilibrium:
            nodes, given = read_problem(self._stuck, begin, lengths, None)
            given = given._replace(added=factor * self._load, anchor=self._anchor)
            rest = settle(self._system, nodes, given)
            return describe_rest(self._stuck, self._system, rest, given)

        found: Equilibrium = find_sliding(replace(self.scene, structure=begun), search, start)
        return found


def follow_sliding(
    scene: Scene, load: Any, factors: tuple[float, float], start: Any
) -> tuple[list[SlidingRow], str]:
    """Trace equilibria while a load grows and cables slip.

    In each step the cables slip no further than needed from the rest lengths of the step before.
    A step is halved until the structure moves little enough.

    Parameters
    ----------
    scene : Scene
        Scene of cables with friction.
    load : array_like, shape (n, 3), mapping of int or str to array_like, or NodalForce
        Change of the nodal forces per unit of the factor [N].
    factors : tuple of float
        Least and largest factor.
    start : object
        Start of the first search, see `find_equilibrium`.

    Returns
    -------
    tuple
        Rows of the path, and the reason for an early end; "" if there is none.

    Raises
    ------
    TypeError, ValueError
        If the scene has a control, or an argument is wrong.
    """
    path = _SlidingPath(read_sliding(scene, None, None), load, start)
    low, high = factors
    first = float(np.clip(0.0, low, high))
    end = high if first < high else low
    found = path.find(first, start, path.scene.structure.rest_length)
    if not found.success:
        return [], f"no equilibrium at factor {first:g}: {found.message}"
    length = unit_length(found.nodes)
    rows, step = [SlidingRow(first, found)], 0.5 * LONGEST
    while (factor := rows[-1].factor) != end:
        reach = float(np.sign(end - factor)) * step * (high - low)
        ahead = end if abs(end - factor) <= abs(reach) else factor + reach
        found = path.find(ahead, rows[-1].equilibrium, rows[-1].equilibrium.control)
        moved = float(np.linalg.norm(found.nodes - rows[-1].equilibrium.nodes)) / length
        if found.success and moved <= LONGEST:
            rows.append(SlidingRow(ahead, found))
            step = min(0.5 * LONGEST, 1.5 * step)
        elif step > SHORTEST:
            step *= 0.5
        else:
            reason = "the structure would snap through" if found.success else found.message
            return rows, f"no equilibrium follows the one at factor {factor:.6g}: {reason}"
    return rows, ""

"""Pseudo-arclength continuation of equilibria (Keller).

Unknowns are displacements y, tensions t of rigid bars, and a factor f of the change of loads and
inputs. The predictor steps along the tangent of the path. The corrector is Newton's method in the
hyperplane normal to the tangent [1]_. Arc length is measured in dy/ℓ and df/φ, with a length ℓ and
the range φ of the factor.

References
----------
.. [1] H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems,
   Applications of Bifurcation Theory (1977), 359-384.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.optimize import brentq
from scipy.sparse.linalg import splu

from tenscasadi.statics.solver.motions import neutral_motions, softest_motions
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.sparse_pattern import join_blocks
from tenscasadi.statics.solver.static_equations import Conditions, StaticPoint
from tenscasadi.statics.solver.trust_region import allowed_residual
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import ROUNDING, TOLERANCE, Array

LONGEST = 0.1  # longest step, in units of arc length
SHORTEST = 1e-7
ITERATIONS = 10  # of a corrector
_TURN = 0.9  # cosine of the angle between successive tangents below which a step is shortened
_EASY = 4  # corrector iterations that leave the step length unchanged
_FLAT = 10  # rows with equal factors after which a path ends
_SAME = 1e-5  # fraction of a step within which critical points count as one
_JUMP = 100.0  # largest distance between two points of a path, relative to their arc length


class LoadChange(NamedTuple):
    """Change of loads and inputs per unit of the factor.

    Attributes
    ----------
    given : Conditions
        Conditions at factor 0.
    inputs : ndarray (nw,)
        Change of the inputs.
    load : ndarray (n, 3)
        Change of the nodal forces [N].
    """

    given: Conditions
    inputs: Array
    load: Array

    def at(self, factor: float) -> Conditions:
        """Return loads and inputs at a factor."""
        added = self.given.added + factor * self.load
        return self.given._replace(inputs=self.given.inputs + factor * self.inputs, added=added)


class PathPoint(NamedTuple):
    """Equilibrium on a load path.

    Attributes
    ----------
    point : StaticPoint
        Nodes and forces.
    tension : ndarray (β_r,)
        Tensions of rigid bars [N].
    factor : float
        Factor of the load.
    direction : ndarray (free + 1,)
        Unit tangent of the path: displacements, then the factor.
    unstable : int
        Number of displacement modes without a positive stiffness.
    neutral : ndarray (free, r)
        Rigid-body motions without stiffness.
    """

    point: StaticPoint
    tension: Array
    factor: float
    direction: Array
    unstable: int
    neutral: Array


class PathRow(NamedTuple):
    """Equilibrium on a load path, with its kind of critical point.

    Attributes
    ----------
    place : PathPoint
        The equilibrium.
    kind : str
        "limit" or "bifurcation" at critical points, otherwise "".
    """

    place: PathPoint
    kind: str


class PathEnd(ArithmeticError):
    """Raised at the end of a path, with the reason as message."""


class BranchJump(ArithmeticError):
    """Raised if the corrector converges to another branch nearby."""


class Tracer:
    """Continuation of equilibria along a load path.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    change : LoadChange
        Changes of loads and inputs per unit factor.
    factors : tuple of float
        Least and largest factor.
    """

    def __init__(
        self, system: NewtonSystem, change: LoadChange, factors: tuple[float, float]
    ) -> None:
        self.system, self.equations, self.change = system, system.equations, change
        self.factors, self.growth = factors, 1.0
        length = unit_length(change.given.anchor)
        self.units = np.append(np.full(system.size, length), factors[1] - factors[0])

    # --- along the path ---

    def start(self, point: StaticPoint, tension: Array, factor: float) -> PathPoint:
        """Begin a path at an equilibrium.

        `tension` (rigid bars,) [N] is that at the point, and `factor` is its load factor. The path
        leads towards larger factors, unless this factor is the largest.
        """
        ahead = np.zeros(self.system.size + 1)
        ahead[-1] = 1.0 if factor < self.factors[1] else -1.0
        return self._complete(point, tension, factor, ahead)

    def follow(self, place: PathPoint, most: int) -> tuple[list[PathRow], str]:
        """Trace the path until the factor leaves its range.

        Parameters
        ----------
        place : PathPoint
            First equilibrium.
        most : int
            Largest number of steps.

        Returns
        -------
        tuple
            Rows of the path, and the reason for an early end; "" if there is none.
        """
        rows, step = [PathRow(place, "")], 0.5 * LONGEST
        low, high = self.factors
        for _ in range(most):
            try:
                taken, new = self._advance(place, step)
                ahead = [*self._find_critical(place, new), PathRow(new, "")]
            except BranchJump:
                step = 0.2 * taken
                continue
            except PathEnd as error:
                return rows, str(error)
            for row in ahead:
                factor = row.place.factor
                if not low <= factor <= high:
                    bound = high if factor > high else low
                    last = self._stop_at(rows[-1].place, row.place, bound)
                    return [*rows, PathRow(last, "")], ""
                rows.append(row)
            if len(rows) > _FLAT and np.ptp([row.place.factor for row in rows[-_FLAT:]]) < 1e-9 * (
                high - low
            ):
                return rows, "the factor does not change along motions without stiffness"
            step, place = min(LONGEST, self.growth * taken), new
        return rows, f"the factor stays in its range for {most} steps"

    def _advance(self, place: PathPoint, step: float) -> tuple[float, PathPoint]:
        """Advance from a path point by at most a given length.

        The `step` is halved until the corrector converges and the tangent turns little enough.
        Returns its length and the new equilibrium.
        """
        while step >= SHORTEST:
            found = self._correct(place, step)
            if found is not None:
                new, iterations = found
                turn = float(new.direction @ place.direction)
                if turn > _TURN or step < 1e3 * SHORTEST:
                    self.growth = float(np.clip(_EASY / max(iterations, 1), 0.5, 1.5))
                    return step, new
            step *= 0.5
        raise PathEnd(f"no equilibrium follows the one at factor {place.factor:.6g}")

    def _stop_at(self, place: PathPoint, beyond: PathPoint, bound: float) -> PathPoint:
        """Find the equilibrium at the factor `bound` between two path points.

        They are `place` and `beyond`. The initial guess is on the parabola through both along the
        first tangent, so that the first one can be a limit point.
        """
        way = self._way(place, beyond)
        along = float(place.direction @ way) * place.direction
        curve = way - along
        roots = np.roots([curve[-1], along[-1], (place.factor - bound) / self.units[-1]])
        share = min((r.real for r in roots if r.imag == 0.0 and 0.0 < r.real <= 1.0), default=1.0)
        y = ((share * along + share**2 * curve) * self.units)[:-1]
        tension = place.tension + share * (beyond.tension - place.tension)
        across = np.zeros(self.system.size + 1)
        across[-1] = 1.0
        nodes = self.equations.displace(place.point.nodes, y)
        found = self._newton(nodes, tension, bound, across, 0.0, place.neutral)
        if found is None:
            return beyond
        point, tension, _, _ = found
        return self._complete(point, tension, bound, place.direction)

    def _displacement(self, place: PathPoint, other: PathPoint) -> Array:
        moved = other.point.nodes - place.point.nodes
        return self.equations.in_free_directions(moved)

    # --- predictor and corrector ---

    def _correct(self, place: PathPoint, step: float) -> tuple[PathPoint, int] | None:
        """Find the equilibrium at a distance along the tangent.

        The tangent is that at the path point `place`, and `step` is the distance. Also returns the
        number of iterations; None if Newton's method does not converge.
        """
        ahead = step * place.direction * self.units
        nodes = self.equations.displace(place.point.nodes, ahead[:-1])
        found = self._newton(
            nodes,
            place.tension,
            place.factor + float(ahead[-1]),
            place.direction / self.units,
            0.0,
            place.neutral,
        )
        if found is None:
            return None
        point, tension, factor, iterations = found
        return self._complete(point, tension, factor, place.direction), iterations

    def _newton(
        self,
        nodes: Array,
        tension: Array,
        factor: float,
        across: Array,
        offset: float,
        neutral: Array,
    ) -> tuple[StaticPoint, Array, float, int] | None:
        """Find the equilibrium in a hyperplane across the path.

        The hyperplane has the normal `across` (free + 1,), and the distance `offset` from the
        initial guess: nodes, tensions of rigid bars, and factor. Rigid-body motions without
        stiffness (`neutral`) are excluded. Returns None if Newton's method does not converge.
        Otherwise also returns the number of iterations.
        """
        equations, system = self.equations, self.system
        for iteration in range(ITERATIONS + 1):
            point = equations.at(nodes, self.change.at(factor))
            bars = equations.bar_forces(point, tension)
            rest = equations.in_free_directions(point.applied + bars)
            errors = equations.bar_errors(nodes)
            if not np.isfinite(rest).all():
                return None
            allowed = allowed_residual(system, point, tension)
            worst = float(np.abs(errors / equations.lengths).max(initial=0.0))
            if np.abs(rest).max(initial=0.0) <= allowed and worst <= 1e-12:
                return point, tension, factor, iteration
            try:
                p, change, df = self._solve(point, tension, factor, across, neutral)(
                    rest, -errors, offset
                )
            except np.linalg.LinAlgError:
                return None
            nodes, tension = equations.displace(nodes, p), tension + change
            factor, offset = factor + df, 0.0
        return None

    def _solve(
        self, point: StaticPoint, tension: Array, factor: float, across: Array, neutral: Array
    ) -> Callable[[Array, Array, float], tuple[Array, Array, float]]:
        """Factorize the Newton system bordered by the hyperplane.

        It is linearized at a point with tensions (rigid bars,) [N] and a load factor. The row
        `across` is the normal of the hyperplane. Rigid-body motions without stiffness (`neutral`)
        are excluded. The result maps residuals of forces, bar lengths and hyperplane to changes of
        coordinates, tensions and factor.
        """
        system, size, rigid = self.system, self.system.size, self.system.rigid
        scale = system.stiffness_scale(point, tension)
        J = system.lengthening(point)
        push = self._push(point, factor)
        weight = np.linalg.norm(push) or 1.0  # of the factor's column
        unit = scale  # of the rows of bars and the plane
        slack, shift = np.full(rigid, -1e-10 / scale), np.full(size, ROUNDING * scale)
        diagonal = np.concatenate([shift, slack, [across[-1] / weight * unit * unit]])
        parts = [
            (0, 0, system.tangent(point, tension)),
            (0, 0, sp.diags_array(diagonal)),
            (size, 0, J),
            (0, size, J.T),
            (0, size + rigid, -(push / weight)[:, None] * unit),
            (size + rigid, 0, across[:size][None, :] * unit),
            (0, size + rigid + 1, neutral * unit),
            (size + rigid + 1, 0, neutral.T * unit),
        ]
        if self.equations.follows:
            parts.append((0, 0, system.load_tangent(point)))
        matrix = join_blocks(parts, size + rigid + 1 + neutral.shape[1])
        try:
            factors = splu(matrix)
        except RuntimeError as error:
            raise np.linalg.LinAlgError(str(error)) from None

        def solve(f: Array, g: Array, h: float) -> tuple[Array, Array, float]:
            target = np.concatenate([f, g, [h * unit], np.zeros(neutral.shape[1])])
            x = factors.solve(target)
            x = x + factors.solve(target - matrix @ x)
            return x[:size], x[size : size + rigid], float(x[size + rigid] * unit / weight)

        return solve

    def _push(self, point: StaticPoint, factor: float) -> Array:
        """Compute the derivative (free,) of forces with respect to the factor.

        It is that at a point with the load factor `factor`.
        """
        pushed = self.change.load
        if self.change.inputs.any():
            pushed = pushed + self.equations.push(
                point.nodes, self.change.at(factor), self.change.inputs
            )
        return self.equations.in_free_directions(pushed)

    def _complete(
        self, point: StaticPoint, tension: Array, factor: float, ahead: Array
    ) -> PathPoint:
        """Compute the tangent and stability of an equilibrium on the path.

        The point has tensions (rigid bars,) [N] and a load factor. The tangent has a positive
        component along `ahead` (free + 1,). The path point contains the number of displacement
        modes without a positive stiffness.
        """
        system = self.system
        pressed = self.equations.at(
            point.nodes, self.change.at(factor)._replace(pressing=point.nodes)
        )
        neutral = neutral_motions(system, pressed, tension)
        across = ahead / self.units
        solve = self._solve(point, tension, factor, across, neutral)
        p, _, df = solve(np.zeros(system.size), np.zeros(system.rigid), 1.0)
        direction = np.append(p, df) / self.units
        direction = direction / np.linalg.norm(direction)
        scale = system.stiffness_scale(pressed, tension)
        try:
            factors = system.factor(pressed, tension, scale, -ROUNDING * scale)
            unstable = factors.count_negative(neutral)
        except np.linalg.LinAlgError:
            unstable = 1
        return PathPoint(point, tension, factor, direction, unstable, neutral)

    # --- critical points ---

    def _find_critical(self, place: PathPoint, new: PathPoint) -> list[PathRow]:
        """Locate limit points and bifurcations between two equilibria.

        These are `place` and the next one, `new`. The result is sorted by arc length.
        """
        reach = float(place.direction @ self._way(place, new))
        low, high = sorted((place.unstable, new.unstable))
        if high == low and place.direction[-1] * new.direction[-1] >= 0.0:
            return []
        # along motions orthogonal to the load the system is singular at a bifurcation
        _, motions = self._softest(place, high)
        push = self._push(place.point, place.factor)
        sideways = np.abs(motions.T @ push) <= TOLERANCE * float(np.linalg.norm(push))
        across = np.hstack(
            [place.neutral, motions[:, sideways & (np.arange(motions.shape[1]) >= low)]]
        )
        found: list[tuple[float, PathRow]] = []

        @cache  # each point serves the searches for all critical points
        def at(step: float) -> PathPoint:
            if step <= 0.0 or step >= reach:
                return place if step <= 0.0 else new
            corrected = self._correct(place._replace(neutral=across), step)
            if corrected is None:
                raise BranchJump
            return corrected[0]

        steps = {0.0, reach}

        @cache
        def spectrum(step: float) -> tuple[Array, Array]:
            steps.add(step)
            return self._softest(at(step), high)

        def stiffness(step: float, k: int) -> float:  # 0 for neutral motions, which are left out
            values = spectrum(step)[0]
            return float(values[k]) if k < len(values) else 0.0

        if place.direction[-1] * new.direction[-1] < 0.0:
            step = _root(lambda s: float(at(s).direction[-1]), steps)
            self._check_continuity(at, step, reach)
            found.append((step, PathRow(at(step), "limit")))
        for k in range(low, high):
            step = _root(lambda s, k=k: stiffness(s, k), steps)  # type: ignore[misc]
            known = (0.0, *(other for other, _ in found))
            if any(abs(step - other) <= _SAME * reach for other in known):
                continue
            self._check_continuity(at, step, reach)
            if self._is_bifurcation(at(step), k, *spectrum(step)):
                found.append((step, PathRow(at(step), "bifurcation")))
        return [row for _, row in sorted(found, key=lambda entry: entry[0])]

    def _is_bifurcation(self, place: PathPoint, k: int, values: Array, motions: Array) -> bool:
        """Return whether the k-th softest mode indicates a bifurcation.

        It is the mode of the path point `place`. Its stiffness `values[k]` is then zero, and its
        mode `motions[:, k]` is orthogonal to the load.
        """
        push = self._push(place.point, place.factor)
        scale = self.system.stiffness_scale(place.point, place.tension)
        across = abs(float(motions[:, k] @ push)) <= TOLERANCE * float(np.linalg.norm(push))
        return across and abs(float(values[k])) <= TOLERANCE * scale

    def _check_continuity(
        self, at: Callable[[float], PathPoint], step: float, reach: float
    ) -> None:
        """Check that the path is continuous at a step.

        The function `at` maps a step length to a path point, and `reach` is the length between the
        two known ones. Raises BranchJump if the points on both sides are far from each other.
        """
        before, after = (at(step + side * _SAME * reach) for side in (-1.0, 1.0))
        apart = float(np.linalg.norm(self._way(before, after)))
        if apart > _JUMP * _SAME * reach and reach > 1e3 * SHORTEST:
            raise BranchJump

    def _way(self, place: PathPoint, other: PathPoint) -> Array:
        """Compute the scaled difference (free + 1,) of two equilibria.

        It points from `place` to `other`. It is in units of arc length: displacements, then the
        factor.
        """
        moved = self._displacement(place, other)
        return np.asarray(np.append(moved, other.factor - place.factor) / self.units)

    def _softest(self, place: PathPoint, count: int) -> tuple[Array, Array]:
        """Find the smallest stiffnesses (count,) with their modes (free, count).

        They are those of the path point `place` [N/m].
        """
        system, nodes = self.system, place.point.nodes
        point = self.equations.at(nodes, self.change.at(place.factor)._replace(pressing=nodes))
        K, J = system.tangent(point, place.tension), system.lengthening(point)
        neutral = neutral_motions(system, point, place.tension)
        return softest_motions(K, J, neutral, max(count, 1))


def unit_length(nodes: Array) -> float:
    """Compute the displacement norm that has unit arc length [m].

    The nodes are (n, 3).
    """
    size = measure_extent(nodes) or 1.0
    return float(0.2 * size * len(nodes) ** 0.5)


def _root(function: Callable[[float], float], steps: Iterable[float]) -> float:
    """Find a root of a function between the first and the last step.

    The function values at all `steps` are known already, or cheap.
    """
    known = sorted(steps)
    values = [function(step) for step in known]
    if values[0] * values[-1] >= 0.0:  # the change is at an end
        return known[-1] if abs(values[-1]) < abs(values[0]) else known[0]
    last = next(k for k, value in enumerate(values) if value * values[0] <= 0.0)
    low, high = known[last - 1], known[last]
    return float(brentq(function, low, high, xtol=1e-11 * known[-1], maxiter=100))

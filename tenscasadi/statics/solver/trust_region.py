"""Stable equilibria by Newton's method with a trust region.

The iterates keep the lengths of rigid bars. A step p minimizes the quadratic model of the energy
with the exact tangent stiffness K over ‖p‖ ≤ Δ and J p = 0: (K + σ I) p = F with the least σ for
which K + σ I is positive definite on these motions [1]_. A step is accepted by the work of the
forces along it, so that forces without an energy need no special treatment.

References
----------
.. [1] J. J. Moré, D. C. Sorensen, Computing a trust region step, SIAM Journal on Scientific and
   Statistical Computing 4 (1983), 553-572.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tenscasadi.statics.solver.motions import (
    find_stable_factors,
    neutral_motions,
    softest_motions,
)
from tenscasadi.statics.solver.newton_system import NewtonFactors, NewtonSystem
from tenscasadi.statics.solver.static_equations import Conditions, StaticPoint
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.util.validate import MAX_ITERATIONS, ROUNDING, Array

ACCURACY = 1e-11  # unbalanced force in equilibrium, relative to the largest force
SEARCH_COST = 1_500_000  # steps times free coordinates, about 20 s; collapses need the most steps
FARTHEST = 1e3  # displacement of an unsupported structure, relative to its size
MOVES_AWAY = "the structure moves away, as nothing holds it"
SINGULAR = "the forces drive a motion that rigid bars block to second order only"
_ROUNDING = 16 * float(np.finfo(float).eps)


class SearchResult(NamedTuple):
    """Result of a search for an equilibrium.

    Attributes
    ----------
    point : StaticPoint
        Forces at the final nodes.
    tension : ndarray (β_r,)
        Tensions of rigid bars [N].
    residual : ndarray (free,)
        Unbalanced forces on the free coordinates [N].
    converged : bool
        Whether the forces balance and no motion lowers the energy.
    stable : bool
        Whether every motion but free rigid-body motions has a positive stiffness.
    stalled : bool
        Whether the search stopped without progress, so that another start may help.
    reason : str
        Reason of a failure; empty on success.
    iterations : int
        Number of steps.
    """

    point: StaticPoint
    tension: Array
    residual: Array
    converged: bool
    stable: bool
    stalled: bool
    reason: str
    iterations: int


class NoRestError(ArithmeticError):
    """Raised if there is no equilibrium near the start."""


class StalledError(NoRestError):
    """Raised if a search makes no progress."""


def find_rest(
    system: NewtonSystem, nodes: Array, given: Conditions, accuracy: float = ACCURACY
) -> SearchResult:
    """Find a stable equilibrium near given nodes.

    Friction is limited by the normal forces at the given pressing nodes. By default these are the
    nodes of the previous iterate.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    nodes : ndarray, shape (n, 3)
        Start of the search [m].
    given : Conditions
        Inputs, time and friction.
    accuracy : float
        Unbalanced forces in equilibrium, relative to the largest force.

    Returns
    -------
    SearchResult
        The equilibrium, or the last iterate and the reason.
    """
    search = _SearchState(system, nodes, given, accuracy)
    try:
        search.run()
    except NoRestError as error:
        return search.result(str(error), isinstance(error, StalledError))
    except np.linalg.LinAlgError:
        return search.result("the tangent stiffness cannot be factorized", True)
    return search.result("")


class _SearchState:
    """Iterate and trust region of a search for an equilibrium."""

    def __init__(
        self, system: NewtonSystem, nodes: Array, given: Conditions, accuracy: float
    ) -> None:
        self.system, self.equations, self.accuracy = system, system.equations, accuracy
        self.lags = given.pressing is None
        self.given = given._replace(pressing=nodes) if self.lags else given
        self.start = nodes
        self.size = measure_extent(nodes) or 1.0
        self.radius = 0.1 * self.size * len(nodes) ** 0.5
        self.shift = 0.0
        self.steps = 0
        self.stable = False
        self.point = self.equations.at(nodes, self.given)
        self.tension = np.zeros(system.rigid)
        self._balance()

    def run(self) -> None:
        """Iterate until the forces balance at an energy minimum."""
        self._take(restore_bars(self.system, self.start))
        self._fit_tension()
        room = SEARCH_COST // max(self.system.size, 1)
        limit = MAX_ITERATIONS + min(10 * MAX_ITERATIONS, room)
        for self.steps in range(limit):
            # a collapse that takes so many steps ends within a few times the size
            if self.steps > MAX_ITERATIONS and self._distance() > 0.01 * FARTHEST * self.size:
                raise NoRestError(MOVES_AWAY)
            if self._is_balanced():
                if not self.system.is_symmetric(self.point):
                    return  # `settle` judges the equilibrium after its last Newton iterations
                factors = self._stable_factors()
                if factors is not None:
                    self._polish(factors)
                    self.stable = self._stable_factors(-ROUNDING) is not None
                    return
                self._leave_saddle()
            else:
                self._step()
        raise StalledError(f"the forces did not balance within {limit} iterations")

    def result(self, reason: str, stalled: bool = False) -> SearchResult:
        """Build the result from the last iterate.

        `reason` explains a failure, and is "" after success. `stalled` is whether the search made
        no progress.
        """
        found, stable = not reason, self.stable and not reason
        return SearchResult(
            self.point, self.tension, self.residual, found, stable, stalled, reason, self.steps
        )

    @property
    def floor(self) -> float:
        """Smallest shift σ of the tangent stiffness [N/m].

        It prevents displacements along modes without stiffness.
        """
        return ROUNDING * self.scale

    def _take(self, nodes: Array) -> None:
        if self.lags:
            self.given = self.given._replace(pressing=nodes)
        self.point = self.equations.at(nodes, self.given)
        if self._distance() > FARTHEST * self.size:
            raise NoRestError(MOVES_AWAY)
        if not np.isfinite(self.point.applied).all():
            raise NoRestError("the forces are not finite")

    def _distance(self) -> float:
        """Compute the largest displacement of a coordinate since the start [m]."""
        return float(np.abs(self.point.nodes - self.start).max(initial=0.0))

    def _fit_tension(self) -> None:
        """Compute the least-squares tensions of rigid bars."""
        if self.system.rigid:
            force = self.equations.in_free_directions(self.point.applied)
            self.tension = self.system.factor_bars(self.point.bars).solve(force)[1]
        self._balance()

    def _balance(self) -> None:
        """Update the unbalanced forces and the stiffness scale."""
        bars = self.equations.bar_forces(self.point, self.tension)
        self.residual = self.equations.in_free_directions(self.point.applied + bars)
        self.scale = self.system.stiffness_scale(self.point, self.tension)

    def _is_balanced(self) -> bool:
        allowed = allowed_residual(self.system, self.point, self.tension, self.accuracy)
        return bool(np.abs(self.residual).max(initial=0.0) <= allowed)

    # --- steps ---

    def _step(self) -> None:
        """Take a trust-region step, or shrink the region."""
        factors, p, change = self._solve_model()
        length = float(np.linalg.norm(p))
        share = min(1.0, self.radius / length) if length else 1.0
        along = float(p @ self.residual)
        predicted = share * (along - 0.5 * share * (along - self.shift * length**2))
        length *= share
        half, whole = (self._move(part * share * p, factors) for part in (0.5, 1.0))
        work = -1.0, -1.0
        if half is not None and whole is not None:
            work = self._works(half, whole, self.tension + share * change)
        ratio = work[1] / predicted if predicted > 0.0 else 1.0
        if ratio < 0.25:
            self.radius = 0.25 * length
        elif ratio > 0.75 and length > 0.5 * self.radius:
            self.radius = 2.0 * self.radius
        # beyond a kink of the energy, half of a step can gain more than all of it
        onward, part = (whole, share) if work[1] >= work[0] else (half, 0.5 * share)
        if (max(work) > 1e-3 * predicted or predicted <= 0.0) and onward is not None:
            self._take(onward)
            self.tension = self.tension + part * change
            self._balance()
        elif onward is None and self.radius < 10.0 * ROUNDING**0.5 * self.size:
            raise NoRestError(SINGULAR)  # shorter steps stay within the rounding error of lengths
        elif self.radius < ROUNDING * self.size:
            self._fit_tension()  # those of the model are too large after all strings became slack
            if not self._is_balanced():
                raise StalledError("no step lowers the energy any more")

    def _solve_model(self) -> tuple[NewtonFactors, Array, Array]:
        """Minimize the quadratic model within the trust region.

        Returns the factors of the shifted stiffness, the displacements (free,) [m], and the changes
        of the tensions of rigid bars (β_r,) [N]. Raises StalledError if the stiffness is not
        finite.
        """
        low, high, shift = 0.0, np.inf, max(self.floor, 0.3 * self.shift)
        found = None
        for _ in range(60):
            factors = self._factor(shift)
            if factors is None:
                low = shift
                shift = (low * high) ** 0.5 if high < np.inf else max(4 * low, 1e-4 * self.scale)
            else:
                p, change = factors.solve(self.residual)
                length = float(np.linalg.norm(p))
                found = factors, p, change
                self.shift = shift
                if length > 1.3 * self.radius:
                    low = shift
                elif length < 0.6 * self.radius and shift > self.floor:
                    high = shift
                else:
                    break
                curvature = float(p @ factors.solve(p)[0])
                shift += length**2 / curvature * (length - self.radius) / self.radius
                if not low < shift < high:
                    shift = (max(low, 1e-4 * high) * high) ** 0.5 if high < np.inf else 4 * low
                shift = max(self.floor, shift)
            if low > 0.9 * high:
                break
        if found is None:
            raise StalledError("the tangent stiffness is not finite")
        return found

    def _polish(self, factors: NewtonFactors) -> None:
        """Accept a last Newton step if it reduces the residual.

        `factors` are those of the Newton system at the iterate.
        """
        before = self.point, self.tension, self.residual
        p, change = factors.solve(self.residual)
        nodes = self._move(p, factors)
        if nodes is not None:
            self._take(nodes)
            self.tension = self.tension + change
            self._balance()
        if not np.abs(self.residual).max(initial=0.0) < np.abs(before[2]).max(initial=0.0):
            self.point, self.tension, self.residual = before

    def _leave_saddle(self) -> None:
        """Step along the softest mode to leave a saddle point."""
        K = self.system.tangent(self.point, self.tension)
        J = self.system.lengthening(self.point)
        neutral = neutral_motions(self.system, self.point, self.tension)
        _, vectors = softest_motions(K, J, neutral, 1)
        direction, factors = vectors[:, 0], self.system.factor_bars(self.point.bars)
        direction = direction * (np.sign(direction[np.argmax(np.abs(direction))]) or 1.0)
        length = 0.1 * self.size
        for _ in range(40):
            for p in (length * direction, -length * direction):
                half, whole = (self._move(share * p, factors) for share in (0.5, 1.0))
                if (
                    half is not None
                    and whole is not None
                    and self._works(half, whole, self.tension)[1] > 0.0
                ):
                    self._take(whole)
                    self.radius = max(self.radius, length)
                    return self._fit_tension()
            length *= 0.5
        raise StalledError("no step leaves the saddle of the energy")

    def _move(self, p: Array, factors: NewtonFactors) -> Array | None:
        """Displace the nodes and restore the bar lengths.

        p (free,) are the displacements [m]. `factors` are those of the Newton system at the
        iterate. Returns None if the lengths cannot be restored.
        """
        return pull_to_bars(self.system, self.equations.displace(self.point.nodes, p), factors)

    def _works(self, half: Array, whole: Array, tension: Array) -> tuple[float, float]:
        """Compute the work of forces along half and all of a step [J].

        The nodes `half` and `whole` (n, 3) are those after half and all of it, and `tension` (β_r,)
        [N] is that of rigid bars. The power along the parabola through the nodes is integrated as a
        parabola, by Simpson's rule. It is exact for constant tensions of rigid bars, which do no
        work but cancel most of the rounding error.
        """
        first, last = half - self.point.nodes, whole - self.point.nodes
        ways = 4 * first - last, last, 3 * last - 4 * first
        points = [
            self.point,
            *(self.equations.at(nodes, self.given) for nodes in (half, whole)),
        ]
        start, middle, end = (
            float(np.sum((point.applied + self.equations.bar_forces(point, tension)) * way))
            for point, way in zip(points, ways, strict=True)
        )
        return (5 * start + 8 * middle - end) / 24, (start + 4 * middle + end) / 6

    # --- factors ---

    def _stable_factors(self, shift: float = ROUNDING) -> NewtonFactors | None:
        """Factorize with a relative shift, or return None at a saddle."""
        return find_stable_factors(self.system, self.point, self.tension, shift)

    def _factor(self, shift: float) -> NewtonFactors | None:
        """Factorize with a shift σ.

        Return None unless K + σ I is positive definite on the motions that preserve the lengths of
        rigid bars.
        """
        try:
            factors = self.system.factor(self.point, self.tension, self.scale, shift)
            return factors if factors.count_negative() <= 0 else None
        except np.linalg.LinAlgError:
            return None


def allowed_residual(
    system: NewtonSystem, point: StaticPoint, tension: Array, accuracy: float = ACCURACY
) -> float:
    """Compute the unbalanced force that counts as zero [N].

    It is `accuracy` times the largest force of springs, rigid bars (`tension`) and loads, plus the
    rounding error of the spring forces.
    """
    lengths = np.linalg.norm(point.springs, axis=1)
    forces = [np.abs(point.gamma) * lengths, np.abs(tension), np.abs(point.loads)]
    largest = max(float(values.max(initial=0.0)) for values in forces)
    longest = max(float(values.max(initial=0.0)) for values in (lengths, system.equations.lengths))
    return accuracy * largest + _ROUNDING * system.stiffness_scale(point, tension) * longest


def restore_bars(system: NewtonSystem, nodes: Array) -> Array:
    """Restore the lengths of rigid bars by minimum-norm displacements.

    Returns the nodes (n, 3) after these, from `nodes` (n, 3). Raises NoRestError if there is no
    such configuration nearby.
    """
    equations = system.equations
    if not system.rigid:
        return nodes
    for _ in range(50):
        if _bars_fit(equations.bar_errors(nodes), equations.lengths):
            return nodes
        factors = system.factor_bars(equations.bar_vectors(nodes))
        nodes = equations.displace(nodes, factors.lengthen(-equations.bar_errors(nodes)))
    raise NoRestError("the rigid bars do not fit the supports near the start")


def pull_to_bars(system: NewtonSystem, nodes: Array, factors: NewtonFactors) -> Array | None:
    """Restore the lengths of rigid bars with a given factorization.

    Returns the nodes (n, 3) after this, from `nodes` (n, 3). The factors are those of a
    configuration nearby. Returns None if the lengths cannot be restored.
    """
    equations = system.equations
    last = np.inf
    for _ in range(30 if system.rigid else 0):
        errors = equations.bar_errors(nodes)
        worst = float(np.abs(errors / equations.lengths).max(initial=0.0))
        if not (worst <= ROUNDING or worst < 0.9 * last):
            return None if worst > 10 * ROUNDING else nodes
        nodes, last = equations.displace(nodes, factors.lengthen(-errors)), worst
        if worst <= ROUNDING:
            break
    return nodes


def _bars_fit(errors: Array, lengths: Array) -> bool:
    return bool(np.abs(errors / lengths).max(initial=0.0) <= ROUNDING)

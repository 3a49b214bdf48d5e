"""Objectives of prestress design: stiffest, most even, smallest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import scipy.sparse as sp

from tenscasadi.design.conic import (
    ConicSolution,
    LinearRows,
    scaled_triangle,
    solve_conic,
    unscaled_matrix,
)
from tenscasadi.design.tangent_stiffness import SOFTEST, TangentStiffness, extend_basis
from tenscasadi.schema.value import Value
from tenscasadi.util.validate import MAX_ITERATIONS, TOLERANCE, Array


class PrestressProgram(NamedTuple):
    """Linear constraints on force densities q = basis · p.

    Attributes
    ----------
    stiffness : TangentStiffness
        Tangent stiffness of the structure.
    basis : csc_array (μ, u)
        One column for each group of members that share a force density, for each cable, and for
        each bar of a body.
    tension : csc_array (α, u)
        Tensions of strings per force density of a group [m].
    equal, below : LinearRows
        Equilibrium, and limits of tensions.
    scale : float
        Typical force density [N/m].
    """

    stiffness: TangentStiffness
    basis: sp.csc_array
    tension: sp.csc_array
    equal: LinearRows
    below: LinearRows
    scale: float

    def minimize(self, cost: Array, quadratic: sp.csc_array | None = None) -> ConicSolution:
        """Minimize a quadratic objective.

        It is ½ pᵀ P p + costᵀ p, with p in units of `scale`. P is the matrix `quadratic`, zero by
        default.
        """
        equal, below = self.in_units()
        found = solve_conic(cost, equal, below, quadratic)
        return found._replace(x=found.x * self.scale)

    def softest(self, p: Array) -> tuple[Array, Array]:
        """Compute the smallest stiffnesses [N/m] and their modes, as columns.

        They are those of the structure with force densities p (u,) [N/m].
        """
        return self.stiffness.softest(self.basis @ p, SOFTEST)

    def fit(self, p: Array, up: bool) -> Array:
        """Scale force densities p (u,) so that limits hold.

        Without `up`, p is reduced to satisfy all upper limits. With `up`, p is scaled such that all
        lower limits are satisfied and one is active. This removes the rounding error of a solver.
        It also determines the level of prestress if the objective does not.
        """
        values, limits = self.below.A @ p, self.below.b
        ratio = np.divide(
            limits, values, out=np.full(len(values), np.nan), where=values * limits > 0
        )
        ratio = ratio[limits < 0.0] if up else ratio[limits > 0.0]
        ratio = ratio[~np.isnan(ratio)]
        if not len(ratio):
            return p
        return p * float(ratio.max() if up else min(ratio.min(), 1.0))

    def in_units(self) -> tuple[LinearRows, LinearRows]:
        """Divide the constraints' right-hand sides by the typical force density.

        Returns the equations, then the inequalities.
        """
        equal, below = self.equal, self.below
        return LinearRows(equal.A, equal.b / self.scale), LinearRows(below.A, below.b / self.scale)


class PrestressGoal(Protocol):
    """Interface of objectives for prestress design.

    `needs_minimum` is whether it needs lower limits of tensions.
    """

    needs_minimum: bool

    def solve(self, program: PrestressProgram) -> ConicSolution:
        """Find the optimal force densities within the limits.

        Parameters
        ----------
        program : PrestressProgram
            Constraints on the force densities: equilibrium and limits of tensions.

        Returns
        -------
        ConicSolution
            Force densities (u,) [N/m], one for each column of ``program.basis``, and status.
        """


@dataclass(frozen=True)
class Stiffest(Value, kind="Stiffest"):
    """Goal of `find_prestress`: the largest stiffness of the softest mode.

    It maximizes the smallest eigenvalue of the tangent stiffness on motions that preserve the
    lengths of rigid bars: a semidefinite program. The message of the result gives the distance from
    the largest stiffness if it is above 1e-6, as for symmetric structures with many self-stresses.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pre = tc.find_prestress(tc.shapes.prism(), tc.Stiffest(), maximum=10.0)
    >>> pre.success, round(float(pre.tension.max()), 6)
    (True, 10.0)
    """

    needs_minimum = False

    def solve(self, program: PrestressProgram) -> ConicSolution:
        """Maximize the smallest stiffness by semidefinite programs.

        Each adds the softest modes to those of the one before. The sequence ends when the softest
        mode is as stiff as in the program. Once there are many modes, only the active ones are
        kept, and a damping keeps force densities near the best ones: a spectral bundle method [1]_.
        After ten programs, the tolerance doubles with each.

        Parameters
        ----------
        program : PrestressProgram
            Constraints on the force densities: equilibrium and limits of tensions.

        Returns
        -------
        ConicSolution
            Force densities (u,) [N/m], one for each column of ``program.basis``, status, and the
            relative distance from the largest stiffness.

        References
        ----------
        .. [1] C. Helmberg, F. Rendl, A spectral bundle method for semidefinite programming, SIAM
           Journal on Optimization 10 (2000), 673-696.
        """
        found = program.minimize(np.zeros(program.basis.shape[1]))
        if found.status != "solved":
            return found
        best, (values, motions) = found.x, program.softest(found.x)
        if not len(values):  # no motion to stiffen
            return found._replace(x=program.fit(best, up=False))
        seen, most, damping = motions[:, :0], SOFTEST + SOFTEST // 2, 0.0
        for k in range(MAX_ITERATIONS):
            least = float(values[0]) if len(values) else np.inf
            more = extend_basis(seen, motions)[:, :most]
            near = Proximity(best, damping)
            found, bound, active = _maximize_least(program, more, near)
            if found.status != "solved":
                return found
            gain, size = bound - least, max(abs(bound), TOLERANCE * program.scale)
            if gain <= TOLERANCE * 2.0 ** max(k - 10, 0) * size:
                return found._replace(x=program.fit(best, up=False), gap=max(gain / size, 0.0))
            crowded = more.shape[1] == most
            seen = active if crowded else more
            there, motions = program.softest(found.x)
            motions = motions[:, there < bound]
            if there[0] - least >= 0.1 * gain:
                best, values, damping = found.x, there, 0.25 * damping
            elif crowded and not damping:
                damping = gain * program.scale / float(np.sum((found.x - best) ** 2))
        return found._replace(status="failed")


@dataclass(frozen=True)
class Even(Value, kind="Even"):
    """Goal of `find_prestress`: the most uniform string tensions.

    It minimizes the sum of squared deviations of the string tensions from their mean: a quadratic
    program.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pre = tc.find_prestress(tc.shapes.six_bar_ball(), tc.Even(), minimum=5.0)
    >>> pre.tension.round(6).min().item(), pre.tension.round(6).max().item()
    (5.0, 5.0)
    """

    needs_minimum = True

    def solve(self, program: PrestressProgram) -> ConicSolution:
        """Minimize the deviations of string tensions from their mean.

        Parameters
        ----------
        program : PrestressProgram
            Constraints on the force densities: equilibrium and limits of tensions.

        Returns
        -------
        ConicSolution
            Force densities (u,) [N/m], one for each column of ``program.basis``, and status.
        """
        T = program.tension
        mean = sp.csc_array(-np.ones((T.shape[0], 1)))
        deviation = sp.hstack([T, mean], format="csc")
        equal, below = program.in_units()
        wider = [
            LinearRows(sp.hstack([rows.A, sp.csc_array((len(rows.b), 1))], format="csc"), rows.b)
            for rows in (equal, below)
        ]
        found = solve_conic(
            np.zeros(deviation.shape[1]), wider[0], wider[1], deviation.T @ deviation
        )
        return found._replace(x=program.fit(found.x[:-1] * program.scale, up=True))


@dataclass(frozen=True)
class Least(Value, kind="Least"):
    """Goal of `find_prestress`: the smallest sum of string tensions.

    It is found by a linear program.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pre = tc.find_prestress(tc.shapes.prism(), tc.Least(), minimum=5.0)
    >>> round(float(pre.tension.min()), 6)
    5.0
    """

    needs_minimum = True

    def solve(self, program: PrestressProgram) -> ConicSolution:
        """Minimize the sum of string tensions.

        Parameters
        ----------
        program : PrestressProgram
            Constraints on the force densities: equilibrium and limits of tensions.

        Returns
        -------
        ConicSolution
            Force densities (u,) [N/m], one for each column of ``program.basis``, and status.
        """
        found = program.minimize(np.asarray(program.tension.sum(axis=0)).ravel())
        return found._replace(x=program.fit(found.x, up=True))


class Proximity(NamedTuple):
    """Quadratic penalty ½ w |p − center|² on force densities p.

    Attributes
    ----------
    center : ndarray (u,)
        Force densities [N/m].
    weight : float
        w, per squared unit of force density.
    """

    center: Array
    weight: float


def _maximize_least(
    program: PrestressProgram, motions: Array, near: Proximity
) -> tuple[ConicSolution, float, Array]:
    """Maximize the smallest eigenvalue of the projected stiffness.

    The stiffness is projected onto given orthonormal modes, columns of `motions`. `near` limits the
    distance from a previous solution. Returns p, this eigenvalue, and the active modes, which
    determine it: a program in these alone has the same solution.
    """
    materials, slopes = program.stiffness.reduce(motions)
    material = np.einsum("k,kij->ij", program.stiffness.stiffness, materials)
    count, unknown = motions.shape[1], program.basis.shape[1]
    by_member = np.stack([scaled_triangle(slope) for slope in slopes], axis=1)
    by_p = (program.basis.T @ by_member.T).T
    rows = np.column_stack([-by_p, scaled_triangle(np.eye(count))])
    cone = LinearRows(sp.csc_array(rows), scaled_triangle(material) / program.scale)
    wider = [
        LinearRows(sp.hstack([part.A, sp.csc_array((len(part.b), 1))], format="csc"), part.b)
        for part in program.in_units()
    ]
    cost = np.zeros(unknown + 1)
    cost[-1] = -1.0
    cost[:-1] = -near.weight * near.center / program.scale
    square = sp.diags_array(np.append(np.full(unknown, near.weight), 0.0), format="csc")
    found = solve_conic(cost, wider[0], wider[1], square, semidefinite=[cone])
    p, least = found.x[:-1] * program.scale, float(found.x[-1]) * program.scale
    weights, vectors = np.linalg.eigh(unscaled_matrix(found.duals[-len(cone.b) :]))
    active = vectors[:, weights > TOLERANCE * weights.max(initial=0.0)]
    return found._replace(x=p), least, motions @ active

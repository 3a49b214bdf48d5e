"""Prestress design: the optimal self-stress of a structure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from tenscasadi.design.conic import LinearRows
from tenscasadi.design.force_densities import Groups, read_basis, set_prestress
from tenscasadi.design.prestress_goals import (
    Even,
    Least,
    PrestressGoal,
    PrestressProgram,
    Stiffest,
)
from tenscasadi.design.tangent_stiffness import TangentStiffness, tangent_stiffness
from tenscasadi.statics.self_stress import self_stress
from tenscasadi.structure.body_assembly import is_separate
from tenscasadi.structure.cables import reject_cable_friction
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.properties import NodalLoads, read_loads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import (
    MAX_ITERATIONS,
    NEGLIGIBLE,
    TOLERANCE,
    Array,
    as_tuple,
    instance,
    nonnegative,
    per_item,
)


@dataclass(frozen=True, eq=False)
class PrestressDesign(ReadOnlyArrays):
    """Optimal prestress of a structure.

    Attributes
    ----------
    tension : ndarray (α,)
        Tensions of strings [N].
    bar_force : ndarray (β,)
        Forces of bars [N], positive in tension.
    force_density : ndarray (α,)
        Force densities of strings [N/m].
    least_stiffness : float
        Smallest eigenvalue of the tangent stiffness [N/m] on motions that preserve the lengths of
        rigid bars; rigid-body motions are excluded.
    original : Structure
        The structure as given.
    success : bool
        Whether the prestress satisfies all limits and is stable.
    message : str
        Result in one sentence; the reason of a failure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pre = tc.find_prestress(tc.shapes.prism(stiffness=1e4), tc.Least(), minimum=10.0)
    >>> pre.success, pre.tension.round(3).tolist()[:2], pre.least_stiffness > 0.0
    (True, [10.0, 10.0], True)
    """

    tension: Array
    bar_force: Array
    force_density: Array
    original: Structure
    success: bool
    message: str
    _density: Array = field(repr=False)  # (μ,), of all members, also the bars of bodies

    def __repr__(self) -> str:
        return f"PrestressDesign({self.message})"

    @cached_property
    def least_stiffness(self) -> float:
        """Smallest eigenvalue of the tangent stiffness [N/m].

        It is 0 without prestress.
        """
        if not self.success and not self.force_density.any():
            return 0.0
        values = tangent_stiffness(self.original).softest(self._density, 1)[0]
        return float(values.min(initial=np.inf))

    @cached_property
    def structure(self) -> Structure:
        """The structure with rest lengths for this prestress.

        Without a prestress it is the original one.
        """
        if not self.success and not self.force_density.any():
            return self.original
        bars = self.bar_force / self.original.bar_lengths
        return set_prestress(self.original, self.force_density, -bars)


@name_errors
def find_prestress(
    structure: Structure,
    goal: Stiffest | Even | Least = Stiffest(),
    load_cases: Sequence[NodalLoads] = (),
    minimum: ArrayLike = 0.0,
    maximum: ArrayLike | None = None,
    groups: Groups | None = None,
) -> PrestressDesign:
    """Find the optimal self-stress for a goal.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    goal : Stiffest, Even or Least
        Largest stiffness of the softest motion, most uniform tensions, or least tensions.
    load_cases : sequence of array_like, shape (n, 3), or mapping
        Forces on the nodes, or on some by name or index [N]. The limits of tensions also apply
        under each load case.
    minimum : array_like, shape (α,)
        Least tension of strings [N], or one number for all. `Even` and `Least` need one above 0, or
        load cases, to determine the level of prestress.
    maximum : array_like, shape (α,), optional
        Largest tension of strings [N], or one number for all.
    groups : sequence of sequence of int or str, optional
        Groups of members that share their force density: strings first, then bars. Strings of
        cables have one tension, and are in no group.

    Returns
    -------
    PrestressDesign
        Tensions and bar forces, with the reason if there is no admissible prestress.

    Raises
    ------
    TypeError, ValueError
        An argument does not fit the structure, or no limit determines the level of prestress.

    Notes
    -----
    The response to a load is linearized about the prestressed state, with the tangent stiffness of
    that state. The program is repeated until prestress and response agree, with Aitken's relaxation
    of the response.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> pre = tc.find_prestress(tc.shapes.prism(), tc.Even(), minimum=10.0)
    >>> pre.success, pre.tension.round(3).tolist()[-1]
    (True, 20.659)
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    reject_cable_friction(structure, "find_prestress")
    instance("goal", goal, (Stiffest, Even, Least), "Stiffest(), Even() or Least()")
    count = len(structure.strings)
    least = nonnegative("minimum", per_item("minimum", minimum, count), "string")
    most = np.full(count, np.inf) if maximum is None else _read_maximum(maximum, least)
    cases = read_load_cases(load_cases, structure)
    if goal.needs_minimum and count and not least.any() and not len(cases):
        raise ValueError(
            f"minimum is 0: {type(goal).__name__} needs a minimum above 0 N, which fixes the scale"
        )
    search = _PrestressSearch(tangent_stiffness(structure), groups, least, most, cases)
    return search.run(goal)


class _PrestressSearch:
    """Fixed-point iteration for a prestress under load cases.

    It alternates between the prestress and the response of the structure to the loads.

    Attributes
    ----------
    tangent : TangentStiffness
        Tangent stiffness of the structure.
    basis : csc_array (μ, u)
        One column for each group of members that share a force density, for each cable, and for
        each bar of a body.
    tension : csc_array (μ, u)
        Tensions of members per force density of a group [m].
    balance : csc_array (free coordinates, u)
        Unbalanced forces per force density of a group [m].
    least, most : ndarray (α,)
        Limits of tensions [N].
    cases : ndarray (cases, n, 3)
        Loads [N].
    """

    def __init__(
        self,
        tangent: TangentStiffness,
        groups: Groups | None,
        least: Array,
        most: Array,
        cases: Array,
    ) -> None:
        self.tangent, self.least, self.most, self.cases = tangent, least, most, cases
        structure = tangent.structure
        self.basis = sp.block_diag(
            [read_basis(structure, groups), sp.eye_array(tangent.held)], format="csc"
        )
        self.tension = sp.csc_array(self.basis.multiply(tangent.lengths[:, None]))
        self.balance = sp.csc_array(tangent.elongation.T @ self.tension)
        finite = np.concatenate([least, most[np.isfinite(most)]])
        force = float(finite.max(initial=0.0)) or float(np.abs(cases).max(initial=0.0)) or 1.0
        self.scale = force / float(tangent.lengths.mean())

    def run(self, goal: PrestressGoal) -> PrestressDesign:
        """Find the optimal prestress for a goal."""
        if not len(self.cases):
            none = np.zeros((len(self.least), 1))
            found = goal.solve(self.program(none, self.least))
            if found.status != "solved":
                return self.fail(self.explain(found.status))
            return self.report(self.basis @ found.x, found.gap)
        moved = np.abs(
            self.tangent.rigid_body.T
            @ (self.tangent.free.T @ self.cases.reshape(len(self.cases), -1).T)
        ).max(axis=0, initial=0.0)
        for case in np.flatnonzero(moved > NEGLIGIBLE * np.abs(self.cases).max(initial=0.0)):
            return self.fail(f"load case {case} moves the structure as a whole: pin some nodes")
        return self.settle(goal)

    def settle(self, goal: PrestressGoal) -> PrestressDesign:
        """Iterate until prestress and response to the loads agree.

        The prestress is optimal for the `goal`. The responses of a degenerate program jump with its
        solutions. Aitken's relaxation makes them converge.
        """
        strings, none = len(self.least), np.zeros((len(self.least), 1))
        force = self.scale * float(self.tangent.lengths.mean())
        level = self.least if self.least.any() else np.minimum(force, self.most)
        first = Even().solve(self.program(none, level))
        q, found = np.zeros(len(self.tangent.lengths)), first
        if first.status == "solved":
            q = self.basis @ first.x
        assumed = last = np.zeros((strings, len(self.cases)))
        margin, relaxation = none, 1.0
        for k in range(MAX_ITERATIONS):
            try:
                response = self.tangent.tension_change(q, self.cases)[:strings]
            except np.linalg.LinAlgError:
                return self.fail(
                    "a load case drives a mechanism that no prestress stiffens: add members or supports"
                )
            tension = q[:strings] * self.tangent.lengths[:strings]
            size = max(np.abs(value).max(initial=0.0) for value in (tension, response))
            error = response - assumed
            # degenerate programs, whose solutions are not unique, may settle to their tolerance only
            allowed = NEGLIGIBLE if k < MAX_ITERATIONS // 4 else TOLERANCE
            if k and np.abs(error).max(initial=0.0) <= allowed * size:
                return self.report(q, found.gap)
            if found.gap > TOLERANCE:  # the solution jumps within its gap: limit the worst response
                under = tension[:, None] + np.hstack([none, response])
                inside = (under.min(axis=1) >= self.least - TOLERANCE * size) & (
                    under.max(axis=1) <= self.most + TOLERANCE * size
                )
                if inside.all():
                    return self.report(q, found.gap)
                margin = np.hstack([margin, response])
            if k > 1:
                turn = error - last
                relaxation *= -float(np.sum(last * turn)) / float(np.sum(turn**2) or 1.0)
                relaxation = float(np.clip(relaxation, 0.1, 1.0))
            assumed, last = assumed + relaxation * error, error
            found = goal.solve(self.program(np.hstack([assumed, margin]), self.least))
            if found.status in ("infeasible", "unbounded"):
                return self.fail(self.explain(found.status))
            if found.status != "solved":
                break
            q = self.basis @ found.x
        least = float(self.tangent.softest(q, 1)[0].min(initial=np.inf))
        if least <= 0.0:
            return self.fail(
                f"the load cases need a prestress that is unstable, the least stiffness is {least:.3g} N/m: reduce the loads, or add members"
            )
        if found.status != "solved":
            return self.fail(self.explain(found.status))
        return self.fail("prestress and response to the loads do not settle: reduce the loads")

    def program(self, response: Array, least: Array) -> PrestressProgram:
        """Build the optimization of force densities with limits under loads.

        `response` (α, cases) is the change of tensions under the loads [N], `least` the lower
        limits.
        """
        strings = len(least)
        T = self.tension[:strings]
        low = least - np.minimum(response.min(axis=1, initial=0.0), 0.0)
        high = self.most - np.maximum(response.max(axis=1, initial=0.0), 0.0)
        bounded = np.flatnonzero(np.isfinite(high))
        A = sp.vstack([-T, T[bounded]], format="csc") if len(bounded) else -T
        below = LinearRows(A, np.concatenate([-low, high[bounded]]))
        equal = LinearRows(self.balance, np.zeros(self.balance.shape[0]))
        return PrestressProgram(self.tangent, self.basis, T, equal, below, self.scale)

    def explain(self, status: str) -> str:
        """Explain why a program has no solution.

        `status` is that of the solver.
        """
        if status == "unbounded":
            return "the least stiffness grows with the prestress without limit: give a maximum"
        if status == "infeasible" and not len(self_stress(self.tangent.structure)):
            return "the structure has no self-stress: add members or change the nodes"
        if status == "infeasible":
            return "no self-stress keeps all strings within the limits: lower the minimum, raise the maximum, or change the nodes"
        cure = "scale the limits to the stiffness of the structure"
        if np.isinf(self.most).any():
            cure = f"give a maximum, or {cure}"
        return f"the solver did not converge: {cure}"

    def fail(self, message: str) -> PrestressDesign:
        """Build an unsuccessful result without prestress, with a message."""
        structure = self.tangent.structure
        strings, bars = np.zeros(len(structure.strings)), np.zeros(len(structure.bars))
        return PrestressDesign(strings, bars, strings, structure, False, message, np.zeros(0))

    def report(self, q: Array, gap: float = 0.0) -> PrestressDesign:
        """Build the result for force densities q (α + β,).

        `gap` is the relative distance from the optimum.
        """
        structure, strings = self.tangent.structure, len(self.least)
        members = strings + len(structure.bars)
        forces = (q * self.tangent.lengths)[:members]
        if (
            np.abs(forces[:strings]).max(initial=0.0)
            <= TOLERANCE * self.scale * self.tangent.lengths.mean()
        ):
            if not len(self_stress(structure)):
                return self.fail(
                    "the structure has no self-stress: add members or change the nodes"
                )
            q, forces = np.zeros_like(q), np.zeros_like(q)
        message = "within all limits"
        if gap > TOLERANCE:
            message += f", the least stiffness is within {gap:.1g} of the largest, relative to it"
        found = PrestressDesign(
            forces[:strings], forces[strings:], q[:strings], structure, True, message, q
        )
        if self.tangent.has_stiff_motions(q):
            return found
        reason = (
            f"unstable within the limits, the least stiffness is {found.least_stiffness:.3g} N/m"
        )
        if is_separate(structure):
            reason = "no member connects one part of the structure with the others"
        return replace(found, success=False, message=f"{reason}: add members or supports")


def read_load_cases(load_cases: Any, structure: Structure) -> Array:
    """Read load cases as an array (cases, n, 3) [N].

    `load_cases` is a list of arrays, or of mappings from nodes to forces. Raises TypeError,
    ValueError.
    """
    entries = as_tuple("load_cases", load_cases, "[loads], with loads of shape (n, 3)")
    cases = [read_loads(f"load_cases[{k}]", case, structure) for k, case in enumerate(entries)]
    return np.array(cases).reshape(len(cases), *structure.nodes.shape)


def _read_maximum(maximum: ArrayLike, least: Array) -> Array:
    """Read the upper limits of tensions (α,) [N].

    They are at least the lower limits `least` (α,) [N]. Raises TypeError, ValueError.
    """
    most = nonnegative("maximum", per_item("maximum", maximum, len(least)), "string")
    for i in np.flatnonzero(most < least):
        raise ValueError(
            f"maximum of string {i} is {most[i]:g} N: it must be at least its minimum, {least[i]:g} N"
        )
    return most

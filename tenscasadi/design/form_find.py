"""Form finding with prescribed properties.

It finds nodes and force densities in equilibrium.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.design.force_densities import (
    ForceDensities,
    Groups,
    read_force_densities,
    set_prestress,
)
from tenscasadi.design.force_density_method import (
    adapt_force_densities,
    estimate_force_densities,
    solve_form,
)
from tenscasadi.design.form_program import FEASIBLE, FormProgram, Goals
from tenscasadi.structure.cables import reject_cable_friction
from tenscasadi.structure.class_one import member_vectors
from tenscasadi.structure.equilibrium_matrix import balance_columns, free_directions, member_pairs
from tenscasadi.structure.names import add_names, name_errors
from tenscasadi.structure.properties import NodalLoads, read_loads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.linear_algebra import fit_rotation
from tenscasadi.util.validate import (
    ROUNDING,
    TOLERANCE,
    Array,
    IndexOrName,
    as_tuple,
    coordinates,
    format_value,
    instance,
    number,
    positive_number,
)


@dataclass(frozen=True, eq=False)
class Form(ReadOnlyArrays):
    """Form of a structure in equilibrium, with its forces.

    Attributes
    ----------
    structure : Structure
        The structure at the computed nodes. The force densities prestress its strings. A string
        whose stiffness does not exceed its force density is left unstressed.
    force_density : ndarray (α,)
        Force densities of strings [N/m].
    bar_force : ndarray (β,)
        Forces of bars [N], positive in tension.
    success : bool
        Whether the form is in equilibrium, with all strings in tension, and satisfies the goals.
    message : str
        The residual; the reason of a failure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> form = tc.form_find(tc.shapes.hyperbolic_paraboloid(cells=4), force_density=2.0)
    >>> form.success, form.force_density.max().item(), len(form.bar_force)
    (True, 2.0, 0)
    """

    structure: Structure
    force_density: Array
    bar_force: Array
    success: bool
    message: str

    def __repr__(self) -> str:
        return f"Form({self.message})"


@name_errors
def form_find(
    structure: Structure,
    force_density: ArrayLike | None = None,
    lengths: Mapping[IndexOrName, float] | None = None,
    positions: Mapping[IndexOrName, Sequence[float | None]] | None = None,
    groups: Groups | None = None,
    equal_tension: Iterable[Sequence[int | str]] | None = None,
    loads: NodalLoads | None = None,
) -> Form:
    """Find nodes and force densities in equilibrium.

    Pinned nodes keep their positions. Nets with given force densities need one linear solution. A
    free-standing structure has a family of forms for given force densities. The form that best
    keeps the lengths of bars is chosen, then the nearest to the initial nodes. Unknown force
    densities of a net are made as equal as the goals allow. Rigid bodies move as a whole.

    Parameters
    ----------
    structure : Structure
        Members, supports, and initial nodes.
    force_density : array_like, shape (α,), optional
        Force densities of strings [N/m], NaN where unknown; None: all are unknown. Those of bars
        are always unknown. If none is given and there are no loads, the mean is 1 N/m.
    lengths : mapping of int or str to float, optional
        Prescribed lengths of strings, ``{string: m}``.
    positions : mapping of int or str to sequence, optional
        Prescribed positions of nodes, ``{node: (x, y, None)}`` [m], None for a free coordinate.
        These nodes are in equilibrium without a support.
    groups : sequence of sequence of int or str, optional
        Groups of members that share their force density: strings first, then bars.
    equal_tension : sequence of sequence of int or str, optional
        Groups of strings whose tensions are equal. Each cable is one.
    loads : array_like, shape (n, 3), or mapping of int or str to array_like, optional
        Forces on the nodes [N]; by default none.

    Returns
    -------
    Form
        Structure, force densities and bar forces, with the reason if there is no form.

    Raises
    ------
    TypeError, ValueError
        An argument does not fit the structure, or contradicts another one.

    Notes
    -----
    The linear solution is Schek's force-density method [1]_. For free-standing structures, the
    adaptive force-density method [2]_ makes the force-density matrix singular, here by Newton's
    method. Unknown force densities and prescribed properties lead to a nonlinear program. IPOPT
    solves it with these results as initial guesses.

    References
    ----------
    .. [1] H.-J. Schek, The force density method for form finding and computation of general
       networks, Computer Methods in Applied Mechanics and Engineering 3 (1974), 115-134.
    .. [2] J. Y. Zhang and M. Ohsaki, Adaptive force density method for form-finding problem of
       tensegrity structures, International Journal of Solids and Structures 43 (2006), 5658-5673.

    Examples
    --------
    The force densities of a prism determine its twist and the forces of its bars:

    >>> import tenscasadi as tc
    >>> start = tc.shapes.prism(twist=2.3)
    >>> form = tc.form_find(start, force_density=[1.0] * 6 + [3.0**0.5] * 3)
    >>> form.success, (form.bar_force / start.bar_lengths).round(6).tolist()
    (True, [-1.732051, -1.732051, -1.732051])
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    reject_cable_friction(structure, "form_find")
    if not len(structure.strings):
        raise ValueError("structure has no strings: add some, or keep its nodes")
    densities = read_force_densities(structure, force_density, groups)
    goals = _read_goals(structure, lengths, positions, equal_tension, loads)
    scale = 0.0 if goals.loads.any() else densities.scale
    forms = (
        _assess(structure, nodes, q, scale, goals.loads, misses)
        for nodes, q, misses in _find_forms(structure, densities, goals)
    )
    first = next(forms)
    return first if first.success else next((form for form in forms if form.success), first)


def _find_forms(
    structure: Structure, densities: ForceDensities, goals: Goals
) -> Iterator[tuple[Array, Array, dict[str, float]]]:
    """Compute equilibrium forms from several initial guesses.

    Yields nodes (n, 3), force densities (α + β,), and the residuals of goals by name.
    """
    prescribed = bool(goals.lengths or goals.positions or goals.equal_tension)
    if not len(densities.lower) and not prescribed and not structure.bodies:
        nodes = solve_form(structure, densities.given, goals.loads)
        if nodes is not None:
            yield nodes, densities.given, {}
            return
    program = FormProgram(structure, densities, goals)
    p = estimate_force_densities(structure, densities)
    starts = [] if structure.bodies else _estimate_forms(structure, densities, goals, p)
    for nodes, start in [*starts, (structure.nodes, p)]:
        x, missed = program.solve(program.unknowns(nodes, start))
        misses = dict(zip(program.names, np.abs(missed).tolist(), strict=True))
        yield program.nodes(x), program.force_densities(x), misses


def _estimate_forms(
    structure: Structure, densities: ForceDensities, goals: Goals, p: Array
) -> list[tuple[Array, Array]]:
    """Estimate equilibrium forms by linear algebra.

    They have nodes (n, 3) and unknown force densities (u,). `p` (u,) is an estimate of these.
    """
    if goals.hold(structure):
        nodes = None if len(structure.bars) else solve_form(structure, densities.of(p), goals.loads)
        return [] if nodes is None else [(nodes, p)]
    adapted = (adapt_force_densities(structure, densities, p, near) for near in (True, False))
    return [found for found in adapted if found is not None]


def _read_goals(
    structure: Structure, lengths: Any, positions: Any, equal_tension: Any, loads: Any
) -> Goals:
    """Read prescribed properties of a form, arguments of `form_find`.

    Raises TypeError, ValueError.
    """
    count, names = len(structure.nodes), structure.names
    for field, value in (("lengths", lengths), ("positions", positions)):
        if value is not None and not isinstance(value, Mapping):
            raise TypeError(f"{field} is {format_value(value)}: give a mapping, such as {{3: ...}}")
    found_lengths = {
        names.index("lengths", "string", string): positive_number(
            f"lengths of string {string}", length
        )
        for string, length in names.resolve_keys("lengths", "string", lengths or {}).items()
    }
    found_positions: dict[int, tuple[float | None, ...]] = {}
    for key, place in names.resolve_keys("positions", "node", positions or {}).items():
        node = names.index("positions", "node", key)
        found = coordinates(f"positions of node {node}", place, "a free coordinate", read=number)
        for axis in range(3):
            if found[axis] is not None and structure.held[node, axis]:
                raise ValueError(
                    f"positions of node {node} prescribes {'xyz'[axis]}, which a support fixes: leave one out"
                )
        found_positions[node] = found
    tensions = [] if equal_tension is None else as_tuple("equal_tension", equal_tension, "[[0, 1]]")
    cables = [list(cable) for cable in structure.cables if len(cable) > 1]
    groups = cables + [
        np.flatnonzero(names.mask(f"equal_tension[{k}]", "string", group)).tolist()
        for k, group in enumerate(tensions)
    ]
    forces = np.zeros((count, 3)) if loads is None else read_loads("loads", loads, structure)
    return Goals(
        found_lengths, found_positions, tuple(tuple(group) for group in groups if group), forces
    )


def _assess(
    structure: Structure,
    nodes: Array,
    q: Array,
    scale: float,
    loads: Array,
    misses: Mapping[str, float],
) -> Form:
    """Assess a form by unbalanced forces, tensions and goals.

    The form has nodes (n, 3), force densities q (α + β,) and `loads` (n, 3) [N]. `misses` are the
    relative residuals of goals by name. Force densities within rounding of their typical size,
    `scale` [N/m], count as zero.
    """
    q = np.where(np.abs(q).max(initial=0.0) > ROUNDING * scale, q, 0.0)
    strings = len(structure.strings)
    pairs = member_pairs(structure)
    vectors = member_vectors(nodes, pairs)
    lengths = np.linalg.norm(vectors, axis=1)
    forces = q * lengths
    short = bool(np.any(lengths <= TOLERANCE * np.ptp(nodes)))
    own = [list(body.nodes) for body in structure.bodies]
    bent = any(not _is_same_body(structure.nodes[each], nodes[each]) for each in own)
    formed = structure if short or bent else structure.replace(nodes=nodes)
    residual = free_directions(formed).T @ (
        balance_columns(pairs, vectors, len(nodes)) @ q - loads.ravel()
    )
    unbalanced = float(np.abs(residual).max(initial=0.0))
    fault = _find_fault(structure, nodes, forces, unbalanced, misses)
    if bent:
        fault = "no form keeps the bodies rigid: leave goals or force densities free (NaN)"
    elif short and not fault:
        fault = (
            "a member of the form has no length: change its force density or prescribe its length"
        )
    if not (short or bent):
        formed = set_prestress(formed, q[:strings], -q[strings:])
    change = np.abs(lengths[strings:] / structure.bar_lengths - 1.0).max(initial=0.0)
    far = f", bars change their lengths by up to {change:.2g} times" if change > TOLERANCE else ""
    balanced = f"in equilibrium, unbalanced forces below {max(unbalanced, 1e-16):.1g} N"
    message = add_names(fault, structure) or balanced + far
    return Form(formed, q[:strings], forces[strings:], not fault, message)


def _is_same_body(before: Array, after: Array) -> bool:
    """Return whether a rigid motion maps nodes `before` to nodes `after`.

    Both are (k, 3).
    """
    start, end = before - before.mean(axis=0), after - after.mean(axis=0)
    moved = start @ fit_rotation(start, end).T
    return bool(np.abs(moved - end).max() <= TOLERANCE * np.abs(start).max())


def _find_fault(
    structure: Structure,
    nodes: Array,
    forces: Array,
    unbalanced: float,
    misses: Mapping[str, float],
) -> str:
    """Explain why a form with nodes (n, 3) is invalid; return "" if it is valid.

    `forces` (α + β,) are those of members [N], `unbalanced` is the largest unbalanced force [N],
    and `misses` are the relative residuals of goals by name.
    """
    strings = len(structure.strings)
    largest = float(np.abs(forces).max(initial=0.0))
    if largest == 0.0:
        return "no member carries a force: give force densities above 0, or leave them free (NaN)"
    pushing = np.flatnonzero(forces[:strings] < -FEASIBLE * largest)
    missed = max(misses.items(), key=lambda item: item[1], default=("", 0.0))
    if unbalanced > FEASIBLE * largest:
        return f"no form in equilibrium was found, {unbalanced:.3g} N are unbalanced: leave force densities free (NaN) or change the supports"
    if missed[1] > FEASIBLE:
        return f"the {missed[0]} cannot be as prescribed: leave it or force densities free"
    if not structure.held.any() and _dimension(nodes) < _dimension(structure.nodes):
        return f"forms of these force densities have {_dimension(nodes)} dimensions: leave some force densities free (NaN)"
    if len(pushing):
        return f"string {pushing[0]} would be in compression, {forces[pushing[0]]:.3g} N: give other force densities or make it a bar"
    return ""


def _dimension(nodes: Array) -> int:
    """Compute the dimension of the affine span of nodes.

    It is 0 to 3. The nodes are (n, 3).
    """
    sizes = np.linalg.svd(nodes - nodes.mean(axis=0), compute_uv=False)
    return int(np.sum(sizes > TOLERANCE * sizes.max(initial=1e-300)))

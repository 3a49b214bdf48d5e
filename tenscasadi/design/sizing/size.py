"""Sizing of members for minimum mass under load cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from tenscasadi.design.conic import LinearRows, solve_conic
from tenscasadi.design.find_prestress import read_load_cases
from tenscasadi.design.sizing.elastic_forces import (
    elastic_response,
    fit_prestress,
    superpose_prestress,
)
from tenscasadi.design.sizing.material import Material, Sections, build_sections
from tenscasadi.design.sizing.program import SizedForces, SizingProgram
from tenscasadi.design.sizing.search import Design, find_least_mass
from tenscasadi.design.sizing.sized import Sized, report_failure, report_sections
from tenscasadi.design.sizing.stable import StableSizing
from tenscasadi.design.tangent_stiffness import TangentStiffness
from tenscasadi.scene.loads import Gravity
from tenscasadi.structure.cables import reject_cable_friction
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.properties import NodalLoads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import (
    MAX_ITERATIONS,
    NEGLIGIBLE,
    TOLERANCE,
    Array,
    finite_array,
    flag,
    instance,
    nonnegative,
    number,
    per_item,
)


@name_errors
def size(
    structure: Structure,
    load_cases: Sequence[NodalLoads] = (),
    string: Material | None = None,
    bar: Material | None = None,
    tube: float = 0.0,
    self_weight: Gravity | None = None,
    minimum_area: ArrayLike = 0.0,
    prestress: ArrayLike | None = None,
    stable: bool = False,
) -> Sized:
    """Find the sections with the smallest mass for all load cases.

    The allowable stress limits strings and bars. Bars are also limited by the Euler load of their
    own length, with hinged ends. Parallel bars do not brace each other. A cable has one section.

    Parameters
    ----------
    structure : Structure
        The structure, evaluated at its nodes.
    load_cases : sequence of array_like, shape (n, 3), or mapping
        Forces on the nodes, or on some by name or index [N]. Each case acts alone. Without one,
        the self-weight acts alone.
    string, bar : Material
        Materials of strings and of bars.
    tube : float
        Inner over outer radius of bars, at least 0 and below 1.
    self_weight : Gravity, optional
        Gravity that adds the weight of the members to each case, one half at each end. The weight
        of point masses and bodies is not added: it belongs to the load cases.
    minimum_area : array_like, shape (α + β,)
        Least areas [m²], or one number for all.
    prestress : array_like, shape (α + β,), optional
        Forces without loads [N], positive in tension. None: they are optimized. ``()``: no
        prestress.
    stable : bool
        Whether a global buckling factor of at least 1 is imposed in each case.

    Returns
    -------
    Sized
        Areas, forces, and a structure to simulate, with the reason if no sections carry the loads.

    Raises
    ------
    TypeError, ValueError
        An argument does not fit the structure, or a given prestress is not in equilibrium.

    Notes
    -----
    By the lower-bound theorem of plasticity, areas carry the loads if any forces within the limits
    are in equilibrium with them. If yield governs, the least mass is the solution of a linear
    program. Euler's load makes it nonconvex: branch and bound over linear programs finds the least
    mass within 1e-6, or the message gives a lower bound. The reported forces are the elastic ones with the reported
    prestress, if these are also within the limits. This is always possible for a single load case
    that compresses no string. A given prestress is superposed with the elastic response to the
    loads.

    Examples
    --------
    A bar of 2 m in compression is lighter alone than braced by a D-bar at 45°:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> aluminum = tc.Material(modulus=60e9, density=2700.0, strength=110e6)
    >>> load = np.zeros((4, 3))
    >>> load[[0, 2], 0] = 1e4, -1e4
    >>> sized = tc.size(tc.shapes.d_bar(2**0.5), [load], aluminum, aluminum)
    >>> round(sized.mass, 4), sized.governs[1:3]
    (8.858, ('yield', 'buckling'))
    """
    instance("structure", structure, Structure, "a tenscasadi.Structure")
    reject_cable_friction(structure, "size")
    sections = _read_sections(structure, string, bar, tube, minimum_area)
    flag("stable", stable)
    cases = read_load_cases(load_cases, structure)
    if self_weight is not None:
        instance("self_weight", self_weight, Gravity, "a tenscasadi.Gravity, or None")
    gravity = None if self_weight is None else np.array(self_weight.at(0.0)).ravel()
    if gravity is not None and not len(cases):  # the self-weight alone
        cases = np.zeros((1, *structure.nodes.shape))
    program = SizingProgram(structure, sections, cases, gravity)
    given = _read_prestress(structure, program, prestress)
    design = find_least_mass(program)
    if not np.isfinite(design.best.mass):
        return report_failure(structure, cases, _explain(program))
    if not stable:
        if given is not None and given.any():
            return _superpose(structure, program, cases, given)
        message = _describe(design) if len(cases) else "no loads"
        chosen = _choose_forces(program, design.best, given)
        return report_sections(structure, program, cases, chosen, message)
    return _stabilize(structure, program, cases, given, design)


def _stabilize(
    structure: Structure,
    program: SizingProgram,
    cases: Array,
    given: Array | None,
    design: Design,
) -> Sized:
    """Size members such that the structure is stable in all load cases.

    `cases` (cases, n, 3) are the loads [N]. `given` is a prescribed prestress (α + β,) [N], or
    None. The search begins with a `design` that may be unstable. The imposed buckling factor is
    increased until that of the result is 1. Both differ by the displacements due to self-weight and
    the accuracy of the solver.
    """
    sections = program.sections
    elastic = structure.replace(bar_stiffness=1.0)  # any: areas give the stiffness
    search = StableSizing(program, TangentStiffness(elastic), given)
    start, lightest = sections.needed(design.best.force), 0.0
    for _ in range(MAX_ITERATIONS):
        found = search.search(start)
        if found.message:
            return report_failure(structure, cases, found.message)
        more = _gap(float(found.area @ sections.mass_per_area), design.bound)
        message = f"stable, {more:.1e} above the least mass without that"
        sized = report_sections(structure, program, cases, found[:3], message)
        least = float(sized.buckling.min(initial=np.inf))
        if least >= 1.0 - TOLERANCE:
            return sized
        if least == 0.0 or sized.mass <= lightest:  # more sections do not help
            break
        search.factor, start, lightest = search.factor / least, found.area, sized.mass
    reason = f"a load case buckles at {least:.6g} times its load: give a minimum area"
    return replace(sized, success=False, message=reason)


def _describe(design: Design) -> str:
    """Describe how far a design may be from the smallest mass."""
    gap = f"within {_gap(design.best.mass, design.bound):.1e} of the least mass"
    bound = f"the lightest design that was found, the lower bound is {design.bound:.6g} kg"
    return gap if design.is_global else bound


def _gap(mass: float, bound: float) -> float:
    """Compute the relative gap between mass and lower bound.

    It is at least 0.
    """
    return max(mass / bound - 1.0, 0.0) if bound > 0.0 else 0.0


def _read_sections(
    structure: Structure,
    string: Material | None,
    bar: Material | None,
    tube: float,
    minimum_area: ArrayLike,
) -> Sections:
    """Read materials and shapes of sections, arguments of `size`.

    Raises TypeError, ValueError.
    """
    for name, given, members in (
        ("string", string, structure.strings),
        ("bar", bar, structure.bars),
    ):
        if given is not None or len(members):
            example = "a tenscasadi.Material, such as Material(200e9, 7850.0, 235e6)"
            instance(name, given, Material, example)
    ratio = number("tube", tube)
    if not 0.0 <= ratio < 1.0:
        raise ValueError(
            f"tube is {ratio:g}: it must be at least 0 and below 1, inner over outer radius"
        )
    count = len(structure.strings) + len(structure.bars)
    minimum = nonnegative("minimum_area", per_item("minimum_area", minimum_area, count), "member")
    return build_sections(structure, string, bar, ratio, minimum)


def _read_prestress(
    structure: Structure, program: SizingProgram, prestress: ArrayLike | None
) -> Array | None:
    """Read the prestress of the members of a program [N].

    It is zero for (), and None if it is to be optimized. Raises TypeError, ValueError.
    """
    if prestress is None:
        return None
    if np.size(prestress) == 0:
        return np.zeros(program.members)
    unit = program.sections.unit
    given = finite_array("prestress", prestress, (len(unit),))
    forces = given[np.unique(unit, return_index=True)[1]]
    largest = float(np.abs(given).max(initial=0.0))
    for cable in structure.cables:
        if np.ptp(given[list(cable)]) > NEGLIGIBLE * largest:
            raise ValueError(
                f"prestress of strings {list(cable)} is {given[list(cable)].round(3).tolist()} N: give one value, as they are one cable"
            )
    left = float(np.abs(program.balance @ forces).max(initial=0.0))
    if left > NEGLIGIBLE * largest:
        raise ValueError(
            f"prestress leaves {left:.3g} N unbalanced: give forces in equilibrium, such as those of find_prestress"
        )
    nonnegative("prestress", forces[: program.strings], "string")
    return forces


def _superpose(structure: Structure, program: SizingProgram, cases: Array, given: Array) -> Sized:
    """Size members for a given prestress and elastic response.

    `cases` (cases, n, 3) are the loads [N], and `given` (α + β,) is the prestress [N].
    """
    sections = program.sections
    area, forces = superpose_prestress(program, given, sections.needed(given[None]))
    needed = sections.needed(np.vstack([forces, given]))
    if not np.all(needed <= area + TOLERANCE * area.max(initial=0.0)):
        reason = "areas and response to the loads do not settle: give a minimum area"
        return report_failure(structure, cases, reason)
    message = "each member is as thin as the given prestress allows"
    return report_sections(structure, program, cases, (area, forces, given), message)


def _choose_forces(
    program: SizingProgram, best: SizedForces, given: Array | None
) -> tuple[Array, Array, Array]:
    """Select the areas, load-case forces and prestress to report.

    They are those of the `best` design. `given` is a prescribed prestress (α + β,) [N], or None.
    Elastic forces are preferred if they are within the limits.
    """
    sections = program.sections
    area = sections.needed(best.force)
    none = np.zeros(program.members)
    if not len(program.loads):
        return area, best.force, none
    response = elastic_response(program, area)
    own = none if given is not None else fit_prestress(program, area, best.force - response)
    elastic = own + response
    largest = float(np.abs(elastic).max(initial=0.0))
    taut = elastic[:, : program.strings].min(initial=0.0) >= -TOLERANCE * largest
    needed = sections.needed(np.vstack([elastic, own]))
    if taut and np.all(needed <= area + TOLERANCE * area.max()):
        same = np.abs(elastic - best.force) <= TOLERANCE * largest
        return area, np.where(same, best.force, elastic), own
    return area, best.force, none


def _explain(program: SizingProgram) -> str:
    """Explain why no sections can carry a program's loads."""
    for case in np.flatnonzero(program.loads.any(axis=1)):
        load = program.loads[case]
        left = unbalanced_load(program, load)
        if left > TOLERANCE * float(np.abs(load).max()):
            return f"no forces with strings in tension balance load case {case}, {left:.3g} N stay unbalanced: change supports, members or the load"
    if program.weight.nnz:
        return "no sections carry their own weight: use a stronger material or shorter members"
    return "the linear program was not solved: scale loads and materials to SI units"


def unbalanced_load(program: SizingProgram, load: Array) -> float:
    """Compute the smallest possible unbalanced force under a load [N].

    Member forces of the program balance the load (free,) as far as possible, with strings in
    tension.
    """
    scale = float(np.abs(load).max(initial=0.0)) or 1.0
    B = program.balance
    count, members = B.shape
    unknown = members + count
    equal = LinearRows(sp.hstack([B, sp.eye_array(count)], format="csc"), load / scale)
    eye = sp.eye_array(unknown, format="csr")
    below = LinearRows(sp.csc_array(-eye[: program.strings]), np.zeros(program.strings))
    weights = np.repeat([1e-9, 1.0], [members, count])
    left = np.zeros(count)
    for _ in range(2):  # the second solution removes the effect of the weights, as a multiplier
        shifted = equal._replace(b=equal.b + left)
        found = solve_conic(
            np.zeros(unknown), shifted, below, sp.diags_array(weights, format="csc")
        )
        before, left = left, found.x[members:]
    return float(np.abs(left - before).max(initial=0.0)) * scale

"""Equilibrium paths under growing loads, with critical points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tenscasadi.dynamics.model import Model
from tenscasadi.scene.failed_strings import describe_overload
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.statics.equilibrium import (
    describe_rest,
    newton_system,
    read_load,
    read_problem,
)
from tenscasadi.statics.sliding_path import SlidingRow, follow_sliding
from tenscasadi.statics.solver.continuation import LoadChange, PathRow, Tracer
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.settling import prepare_friction, settle
from tenscasadi.statics.solver.static_equations import Conditions
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.properties import NodalLoads
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import (
    MAX_REPETITIONS,
    Array,
    FilePath,
    Indices,
    finite_array,
    format_value,
    instance,
    nesting,
    nonnegative,
)


@dataclass(frozen=True, eq=False)
class LoadPath(ReadOnlyArrays):
    """Equilibria under loads, control or parameters that grow by a factor.

    Each row is exact to rounding.

    Attributes
    ----------
    factor : ndarray, shape (T,)
        Factor of the load.
    nodes : ndarray, shape (T, n, 3)
        Positions [m].
    tension : ndarray, shape (T, α)
        Tensions of the strings [N].
    bar_force : ndarray, shape (T, β)
        Forces of the bars [N], positive in tension.
    stable : ndarray of bool, shape (T,)
        Whether an equilibrium is a minimum of the energy.
    limit_points : ndarray of int, shape (m,)
        Rows with a local extremum of the factor.
    bifurcations : ndarray of int, shape (m,)
        Rows at intersections with other paths.
    success : bool
        Whether the path reaches an end of the range of factors.
    message : str
        Result in one sentence; the reason of an early end.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> truss = tc.Structure([(-1, 0, 0), (0, 0.5, 0), (1, 0, 0)], bars=[(0, 1), (1, 2)], bar_stiffness=1000.0, pinned={0: "xyz", 1: "z", 2: "xyz"})
    >>> path = tc.load_path(tc.Scene(truss), load=[(0, 0, 0), (0, -1, 0), (0, 0, 0)], factors=(-100, 100))
    >>> path.factor[path.limit_points].round(6).tolist()
    [42.914326, -42.914326]
    """

    factor: Array
    nodes: Array
    tension: Array
    bar_force: Array
    stable: Any
    limit_points: Indices
    bifurcations: Indices
    success: bool
    message: str

    def plot(self, path: FilePath | None = None, title: str = "") -> Any:
        """Plot the load factor against the largest displacement.

        Parameters
        ----------
        path : path-like, optional
            File to save the diagram to, whose suffix selects the format.
        title : str
            Title of the diagram.

        Returns
        -------
        matplotlib.figure.Figure
            The diagram.
        """
        from tenscasadi.plots import load_paths  # loads matplotlib

        return load_paths.load_path(self, title=title, path=path)

    def __repr__(self) -> str:
        return f"LoadPath({len(self.factor)} rows: {self.message})"


@name_errors
def load_path(
    scene: Scene | Model,
    load: NodalLoads | NodalForce | None = None,
    control: ArrayLike | None = None,
    parameters: Any = None,
    factors: tuple[float, float] = (0.0, 2.0),
    start: Any = None,
) -> LoadPath:
    """Trace equilibria while loads, control or parameters change.

    The changes given here are multiplied by a factor. They are added to the loads, control and
    nominal parameters of the scene. The path begins at factor 0, or the nearest one in the range.
    Arc-length continuation follows it through snap-through and slack strings until the factor
    leaves the range.

    Parameters
    ----------
    scene : Scene or Model
        The scene.
    load : array_like, shape (n, 3), mapping of int or str to array_like, or NodalForce, optional
        Forces on the nodes [N].
    control : array_like, shape (nu,), optional
        Change of the control, such as that of rest lengths [m].
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Change of parameters.
    factors : tuple of float
        Least and largest factor.
    start : array_like, shape (n, 3) or (nx,), or Equilibrium, optional
        Start of the search for the first equilibrium, see `find_equilibrium`. An equilibrium
        also provides control and parameters at factor 0.

    Returns
    -------
    LoadPath
        Equilibria, in order. `success` is False and `message` gives the reason if the path ends
        early or there is no first equilibrium.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong, or a parameter or rest length becomes invalid in the range.

    See Also
    --------
    find_equilibrium : One equilibrium.
    buckling_factor : Linear estimate of the first critical factor.

    Notes
    -----
    Each row is an equilibrium to rounding. Limit points and bifurcations are rows of their own. At
    bifurcations the path continues on the primary branch.

    Cables with friction slip from row to row, no further than needed: their tensions differ by at
    most the factor exp(μ θ), with the angle θ in the row. Such a path follows a growing `load`, and
    ends where the structure would snap through. Stability is that of cables that stick.

    Examples
    --------
    Shortening the strings of a prism stiffens it:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(prestress=10.0)
    >>> scene = tc.Scene(prism, control=tc.RestLength())
    >>> path = tc.load_path(scene, control=-0.1 * prism.rest_length, factors=(0, 1))
    >>> path.success, bool(np.all(np.diff(path.tension[:, 0]) > 0))
    (True, True)
    """
    instance("scene", scene, (Scene, Model), "a tenscasadi.Scene or Model")
    bare = scene if isinstance(scene, Scene) else scene.scene
    low, high = _read_factors(factors)
    if load is None and control is None and parameters is None:
        raise ValueError("load, control and parameters are None: give one that changes")
    if bare.structure.cable_friction.any():
        for name, value in (("control", control), ("parameters", parameters)):
            if value is not None:
                raise ValueError(
                    f"{name} is {format_value(value)}: load paths of cables with friction take a load only; "
                    "give load, or Structure.replace(cable_friction=0.0)"
                )
        return _collect_sliding(bare, *follow_sliding(bare, load, (low, high), start))
    nodes, given = read_problem(scene, start, None, None)
    system = newton_system(bare)
    change = _read_change(system, given, load, control, parameters, (low, high))
    first = float(np.clip(0.0, low, high))
    rest = settle(system, nodes, change.at(first))
    if not rest.converged:
        eq = describe_rest(scene, system, rest, change.at(first))
        return _collect(bare, system, [], f"no equilibrium at factor {first:g}: {eq.message}")
    change = change._replace(given=prepare_friction(system, nodes, change.given))
    tracer = Tracer(system, change, (low, high))
    begin = tracer.start(rest.point, rest.tension, first)
    rows, fault = tracer.follow(begin, MAX_REPETITIONS)
    return _collect(bare, system, rows, fault)


def _read_factors(factors: Any) -> tuple[float, float]:
    low, high = finite_array("factors", factors, (2,)).tolist()
    if not low < high:
        raise ValueError(f"factors is ({low:g}, {high:g}): give the least, then the largest")
    return low, high


def _read_change(
    system: NewtonSystem,
    given: Conditions,
    load: Any,
    control: Any,
    parameters: Any,
    factors: tuple[float, float],
) -> LoadChange:
    """Read the changes of loads and inputs per unit factor.

    `load`, `control` and `parameters` are arguments of `load_path`. `given` are the inputs at
    factor 0, and `factors` the first and last factor. Raises TypeError, ValueError.
    """
    scene = system.equations.scene
    forces = read_load(system, load) if load is not None else np.zeros(given.anchor.shape)
    du = np.zeros(scene.nu) if control is None else finite_array("control", control, (scene.nu,))
    dp = _read_parameters(scene, parameters)
    change = LoadChange(
        given._replace(added=np.zeros_like(given.anchor)), np.append(du, dp), forces
    )
    for factor in factors:
        u, p = np.split(change.at(factor).inputs, [scene.nu])
        try:
            scene.layout.check(p)
            if scene.nu:
                nonnegative("control", u, "string", strict=isinstance(scene.control, RestLength))
        except ValueError as error:
            raise ValueError(f"{error} at factor {factor:g}: give a smaller range") from None
    return change


def _read_parameters(scene: Scene, given: Any) -> Array:
    """Read changes of parameters (np,).

    `given` is an array, or a mapping of names to values. Raises TypeError, ValueError.
    """
    layout = scene.layout
    if given is None or not isinstance(given, Mapping):
        none = np.zeros(len(layout))
        return none if given is None else finite_array("parameters", given, (len(layout),))
    changes = np.zeros(len(layout))
    for name, value in given.items():
        if name not in layout.places:
            known = ", ".join(layout.places) or "none, as the scene has no Parameters"
            raise ValueError(f"parameters has {format_value(name)}: the parameters are {known}")
        place = layout.places[name]
        shape = (place.stop - place.start,) if nesting(value) else ()
        changes[place] = finite_array(f"parameters[{name!r}]", value, shape)
    return changes


def _collect(scene: Scene, system: NewtonSystem, rows: list[PathRow], fault: str) -> LoadPath:
    """Compute forces and stability at all points of a path.

    `rows` are its equilibria, and `fault` is the reason for an early end, or "".
    """
    equations = system.equations
    strings, bars = len(equations.structure.strings), len(equations.structure.bars)
    count = len(rows)
    tension, force = np.zeros((count, strings)), np.zeros((count, bars))
    for k, row in enumerate(rows):
        point = row.place.point
        pulls = point.gamma * np.linalg.norm(point.springs, axis=1)
        tension[k], force[k, equations.elastic] = pulls[:strings], pulls[strings:]
        force[k, equations.rigid] = row.place.tension[: len(equations.rigid)]
    nodes = [row.place.point.nodes for row in rows]
    kinds = np.array([row.kind for row in rows], dtype="U11")
    factor = np.array([row.place.factor for row in rows])
    return LoadPath(
        factor=factor,
        nodes=np.array(nodes).reshape(count, len(equations.structure.nodes), 3),
        tension=tension,
        bar_force=force,
        stable=np.array([row.place.unstable == 0 for row in rows], dtype=bool),
        limit_points=np.flatnonzero(kinds == "limit"),
        bifurcations=np.flatnonzero(kinds == "bifurcation"),
        success=not fault,
        message=_describe(scene, factor, tension, fault),
    )


def _collect_sliding(scene: Scene, rows: list[SlidingRow], fault: str) -> LoadPath:
    """Collect the equilibria of a path with cable friction.

    `rows` are these equilibria, and `fault` is the reason for an early end, or "".
    """
    s, found = scene.modelled, [row.equilibrium for row in rows]
    factor = np.array([row.factor for row in rows])
    tension = np.array([eq.tension for eq in found]).reshape(len(rows), len(s.strings))
    none = np.zeros(0, dtype=np.intp)
    return LoadPath(
        factor=factor,
        nodes=np.array([eq.nodes for eq in found]).reshape(len(rows), len(s.nodes), 3),
        tension=tension,
        bar_force=np.array([eq.bar_force for eq in found]).reshape(len(rows), len(s.bars)),
        stable=np.array([eq.stable for eq in found], dtype=bool),
        limit_points=none,
        bifurcations=none,
        success=not fault,
        message=_describe(scene, factor, tension, fault),
    )


def _describe(scene: Scene, factor: Array, tension: Array, fault: str) -> str:
    """Describe a path, its first string overload, and an early end.

    `factor` (k,) and `tension` (k, α) [N] are those of its rows, and `fault` is the reason for the
    early end, or "".
    """
    if not len(factor):
        return fault
    end = f"from factor {factor[0]:g} to {factor[-1]:g} in {len(factor)} rows"
    overloads = [describe_overload(scene, row) for row in tension]
    for k in [k for k, overload in enumerate(overloads) if overload][:1]:
        end += f"; at factor {factor[k]:.4g} {overloads[k]}"
    return f"{end}: {fault}" if fault else end

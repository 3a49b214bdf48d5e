"""Equilibrium of a scene under all its static loads."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.dynamics.operating_point import OperatingPoint
from tenscasadi.scene.binding import fix, initial_control
from tenscasadi.scene.failed_strings import describe_overload, require_intact
from tenscasadi.scene.loads import NodalForce
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import RestLength
from tenscasadi.schema.definitions import resolve_names
from tenscasadi.statics.self_stress import rigid_body_motions
from tenscasadi.statics.solver.newton_system import NewtonSystem
from tenscasadi.statics.solver.relaxation import relax
from tenscasadi.statics.solver.settling import settle
from tenscasadi.statics.solver.static_equations import Conditions, StaticEquations
from tenscasadi.statics.solver.trust_region import MOVES_AWAY, SINGULAR, SearchResult
from tenscasadi.statics.stuck_cables import (
    find_sliding,
    fix_rest_lengths,
    read_sliding,
    replace_cables,
)
from tenscasadi.structure.class_one import measure_extent
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.properties import read_loads
from tenscasadi.structure.structure import Structure
from tenscasadi.util.immutable import ReadOnlyArrays, keep
from tenscasadi.util.validate import NEGLIGIBLE, Array, finite_array, instance, nesting


@dataclass(frozen=True, eq=False)
class Equilibrium(OperatingPoint, ReadOnlyArrays):
    """Equilibrium of a scene, with its forces and stability.

    Nodes and strings are those of the model. They include the inner nodes and the segments of
    subdivided strings.

    Attributes
    ----------
    success : bool
        Whether the forces balance at a minimum of the energy.
    message : str
        Result in one sentence; the reason of a failure.
    residual : float
        Largest unbalanced force on a node [N].
    nodes : ndarray, shape (n, 3)
        Positions [m].
    force_density : ndarray, shape (α,)
        Force densities γ of the strings [N/m].
    tension : ndarray, shape (α,)
        Tensions of the strings [N].
    bar_force : ndarray, shape (β,)
        Forces of the bars [N], positive in tension.
    reactions : ndarray, shape (n, 3)
        Forces of pins, rollers and grounds on the nodes [N].
    stable : bool
        Whether every motion that bars and supports allow has a positive stiffness. Rigid-body
        motions without stiffness are left out.
    control : ndarray, shape (nu,)
        Control.
    parameters : ndarray, shape (np,)
        Parameters.
    time : float
        Time of the loads and support positions [s].
    iterations : int
        Number of steps of the search.
    source : Scene or Model
        The scene in equilibrium, or its model.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> rope = tc.Structure([(0, 0, 0), (0, 0, -1)], strings=[(0, 1)], pinned=[0], node_mass=[0.0, 2.0])
    >>> eq = tc.find_equilibrium(tc.Scene(rope, gravity=tc.Gravity((0, 0, -10))))
    >>> eq.nodes[1].round(6).tolist(), eq.tension.round(6).tolist()
    ([0.0, 0.0, -1.2], [20.0])
    >>> eq.reactions[0].round(6).tolist()
    [0.0, 0.0, 20.0]
    """

    success: bool
    message: str
    residual: float
    nodes: Array
    force_density: Array
    tension: Array
    bar_force: Array
    reactions: Array
    stable: bool
    control: Array
    parameters: Array
    time: float
    iterations: int
    source: Any

    @property
    def scene(self) -> Scene:
        """Scene that is in equilibrium."""
        return self.source if isinstance(self.source, Scene) else self.source.scene

    @property
    def model(self) -> Model:
        """Model of the scene."""
        return model_of(self.source)

    @cached_property
    def structure(self) -> Structure:
        """Structure with the nodes and rest lengths of the equilibrium."""
        scene = fix(self.scene.locked, self.parameters)
        modelled: Structure = scene.modelled
        changes: dict[str, Any] = {"nodes": self.nodes}
        if isinstance(scene.control, RestLength):
            changes["rest_length"] = self.control[scene.input_of] * scene.rest_shares
        return modelled.replace(**changes)

    @cached_property
    def state(self) -> Array:
        """State (nx,) of the model, at rest."""
        x = self.state_of(self.model)
        x.flags.writeable = False
        return x

    def __repr__(self) -> str:
        return f"Equilibrium({self.message})"


@name_errors
def find_equilibrium(
    scene: Scene | Model,
    start: Any = None,
    control: Any = None,
    parameters: Any = None,
) -> Equilibrium:
    """Find an equilibrium of a scene.

    It is a minimum of the energy under gravity, nodal forces, pressure and ground contact, with
    taut and slack strings, elastic and rigid bars, pins and rollers.

    Parameters
    ----------
    scene : Scene or Model
        The scene.
    start : array_like, shape (n, 3) or (nx,), or Equilibrium, optional
        Nodes [m] or state from which the search begins; by default the nodes of the scene. The
        clock of a state is the time of the loads and support positions, by default 0.
    control : array_like, shape (nu,), optional
        Control; by default the initial control of the scene. Winches are locked: under
        `RestLengthRate`, it contains rest lengths [m].
    parameters : array_like, shape (np,), or mapping, optional
        Values of the parameters, see `ParameterLayout.values`; nominal if None.

    Returns
    -------
    Equilibrium
        The equilibrium. If there is none near the start, `success` is False and `message` gives the
        reason.

    Raises
    ------
    TypeError, ValueError
        If an argument is wrong or the start displaces a pinned coordinate.

    See Also
    --------
    stability : Stiffness and stability of an equilibrium.
    load_path : Equilibria under growing loads.

    Notes
    -----
    The search is a trust-region Newton method with the exact tangent stiffness. It preserves the
    lengths of rigid bars and escapes from saddle points of the energy. If it fails, dynamic
    relaxation provides another start: a simulation that restarts at rest at each maximum of its
    kinetic energy.

    Friction opposes the slip since the start. It is at most μ times the normal force. A sticking
    contact slips by about a millionth of the structure's size.

    Cables with friction slip no further than needed from the rest lengths of their strings: T₁ ≤ T₂
    exp(μ θ) over each node, and equal where they slip. `scene` of the result has strings in place
    of cables, with the rest lengths after the slip.

    Examples
    --------
    A weight between two strings of 45°:

    >>> import numpy as np
    >>> import tenscasadi as tc
    >>> net = tc.Structure([(-1, 0, 1), (0, 0, 0), (1, 0, 1)], strings=[(0, 1), (1, 2)], pinned=[0, 2], node_mass=1.0, stiffness=1e6)
    >>> eq = tc.find_equilibrium(tc.Scene(net, gravity=tc.Gravity((0, 0, -10))))
    >>> eq.success, eq.tension.round(3).tolist()
    (True, [7.071, 7.071])
    """
    instance("scene", scene, (Scene, Model), "a tenscasadi.Scene or Model")
    bare = scene if isinstance(scene, Scene) else scene.scene
    if bare.structure.cable_friction.any():
        fixed = read_sliding(bare, control, parameters)
        stuck = replace_cables(fixed)
        found = find_sliding(fixed, lambda rho, begin: find_equilibrium(stuck, begin, rho), start)
        sliding: Equilibrium = fix_rest_lengths(fixed, found)
        return sliding
    nodes, given = read_problem(scene, start, control, parameters)
    system = newton_system(bare)
    rest = settle(system, nodes, given)
    if rest.stalled and not is_unheld(system, rest):
        rest = _retry(system, rest, nodes, given)
    return describe_rest(scene, system, rest, given)


def newton_system(scene: Scene) -> NewtonSystem:
    """Return the Newton linear systems of a scene, which caches them."""
    return keep(scene, "newton system", lambda: NewtonSystem(StaticEquations(scene.locked)))


def model_of(source: Scene | Model) -> Model:
    """Return the given model, or a scene's cached model."""
    if isinstance(source, Model):
        return source

    def build() -> Model:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # statics needs no multipliers
            return Model(source)

    return keep(source, "model", build)


def read_problem(
    source: Scene | Model, start: Any, control: Any, parameters: Any
) -> tuple[Array, Conditions]:
    """Read the initial nodes and the inputs of a static problem.

    Parameters
    ----------
    source : Scene or Model
        The scene, or its model.
    start, control, parameters : array_like, optional
        See `find_equilibrium`.

    Returns
    -------
    tuple
        Nodes (n, 3) with supports in place, and the conditions.

    Raises
    ------
    TypeError, ValueError
        If one of them is wrong.
    """
    scene = source if isinstance(source, Scene) else source.scene
    equations = newton_system(scene).equations
    structure, time = equations.structure, 0.0
    if isinstance(start, Equilibrium):
        control = start.control if control is None else control
        parameters = start.parameters if parameters is None else parameters
        start, time = start.nodes, start.time
    p = scene.layout.values(parameters)
    u = initial_control(scene.locked, p)
    if control is not None:
        u = finite_array("control", control, (scene.nu,))
    nodes = structure.nodes
    if start is not None and nesting(start) == 1:
        model = model_of(source)
        state = finite_array("start", start, (model.nx,))
        require_intact("start", model.scene, model.split(state).internal)
        nodes, clock = model.nodes(state), model.split(state).clock
        if control is None and scene.locked.control is not scene.control:
            u = np.asarray(model.split(state).internal[: scene.nu])
        time = float(clock[0]) if len(clock) else 0.0
    elif start is not None:
        nodes = finite_array("start", start, structure.nodes.shape)
        _check_supports(structure, nodes, [] if scene.supports is None else scene.supports.nodes)
    nodes = equations.place_supports(nodes, time)
    return nodes, Conditions(np.concatenate([u, p]), time, nodes)


def read_load(system: NewtonSystem, load: Any) -> Array:
    """Read a constant load as nodal forces (n, 3) [N].

    Nodes are those of the model, which `system` contains. Raises TypeError, ValueError.
    """
    modelled, own = system.equations.structure, system.equations.scene.structure
    if not isinstance(load, NodalForce):
        return read_loads("load", load, modelled)
    load = resolve_names(load, own.names)
    load.check(len(own.nodes))
    if load.varies:
        raise ValueError("load changes over time: give its values at one time")
    return np.pad(load.values, ((0, len(modelled.nodes) - len(own.nodes)), (0, 0)))


def describe_rest(
    source: Scene | Model, system: NewtonSystem, rest: SearchResult, given: Conditions
) -> Equilibrium:
    """Compute forces and stability at the nodes of an equilibrium.

    Parameters
    ----------
    source : Scene or Model
        The scene, or its model.
    system : NewtonSystem
        Newton systems of the scene.
    rest : SearchResult
        Result of the search.
    given : Conditions
        Inputs and time.

    Returns
    -------
    Equilibrium
        The equilibrium.
    """
    equations, point = system.equations, rest.point
    structure = equations.structure
    lengths = np.linalg.norm(point.springs, axis=1)
    strings = len(structure.strings)
    bar_force = np.zeros(len(structure.bars))
    bar_force[equations.rigid] = rest.tension[: len(equations.rigid)]
    bar_force[equations.elastic] = (point.gamma * lengths)[strings:]
    total = point.applied + equations.bar_forces(point, rest.tension)
    unbalanced = (equations.free @ rest.residual).reshape(total.shape)
    residual = float(np.linalg.norm(unbalanced, axis=1).max(initial=0.0))
    scene, tension = equations.scene, (point.gamma * lengths)[:strings]
    bare = source if isinstance(source, Scene) else source.scene
    overload = describe_overload(bare, tension)
    return Equilibrium(
        success=rest.converged,
        message=_message(system, rest, unbalanced, residual) + (overload and f"; {overload}"),
        residual=residual,
        nodes=point.nodes,
        force_density=point.gamma[:strings],
        tension=tension,
        bar_force=bar_force,
        reactions=equations.support_forces(total) + point.ground,
        stable=rest.stable,
        control=given.inputs[: scene.nu],
        parameters=given.inputs[scene.nu :],
        time=given.time,
        iterations=rest.iterations,
        source=source,
    )


def _retry(
    system: NewtonSystem, rest: SearchResult, nodes: Array, given: Conditions
) -> SearchResult:
    """Repeat the search for an equilibrium after dynamic relaxation.

    It starts at nodes (n, 3). `rest` is the result of the first search, which is kept if the second
    one does not converge. `given` are the inputs and the time.
    """
    scene = system.equations.scene
    u, p = np.split(given.inputs, [scene.nu])
    relaxed = relax(scene, nodes, u, p, given.time)
    again = settle(system, relaxed, given)
    return again if again.converged else rest


def is_unheld(system: NewtonSystem, rest: SearchResult) -> bool:
    """Return whether unbalanced forces mainly act on rigid-body motions.

    These are motions that no support prevents.

    Parameters
    ----------
    system : NewtonSystem
        Newton systems of the scene.
    rest : SearchResult
        Result of a search.

    Returns
    -------
    bool
        Whether the structure as a whole accelerates.
    """
    motions = rigid_body_motions(system.equations.structure, rest.point.nodes)
    net = motions.T @ (system.equations.free @ rest.residual)
    return float(np.linalg.norm(net)) > 0.5 * float(np.linalg.norm(rest.residual))


def _message(system: NewtonSystem, rest: SearchResult, unbalanced: Array, residual: float) -> str:
    if rest.converged:
        return f"in equilibrium after {rest.iterations} steps, unbalanced force {residual:.1e} N"
    cure = "give another start, or change supports, loads or rest lengths"
    if rest.reason == SINGULAR:
        cure = "give the bars a bar_stiffness, or displace the nodes"
    elif rest.reason == MOVES_AWAY or is_unheld(system, rest):
        total = unbalanced.sum(axis=0)
        total[np.abs(total) <= NEGLIGIBLE * np.abs(total).max()] = 0.0
        force = ", ".join(f"{value:.3g}" for value in total)
        cure = f"support the structure, or balance the net load of ({force}) N"
    return f"no equilibrium: {rest.reason}, {residual:.3g} N stay unbalanced: {cure}"


def _check_supports(structure: Structure, nodes: Array, moved: list[int]) -> None:
    """Reject nodes (n, 3) displaced from their pins or rollers.

    Nodes with the indices `moved`, whose motion is prescribed, are exempt. Raises ValueError.
    """
    size = measure_extent(structure.nodes)
    shift = nodes - structure.nodes
    fixed = structure.fixed.copy()
    fixed[moved] = False
    for node, axis in np.argwhere((np.abs(shift) > 1e-9 * size) & fixed)[:1]:
        raise ValueError(
            f"start[{node}, {axis}] moves a pinned coordinate: keep node {node} at {structure.nodes[node]}"
        )
    for node, normals in structure.rollers.items():
        if np.any(np.abs(np.array(normals) @ shift[node]) > 1e-9 * size):
            raise ValueError(
                f"start[{node}] moves node {node} off its roller: keep it on {normals}"
            )

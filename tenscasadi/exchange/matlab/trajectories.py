"""Import of trajectories written by `save_mat`, MOTES or TsgFEM."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tenscasadi.dynamics.model import Model
from tenscasadi.exchange.matlab.mat_file import read_mat
from tenscasadi.exchange.matlab.save import HISTORY, LETTERS, TRAJECTORY_FORM
from tenscasadi.exchange.matlab.structures import find_structure
from tenscasadi.exchange.matlab.variables import Variables, read_indices, read_pairs
from tenscasadi.exchange.source import Source
from tenscasadi.scene.scene import Scene
from tenscasadi.scene.strings import ForceDensity
from tenscasadi.schema.reading import SceneFileError
from tenscasadi.simulation.trajectory import Trajectory, record_trajectory
from tenscasadi.util.validate import Array, FilePath, Indices, finite_array, format_value, instance


class ForeignTrajectory(NamedTuple):
    """Trajectory of MOTES or TsgFEM.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Times [s].
    nodes, velocities : ndarray, shape (T, columns of N, 3)
        Positions [m] and velocities [m/s].
    force_density : ndarray, shape (T, α), or None
        Force densities [N/m].
    """

    time: Array
    nodes: Array
    velocities: Array
    force_density: Array | None

    def select(self, columns: Indices) -> ForeignTrajectory:
        """Select the nodes with given columns of N, zero-based.

        Raises ValueError.
        """
        count = self.nodes.shape[1]
        if max(columns, default=-1) >= count:
            raise ValueError(f"its motion has {count} nodes, its N more")
        nodes, velocities = self.nodes[:, columns], self.velocities[:, columns]
        return self._replace(nodes=nodes, velocities=velocities)


def load_mat_trajectory(
    path: FilePath,
    model: Model | None = None,
    parameters: Any = None,
    *,
    strict: bool = True,
) -> Trajectory:
    """Read a trajectory from a MATLAB file.

    A file of `save_mat` is restored exactly. From MOTES, Nhist, Ndhist, t and gamma are read, and
    from TsgFEM n_t, nd_t and out_tspan, in a struct or outside. Forces, energies and errors are
    then those of the model at these positions and velocities. Nodes that the
    matrix P of MOTES ties together become one node.

    Parameters
    ----------
    path : str or PathLike
        File of MATLAB's versions 5, 6 or 7 (``save('x.mat', '-v7')``).
    model : Model, optional
        Model of another program's trajectory, such as one with gravity. Default: the structure in
        the file, as from `load_mat`, without loads.
    parameters : array_like, shape (np,), or mapping of str to array_like, optional
        Values of the model's parameters, see `ParameterLayout.values`; nominal if None.
    strict : bool
        Whether properties of the structure without a counterpart are errors, see `load_mat`.

    Returns
    -------
    Trajectory
        The trajectory.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    TypeError, ValueError
        The file cannot be read, has no trajectory, or one that does not fit the model; the message
        names the file and the variable.

    Warns
    -----
    InexactImportWarning
        Properties of the structure were left out, which it lists.

    See Also
    --------
    load_mat : Read a structure.
    save_mat : Write a trajectory.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> run = tc.simulate(tc.Model(tc.Scene(tc.shapes.prism())), 0.1, 0.01, compiled=False)
    >>> tc.load_mat_trajectory(tc.save_mat(run, "run.mat"))
    Trajectory(11 rows, 6 nodes, t = 0 … 0.1 s, success=True)
    """
    if model is not None:
        instance("model", model, Model, "a Model or None")
    source = Source(path, strict)
    variables = read_mat(source)
    try:
        if variables.get("format") == TRAJECTORY_FORM and "History" in variables:
            return _restore(variables)
        motion = _find(variables)
        if model is None or motion.nodes.shape[1] != len(model.structure.nodes):
            found = find_structure(source, variables, None, {})
            motion = motion.select(found.columns)
            model = Model(Scene(found.structure)) if model is None else model
        run = _record(model, motion, parameters, source.path.name)
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, SceneFileError):
            raise
        text = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise SceneFileError(text, source.path.name) from error
    source.report()
    return run


def _restore(variables: Variables) -> Trajectory:
    """Restore a trajectory from the variables that `save_mat` wrote.

    Raises KeyError, TypeError, ValueError.
    """
    history, N = variables["History"], finite_array("N", variables["N"], (3, None))
    count = N.shape[1]
    content: dict[str, Any] = {
        "bars": read_pairs("C_b", variables["C_b"], count),
        "strings": read_pairs("C_s", variables["C_s"], count),
    }
    content["pinned"] = read_indices("pinned_nodes", variables["pinned_nodes"], count)
    sizes = {"T": np.size(history["t"]), "n": count, "3": 3, "α": len(content["strings"])}
    for name, letters in LETTERS.items():
        entry = HISTORY.get(name, name)
        if name in content or (name in _ADDED and entry not in history):
            continue
        value = history[entry]
        if letters:  # MATLAB drops trailing dimensions of size 1
            shape = [sizes.get(letter, -1) for letter in letters]
            shape = shape if np.size(value) else [max(0, size) for size in shape]
            content[name] = np.asarray(value, dtype=float).T.reshape(shape)
        else:
            is_text = isinstance(value, str)
            content[name] = value if is_text else _KINDS[name](np.asarray(value).item())
    return Trajectory.from_arrays(content)


def _find(variables: Variables) -> ForeignTrajectory:
    """Find a trajectory among the variables and structs of a file.

    Raises TypeError, ValueError.
    """
    scopes = {"": variables}
    scopes |= {name: value for name, value in variables.items() if isinstance(value, dict)}
    found = {
        name: read
        for name, scope in scopes.items()
        for keys, read in _READERS.items()
        if set(keys) <= set(scope)
    }
    names = [name for name in found if name] or list(found)
    if not names:
        ways = " or ".join(", ".join(keys) for keys in _READERS)
        held = ", ".join(variables) or "nothing"
        raise ValueError(
            f"it holds no motion, which is {ways}, in a struct or outside: it holds {held}"
        )
    if len(names) > 1:
        raise ValueError(f"it holds the motions {', '.join(names)}: keep one of them in the file")
    return found[names[0]](scopes[names[0]])


def _read_motes(scope: Variables) -> ForeignTrajectory:
    time = finite_array("t", np.ravel(scope["t"]), (None,))
    given = _read_numbers(scope, "Nhist"), _read_numbers(scope, "Ndhist")
    # MATLAB drops a last dimension of size 1
    cubes = [value.reshape(*value.shape, *[1] * (3 - value.ndim)) for value in given]
    nodes = finite_array("Nhist", cubes[0], (3, None, len(time))).transpose(2, 1, 0)
    velocities = finite_array("Ndhist", cubes[1], (3, nodes.shape[1], len(time))).transpose(2, 1, 0)
    gamma = _read_numbers(scope, "gamma").T if "gamma" in scope else None
    return ForeignTrajectory(time, nodes, velocities, gamma)


def _read_tsgfem(scope: Variables) -> ForeignTrajectory:
    # TsgFEM stores one time fewer for velocities than for positions
    rows = min(_read_numbers(scope, key).shape[-1] for key in ("n_t", "nd_t", "out_tspan"))
    time = finite_array("out_tspan", np.ravel(scope["out_tspan"])[:rows], (rows,))
    size = len(scope["n_t"])
    nodes, velocities = (
        finite_array(key, scope[key][..., :rows], (size - size % 3, rows)).T
        for key in ("n_t", "nd_t")
    )
    return ForeignTrajectory(
        time, nodes.reshape(rows, -1, 3), velocities.reshape(rows, -1, 3), None
    )


def _read_numbers(scope: Variables, key: str) -> Array:
    if not isinstance(scope[key], np.ndarray):
        raise ValueError(f"{key} is {format_value(scope[key])}: give an array of numbers")
    return np.asarray(scope[key], dtype=float)


_READERS = {("Nhist", "Ndhist", "t"): _read_motes, ("n_t", "nd_t", "out_tspan"): _read_tsgfem}
_KINDS: dict[str, Any] = {
    "success": bool,
    "compiled": bool,
    "interrupted": bool,
    "attempts": int,
    "step": float,
    "seconds": float,
    "error_estimate": float,
}
_ADDED = ("error_estimate",)  # fields that files of earlier versions do not have


def _record(model: Model, motion: ForeignTrajectory, parameters: Any, name: str) -> Trajectory:
    """Build a trajectory whose forces follow from the model.

    `motion` contains its times and states, and `name` is the file's name for messages. Raises
    ValueError.
    """
    rows = len(motion.time)
    controlled = isinstance(model.scene.control, ForceDensity)
    if model.nu and not controlled:
        cure = "give a model with control=None, or ForceDensity() to take gamma from the file"
        raise ValueError(f"model.scene.control is {model.scene.control}: {cure}")
    gamma = motion.force_density if controlled else None
    if controlled and (gamma is None or gamma.shape != (rows, model.nu)):
        sizes = f"{model.nu} strings at {rows} times"
        raise ValueError(f"its gamma does not hold {sizes}: give a model with control=None")
    if rows < 1 or np.any(np.diff(motion.time) <= 0):
        raise ValueError("its times are none, or do not increase")
    states = np.zeros((rows, model.nx))
    for row in range(rows):
        try:
            states[row] = model.state(motion.nodes[row], motion.velocities[row])
        except ValueError as error:
            raise ValueError(f"at time {motion.time[row]:g} s {error}") from error
    model.split(states).clock[:] = motion.time[:, None]
    p = model.parameters.values(parameters)
    controls = [model.stack_inputs(None if gamma is None else gamma[row], p) for row in range(rows)]
    step = float(motion.time[-1] - motion.time[0]) / max(1, rows - 1) or 1.0
    return record_trajectory(
        model,
        motion.time,
        states,
        np.array(controls).reshape(rows, -1),
        step=step,
        message=f"another program's motion, read from {name}",
    )

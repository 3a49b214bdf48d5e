"""Results of rollouts (batches of runs), with errors, in .npz files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from tenscasadi.scene.scene import Scene
from tenscasadi.schema.stored import check_indices
from tenscasadi.simulation.scene_result import SceneResult, format_largest
from tenscasadi.simulation.string_breaks import StringBreak, StringYield, find_breaks, find_yields
from tenscasadi.structure.names import names_of
from tenscasadi.util.tables import MOST_LISTED
from tenscasadi.util.validate import Array, Booleans, Indices
from tenscasadi.util.viewable import Viewable


@dataclass(frozen=True, eq=False)
class Rollouts(Viewable, SceneResult, form="tenscasadi rollouts 1", title="file of rollouts"):
    """Results of a batch of n runs (rollouts) of one model.

    `rollouts` returns them at T saved times. All arrays are read-only.

    Attributes
    ----------
    time : ndarray, shape (T,)
        Saved times [s], from the start of the runs.
    states : ndarray, shape (n, T, nx)
        States of the model. A diverged run is NaN from the row at which divergence was detected.
    success : ndarray of bool, shape (n,)
        Whether a run reached its end and is trustworthy.
    message : ndarray of str, shape (n,)
        End of the run, and reasons not to trust it.
    bar_length_error : ndarray, shape (n,)
        Largest relative error of a bar's length during the run.
    joint_error : ndarray, shape (n,)
        Largest joint error during the run [m].
    energy : ndarray, shape (n, T)
        Total energy [J]. If the control changes at a saved time, it is that under the previous
        control.
    energy_error : ndarray, shape (n,)
        Largest energy gained or lost beyond the work of all forces and of changes of the control
        [J], due to numerical errors.
    place : ndarray of int, shape (N, 3)
        Entry of the state for each coordinate of a node, -1 for prescribed coordinates.
    given : ndarray, shape (T, N, 3)
        Coordinates of nodes that supports prescribe [m]; NaN for free coordinates.
    step : float
        Mean length of a step [s].
    steps : int
        Number of steps of each run.
    seconds : float
        Wall time of the steps [s].
    lanes : int
        Number of runs that each instruction advances; 0 if the code was not compiled.
    note : str
        The reason if the code was not compiled or has one lane only; empty otherwise.
    threads : int
        Number of threads.
    interrupted : bool
        Whether the run was interrupted from the keyboard.
    bars, strings : ndarray of int, shape (β, 2) and (α, 2)
        Nodes at the ends of each bar and string; empty in older files.
    pinned : ndarray of int
        Nodes with pins or rollers; empty in older files.
    turn : ndarray, shape (N, 3, 3)
        Local axes of the coordinates of each node, as columns; empty if all are x, y, z.
    follow : ndarray, shape (w, 3)
        Nodes of rigid bodies that are affine combinations of others: the node, another one, and its
        weight; empty without bodies.
    error_estimate : ndarray, shape (n,)
        Estimated step-size error of the node positions [m], NaN if unknown; empty in older files.
    scene : Scene or None
        The simulated scene; None if the file does not contain it. Its functions of time are tables
        of samples at the saved times after loading.
    sampled : tuple of str
        Fields of `scene` that are such tables.

    See Also
    --------
    rollouts : Simulate a batch of runs.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.double_pendulum(), gravity=tc.Gravity((0, -9.81, 0))))
    >>> tc.rollouts(model, t_end=0.1, step=1e-3, states=[model.initial_state] * 3, save_every=50)
    Rollouts(3 motions, 3 rows, t = 0 … 0.1 s, 3 succeeded)
    """

    # the shape by letters, and NumPy's letter of the numbers
    time: Annotated[Array, "T", "f"]
    states: Annotated[Array, "nTx", "f"]
    success: Annotated[Booleans, "n", "b"]
    message: Annotated[NDArray[np.str_], "n", "U"]
    bar_length_error: Annotated[Array, "n", "f"]
    joint_error: Annotated[Array, "n", "f"]
    energy: Annotated[Array, "nT", "f"]
    energy_error: Annotated[Array, "n", "f"]
    place: Annotated[Indices, "N3", "i"]
    given: Annotated[Array, "TN3", "f"]
    step: Annotated[float, "", "f"]
    steps: Annotated[int, "", "i"]
    seconds: Annotated[float, "", "f"]
    lanes: Annotated[int, "", "i"]
    note: Annotated[str, "", "U"]
    threads: Annotated[int, "", "i"]
    interrupted: Annotated[bool, "", "b"] = False
    bars: Annotated[Indices, "β2", "i"] = field(
        default_factory=lambda: np.zeros((0, 2), dtype=np.intp)
    )
    strings: Annotated[Indices, "α2", "i"] = field(
        default_factory=lambda: np.zeros((0, 2), dtype=np.intp)
    )
    pinned: Annotated[Indices, "p", "i"] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    turn: Annotated[Array, "r33", "f"] = field(default_factory=lambda: np.zeros((0, 3, 3)))
    follow: Annotated[Array, "w3", "f"] = field(default_factory=lambda: np.zeros((0, 3)))
    error_estimate: Annotated[Array, "e", "f"] = field(default_factory=lambda: np.zeros(0))
    scene: Scene | None = None
    sampled: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not len(self.time):
            raise ValueError("field 'time' is empty")
        check_indices("place", self.place, max(self.states.shape[2], 1), least=-1)
        for name in ("bars", "strings", "pinned"):
            check_indices(name, getattr(self, name), len(self.place))
        if len(self.turn) not in (0, len(self.place)) or not np.all(np.abs(self.turn) <= 1 + 1e-9):
            raise ValueError("field 'turn' holds no directions of each node")
        check_indices("follow", self.follow[:, :2], len(self.place))

    def __repr__(self) -> str:
        n, rows, _ = self.states.shape
        return f"Rollouts({n} motions, {rows} rows, t = {self.time[0]:g} … {self.time[-1]:g} s, {np.count_nonzero(self.success)} succeeded)"

    @property
    def final(self) -> Array:
        """Final states (n, nx); NaN for diverged runs."""
        return self.states[:, -1]

    @property
    def breaks(self) -> list[tuple[StringBreak, ...]]:
        """Strings and cables that break in each run, by time; see `Breaking`."""
        if self.scene is None:
            return [()] * len(self.states)
        good: Any = np.isfinite(self.states).all(axis=2)
        return [
            find_breaks(self.scene, own[rows]) for own, rows in zip(self.states, good, strict=True)
        ]

    @property
    def yields(self) -> list[tuple[StringYield, ...]]:
        """Strings and cables that yield in each run, by time; see `Yielding`."""
        if self.scene is None:
            return [()] * len(self.states)
        good: Any = np.isfinite(self.states).all(axis=2)
        return [
            find_yields(self.scene, self.time[rows], own[rows])
            for own, rows in zip(self.states, good, strict=True)
        ]

    def path(self, node: int | str) -> Array:
        """Compute the positions of a node in all runs.

        Parameters
        ----------
        node : int or str
            Physical node, by its index or name.

        Returns
        -------
        ndarray, shape (n, T, 3)
            Positions at the saved times [m]; NaN for rows of a diverged run.

        Raises
        ------
        TypeError, ValueError
            If there is no such node.
        """
        structure = None if self.scene is None else self.scene.modelled
        names = names_of(structure, node=len(self.place))
        return node_positions(self, [names.index("node", "node", node)])[:, :, 0]

    def summary(self) -> str:
        """Summarize success, wall time and errors of the runs.

        Returns
        -------
        str
            One line for each quantity, with its unit. Errors are the largest ones of successful
            runs. The last lines count the messages of failed runs.
        """
        n, good = len(self.states), int(np.count_nonzero(self.success))
        total = n * self.steps
        rate = f" ({total / self.seconds:,.0f} steps/s)" if self.seconds > 0 else ""
        way = f"{self.lanes} lanes" if self.lanes else "one by one"
        lines = [
            f"{good} of {n} motions succeeded; the errors below are theirs"
            + (", interrupted" if self.interrupted else ""),
            f"time          {self.time[0]:g} … {self.time[-1]:g} s, {self.steps} steps of {self.step:g} s each, {len(self.time)} rows kept",
            f"wall time     {self.seconds:.3g} s{rate}, {way}, {self.threads} threads"
            + (f"; {self.note}" if self.note else ""),
            f"energy        largest error {format_largest(self.energy_error[self.success], 'J')}",
            f"bar lengths   largest relative error {format_largest(self.bar_length_error[self.success])}",
            f"joints        largest gap {format_largest(self.joint_error[self.success], 'm')}",
        ]
        ends = Counter(self.message[~self.success].tolist()).most_common()
        lines += [f"{count:<13} {message}" for message, count in ends[:MOST_LISTED]]
        lines += (
            [f"{sum(count for _, count in ends[MOST_LISTED:]):<13} for other reasons"]
            if len(ends) > MOST_LISTED
            else []
        )
        return "\n".join(lines)

    @classmethod
    def _check_loaded(cls, given: Mapping[str, Any]) -> None:
        _check_values(given)


def node_positions(rollouts: Rollouts, nodes: Any, motions: Any = slice(None)) -> Array:
    """Compute positions (m, T, k, 3) of selected nodes [m].

    `motions` selects m of the runs, and `nodes` selects k nodes.
    """
    follow = rollouts.follow[np.isin(rollouts.follow[:, 0], nodes)]
    dependent, others = (follow[:, k].astype(np.intp) for k in (0, 1))
    chosen = np.arange(len(rollouts.place))[nodes]
    columns = np.concatenate([chosen, np.unique(others)])
    place, given, states = (
        rollouts.place[columns],
        rollouts.given[:, columns],
        rollouts.states[motions],
    )
    found = np.repeat(given[None], len(states), axis=0)
    free = place >= 0
    found[..., free] = states[..., place[free]]
    if len(rollouts.turn):
        found = np.einsum("kij,mtkj->mtki", rollouts.turn[columns], found)
    for k in np.flatnonzero(np.isin(chosen, dependent)):
        own = dependent == chosen[k]
        sources = len(chosen) + np.searchsorted(np.unique(others), others[own])
        found[:, :, k] = np.einsum("w,mtwa->mta", follow[own, 2], found[:, :, sources])
    return found[:, :, : len(chosen)]


def _check_values(content: Mapping[str, Any]) -> None:
    """Check the values of the fields of a file (`content`).

    Raises ValueError with the name of the first wrong field. Only failed runs may contain values
    that are not finite.
    """
    time = np.asarray(content["time"])
    if not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0):
        raise ValueError("field 'time' does not increase")
    for name, least in {"step": 0.0, "steps": 0, "seconds": 0.0, "lanes": 0, "threads": 0}.items():
        if not least <= content[name] < np.inf:
            raise ValueError(
                f"field {name!r} is {content[name]:g}: it must be at least {least:g}, and finite"
            )
    good = np.asarray(content["success"])
    for name in ("states", "energy", "bar_length_error", "joint_error"):
        if not np.all(np.isfinite(content[name][good])):
            raise ValueError(f"field {name!r} is not finite in a motion that succeeded")
    for name in ("energy_error", "bar_length_error", "joint_error", "error_estimate"):
        if np.any(np.asarray(content[name]) < 0):
            raise ValueError(f"field {name!r} holds a value below 0")

"""Statics and design against jax-fdm, tnsgrt and SciPy, in one run on the same structures.

Each task is solved by both programs: once to warm up, then several times. Repeated calls count;
the first call of jax-fdm compiles, and is told apart. Needs pip install 'tenscasadi[peers]'.
"""

from __future__ import annotations

import contextlib
import io
import time
import warnings
from collections.abc import Callable, Iterator
from statistics import median
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from scipy.optimize import linprog

import tenscasadi as tc


class Task(NamedTuple):
    """Task of both programs: each call returns the result, `error` measures it."""

    name: str
    own: Callable[[], Any]
    peer: Callable[[], Any]
    error: Callable[[Any], float]


class Row(NamedTuple):
    """Seconds of repeated calls and of the peer's first one, and errors."""

    name: str
    own: float
    peer: float
    first: float
    own_error: float
    peer_error: float


def main(quick: bool = False) -> list[Row]:
    """Prints the table and returns its rows. `quick`: the smallest task of each program, once."""
    with warnings.catch_warnings():  # of the peers, and of their dependencies as they are imported
        warnings.simplefilter("ignore")
        rows = [measure(task, 1 if quick else 7) for task in tasks(quick)]
    print(f"{'':44s}{'own':>10s}{'peer':>10s}{'ratio':>8s}{'first':>9s}   errors: own, peer")
    for row in rows:
        times = f"{1e3 * row.own:7.1f} ms{1e3 * row.peer:7.1f} ms{row.peer / row.own:8.1f}{row.first:7.1f} s"
        print(f"{row.name:44s}{times}{row.own_error:11.1e}{row.peer_error:11.1e}")
    return rows


def measure(task: Task, repeats: int) -> Row:
    """Run a task with both programs, in turns."""
    own: list[float] = []
    peer: list[float] = []
    with contextlib.redirect_stdout(io.StringIO()):
        started = time.perf_counter()
        theirs = task.peer()
        first = time.perf_counter() - started
        ours = task.own()
        for _ in range(repeats):
            for call, seconds in ((task.own, own), (task.peer, peer)):
                started = time.perf_counter()
                call()
                seconds.append(time.perf_counter() - started)
    errors = task.error(ours), task.error(theirs)
    return Row(task.name, median(own), median(peer), first, *errors)


def tasks(quick: bool) -> Iterator[Task]:
    """Yield the tasks whose peer is installed."""
    with contextlib.suppress(ImportError):
        for cells in (8,) if quick else (10, 40):
            yield from net_tasks(cells)
    with contextlib.suppress(ImportError):
        for stages in (2,) if quick else (3, 10, 14, 20):
            yield self_stress_task(stages)
    yield sizing_task(4 if quick else 16)


def net_tasks(cells: int) -> Iterator[Task]:
    """Yield form finding of a net by given force densities, and by prescribed lengths."""
    import jax

    jax.config.update("jax_enable_x64", True)
    from jax_fdm.datastructures import FDNetwork
    from jax_fdm.equilibrium import constrained_fdm, fdm
    from jax_fdm.goals import EdgeLengthGoal
    from jax_fdm.losses import Loss, SquaredError
    from jax_fdm.optimization import LBFGSB

    net = tc.shapes.hyperbolic_paraboloid(cells)
    edges = [(int(a), int(b)) for a, b in net.strings]
    density = np.random.default_rng(0).uniform(0.5, 3.0, len(edges))

    def network(values: Any) -> Any:
        made = FDNetwork.from_nodes_and_edges(net.nodes.tolist(), edges)
        for node in net.pinned:
            made.node_support(node)
        for edge, value in zip(edges, values, strict=True):
            made.edge_forcedensity(edge, float(value))
        return made

    def nodes(found: Any) -> Any:
        if isinstance(found, tc.Form):
            return found.structure.nodes
        return np.array([found.node_coordinates(node) for node in found.nodes()])

    def unbalanced(found: Any) -> float:
        C = net.C_s
        force = C.T @ (density[:, None] * (C @ nodes(found)))
        return float(np.abs(force[~net.fixed.all(axis=1)]).max())

    given, same = network(density), network(np.ones(len(edges)))
    name = f"net of {len(edges)} strings"
    yield Task(
        f"{name}: force densities",
        lambda: tc.form_find(net, density),
        lambda: fdm(given),
        unbalanced,
    )
    lengths = {k: 1.1 * float(net.string_lengths[k]) for k in range(0, len(edges), 9)}
    goals = [EdgeLengthGoal(edges[k], target=length) for k, length in lengths.items()]
    loss = Loss(SquaredError(goals))

    def missed(found: Any) -> float:
        ends = nodes(found)[net.strings]
        own = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        return max(abs(float(own[k]) - length) for k, length in lengths.items())

    yield Task(
        f"{name}: {len(lengths)} lengths",
        lambda: tc.form_find(net, lengths=lengths),
        lambda: constrained_fdm(same, LBFGSB(), loss, maxiter=500, tol=1e-12),
        missed,
    )


def self_stress_task(stages: int) -> Task:
    """Build the task of a tower's least self-stress, by linear programs."""
    vars(np).setdefault("float_", np.float64)  # which tnsgrt 0.6 names
    from tnsgrt.structure import Structure

    tower = tc.shapes.prism_tower(stages, joint_class=1)
    members = np.concatenate([tower.strings, tower.bars])
    vectors = tower.nodes[members[:, 1]] - tower.nodes[members[:, 0]]
    peer = Structure(tower.nodes.T)
    peer.add_members(members.T, number_of_strings=len(tower.strings))

    def solve() -> Any:
        peer.equilibrium()
        return peer.member_properties["lambda_"].to_numpy()

    def unbalanced(found: Any) -> float:
        if isinstance(found, tc.PrestressDesign):
            bars = found.bar_force / tower.bar_lengths
            q = np.concatenate([found.force_density, bars])
        else:
            q = found  # in tension, as that of bars
        force = np.zeros(tower.nodes.shape)
        np.add.at(force, members[:, 0], q[:, None] * vectors)
        np.subtract.at(force, members[:, 1], q[:, None] * vectors)
        return float(np.abs(force).max() / np.abs(q).max())

    name = f"tower of {len(members)} members: self-stress"
    return Task(name, lambda: tc.find_prestress(tower, tc.Least(), minimum=1.0), solve, unbalanced)


def sizing_task(nodes: int, cases: int = 5) -> Task:
    """Build the task of least mass of a plane grid by yield, against HiGHS in SciPy."""
    index = np.arange(nodes**2).reshape(nodes, nodes)
    places = np.array([(i, j, 0) for i in range(nodes) for j in range(nodes)], dtype=float)
    bars = np.concatenate([_join(index[:-1], index[1:]), _join(index[:, :-1], index[:, 1:])])
    cross = _join(index[:-1, :-1], index[1:, 1:]), _join(index[1:, :-1], index[:-1, 1:])
    pins = {int(k): "xyz" if k in index[:, 0] else "z" for k in index.ravel()}
    grid = tc.Structure(places, bars, np.concatenate(cross), pinned=pins)
    loads = np.random.default_rng(0).normal(size=(cases, nodes**2, 3)) * [1.0, 1.0, 0.0]
    strong = tc.Material(modulus=1e30, density=1.0, strength=1.0)  # bars do not buckle
    lengths = np.concatenate([grid.string_lengths, grid.bar_lengths])

    members = np.concatenate([grid.strings, grid.bars])
    units = (places[members[:, 1]] - places[members[:, 0]]) / lengths[:, None]
    count, strings = len(members), len(grid.strings)
    rows = 3 * members[:, :, None] + np.arange(3)
    values = np.stack([-units, units], axis=1).ravel()
    columns = np.repeat(np.arange(count), 6)
    balance = sp.csr_array((values, (rows.ravel(), columns)), shape=(places.size, count))
    free = ~grid.fixed.ravel()
    each, every, own = sp.eye_array(cases), np.ones((cases, 1)), sp.eye_array(count)
    equal = sp.hstack([sp.csr_array((cases * free.sum(), count)), sp.kron(each, balance[free])])
    below = sp.vstack(
        [sp.hstack([sp.kron(every, -own), sp.kron(each, sign * own)]) for sign in (1.0, -1.0)]
    )
    least = np.full(count * (1 + cases), -np.inf)
    least[:count] = 0.0
    least[count:].reshape(cases, count)[:, :strings] = 0.0
    right = loads.reshape(cases, -1)[:, free].ravel()
    cost = np.concatenate([lengths, np.zeros(cases * count)])

    def solve() -> float:
        bounds = np.column_stack([least, np.full(len(least), np.inf)])
        found = linprog(
            cost, below, np.zeros(below.shape[0]), equal, right, bounds, method="highs-ipm"
        )
        return float(found.fun)

    exact = solve()
    return Task(
        f"{count} members, {cases} load cases: least mass",
        lambda: tc.size(grid, list(loads), strong, strong).mass,
        solve,
        lambda mass: abs(mass / exact - 1.0),
    )


def _join(first: Any, second: Any) -> Any:
    return np.column_stack([first.ravel(), second.ravel()])


if __name__ == "__main__":
    main()

"""The paper's class-one matrices (Eqs. 61-66, 81, 84).

N has one column for each bar end, and N P = D are the joints and pins.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array, issparse

from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import ROUNDING, SMALLEST, Array, Indices, finite_array, per_item

Matrix = Any  # ndarray, or csr_array on request


class ClassOne(NamedTuple):
    """The paper's class-one matrices of a structure.

    N has one column for each bar end, and N P = D are the joints and pins. There are β bars, α
    strings, σ string nodes, n' = 2β + σ columns, and c columns of joints and pins. The other
    matrices follow from N: B = N C_nbᵀ C_bᵀ (Eq. 65), R_b = N C_nbᵀ C_rᵀ (Eq. 63), R_s = N C_nsᵀ
    (Eq. 64), S = N C_sᵀ (Eq. 66). They are the bars, their centers, the string nodes and the
    strings. Matrices are ndarrays, or ``csr_array`` on request.

    Attributes
    ----------
    N : ndarray, shape (3, n')
        Positions of bar ends and string nodes [m].
    C_b : ndarray or csr_array, shape (β, 2β)
        Connectivity of bars.
    C_s : ndarray or csr_array, shape (α, n')
        Connectivity of strings.
    C_r : ndarray or csr_array, shape (β, 2β)
        Averages of bar ends, ½ |C_b|.
    C_nb : ndarray or csr_array, shape (2β, n')
        Selection matrix of the bar ends.
    C_ns : ndarray or csr_array, shape (σ, n')
        Selection matrix of the string nodes.
    P : ndarray or csr_array, shape (n', c)
        Joints and pins (Eq. 84).
    D : ndarray, shape (3, c)
        Right-hand side of N P = D [m].
    M_s : ndarray or csr_array, shape (n', n')
        Mass matrix [kg]: Eq. 81 plus the point masses on bar ends.
    physical : ndarray of int, shape (n',)
        Node of the structure that each column belongs to.

    Notes
    -----
    A pinned string node without mass has a zero on the diagonal of M_s. Any positive number there
    gives the same trajectory, because P fixes that node.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> split = tc.shapes.double_pendulum().class_one()
    >>> split.physical.tolist()
    [0, 1, 1, 2]
    >>> split.P.T.tolist()
    [[0.0, 1.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0]]
    """

    N: Array
    C_b: Matrix
    C_s: Matrix
    C_r: Matrix
    C_nb: Matrix
    C_ns: Matrix
    P: Matrix
    D: Array
    M_s: Matrix
    physical: Indices


class Layout(NamedTuple):
    """Columns of the class-one matrices for each node and member.

    There are n' columns. `bar_columns` and `string_columns` have the end columns of each member,
    and `P` (n', c) the joints and pins, see `ClassOne`.
    """

    physical: Indices  # (n',) physical node of each column
    bar_columns: Indices  # (β, 2) first and second end
    string_columns: Indices  # (α, 2)
    mass_share: Array  # (n',) fraction of the physical node's point mass
    P: csr_array  # n'×c


class MatrixInput(NamedTuple):
    """Structure that was read from the paper's matrices.

    `bars` and `strings` are pairs of rows of `nodes`; `pinned` are such rows, and `node_mass` is in
    kg. `layout` is None if bars share columns.
    """

    nodes: Array  # (n, 3)
    bars: Indices
    strings: Indices
    pinned: list[int]
    node_mass: Array  # (n,)
    layout: Layout | None


def connectivity(pairs: Indices, count: int) -> csr_array:
    """Build the connectivity matrix (members, `count`) of `pairs`.

    It has −1 at the first node and +1 at the second.
    """
    members = len(pairs)
    rows = np.repeat(np.arange(members), 2)
    return csr_array((np.tile([-1.0, 1.0], members), (rows, pairs.ravel())), shape=(members, count))


def measure_extent(nodes: Array) -> float:
    """Measure the largest extent of nodes (n, 3) along an axis [m]."""
    return float(np.ptp(nodes, axis=0).max(initial=0.0))


def measure_diagonal(nodes: Array) -> float:
    """Measure the diagonal of the box around nodes (n, 3) [m]."""
    return float(np.linalg.norm(np.ptp(nodes, axis=0)))


def member_vectors(nodes: Array, pairs: Indices) -> Array:
    """Compute the vectors (..., m, 3) between pairs of nodes.

    Pairs are (m, 2), nodes (..., n, 3).
    """
    return np.asarray(nodes[..., pairs[:, 1], :] - nodes[..., pairs[:, 0], :])


def distances(nodes: Array, pairs: Indices) -> Array:
    """Compute the distances (..., m) between pairs of nodes.

    Pairs are (m, 2), nodes (..., n, 3).
    """
    return np.asarray(np.linalg.norm(member_vectors(nodes, pairs), axis=-1))


def member_lengths(field: str, nodes: Array, pairs: Indices, item: str) -> Array:
    """Compute member lengths (m,) [m].

    `nodes` are (n, 3), and `pairs` (m, 2) are the end nodes of the members. Raises ValueError if a
    length is zero. The message names `field` and the kind of `item`, such as "bar".
    """
    lengths = distances(nodes, pairs)
    for i in np.flatnonzero(lengths < max(ROUNDING * np.abs(nodes).max(), SMALLEST)):
        a, b = pairs[i]
        raise add_address(
            ValueError(
                f"{field}: {item} {i} joins nodes {a} and {b}, which lie {lengths[i]:g} m apart: "
                f"move one or remove the {item}"
            )
        )
    return np.asarray(lengths)


def selection_matrix(columns: Indices, count: int) -> csr_array:
    """Build the rows of the identity matrix that select `columns`.

    The matrix is (columns, count).
    """
    return csr_array(
        (np.ones(len(columns)), (np.arange(len(columns)), columns)), shape=(len(columns), count)
    )


def bar_mass_matrix(bars: Indices, inertia: Array, mass: Array, count: int) -> csr_array:
    """Compute the mass matrix (count, count) of bars (Eq. 59) [kg].

    It is C_bᵀ Ĵ C_b + C_rᵀ m̂ C_r with C_r = ½|C_b|, `inertia` J and `mass` m (β,). `bars` (β, 2)
    are the end nodes of bars, which can share nodes.
    """
    C_b = connectivity(bars, count)
    C_r = 0.5 * abs(C_b)
    return csr_array(C_b.T @ diags_array(inertia) @ C_b + C_r.T @ diags_array(mass) @ C_r)


def default_layout(count: int, bars: Indices, strings: Indices, pinned: Indices) -> Layout:
    """Choose the default columns of the class-one matrices.

    N consists of the first ends of bars, their second ends, and the string nodes. In P the joints
    come first, in node order, then the pins. The structure has `count` nodes, of which some are
    `pinned`; `bars` and `strings` are pairs of nodes.
    """
    physical = np.concatenate([bars[:, 0], bars[:, 1], np.setdiff1d(np.arange(count), bars)])
    # strings, masses and pins are attached to the first copy of a node
    first = np.unique(physical, return_index=True)[1]
    share = np.zeros(len(physical))
    share[first] = 1.0
    copies = np.flatnonzero(share == 0.0)
    copies = copies[np.argsort(physical[copies], kind="stable")]
    ties, pins = len(copies), len(pinned)
    rows = np.concatenate([first[physical[copies]], copies, first[pinned]])
    columns = np.concatenate([np.arange(ties), np.arange(ties), ties + np.arange(pins)])
    values = np.concatenate([np.ones(ties), -np.ones(ties), np.ones(pins)])
    P = csr_array((values, (rows, columns)), shape=(len(physical), ties + pins))
    ends = np.arange(len(bars))
    return Layout(physical, np.column_stack([ends, ends + len(bars)]), first[strings], share, P)


def extend_layout(layout: Layout, count: int, strings: Indices, parent: Indices) -> Layout:
    """Extend the class-one columns by the nodes inside strings.

    `layout` has `count` nodes, and `strings` (segments, 2) are the segments. New nodes have the
    last columns. A segment end at an old node keeps the column of the `parent` string.
    """
    columns = len(layout.physical)
    new = max(int(strings.max(initial=-1)) + 1 - count, 0)
    P = layout.P.tocoo()
    return Layout(
        np.concatenate([layout.physical, count + np.arange(new)]),
        layout.bar_columns,
        np.where(strings < count, layout.string_columns[parent], columns + strings - count),
        np.concatenate([layout.mass_share, np.ones(new)]),
        csr_array((P.data, (P.row, P.col)), shape=(columns + new, P.shape[1])),
    )


def class_one(
    layout: Layout, nodes: Array, inertia: Array, mass: Array, node_mass: Array, sparse: bool
) -> ClassOne:
    """Compute the class-one matrices of a layout.

    `nodes` (n, 3) are positions [m]. Bars have the `inertia` J and the `mass` m (β,), nodes the
    point masses `node_mass` (n,) [kg]. If `sparse`, matrices other than N and D are ``csr_array``.
    """
    count = len(layout.physical)
    N = nodes[layout.physical].T
    bar_ends = np.unique(layout.bar_columns)
    C_nb = selection_matrix(bar_ends, count)
    C_ns = selection_matrix(np.setdiff1d(np.arange(count), bar_ends), count)
    bars = np.searchsorted(bar_ends, layout.bar_columns)
    C_b = connectivity(bars, len(bar_ends))
    M_b = bar_mass_matrix(bars, inertia, mass, len(bar_ends))
    points = diags_array(layout.mass_share * node_mass[layout.physical])
    matrices = {
        "C_b": C_b,
        "C_s": connectivity(layout.string_columns, count),
        "C_r": 0.5 * abs(C_b),
        "C_nb": C_nb,
        "C_ns": C_ns,
        "P": layout.P,
        "M_s": C_nb.T @ M_b @ C_nb + points,
    }
    shown = {
        name: csr_array(matrix) if sparse else matrix.toarray() for name, matrix in matrices.items()
    }
    return ClassOne(N=N, D=N @ layout.P, physical=layout.physical, **shown)


def read_matrices(N: ArrayLike, C_b: Any, C_s: Any, P: Any, D: Any, node_mass: Any) -> MatrixInput:
    """Convert the paper's matrices to nodes, bars and strings.

    The arguments are those of `Structure.from_matrices`. Raises TypeError or ValueError.
    """
    columns = finite_array("N", N, (3, None)).T
    count = len(columns)
    if count == 0:
        raise ValueError("N has no columns: give one column for each node")
    shape = getattr(C_b, "shape", ())
    if (
        isinstance(shape, tuple)
        and len(shape) == 2
        and shape[1] == 2 * shape[0]
        and 0 < shape[1] < count
    ):  # the paper's C_b, which refers to N_b
        raise ValueError(
            f"C_b has shape {shape}, a column for each end of a bar: "
            f"give C_b @ C_nb, of shape ({shape[0]}, {count})"
        )
    bars = _member_columns("C_b", C_b, count, "bar")
    strings = _member_columns("C_s", C_s, count, "string")
    mass = per_item("node_mass", node_mass, count)
    ties, pins, P_matrix = _read_joints(columns, P, D)
    root = np.arange(count)
    for tie in ties:
        _link(root, *tie)
    first, physical = np.unique(root, return_inverse=True)
    physical = physical.astype(np.intp)
    total = np.zeros(len(first))
    np.add.at(total, physical, mass)
    pinned = sorted({int(physical[pin]) for pin in pins})
    layout = None
    if len(np.unique(bars)) == bars.size:  # shared columns are split by the default layout
        on_bar = np.zeros(count, dtype=bool)
        on_bar[bars] = True
        for column in (end for tie in ties for end in tie):
            if not on_bar[column] and mass[column] == 0.0:
                raise ValueError(
                    f"node_mass of column {column} is 0, but P ties it and no bar ends there, "
                    "so M_s is singular: give a mass, or attach its strings to the tied column"
                )
        share = np.divide(mass, total[physical], out=np.zeros(count), where=total[physical] > 0.0)
        share[first[total == 0.0]] = 1.0  # masses that are added later
        layout = Layout(physical, bars, strings, share, P_matrix)
    return MatrixInput(columns[first], physical[bars], physical[strings], pinned, total, layout)


def _dense(field: str, value: Matrix, shape: tuple[int | None, int | None]) -> Array:
    """Convert a matrix to a finite array of given shape.

    None or an empty value has the size 0 in unspecified dimensions. Messages name `field`.
    """
    dense = value.toarray() if issparse(value) else value
    if (
        dense is None
        or (isinstance(dense, np.ndarray) and dense.size == 0)
        or (isinstance(dense, (list, tuple)) and not dense)
    ):
        return np.zeros([size or 0 for size in shape])
    return finite_array(field, dense, shape)


def _member_columns(field: str, value: Any, count: int, item: str) -> Indices:
    """Read the node columns (members, 2) from a connectivity matrix.

    The matrix `value` has `count` columns, and each row has −1 at the first and +1 at the second
    end of a member. Messages name `field` and the kind of `item`, such as "bar".
    """
    matrix = _dense(field, value, (None, count))
    good = (
        (np.sum(matrix == -1.0, axis=1) == 1)
        & (np.sum(matrix == 1.0, axis=1) == 1)
        & (np.sum(matrix != 0.0, axis=1) == 2)
    )
    if not good.all():
        row = int(np.flatnonzero(~good)[0])
        raise ValueError(
            f"{field}: row {row} ({item} {row}) is {matrix[row].tolist()}: "
            "give one −1, one +1 and zeros"
        )
    return np.column_stack(
        [np.argmax(matrix == -1.0, axis=1), np.argmax(matrix == 1.0, axis=1)]
    ).reshape(-1, 2)


def _read_joints(
    columns: Array, P: Any, D: Any
) -> tuple[list[tuple[int, int]], list[int], csr_array]:
    """Read joints and pins from the constraints N P = D.

    `columns` (n', 3) are the columns of N. Returns pairs of joined columns of N, pinned ones, and P.
    They are in the order of the columns of P, which must be independent.
    """
    count = len(columns)
    P = _dense("P", P, (count, None))
    joints = P.shape[1]
    D = np.zeros((3, joints)) if D is None else _dense("D", D, (3, joints))
    if D.shape[1] != joints:
        raise ValueError(
            f"D has shape {D.shape}: give an array of shape (3, {joints}), one column for each of P"
        )
    ties: list[tuple[int, int]] = []
    pins: list[int] = []
    error = np.abs(columns.T @ P - D).max(axis=0, initial=0.0)
    linked = np.arange(count + 1)
    tolerance = 1e-9 * np.abs(columns).max(initial=0.0)
    for c in range(joints):
        ends = np.flatnonzero(P[:, c])
        values = sorted(P[ends, c].tolist())
        if values not in ([-1.0, 1.0], [1.0], [-1.0]):
            raise ValueError(
                f"P: column {c} has entries {values}: "
                "give +1 and −1 to tie two nodes, or a single ±1 to pin one"
            )
        if len(ends) == 2 and np.any(D[:, c] != 0.0):
            raise ValueError(
                f"D: column {c} is {D[:, c].tolist()}: "
                f"give 0, because P ties nodes {ends[0]} and {ends[1]}"
            )
        if error[c] > tolerance:
            raise add_address(
                ValueError(
                    f"P: N P differs from D by {error[c]:g} in column {c}: move nodes of N or correct D"
                )
            )
        if len(ends) == 2:
            ties.append((int(ends[0]), int(ends[1])))
        else:
            pins.append(int(ends[0]))
        # The ground is an additional node. A column is redundant if it joins nodes that are already
        # connected.
        if not _link(linked, int(ends[0]), int(ends[-1]) if len(ends) == 2 else count):
            raise ValueError(f"P: column {c} depends on the columns before it: remove it")
    return ties, pins, csr_array(P)


def _link(root: Indices, a: int, b: int) -> bool:
    """Merge the groups of a and b in the labels `root`, in place.

    The label of a group is its smallest member. Returns False if they were already merged.
    """
    low, high = sorted((root[a], root[b]))
    root[root == high] = low
    return bool(low != high)

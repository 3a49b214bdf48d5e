"""The structure: physical nodes, rigid bars, strings, masses and pins, checked when it is built."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

from tenscasadi.structure.class_one import ClassOne, Layout, bar_mass_matrix, connectivity, default_layout, extended, read_matrices, split
from tenscasadi.structure.subdivision import split_strings
from tenscasadi.util.validate import SMALLEST, Array, Indices, finite_array, node_index, node_pairs, nonnegative, per_item

__all__ = ["ClassOne", "Structure", "connectivity"]

PARAMETERS = ("nodes", "bars", "strings", "bar_mass", "bar_radius", "node_mass", "pinned", "stiffness", "damping", "rest_length", "string_mass")
SHORTEST = 1e-12  # of the largest coordinate: below it rounding decides where a member points
THICKEST = 1e3  # radius over length: beyond it M loses its positive definiteness to rounding


class Structure:
    """n physical nodes, β rigid bars and α strings. Immutable, its arrays are read-only; scalars stand for one value each.

    nodes (n, 3) in metres. bars, strings: pairs of node indices; bars that meet share the node (class k).
    bar_mass (β,) kg > 0 and bar_radius (β,) m ≥ 0 give J = m/12 + m r²/(4 l²) (Eq. 19). node_mass (n,) kg ≥ 0: point masses.
    stiffness (α,) N/m ≥ 0, damping (α,) N·s/m ≥ 0, rest_length (α,) m > 0 (None: as long as the string is in `nodes`).
    string_mass (α,) kg ≥ 0 acts once `subdivide` puts it on nodes. pinned: nodes held in place, or {node: "xz"} to hold some axes.

    Raises TypeError or ValueError that names the field, e.g. when the mass matrix would be singular at a node of no bar.
    Further attributes: fixed (n, 3) bool, bar_lengths (β,), string_lengths (α,), bar_inertia (β,) J in kg; string_parent (α,)
    and string_fraction (α,): the string that `subdivide` cut each string from, and its share of that string's length.
    """

    nodes: Array
    bars: Indices
    strings: Indices
    bar_mass: Array
    bar_radius: Array
    node_mass: Array
    pinned: Mapping[int, str]
    stiffness: Array
    damping: Array
    rest_length: Array
    string_mass: Array
    fixed: np.ndarray[Any, np.dtype[np.bool_]]
    bar_lengths: Array
    string_lengths: Array
    bar_inertia: Array
    string_parent: Indices
    string_fraction: Array
    _layout: Layout

    def __init__(
        self,
        nodes: ArrayLike,
        bars: Iterable[Sequence[int]] | Indices = (),
        strings: Iterable[Sequence[int]] | Indices = (),
        bar_mass: ArrayLike = 1.0,
        bar_radius: ArrayLike = 0.0,
        node_mass: ArrayLike = 0.0,
        pinned: Iterable[int] | Mapping[int, str] = (),
        stiffness: ArrayLike = 100.0,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        string_mass: ArrayLike = 0.0,
    ) -> None:
        own = self.__dict__
        own["nodes"] = finite_array("nodes", nodes, (None, 3))
        n = len(self.nodes)
        if n == 0:
            raise ValueError("nodes is empty: give at least one node")
        own["bars"] = node_pairs("bars", bars, n, "bar")
        own["strings"] = node_pairs("strings", strings, n, "string")
        own["pinned"] = _read_pins(pinned, n)
        own["fixed"] = np.zeros((n, 3), dtype=bool)
        for node, axes in self.pinned.items():
            self.fixed[node, ["xyz".index(axis) for axis in axes]] = True
        beta, alpha = len(self.bars), len(self.strings)
        own["bar_mass"] = nonnegative("bar_mass", per_item("bar_mass", bar_mass, beta), "bar", strict=True)
        own["bar_radius"] = nonnegative("bar_radius", per_item("bar_radius", bar_radius, beta), "bar")
        own["node_mass"] = nonnegative("node_mass", per_item("node_mass", node_mass, n), "node")
        own["stiffness"] = nonnegative("stiffness", per_item("stiffness", stiffness, alpha), "string")
        own["damping"] = nonnegative("damping", per_item("damping", damping, alpha), "string")
        own["string_mass"] = nonnegative("string_mass", per_item("string_mass", string_mass, alpha), "string")
        own["bar_lengths"] = _lengths("bars", self.nodes, self.bars, "bar")
        own["string_lengths"] = _lengths("strings", self.nodes, self.strings, "string")
        given = self.string_lengths if rest_length is None else rest_length
        own["rest_length"] = nonnegative("rest_length", per_item("rest_length", given, alpha), "string", strict=True)
        slenderness = _slenderness(self.bar_radius, self.bar_lengths)
        own["bar_inertia"] = self.bar_mass * (1.0 / 12.0 + slenderness**2 / 4.0)  # Eq. 19
        own["string_parent"] = np.arange(alpha)
        own["string_fraction"] = np.ones(alpha)
        self._refuse_massless_nodes()
        own["_layout"] = default_layout(n, self.bars, self.strings, np.flatnonzero(self.fixed.all(axis=1)))
        self._freeze()

    def parent_mean(self, values: ArrayLike) -> Array:
        """Quantities of strings (…, α) such as tensions or force densities × length, averaged along each parent string (…, parents).

        The average over a parent's segments is weighted by their share of its length. Raises TypeError, ValueError.
        """
        array = np.asarray(values, dtype=float)
        if array.ndim == 0 or array.shape[-1] != len(self.strings):
            raise ValueError(f"values has shape {array.shape}: give one entry per string in the last axis, {len(self.strings)}")
        weight = np.zeros((len(self.strings), int(self.string_parent.max(initial=-1)) + 1))
        weight[np.arange(len(self.strings)), self.string_parent] = self.string_fraction
        return np.asarray(array @ (weight / weight.sum(axis=0)))

    @classmethod
    def from_matrices(
        cls, N: ArrayLike, C_b: Any = None, C_s: Any = None, P: Any = None, D: Any = None, node_mass: ArrayLike = 0.0, **options: Any
    ) -> Structure:
        """Structure from the paper's matrices, dense or scipy sparse: N (3, n'), C_b (β, n'), C_s (α, n'), N P = D (Eq. 84).

        A column of P with +1 and −1 ties two nodes (D is 0 there): they are merged; a single ±1 pins a node at ±D.
        Physical nodes keep the order of first appearance; node_mass, one per column of N, adds up. `options` are the
        constructor's other keywords. `class_one()` gives the same matrices back (bars that share columns are split).
        Raises TypeError, ValueError; a column of P that says anything else, or repeats others, is named.
        """
        read = read_matrices(N, C_b, C_s, P, D, node_mass)
        structure = cls(read.nodes, read.bars, read.strings, node_mass=read.node_mass, pinned=read.pinned, **options)
        return structure if read.layout is None else structure._derived(_layout=read.layout)

    @property
    def C_b(self) -> Array:
        """Bar connectivity (β, n) on physical nodes: B = N C_bᵀ."""
        return np.asarray(connectivity(self.bars, len(self.nodes)).toarray())

    @property
    def C_s(self) -> Array:
        """String connectivity (α, n) on physical nodes: S = N C_sᵀ."""
        return np.asarray(connectivity(self.strings, len(self.nodes)).toarray())

    def mass_matrix(self) -> csr_array:
        """M (n, n) in kg on physical nodes: C_bᵀ Ĵ C_b + C_rᵀ m̂ C_r (Eq. 59) plus the point masses."""
        return csr_array(bar_mass_matrix(self.bars, self.bar_inertia, self.bar_mass, len(self.nodes)) + diags_array(self.node_mass))

    def class_one(self, sparse: bool = False) -> ClassOne:
        """The paper's split: a column of N for each bar end (first ends, second ends), then one for each string node.

        A node of k bars gives k columns, tied by k−1 columns of P; strings, point masses and pins attach to the first of them.
        P has columns for nodes pinned in all axes only: N P = D cannot hold a single axis. A structure made by `from_matrices`
        gives the columns and P it was made from. sparse=True: scipy csr_array in place of ndarray, except N and D.
        """
        return split(self._layout, self.nodes, self.bar_inertia, self.bar_mass, self.node_mass, sparse)

    def replace(self, **changes: Any) -> Structure:
        """The same structure with some of the constructor's keywords changed. rest_length stays as it is unless given."""
        unknown = sorted(set(changes) - set(PARAMETERS))
        if unknown:
            raise TypeError(f"replace got {unknown[0]!r}: give keywords of Structure ({', '.join(PARAMETERS)})")
        new = Structure(**{**{name: getattr(self, name) for name in PARAMETERS}, **changes})
        kept: dict[str, Any] = {}
        if np.array_equal(new.strings, self.strings):
            kept.update(string_parent=self.string_parent, string_fraction=self.string_fraction)
            if len(new.nodes) == len(self.nodes) and np.array_equal(new.bars, self.bars) and np.array_equal(new.fixed, self.fixed):
                kept.update(_layout=self._layout)
        return new._derived(**kept)

    def prestressed(self, force_density: ArrayLike) -> Structure:
        """Rest lengths ρ = s (1 − γ/k), so that each string has force density γ (α,) N/m ≥ 0 in these nodes (Appendix A).

        Raises ValueError where γ ≥ k: no positive rest length gives that much.
        """
        gamma = nonnegative("force_density", per_item("force_density", force_density, len(self.strings)), "string")
        bad = np.flatnonzero((gamma > 0.0) & (gamma >= self.stiffness))
        if bad.size:
            i = int(bad[0])
            raise ValueError(f"force_density of string {i} is {gamma[i]:g} N/m: it must be below its stiffness, {self.stiffness[i]:g} N/m")
        ratio = np.divide(gamma, self.stiffness, out=np.zeros_like(gamma), where=gamma > 0.0)
        return self.replace(rest_length=self.string_lengths * (1.0 - ratio))

    def subdivide(self, segments: int | Sequence[int] | Indices, ends: str = "interior", fractions: ArrayLike | None = None) -> Structure:
        """Each string cut into `segments` (one number, or one per string) that together are as stiff as it was (Sect. 5).

        A segment with share f of the length has k/f, c/f, rest length ρ f. fractions: the shares along each string (they sum to 1;
        None: equal). New nodes follow the existing ones, string by string; segments follow each other from first to second node.
        The string's mass m goes to nodes: ends="interior" puts m/(segments−1) on each inner node (the paper's; a string in one
        segment then has no mass), ends="lumped" half of each segment's mass on each of its ends (more accurate).
        """
        if ends not in ("interior", "lumped"):
            raise ValueError(f"ends is {ends!r}: give 'interior' or 'lumped'")
        cut = split_strings(self.nodes, self.strings, self.string_mass, segments, ends == "lumped", fractions)
        if len(cut.parent) == len(self.strings) and not self.string_mass.any():
            return self
        share, parent = cut.fraction, cut.parent
        massless = np.flatnonzero((np.bincount(parent, minlength=len(self.strings)) > 1) & (self.string_mass == 0.0))
        if massless.size:
            raise ValueError(f"string_mass of string {massless[0]} is 0: give it a mass, as segments meet in nodes that need one")
        mass = cut.node_mass + np.concatenate([self.node_mass, np.zeros(len(cut.points))])
        new = self.replace(
            nodes=np.concatenate([self.nodes, cut.points]),
            strings=cut.strings,
            node_mass=mass,
            stiffness=self.stiffness[parent] / share,
            damping=self.damping[parent] / share,
            rest_length=self.rest_length[parent] * share,
            string_mass=0.0,
        )
        return new._derived(
            _layout=extended(self._layout, len(self.nodes), cut.strings, parent),
            string_parent=self.string_parent[parent],
            string_fraction=self.string_fraction[parent] * share,
        )

    def __repr__(self) -> str:
        return f"Structure({len(self.nodes)} nodes, {len(self.bars)} bars, {len(self.strings)} strings, {len(self.pinned)} pinned)"

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"a Structure does not change: use structure.replace({name}=...)")

    def _derived(self, **attributes: Any) -> Structure:
        """Self, just built, with what a constructor keyword cannot say."""
        self.__dict__.update(attributes)
        self._freeze()
        return self

    def _freeze(self) -> None:
        for value in self.__dict__.values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def _refuse_massless_nodes(self) -> None:
        """A node of no bar needs a mass, or M is singular."""
        heavy = (self.node_mass > SMALLEST) | self.fixed.all(axis=1)
        heavy[self.bars] = True
        heavy[self.strings[self.string_mass > SMALLEST]] = True
        if not heavy.all():
            node = int(np.flatnonzero(~heavy)[0])
            cure = "give it a mass, pin it in all axes, or give its strings a string_mass"
            raise ValueError(f"node_mass of node {node} is {self.node_mass[node]:g} and no bar ends there: {cure}")


def _slenderness(radius: Array, length: Array) -> Array:
    """Radius over length of each bar, refused beyond THICKEST."""
    ratio = radius / length
    bad = np.flatnonzero(ratio > THICKEST)
    if bad.size:
        i = int(bad[0])
        raise ValueError(f"bar_radius of bar {i} is {radius[i]:g} m: it must be at most {THICKEST:g} times its length, {length[i]:g} m")
    return ratio


def _lengths(field: str, nodes: Array, pairs: Indices, item: str) -> Array:
    lengths = np.linalg.norm(nodes[pairs[:, 1]] - nodes[pairs[:, 0]], axis=1)
    bad = np.flatnonzero(lengths < max(SHORTEST * np.abs(nodes).max(), SMALLEST))
    if bad.size:
        i = int(bad[0])
        a, b = pairs[i]
        raise ValueError(f"{field}: {item} {i} joins nodes {a} and {b}, which lie {lengths[i]:g} m apart: move one or leave the {item} out")
    return np.asarray(lengths)


def _read_pins(pinned: Any, count: int) -> Mapping[int, str]:
    """{node: axes} in node order, axes in the order x, y, z."""
    try:
        entries = list(pinned.items() if isinstance(pinned, Mapping) else ((node, "xyz") for node in pinned))
    except TypeError:
        raise TypeError(f"pinned is {pinned!r}: give node indices, such as [0, 3], or a mapping such as {{0: 'xyz', 3: 'z'}}") from None
    pins: dict[int, str] = {}
    for key, axes in entries:
        node = node_index("pinned", key, count)
        if not isinstance(axes, str):
            raise TypeError(f"pinned of node {node} is {axes!r}: give the axes as text, such as 'xyz' or 'z'")
        if not axes or len(set(axes)) != len(axes) or not set(axes) <= set("xyz"):
            raise ValueError(f"pinned of node {node} is {axes!r}: give some of x, y, z, each once")
        if node in pins:
            raise ValueError(f"pinned: node {node} is given twice: leave one out")
        pins[node] = "".join(sorted(axes))
    return MappingProxyType(dict(sorted(pins.items())))

"""Structure: nodes, rigid bars, strings, masses and pins."""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array, diags_array

from tenscasadi.schema.reading import Names
from tenscasadi.schema.value import Value
from tenscasadi.structure.body_assembly import BodyAssembly, assemble_bodies
from tenscasadi.structure.cables import Cables, read_cables
from tenscasadi.structure.class_one import (
    ClassOne,
    Layout,
    bar_mass_matrix,
    class_one,
    connectivity,
    default_layout,
    member_lengths,
    read_matrices,
)
from tenscasadi.structure.derived import read_derived, write_derived
from tenscasadi.structure.mass_checks import check_node_masses
from tenscasadi.structure.names import name_errors, names_of, read_names, reset_item_fields
from tenscasadi.structure.pins import Normals, read_axes, read_pins, read_rollers
from tenscasadi.structure.prestress import find_rest_lengths
from tenscasadi.structure.properties import read_properties
from tenscasadi.structure.rigid_body import RigidBody, move_bodies, read_bodies
from tenscasadi.structure.subdivision import average_segments, divide_strings
from tenscasadi.util.immutable import ReadOnlyArrays, keep, read_only
from tenscasadi.util.renamed import rename_keywords
from tenscasadi.util.troubleshooting import add_address
from tenscasadi.util.validate import (
    Array,
    Booleans,
    IndexOrName,
    Indices,
    finite_array,
    flag,
    rows_of_size,
)
from tenscasadi.util.viewable import Viewable


class Structure(ReadOnlyArrays, Value, Viewable, kind="Structure"):
    """Nodes, rigid bars and strings, with masses, stiffness and pins.

    A structure is immutable; `replace` returns a changed copy. A scalar given for an array applies
    to every item. A node shared by k bars is a class-k joint.

    Parameters
    ----------
    nodes : array_like, shape (n, 3)
        Positions [m].
    bars : sequence of pairs of int or str
        End nodes of each of the β bars, zero-based.
    strings : sequence of pairs of int or str
        End nodes of each of the α strings. Several strings can join the same nodes, bars cannot.
    bar_mass : array_like, shape (β,)
        Mass of each bar [kg], greater than 0.
    bar_radius : array_like, shape (β,)
        Radius of each bar [m], for its inertia J = m/12 + m r²/(4 l²) (Eq. 19).
    node_mass : array_like, shape (n,)
        Point mass on each node [kg].
    pinned : iterable of int or str or mapping of int or str to str
        Fixed nodes, or the fixed axes of nodes, such as ``{0: "xyz", 3: "z"}``.
    stiffness : array_like, shape (α,)
        Force of each string per elongation [N/m].
    damping : array_like, shape (α,)
        Force of each string per elongation rate [N·s/m].
    rest_length : array_like, shape (α,), optional
        Unstretched length of each string [m]. Default: its length in `nodes`.
    string_mass : array_like, shape (α,)
        Mass of each string [kg], which `subdivide` assigns to nodes.
    rollers : mapping of int or str to array_like, shape (3,) or (k, 3)
        Fixed directions of nodes, such as ``{3: (1, 0, 1)}``: one normal for a node that moves in a
        plane, or two normals for a node that moves along a line.
    bar_stiffness : array_like, shape (β,), optional
        Force of each bar per elongation [N/m], inf for rigid bars. Default: all bars are rigid.
    bar_rest_length : array_like, shape (β,), optional
        Unstressed length of each elastic bar [m]. Default: its length in `nodes`.
    bodies : sequence of RigidBody
        Rigid bodies that hold some of the nodes.
    cables : sequence of sequences of int or str
        Strings of each cable in order, end to end. A cable has one tension and slides over the
        nodes between its strings.
    cable_friction : array_like, shape (cables,)
        Coefficient of friction μ between each cable and the nodes it slides over.
    node_names, string_names, bar_names : sequence of str, optional
        Names, "" for unnamed items. ``"guys[0]"`` and ``"guys[1]"`` are members of the group
        ``"guys"``.

    Attributes
    ----------
    names : Names
        Indices of all names and groups.
    fixed : ndarray of bool, shape (n, 3)
        Whether a node is fixed along x, y and z.
    held : ndarray of bool, shape (n, 3)
        Whether a node is fixed along x, y and z, or the normal of its roller has such a component.
    bar_lengths, string_lengths : ndarray, shape (β,) and (α,)
        Lengths in `nodes` [m].
    elastic : ndarray of bool, shape (β,)
        Whether a bar is elastic.
    cable_of : ndarray of int, shape (α,)
        Index of the input of each string: one input for each cable and each string in no cable.
    bar_inertia : ndarray, shape (β,)
        J of each bar [kg] (Eq. 19).
    string_parent : ndarray of int, shape (α,)
        Parent string of each segment.
    string_fraction : ndarray, shape (α,)
        Length of each string relative to its parent.
    coupled_mass : ndarray, shape (α,)
        Consistent mass of each string, which couples its ends [kg].

    Raises
    ------
    TypeError, ValueError
        If a field is wrong, or the mass matrix would be singular at a node without bars.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> cross = tc.Structure([(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)], bars=[(0, 1), (2, 3)], strings=[(0, 2), (2, 1), (1, 3), (3, 0)])
    >>> cross.string_lengths.tolist()
    [1.0, 1.0, 1.0, 1.0]
    >>> cross.replace(bar_mass=[1.0, 2.0]).bar_mass.tolist()
    [1.0, 2.0]
    """

    nodes: Array
    bars: Indices
    strings: Indices
    bar_mass: Array
    bar_radius: Array
    node_mass: Array
    pinned: Mapping[int, str]
    rollers: Mapping[int, Normals]
    stiffness: Array
    damping: Array
    rest_length: Array
    string_mass: Array
    bar_stiffness: Array
    bar_rest_length: Array
    bodies: tuple[RigidBody, ...]
    cables: Cables
    cable_friction: Array
    cable_of: Indices
    elastic: Booleans
    fixed: Booleans
    held: Booleans
    bar_lengths: Array
    string_lengths: Array
    bar_inertia: Array
    string_parent: Indices
    string_fraction: Array
    coupled_mass: Array
    node_names: tuple[str, ...]
    string_names: tuple[str, ...]
    bar_names: tuple[str, ...]
    _layout: Layout
    _assembly: BodyAssembly | None

    @name_errors
    def __init__(  # noqa: PLR0913  one keyword for each property
        self,
        nodes: ArrayLike,
        bars: Iterable[Sequence[int | str]] | Indices = (),
        strings: Iterable[Sequence[int | str]] | Indices = (),
        bar_mass: ArrayLike = 1.0,
        bar_radius: ArrayLike = 0.0,
        node_mass: ArrayLike = 0.0,
        pinned: Iterable[int | str] | Mapping[IndexOrName, str] = (),
        stiffness: ArrayLike = 100.0,
        damping: ArrayLike = 0.0,
        rest_length: ArrayLike | None = None,
        string_mass: ArrayLike = 0.0,
        rollers: Mapping[IndexOrName, ArrayLike] = MappingProxyType({}),
        bar_stiffness: ArrayLike | None = None,
        bar_rest_length: ArrayLike | None = None,
        bodies: Iterable[RigidBody] = (),
        cables: Iterable[Sequence[int | str]] = (),
        cable_friction: ArrayLike = 0.0,
        node_names: Iterable[str] = (),
        string_names: Iterable[str] = (),
        bar_names: Iterable[str] = (),
    ) -> None:
        own = self.__dict__
        own["nodes"] = finite_array("nodes", nodes, (None, 3))
        if not (n := len(self.nodes)):
            raise ValueError("nodes is empty: give at least one node")
        own["node_names"] = read_names("node_names", node_names, n)
        names = names_of(self)
        own["bars"] = names.pairs("bars", bars, "bar")
        own["strings"] = names.pairs("strings", strings, "string", parallel=True)
        own["string_names"] = read_names("string_names", string_names, len(self.strings))
        own["bar_names"] = read_names("bar_names", bar_names, len(self.bars))
        names = names_of(self)
        own["pinned"], own["rollers"] = read_rollers(rollers, read_pins(pinned, names), names)
        own["fixed"], own["held"] = read_axes(self.pinned, self.rollers, n)
        own["bar_lengths"] = member_lengths("bars", self.nodes, self.bars, "bar")
        own["string_lengths"] = member_lengths("strings", self.nodes, self.strings, "string")
        given: dict[str, Any] = {"bar_mass": bar_mass, "bar_radius": bar_radius}
        given |= {"stiffness": stiffness, "damping": damping, "rest_length": rest_length}
        given |= {"string_mass": string_mass, "bar_stiffness": bar_stiffness}
        given |= {"bar_rest_length": bar_rest_length, "node_mass": node_mass}
        own.update(read_properties(given, n, self.bar_lengths, self.string_lengths))
        own["bodies"] = read_bodies(bodies, names)
        cables = names.resolve_lists("cables", "string", cables)
        own |= read_cables(cables, cable_friction, self.strings, self.damping)
        own["_assembly"] = assemble_bodies(self)
        check_node_masses(self)
        layout = default_layout(n, self.bars, self.strings, np.flatnonzero(self.fixed.all(axis=1)))
        self._finish(
            string_parent=np.arange(len(self.strings)),
            string_fraction=np.ones(len(self.strings)),
            coupled_mass=np.zeros(len(self.strings)),
            _layout=layout,
        )

    @classmethod
    def from_fields(cls, **given: Any) -> Structure:
        """Restore a structure from the result of `to_fields`."""
        derived = given.pop("derived", None)
        structure = cls(**given)
        return structure._finish(**read_derived(derived, structure)) if derived else structure

    def to_fields(self) -> dict[str, Any]:
        """Return the keyword arguments from which `from_fields` restores it."""
        own = {name: getattr(self, name) for name in PARAMETERS}
        plain, derived = write_derived(Structure(**own)), write_derived(self)
        own |= {name: dict(own[name]) for name in ("pinned", "rollers")}
        if not self.elastic.any():  # the defaults, for rigid bars
            own |= {"bar_stiffness": None, "bar_rest_length": None}
        own["cables"] = [list(cable) for cable in self.cables]
        same = derived.keys() == plain.keys() and all(
            np.array_equal(derived[name], value) for name, value in plain.items()
        )
        return own if same else own | {"derived": derived}

    @classmethod
    def from_matrices(
        cls,
        N: ArrayLike,
        C_b: Any = None,
        C_s: Any = None,
        P: Any = None,
        D: Any = None,
        node_mass: ArrayLike = 0.0,
        **options: Any,
    ) -> Structure:
        """Build a structure from the paper's matrices.

        A column of P with +1 and −1 ties two nodes, which are merged. D is 0 there. A single ±1
        pins a node at ±D. Physical nodes keep the order of their first appearance. `class_one`
        restores the same matrices, with C_b as C_b C_nb, except for bars that share columns.

        Parameters
        ----------
        N : array_like, shape (3, n')
            Positions, one column for each node [m].
        C_b, C_s : array_like or sparse array, shape (β, n') and (α, n'), optional
            Connectivity of bars and of strings, −1 at the first node and +1 at the second.
        P, D : array_like or sparse array, shape (n', c) and (3, c), optional
            Joints and pins as N P = D (Eq. 84).
        node_mass : array_like, shape (n',)
            Point mass of each column of N [kg]. Those of one physical node are added.
        **options : array_like
            Other keywords of `Structure`.

        Returns
        -------
        Structure
            Structure with merged and pinned nodes.

        Raises
        ------
        TypeError, ValueError
            If a matrix has another shape, or a column of P has other entries or is redundant.
        """
        read = read_matrices(N, C_b, C_s, P, D, node_mass)
        structure = cls(
            read.nodes,
            read.bars,
            read.strings,
            node_mass=read.node_mass,
            pinned=read.pinned,
            **options,
        )
        return structure if read.layout is None else structure._finish(_layout=read.layout)

    @property
    def C_b(self) -> Array:
        """Connectivity matrix (β, n) of bars, with B = N C_bᵀ."""
        return np.asarray(connectivity(self.bars, len(self.nodes)).toarray())

    @property
    def C_s(self) -> Array:
        """Connectivity matrix (α, n) of strings, with S = N C_sᵀ."""
        return np.asarray(connectivity(self.strings, len(self.nodes)).toarray())

    @property
    def names(self) -> Names:
        """Indices by name of nodes, strings, bars and control inputs."""
        return keep(self, "names", lambda: names_of(self).add_inputs(self.cable_of))

    def mass_matrix(self) -> csr_array:
        """Compute the mass matrix on physical nodes (Eq. 59).

        It is C_bᵀ Ĵ C_b + C_rᵀ m̂ C_r plus the point masses.

        Returns
        -------
        csr_array, shape (n, n)
            M [kg], without the masses of strings that `subdivide` has not assigned to nodes. A body
            with coplanar nodes whose mass is not in their plane adds an auxiliary row at the end.
        """
        n = len(self.nodes)
        M = bar_mass_matrix(self.bars, self.bar_inertia, self.bar_mass, n)
        M = M + diags_array(self.node_mass)
        if self.coupled_mass.any():
            C_s = connectivity(self.strings, n)
            M = M - C_s.T @ diags_array(self.coupled_mass / 6) @ C_s
        return csr_array(M) if self._assembly is None else self._assembly.add_mass(M)

    def class_one(self, sparse: bool = False) -> ClassOne:
        """Compute the paper's class-one matrices.

        N has a column for each bar end, then one for each string node. A node of k bars has k
        columns, tied by k−1 columns of P. Strings, point masses and pins are attached to the first
        of them. P has columns only for nodes pinned along all axes, because N P = D cannot fix a
        single axis. A structure made by `from_matrices` returns its original columns and P.

        Parameters
        ----------
        sparse : bool
            Whether matrices other than N and D are SciPy's ``csr_array``.

        Returns
        -------
        ClassOne
            The matrices of Eqs. 61-66, 81 and 84.
        """
        flag("sparse", sparse)
        if self.bodies:
            raise ValueError("bodies: the class-one matrices have no bodies: use mass_matrix()")
        found: ClassOne = read_only(
            class_one(
                self._layout, self.nodes, self.bar_inertia, self.bar_mass, self.node_mass, sparse
            )
        )
        return found

    def replace(self, **changes: Any) -> Structure:
        """Copy the structure with changed parameters.

        Rest lengths are kept unless they are given, even if nodes move. Bodies move with their nodes.

        Parameters
        ----------
        **changes : array_like
            Keywords of `Structure`.

        Returns
        -------
        Structure
            The changed copy.
        """
        unknown = sorted(set(changes) - set(PARAMETERS))
        if unknown:
            raise TypeError(
                f"replace got {unknown[0]!r}: give keywords of Structure ({', '.join(PARAMETERS)})"
            )
        if self.bodies and np.shape(changes.get("nodes", ())) == self.nodes.shape:
            changes.setdefault("bodies", move_bodies(self.bodies, self.nodes, changes["nodes"]))
        reset_item_fields(self, changes)
        new = Structure(**{**{name: getattr(self, name) for name in PARAMETERS}, **changes})
        kept: dict[str, Any] = {}
        if np.array_equal(new.strings, self.strings):
            names = ("string_parent", "string_fraction", "coupled_mass")
            kept.update({name: getattr(self, name) for name in names})
            if (
                len(new.nodes) == len(self.nodes)
                and np.array_equal(new.bars, self.bars)
                and np.array_equal(new.fixed, self.fixed)
            ):
                kept.update(_layout=self._layout)
        return new._finish(**kept)

    @rename_keywords(pushing="compression_strings")
    def prestressed(
        self, force_density: ArrayLike, compression_strings: Iterable[int | str] = ()
    ) -> Structure:
        """Copy the structure with rest lengths for given force densities.

        The rest lengths of strings are ρ = s (1 − γ/k) (Appendix A), and those of elastic bars are
        l (1 + λ/k).

        Parameters
        ----------
        force_density : array_like, shape (α,) or (α + β,)
            γ of each string at these nodes [N/m], at least 0 and below its stiffness. λ of each bar
            can follow, positive in compression, as in a row of `self_stress`. By default bars
            balance the strings by least squares.
        compression_strings : sequence of int or str
            Compression-capable strings, whose γ can be negative (law `Linear`).

        Returns
        -------
        Structure
            Copy with these rest lengths.

        Raises
        ------
        ValueError
            If γ ≥ k, which no positive rest length gives.
        """
        return self.replace(**find_rest_lengths(self, force_density, compression_strings))

    def subdivide(
        self,
        segments: int | Sequence[int] | Indices,
        ends: str = "interior",
        fractions: ArrayLike | None = None,
    ) -> Structure:
        """Divide strings into segments (Sect. 5).

        A segment with fraction f of the length has k/f, c/f and rest length ρ f. New nodes follow
        the existing ones, string by string. Segments run from the string's first node to its second.

        Parameters
        ----------
        segments : int or sequence of int, shape (α,)
            Number of segments of each string.
        ends : {"interior", "lumped", "consistent"}
            Distribution of a string's mass m. "interior": m/(segments−1) on each inner node, as in
            the paper. A string with one segment then has no mass. "lumped": half of each segment's
            mass on each of its ends, which is more accurate. "consistent": the finite-element mass
            matrix m/6 [[2, 1], [1, 2]] of each segment.
        fractions : array_like, shape (segments,), optional
            Fractions of each string's length, with sum 1. Default: equal.

        Returns
        -------
        Structure
            Structure whose strings are the segments.

        Raises
        ------
        ValueError
            If a subdivided string has no mass, or the fractions do not sum to 1.
        """
        found = divide_strings(self, segments, ends, fractions)
        return self if found is None else self.replace(**found.fields)._finish(**found.derived)

    def parent_mean(self, values: ArrayLike) -> Array:
        """Average a quantity over the segments of each parent string.

        The weights are the lengths of the segments.

        Parameters
        ----------
        values : array_like, shape (..., α)
            Quantities of strings, such as tensions.

        Returns
        -------
        ndarray, shape (..., parents)
            Means, in the order of the parent strings.
        """
        array = rows_of_size("values", values, len(self.strings), "values of strings")
        return average_segments(array, self.string_parent, self.string_fraction)

    def __repr__(self) -> str:
        parts = f"{len(self.nodes)} nodes, {len(self.bars)} bars, {len(self.strings)} strings"
        cables = f", {len(self.cables)} cable{'s'[len(self.cables) == 1 :]}" if self.cables else ""
        count = len(self.bodies)
        bodies = f", {count} bod{'y' if count == 1 else 'ies'}" if count else ""
        return f"Structure({parts}{cables}, {len(self.pinned)} pinned{bodies})"

    def __setattr__(self, name: str, value: Any) -> None:
        message = f"a Structure is immutable: use structure.replace({name}=...)"
        raise add_address(AttributeError(message))

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "pinned": dict(self.pinned), "rollers": dict(self.rollers)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        maps = {name: MappingProxyType(state[name]) for name in ("pinned", "rollers")}
        super().__setstate__({**state, **maps})  # a mapping proxy cannot be pickled

    def _finish(self, **attributes: Any) -> Structure:
        """Set derived attributes of a new structure and freeze it."""
        self.__dict__.update(attributes)
        self.__post_init__()
        return self


PARAMETERS = tuple(inspect.signature(Structure).parameters)

"""Layout of the parameter vector p of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.quantities import (
    BODIES,
    ELASTIC_BARS,
    GROUPED,
    MOMENTS,
    QUANTITIES,
    build_inertia,
    read_values,
)
from tenscasadi.structure.mass_checks import check_inertia, check_mass_ratio, find_second_moments
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.immutable import ReadOnlyArrays
from tenscasadi.util.validate import (
    NEGLIGIBLE,
    SMALLEST,
    Array,
    Indices,
    finite_array,
    format_value,
    nesting,
    node_index,
)

if TYPE_CHECKING:
    from tenscasadi.scene.parameters import Parameters
    from tenscasadi.structure.structure import Structure


class Affine(NamedTuple):
    """Affine function constant + matrix · p of the parameters p.

    Its k values belong to items, such as the k strings.
    """

    constant: Array  # (k,)
    matrix: sp.csr_array  # k×np

    def numbers(self, p: Array) -> Array:
        """Compute the values (…, k) for parameters p (…, np)."""
        rows = p.reshape(-1, self.matrix.shape[1])
        return np.asarray(self.constant + (self.matrix @ rows.T).T).reshape(
            *p.shape[:-1], len(self.constant)
        )

    def expression(self, p: Any, full: bool = False) -> Any:
        """Build the values (k×1) for a CasADi column p.

        Equal values become 1×1 unless `full`.
        """
        count = len(self.constant)
        first = self.matrix[[0] * count]
        equal = count > 1 and not np.ptp(self.constant) and not (self.matrix - first).nnz
        constant, matrix = (self.constant[:1], self.matrix[:1]) if equal else self
        value = ca.mtimes(sparse(matrix), p)
        value = ca.densify(value + ca.DM(constant) if constant.any() else value)
        return ca.repmat(value, count, 1) if full and equal else value

    def then(self, matrix: Any) -> Affine:
        """Multiply the k values by a constant matrix (m×k).

        Returns the affine function of the m results.
        """
        return Affine(np.asarray(matrix @ self.constant), sp.csr_array(matrix @ self.matrix))


@dataclass(frozen=True, eq=False)
class ParameterLayout(ReadOnlyArrays):
    """Names, units and nominal values of the parameter vector p.

    It is `Model.parameters`, and empty for a scene without `Parameters`.

    Attributes
    ----------
    names : tuple of str, length np
        Names of the entries, such as ``"stiffness[3]"`` of string 3, ``"bar_mass"`` of all bars, or
        ``"damping scale[1]"`` of group 1.
    units : tuple of str, length np
        Unit of each entry; "1" for scales.
    nominal : ndarray, shape (np,)
        Values of the scene.
    quantities : dict of str to Affine
        Items of each quantity as functions of p.
    places : dict of str to slice
        Entries of each quantity.
    strict : dict of str to ndarray of bool
        Whether each item of a quantity must be greater than 0.
    structure : Structure or None
        Structure of the items; None without parameters.

    See Also
    --------
    Parameters : Choice of the quantities.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> model = tc.Model(tc.Scene(tc.shapes.prism(), parameters=tc.Parameters("gravity", scale=["stiffness"]), gravity=tc.Gravity()))
    >>> model.parameters.names
    ('gravity[x]', 'gravity[y]', 'gravity[z]', 'stiffness scale')
    >>> model.parameters.values(gravity=[0, 0, -1.62]).tolist()
    [0.0, 0.0, -1.62, 1.0]
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Array
    quantities: dict[str, Affine]
    places: dict[str, slice]
    strict: dict[str, Any]
    structure: Structure | None = None

    def __len__(self) -> int:
        return len(self.names)

    def values(self, given: Any = None, /, **changes: Any) -> Array:
        """Build and check the vector p.

        Parameters
        ----------
        given : array_like, shape (np,), or mapping of str to array_like, optional
            All entries, or quantities by name. A quantity is one number for all its entries, or one
            for each. The others are nominal.
        **changes : array_like
            Quantities by name, which replace those in `given`.

        Returns
        -------
        ndarray, shape (np,)
            Values.

        Raises
        ------
        TypeError, ValueError
            If a name is not a parameter, or a value has another shape, is not finite, or is
            physically impossible.
        """
        mapping = isinstance(given, Mapping)
        p = np.array(
            self.nominal
            if given is None or mapping
            else finite_array("parameters", given, (len(self),))
        )
        for name, value in {**(given if mapping else {}), **changes}.items():
            if name not in self.places:
                known = ", ".join(self.places) or "none, as its scene has no Parameters"
                raise ValueError(
                    f"parameters has {format_value(name)}: the parameters of this model are {known}"
                )
            place = self.places[name]
            p[place] = finite_array(
                f"parameters[{name!r}]",
                value,
                (place.stop - place.start,) if nesting(value) else (),
            )
        self.check(p)
        p.flags.writeable = False
        return p

    def item_values(self, name: str, p: Array, constant: Array) -> Array:
        """Compute the values of a quantity for all items.

        Items are, for example, strings. The values are `constant` if the quantity is no parameter.

        Parameters
        ----------
        name : str
            Quantity.
        p : ndarray, shape (np,)
            Parameters.
        constant : ndarray, shape (k,)
            Values of the scene, used if the quantity is not a parameter.

        Returns
        -------
        ndarray, shape (k,)
            Values.
        """
        return self.quantities[name].numbers(p) if name in self.quantities else constant.copy()

    def check(self, p: Array) -> None:
        """Check that parameter values are physically possible.

        Parameters
        ----------
        p : ndarray, shape (..., np)
            One parameter vector or many.

        Raises
        ------
        ValueError
            If a value is impossible, such as a negative mass.
        """
        where = "parameters"
        for name, affine in self.quantities.items():
            quantity, strict = QUANTITIES[name], self.strict[name]
            if quantity.least == "any":
                continue
            values = affine.numbers(p).reshape(-1, len(affine.constant))
            for row, item in np.argwhere(values < np.where(strict, SMALLEST, 0.0))[:1]:
                which = f" of {quantity.item} {item}" if quantity.item in GROUPED else ""
                where += f"[{row}]" if p.ndim > 1 else ""
                unit = "" if quantity.unit == "1" else f" {quantity.unit}"
                relation = "greater than" if strict[item] else "at least"
                raise ValueError(
                    f"{where}: {name}{which} is {values[row, item]:g}{unit}: it must be {relation} 0"
                )
        s = self.structure
        if s is not None and "body_inertia" in self.quantities:
            moments = self.quantities["body_inertia"].numbers(p).reshape(-1, len(s.bodies), 6)
            nominal = read_values(s, "body_inertia").reshape(-1, 6)
            check_inertia(where, build_inertia(moments), build_inertia(nominal))
        if s is not None and {"bar_mass", "node_mass"} & self.quantities.keys():
            masses = [
                self.item_values(name, p, getattr(s, name)) for name in ("bar_mass", "node_mass")
            ]
            check_mass_ratio(where, s, *masses)

    def __str__(self) -> str:
        width = max(map(len, self.names), default=0)
        return "\n".join(
            f"{name:<{width}}  {value:g} {unit}"
            for name, value, unit in zip(self.names, self.nominal, self.units, strict=True)
        )


EMPTY = ParameterLayout((), (), np.zeros(0), {}, {}, {})


class _ParameterBlock(NamedTuple):
    """Entries of p that belong to one quantity.

    The entries have `names` and `nominal` values. Item items[j] of the k items has the value
    weights[j] times entry entries[j]. Other items have their values in `constant`.
    """

    names: list[str]
    nominal: Array
    constant: Array  # (k,)
    items: Indices
    entries: Indices
    weights: Array


def build_layout(scene: Any, parameters: Parameters) -> ParameterLayout:
    """Build the layout of the parameters of a scene.

    Raises ValueError for a quantity that the scene does not have.
    """
    order = (*parameters.names, *parameters.scale)
    blocks = {name: _build_block(scene, parameters, name) for name in order}
    ends = dict(zip(order, np.cumsum([len(block.names) for block in blocks.values()]), strict=True))
    places = {
        name: slice(int(ends[name]) - len(blocks[name].names), int(ends[name])) for name in order
    }
    quantities, units = {}, []
    for name, block in blocks.items():
        index = block.items, places[name].start + block.entries
        shape = len(block.constant), int(ends[order[-1]])
        quantities[name] = Affine(block.constant, sp.csr_array((block.weights, index), shape=shape))
        unit = "1" if name in parameters.scale else QUANTITIES[name].unit
        units += [unit] * len(block.names)
    return ParameterLayout(
        tuple(name for block in blocks.values() for name in block.names),
        tuple(units),
        np.concatenate([block.nominal for block in blocks.values()]),
        quantities,
        places,
        {name: _find_strict(scene, name, len(own.constant)) for name, own in blocks.items()},
        scene.structure,
    )


def _build_block(scene: Any, parameters: Parameters, name: str) -> _ParameterBlock:
    values, labels = _read_items(scene, parameters, name)
    members, keys = _find_members(parameters, name, labels)
    scaled = name in parameters.scale
    for key, group in zip(keys, members, strict=True):
        own = values[group]
        if name in ELASTIC_BARS and not scene.structure.elastic[group].all():
            bar = group[~scene.structure.elastic[group]][0]
            raise ValueError(
                f"Parameters has {name!r}, but bar {bar} is rigid: give groups of elastic bars"
            )
        if name == "body_inertia" and not scaled:
            _reject_flat(scene.structure)
        if scaled and not own.any():
            raise ValueError(
                f"Parameters.scale has {name!r}, whose value{key} is 0: name it without scale="
            )
        if not scaled and np.ptp(own):
            raise ValueError(
                f"Parameters: the scene's {name}{key} differs, from {own.min():g} to {own.max():g}: "
                "give it under scale=, or equal values"
            )
    items = np.concatenate(members)
    constant = np.array(values, dtype=float)
    constant[items] = 0.0
    if name in ELASTIC_BARS:  # rigid bars have none
        constant[~scene.structure.elastic] = 0.0
    return _ParameterBlock(
        [f"{name}{' scale' if scaled else ''}{key}" for key in keys],
        np.array([1.0 if scaled else values[group[0]] for group in members]),
        constant,
        items,
        np.repeat(np.arange(len(members)), [len(group) for group in members]),
        values[items] if scaled else np.ones(len(items)),
    )


def _find_members(
    parameters: Parameters, name: str, labels: list[Any]
) -> tuple[list[Indices], list[str]]:
    """Find the items that share each entry of p.

    Items are, for example, strings. The quantity is called `name`, and its items have `labels`.
    Returns the item indices of each entry, and its index in names, such as "[3]", or "" for a
    single entry.
    """
    groups, count = dict(parameters.groups).get(name), len(labels)
    if groups == ((),) or labels == [""] or (groups is None and name in parameters.scale):
        return [np.arange(count)], [""]
    if groups is None:
        return [np.array([k]) for k in range(count)], [f"[{label}]" for label in labels]
    for g, group in enumerate(groups):
        for index in group:
            node_index(f"Parameters.groups[{name!r}][{g}]", index, count, QUANTITIES[name].item)
    return [np.array(group) for group in groups], [f"[{g}]" for g in range(len(groups))]


def _read_items(scene: Any, parameters: Parameters, name: str) -> tuple[Array, list[Any]]:
    """Read the values of a quantity, and the labels of its items.

    `name` is that of the quantity. A load with a scale has the single value 1. Raises ValueError if
    the scene does not have the quantity.
    """
    part = QUANTITIES[name].part
    source = getattr(scene, part)
    missing = "" if source is not None else f"Scene.{part} is None: give one"
    values: Any = []
    if part == "structure":
        values = read_values(source, name)
        missing = "" if len(values) else f"the structure has no {_plural(name)}"
    elif part == "ground":
        values = [getattr(ground, name.removeprefix("ground_")) for ground in scene.grounds]
        missing = missing or (
            "Ground.friction is None: give a coefficient" if None in values else ""
        )
    elif part == "bar_contact":
        values = [getattr(source, name.removeprefix("bar_contact_"), None)]
        missing = missing or (
            "BarContact.friction is None: give a coefficient" if None in values else ""
        )
    if missing:
        cure = ", or remove the name" if ": " in missing else ": remove the name"
        raise ValueError(f"Parameters has {name!r}, but {missing}{cure}")
    if name == "body_inertia":
        return values, [f"{body}, {axes}" for body in range(len(values) // 6) for axes in MOMENTS]
    if part in ("structure", "ground", "bar_contact"):
        single = part != "structure" and len(values) == 1
        return np.array(values), [""] if single else list(range(len(values)))
    if name in parameters.scale:  # a factor of the whole load, which can vary over time
        return np.ones(1), [""]
    if source.varies:
        raise ValueError(
            f"Parameters has {name!r}, but {source.field} varies over time: "
            f"name {name!r} under scale="
        )
    values = np.asarray(source.quantity, dtype=float)
    nodes = [f"{node}, " for node in range(len(values))] if values.ndim == 2 else [""]
    axes = "xyz" if values.ndim else [""]
    return values.ravel(), [node + axis for node in nodes for axis in axes]


def _plural(name: str) -> str:
    item = QUANTITIES[name].item
    return "bodies" if name in BODIES else f"{item}s"


def _reject_flat(structure: Any) -> None:
    """Reject single inertia parameters of flat bodies.

    The moments of inertia of bodies without thickness are not independent.
    """
    inertia = build_inertia(read_values(structure, "body_inertia").reshape(-1, 6))
    for k, moments in enumerate(find_second_moments(inertia)):
        if moments[0] < NEGLIGIBLE * moments.sum():
            raise ValueError(
                f"Parameters has 'body_inertia', but bodies[{k}] has no thickness: "
                "name it under scale=, or give an inertia with thickness"
            )


def _find_strict(scene: Any, name: str, count: int) -> Any:
    """Find which items of a quantity must be greater than 0.

    `name` is that of the quantity. Returns Booleans (count,).
    """
    s = scene.structure
    if name == "node_mass":  # nodes without mass of bars or strings
        bare = ~s.fixed.all(axis=1)
        bare[s.bars] = False
        bare[[node for body in s.bodies for node in body.nodes]] = False
        bare[s.strings[s.string_mass > SMALLEST]] = False
        return bare
    if name == "string_mass":  # strings with inner nodes
        return np.bincount(scene.modelled.string_parent, minlength=count) > 1
    if name in ELASTIC_BARS:  # rigid bars have none
        return s.elastic
    return np.full(count, QUANTITIES[name].least == "positive")

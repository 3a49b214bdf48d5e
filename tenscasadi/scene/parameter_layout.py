"""The parameter vector p of a scene: its entries, how quantities follow from it, and its checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse as sp

from tenscasadi.scene.parameters import GROUPED, QUANTITIES, Parameters
from tenscasadi.structure.structure import Structure
from tenscasadi.util.casadi_tools import sparse
from tenscasadi.util.read_only import ReadOnlyArrays
from tenscasadi.util.validate import SMALLEST, Array, Indices, finite_array, nesting, shown

HEAVIEST = (
    1e12  # times the lightest bar: what rounding leaves of a bar that is heavier does not hold it
)


class Affine(NamedTuple):
    """Values of the items of a quantity, constant + matrix · p: all parameters enter so."""

    constant: Array  # (k,)
    matrix: sp.csr_array  # k×np

    def numbers(self, p: Array) -> Array:
        """Return the values (…, k) for parameters p (…, np)."""
        return np.asarray(
            self.constant + (self.matrix @ p.reshape(-1, self.matrix.shape[1]).T).T
        ).reshape(*p.shape[:-1], len(self.constant))

    def expression(self, p: Any) -> Any:
        """Return the values (k×1) for a CasADi column p: 1×1 where all are the same."""
        same = (
            len(self.constant) > 1
            and not np.ptp(self.constant)
            and not (self.matrix - self.matrix[[0] * len(self.constant)]).nnz
        )
        constant, matrix = (self.constant[:1], self.matrix[:1]) if same else self
        value = ca.mtimes(sparse(matrix), p)
        return ca.densify(value + ca.DM(constant) if constant.any() else value)

    def then(self, matrix: Any) -> Affine:
        """Return matrix · values."""
        return Affine(np.asarray(matrix @ self.constant), sp.csr_array(matrix @ self.matrix))


@dataclass(frozen=True, eq=False)
class ParameterLayout(ReadOnlyArrays):
    """The parameter vector p of a model: names, units and nominal values of its entries.

    `Model.parameters` is one; it is empty for a scene without `Parameters`.

    Attributes
    ----------
    names : tuple of str, length np
        What each entry is: ``"stiffness[3]"`` of string 3, ``"bar_mass"`` of all bars, ``"damping
        scale[1]"`` of group 1.
    units : tuple of str, length np
        Unit of each entry; "1" for scales.
    nominal : ndarray, shape (np,)
        Values with which the model is that of its scene.
    quantities : dict of str to Affine
        How the items of each quantity follow from p.
    places : dict of str to slice
        The entries of each quantity.
    strict : dict of str to ndarray of bool
        The items of each quantity that must be greater than 0.
    structure : Structure or None
        The structure whose items these are; None where there are no parameters.

    See Also
    --------
    Parameters : Which quantities are parameters.

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
        """Return the vector p, checked.

        Parameters
        ----------
        given : array_like, shape (np,), or mapping of str to array_like, optional
            All entries, or those of some quantities by name, one number for all of a quantity's or
            one each; others are nominal, as are all if None.
        **changes : array_like
            Quantities by name, changed after that.

        Returns
        -------
        ndarray, shape (np,)
            Values.

        Raises
        ------
        TypeError, ValueError
            Where a name is no parameter, a shape does not fit, a number is not finite or has no
            physical meaning, by its name.
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
                    f"parameters has {shown(name)}: the parameters of this model are {known}"
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
        """Return the values of the items of a quantity.

        Parameters
        ----------
        name : str
            Quantity.
        p : ndarray, shape (np,)
            Parameters.
        constant : ndarray, shape (k,)
            The scene's own values, which it has where it is no parameter.

        Returns
        -------
        ndarray, shape (k,)
            Values of its items.
        """
        return self.quantities[name].numbers(p) if name in self.quantities else constant.copy()

    def check(self, p: Array) -> None:
        """Raise ValueError, naming quantity and item, where parameters have no physical meaning, such as a negative mass.

        Parameters
        ----------
        p : ndarray, shape (..., np)
            Parameters, one row or many.
        """
        for name, affine in self.quantities.items():
            quantity = QUANTITIES[name]
            if quantity.least == "any":
                continue
            values = affine.numbers(p).reshape(-1, len(affine.constant))
            strict = self.strict[name]
            for row, item in np.argwhere(values < np.where(strict, SMALLEST, 0.0))[:1]:
                which = f" of {quantity.item} {item}" if quantity.item in GROUPED else ""
                where = "parameters" if p.ndim == 1 else f"parameters[{row}]"
                unit = "" if quantity.unit == "1" else f" {quantity.unit}"
                relation = "greater than" if strict[item] else "at least"
                raise ValueError(
                    f"{where}: {name}{which} is {values[row, item]:g}{unit}: it must be {relation} 0"
                )

        if self.structure is not None and {"bar_mass", "node_mass"} & self.quantities.keys():
            self._check_ratio(self.structure, p)

    def _check_ratio(self, s: Structure, p: Array) -> None:
        """Raise ValueError where a bar that can move is more than `HEAVIEST` times as heavy as another, both with the nodes at its ends."""
        masses = [
            self.quantities[name].numbers(p) if name in self.quantities else getattr(s, name)
            for name in ("bar_mass", "node_mass")
        ]
        moving = np.flatnonzero(~s.fixed[s.bars].all(axis=(1, 2)))
        if len(moving) < 2:
            return
        weights = (masses[0] + masses[1][..., s.bars].sum(axis=-1))[..., moving].reshape(
            -1, len(moving)
        )
        ratio = weights.max(axis=1, initial=0.0) / weights.min(axis=1, initial=np.inf)
        for row in np.flatnonzero(ratio > HEAVIEST)[:1]:
            heavy, light = moving[weights[row].argmax()], moving[weights[row].argmin()]
            raise ValueError(
                f"parameters: bar {heavy} is {ratio[row]:.1g} times as heavy as bar {light}, with the nodes at their ends: rounding leaves no room "
                f"above {HEAVIEST:g}, pin what is so heavy or give masses nearer to each other"
            )

    def __str__(self) -> str:
        width = max(map(len, self.names), default=0)
        return "\n".join(
            f"{name:<{width}}  {value:g} {unit}"
            for name, value, unit in zip(self.names, self.nominal, self.units, strict=True)
        )


def lay_out(scene: Any, parameters: Parameters) -> ParameterLayout:
    """Return the vector that `parameters` make of a scene's quantities, in their order. Raises ValueError where a quantity is not there."""
    entries = [
        (name, _entries(scene, parameters, name)) for name in (*parameters.names, *parameters.scale)
    ]
    count = sum(len(entry.nominal) for _, entry in entries)
    names: list[str] = []
    units: list[str] = []
    nominal: list[Array] = []
    quantities, places, strict = {}, {}, {}
    first = 0
    for name, entry in entries:
        last = first + len(entry.nominal)
        matrix = sp.csr_array(
            (entry.weight, (entry.item, first + entry.place)), shape=(len(entry.constant), count)
        )
        quantities[name], places[name] = Affine(entry.constant, matrix), slice(first, last)
        strict[name] = _strict_items(scene, name, len(entry.constant))
        names += entry.names
        units += ["1" if name in parameters.scale else QUANTITIES[name].unit] * (last - first)
        nominal.append(entry.nominal)
        first = last
    return ParameterLayout(
        tuple(names),
        tuple(units),
        np.concatenate(nominal),
        quantities,
        places,
        strict,
        scene.structure,
    )


EMPTY = ParameterLayout((), (), np.zeros(0), {}, {}, {})


class _Entries(NamedTuple):
    """Entries of p for a quantity of k items: item[j] follows entry place[j] with a weight; other items are constant."""

    names: list[str]
    nominal: Array
    constant: Array  # (k,)
    item: Indices
    place: Indices
    weight: Array


def _entries(scene: Any, parameters: Parameters, name: str) -> _Entries:
    values, labels = _nominal_items(scene, parameters, name)
    members, keys = _members(parameters, name, labels)
    scaled = name in parameters.scale
    own = [values[group] for group in members]
    for key, group in zip(keys, own, strict=True):
        if scaled and not group.any():
            raise ValueError(
                f"Parameters.scale has {name!r}, whose value{key} is 0: name it without scale="
            )
        if not scaled and np.ptp(group):
            low, high = group.min(), group.max()
            raise ValueError(
                f"Parameters: the scene's {name}{key} differs, from {low:g} to {high:g}: give it under scale=, or equal values"
            )
    item = np.concatenate(members)
    constant = np.array(values, dtype=float)
    constant[item] = 0.0
    place = np.repeat(np.arange(len(members)), [len(group) for group in members])
    if scaled:
        return _Entries(
            [f"{name} scale{key}" for key in keys],
            np.ones(len(keys)),
            constant,
            item,
            place,
            values[item],
        )
    return _Entries(
        [name + key for key in keys],
        np.array([group[0] for group in own]),
        constant,
        item,
        place,
        np.ones(len(item)),
    )


def _members(
    parameters: Parameters, name: str, labels: list[Any]
) -> tuple[list[Indices], list[str]]:
    """Return the items that follow each entry of a quantity, and how the entries' names end."""
    groups, count = dict(parameters.groups).get(name), len(labels)
    if groups == ((),) or labels == [""] or (groups is None and name in parameters.scale):
        return [np.arange(count)], [""]
    if groups is None:
        return [np.array([k]) for k in range(count)], [f"[{label}]" for label in labels]
    for g, group in enumerate(groups):
        if max(group) >= count:
            item = QUANTITIES[name].item
            raise ValueError(
                f"Parameters.groups[{name!r}][{g}] has index {max(group)}: {item}s run from 0 to {count - 1}"
            )
    return [np.array(group) for group in groups], [f"[{g}]" for g in range(len(groups))]


def _nominal_items(scene: Any, parameters: Parameters, name: str) -> tuple[Array, list[Any]]:
    """Return the scene's own values of the items of a quantity, and what to call the items."""
    part = QUANTITIES[name].part
    source = getattr(scene, part)
    if source is None:
        raise ValueError(
            f"Parameters has {name!r}, but Scene.{part} is None: give one, or leave the name out"
        )
    if part == "structure":
        values = np.asarray(getattr(source, name))
        if not len(values):
            raise ValueError(
                f"Parameters has {name!r}, but the structure has no {QUANTITIES[name].item}s: leave the name out"
            )
        return values, list(range(len(values)))
    if part == "ground":
        each = [getattr(ground, name.removeprefix("ground_")) for ground in scene.grounds]
        if None in each:
            raise ValueError(
                f"Parameters has {name!r}, but Ground.friction is None: give a coefficient, or leave the name out"
            )
        return np.array(each), [""] if len(each) == 1 else list(range(len(each)))
    if name in parameters.scale:  # of a load as a whole, which may depend on time
        return np.ones(1), [""]
    if source.varies:
        raise ValueError(
            f"Parameters has {name!r}, but {source.field} changes over time: name {name!r} under scale="
        )
    if part == "gravity":
        return np.asarray(source.acceleration), ["x", "y", "z"]
    if part == "pressure":
        return np.array([source.difference]), [""]
    return np.asarray(source.values).ravel(), [
        f"{node}, {axis}" for node in range(len(source.values)) for axis in "xyz"
    ]


def _strict_items(scene: Any, name: str, count: int) -> Any:
    """Tell which items must be greater than 0 (count,): masses where nothing else makes a node heavy, too."""
    s = scene.structure
    if name == "node_mass":  # as the structure itself asks
        bare = ~s.fixed.all(axis=1)
        bare[s.bars] = False
        bare[s.strings[s.string_mass > SMALLEST]] = False
        return bare
    if name == "string_mass":  # nodes inside strings need one
        return np.bincount(scene.modelled.string_parent, minlength=count) > 1
    return np.full(count, QUANTITIES[name].least == "positive")

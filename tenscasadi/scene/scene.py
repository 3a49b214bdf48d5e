"""Class `Scene`: a structure with its control, loads and supports."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Literal, cast

import numpy as np

from tenscasadi.scene.bar_contact import BarContact
from tenscasadi.scene.binding import declare_internal_states
from tenscasadi.scene.breaking import Strength
from tenscasadi.scene.control import Control
from tenscasadi.scene.ground import Surface, read_grounds
from tenscasadi.scene.internal_states import InternalStates
from tenscasadi.scene.loads import Gravity, NodalForce, Pressure
from tenscasadi.scene.parameter_layout import EMPTY, ParameterLayout, build_layout
from tenscasadi.scene.parameters import Parameters
from tenscasadi.scene.slack import read_slack
from tenscasadi.scene.strength import find_limited
from tenscasadi.scene.strings import Clip, ForceDensity, StringLaw
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.schema.containers import Either, MapOf
from tenscasadi.schema.definitions import OneOf, definition, resolve_fields
from tenscasadi.schema.field_types import ElsewhereInFile, ListOf
from tenscasadi.schema.value import Value
from tenscasadi.structure.cables import select_first
from tenscasadi.structure.names import name_errors
from tenscasadi.structure.structure import Structure
from tenscasadi.structure.subdivision import segment_counts, segment_shares
from tenscasadi.util.immutable import read_only
from tenscasadi.util.renamed import RenamedAttribute
from tenscasadi.util.validate import Array, IndexOrName, Indices, instance
from tenscasadi.util.viewable import Viewable


@dataclass(frozen=True)
class Scene(Value, Viewable, kind="Scene"):
    """Structure with its control, string laws, loads and supports.

    Parameters
    ----------
    structure : Structure
        Structure with its initial nodes.
    control : ForceDensity, Tension, RestLength, RestLengthRate or Winch, optional
        Kind of control. Default: strings keep the structure's rest lengths.
    segments : int or sequence of int, shape (α,)
        Number of segments of each string.
    ends : {"interior", "lumped", "consistent"}
        Distribution of a string's mass, see `Structure.subdivide`.
    gravity : Gravity, optional
        Gravity.
    ground : Ground or Terrain or a sequence of them, optional
        Planes and height fields that nodes and bars can touch.
    pressure : Pressure, optional
        Pressure on triangles.
    forces : NodalForce, optional
        Forces on nodes.
    slack : Clip, Smooth or Linear, or a sequence or mapping of them
        Law of all strings, or of each. Strings that a mapping such as ``{3: tc.Linear()}`` does not
        name have `Clip()`. Force-density control does not use it.
    supports : SupportMotion, optional
        Motion of pinned nodes.
    fractions : sequence of float, shape (segments,), optional
        Fractions of a string's length that its segments have. Default: equal.
    parameters : Parameters, optional
        Quantities whose values each run can set. Default: all are constant.
    bar_contact : BarContact, optional
        Contact of bars with each other. Default: bars pass through each other.
    strength : Breaking or Yielding, optional
        Tensions at which strings break or yield. Default: strings carry any tension.

    Raises
    ------
    TypeError, ValueError
        If a field is wrong or does not fit the structure.

    Examples
    --------
    >>> import tenscasadi as tc
    >>> prism = tc.shapes.prism(string_mass=0.1)
    >>> scene = tc.Scene(prism, control=tc.RestLength(), segments=2, gravity=tc.Gravity())
    >>> len(scene.structure.strings), len(scene.modelled.strings)
    (9, 18)
    """

    structure: Annotated[Structure, ElsewhereInFile()]
    control: Control | None = None
    segments: int | Sequence[int] = 1
    ends: Literal["interior", "lumped", "consistent"] = "interior"
    gravity: Gravity | None = None
    ground: Surface | Sequence[Surface] | None = None
    pressure: Pressure | None = None
    forces: NodalForce | None = None
    slack: Annotated[
        StringLaw | Sequence[StringLaw] | Mapping[IndexOrName, StringLaw],
        Either(
            (Mapping,),
            MapOf("string", OneOf(StringLaw)),
            Either((list,), ListOf(OneOf(StringLaw)), OneOf(StringLaw)),
            unless="kind",
        ),
    ] = field(default_factory=Clip)
    supports: SupportMotion | None = None
    fractions: Sequence[float] | None = None
    parameters: Parameters | None = None
    bar_contact: BarContact | None = None
    strength: Strength | None = None

    @name_errors
    def __post_init__(self) -> None:
        instance("Scene.structure", self.structure, Structure, "a tenscasadi.Structure")
        vars(self).update(resolve_fields(definition(Scene), vars(self), self.structure.names))
        for name, kind in {
            "gravity": Gravity,
            "pressure": Pressure,
            "forces": NodalForce,
            "supports": SupportMotion,
            "bar_contact": BarContact,
        }.items():
            value = getattr(self, name)
            if value is not None:
                instance(f"Scene.{name}", value, kind, f"a tenscasadi.{kind.__name__} or None")
        if self.control is not None:
            kinds = "RestLength(), RestLengthRate(), Winch(), Tension(), ForceDensity() or None"
            instance("Scene.control", self.control, Control, kinds)
            self.control.check(self.nu)
        object.__setattr__(self, "slack", read_slack(self.slack, len(self.structure.strings)))
        self._check_cables()
        if not isinstance(self.ground, Surface):
            grounds = read_grounds(self.ground)
            object.__setattr__(
                self, "ground", (grounds if len(grounds) != 1 else grounds[0]) or None
            )
        for ground in self.grounds:
            ground.check(self.structure)
        if self.pressure is not None:
            self.pressure.check(len(self.structure.nodes))
        if self.forces is not None:
            self.forces.check(len(self.structure.nodes), self.structure.bars)
        if self.supports is not None:
            self.supports.check(self.structure)
        if self.bar_contact is not None:
            self.bar_contact.check(self.structure)
        if self.strength is not None:
            instance("Scene.strength", self.strength, Strength, "Breaking(), Yielding() or None")
            self.strength.check(len(self.structure.strings))
            if self.commands_forces and not self.strength.breaks:
                raise ValueError(
                    f"Scene.strength is {self.strength}, and the control commands forces: "
                    "give control=RestLength(), or Breaking()"
                )
        if self.parameters is not None:
            instance(
                "Scene.parameters",
                self.parameters,
                Parameters,
                'tenscasadi.Parameters("stiffness") or None',
            )
        _ = self.modelled, self.layout  # raises errors here instead of at first use

    def _check_cables(self) -> None:
        """Check that a cable has one law and one control.

        Raises ValueError.
        """
        cables = self.structure.cables
        if cables and isinstance(self.control, ForceDensity):
            raise ValueError(
                "Scene.control is ForceDensity(), but the structure has cables, whose strings "
                "have one tension: give Tension() or RestLength()"
            )
        for k, cable in enumerate(cables if isinstance(self.slack, tuple) else ()):
            laws = [cast("tuple[StringLaw, ...]", self.slack)[string] for string in cable]
            if len(set(laws)) > 1:
                raise ValueError(
                    f"Scene.slack has {laws[0]} and {next(law for law in laws if law != laws[0])} "
                    f"in cables[{k}]: give one law to strings {list(cable)}"
                )

    def to_fields(self) -> dict[str, Any]:
        """Return the fields as a dictionary, with string laws by string.

        Strings with the default law `Clip()` are omitted.
        """
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        if isinstance(self.slack, tuple):
            own["slack"] = {k: law for k, law in enumerate(self.slack) if law != Clip()}
        return own

    @cached_property
    def modelled(self) -> Structure:
        """Structure of the model, whose strings are divided into segments."""
        return self.structure.subdivide(self.segments, self.ends, self.fractions)

    @cached_property
    def segment_fractions(self) -> tuple[Array, ...]:
        """Segment lengths of each string as fractions of its length."""
        counts = segment_counts(self.segments, len(self.structure.strings))
        shares: tuple[Array, ...] = read_only(
            tuple(segment_shares(count, self.fractions) for count in counts)
        )
        return shares

    @cached_property
    def first_strings(self) -> Indices:
        """First modeled string of each cable and of strings in no cable.

        The order is that of the control inputs.
        """
        return select_first(self.modelled.cable_of)

    @property
    def winch_strings(self) -> Indices:
        """Index of the modeled string (nu,) at each control input's winch.

        In a cable it is the first string.
        """
        first = select_first(self.input_of)
        for own in self.modelled.cables:
            first[self.input_of[own[0]]] = own[0]
        return first

    @property
    def input_of(self) -> Indices:
        """Index of the control input (α,) that acts on each modeled string."""
        return self.structure.cable_of[self.modelled.string_parent]

    @property
    def rest_shares(self) -> Array:
        """Fraction (α,) of its cable's rest length in each modeled string."""
        s = self.modelled
        shares = s.string_fraction.copy()
        for cable in map(list, s.cables):
            shares[cable] = s.rest_length[cable] / s.rest_length[cable].sum()
        return shares

    @cached_property
    def string_laws(self) -> list[tuple[StringLaw, Indices]]:
        """String laws, each with the indices of its modeled strings.

        The list is empty if the control prescribes forces.
        """
        count = len(self.modelled.strings)
        if self.commands_forces:
            return []
        if isinstance(self.slack, StringLaw):
            return [(self.slack, np.arange(count))]
        given = cast("tuple[StringLaw, ...]", self.slack)
        own = zip(given, self.segment_fractions, strict=True)
        laws = [law for law, fractions in own for _ in fractions]
        return [
            (law, np.array([i for i, other in enumerate(laws) if other == law]))
            for law in dict.fromkeys(laws)
        ]

    @property
    def commands_forces(self) -> bool:
        """Whether the control prescribes string forces instead of string laws."""
        return self.control is not None and self.control.commands_forces

    @property
    def input_laws(self) -> list[tuple[StringLaw, Indices]]:
        """String laws, each with the indices of its cables.

        Strings that belong to no cable are counted as cables of one string.
        """
        of = self.modelled.cable_of
        return [(law, np.unique(of[which])) for law, which in self.string_laws]

    @property
    def switching_inputs(self) -> Indices:
        """Indices of cables, and of strings in no cable, that can go slack."""
        return np.unique(self.modelled.cable_of[self.switching_strings])

    @property
    def switching_strings(self) -> Indices:
        """Indices of the modeled strings that can go slack."""
        return self._strings_with("switches")

    @property
    def clamped_strings(self) -> Indices:
        """Indices of the modeled strings with clamped damping.

        Damping cannot make their tension negative.
        """
        return self._strings_with("clamps")

    @property
    def compression_strings(self) -> Indices:
        """Indices of the modeled strings that can carry compression."""
        return self._strings_with("pushes")

    pushing_strings = RenamedAttribute("compression_strings")

    @cached_property
    def layout(self) -> ParameterLayout:
        """Layout of the parameter vector p, `Model.parameters`."""
        return EMPTY if self.parameters is None else build_layout(self, self.parameters)

    @cached_property
    def internal_states(self) -> tuple[InternalStates, ...]:
        """Internal states besides positions and velocities, such as rest lengths."""
        return declare_internal_states(self, self.layout.nominal)

    @cached_property
    def locked(self) -> Scene:
        """Scene for statics, without internal states.

        Winches are locked, and no string fails.
        """
        control = self.control and self.control.locked
        if control is self.control and self.strength is None:
            return self
        return replace(self, control=control, strength=None)

    def has_parameter(self, name: str) -> bool:
        """Return whether a quantity is a parameter.

        Parameters
        ----------
        name : str
            Quantity, see `Parameters`.

        Returns
        -------
        bool
            Whether p has the quantity or its scale.
        """
        return self.parameters is not None and name in self.parameters

    @cached_property
    def limited_inputs(self) -> Indices:
        """Indices of cables, and of strings in no cable, that can fail.

        They can break or yield.
        """
        found: Indices = read_only(find_limited(self))
        return found

    @property
    def breakable_inputs(self) -> Indices:
        """Indices of cables, and of strings in no cable, that can break."""
        breaks = self.strength is not None and self.strength.breaks
        return self.limited_inputs if breaks else self.limited_inputs[:0]

    @property
    def nu(self) -> int:
        """Number of control inputs."""
        return 0 if self.control is None else len(select_first(self.structure.cable_of))

    @property
    def grounds(self) -> tuple[Surface, ...]:
        """All grounds."""
        return read_grounds(self.ground)

    @property
    def contact_laws(self) -> tuple[Surface | BarContact, ...]:
        """Contact laws: those of the grounds, then that of bar contact."""
        return (*self.grounds, *([] if self.bar_contact is None else [self.bar_contact]))

    @property
    def has_clock(self) -> bool:
        """Whether any part of the scene depends on time."""
        return bool(self.over_time)

    @property
    def over_time(self) -> list[Gravity | Pressure | NodalForce | SupportMotion]:
        """Time-varying loads and support motions."""
        loads = [
            load
            for load in (self.gravity, self.pressure, self.forces)
            if load is not None and load.varies
        ]
        return [*loads, *([] if self.supports is None else [self.supports])]

    def _strings_with(self, property_of_law: str) -> Indices:
        none = np.zeros(0, dtype=np.intp)
        return np.sort(
            np.concatenate(
                [none, *(which for law, which in self.string_laws if getattr(law, property_of_law))]
            )
        )

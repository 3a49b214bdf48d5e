"""A scene: which structure, driven how, under which loads, and how finely its strings are modelled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from tenscasadi.scene.loads import Gravity, Ground, NodalForce, Pressure
from tenscasadi.scene.strings import Clip, Control, ForceDensity, RestLength, Slack, Smooth
from tenscasadi.scene.supports import SupportMotion
from tenscasadi.structure.structure import Structure
from tenscasadi.util.validate import instance


@dataclass(frozen=True)
class Scene:
    """What is modelled, and how finely. What is None is not modelled and builds no expression.

    `control`: `ForceDensity()`, `RestLength()`, or None: strings keep the structure's rest lengths and there is no input.
    `segments`: pieces that each string is modelled by, one number or one per string; `ends`: where the string's mass goes,
    "interior" (m/(n−1) on inner nodes, the paper's §5; one segment is massless) or "lumped" (m/n inside, m/2n on the ends).
    `fractions`: the segments' shares of each string, from its first node to its second (they sum to 1); None: equal.
    `gravity`, `ground`, `pressure`, `forces`: loads; `slack`: `Clip()` (exact) or `Smooth(width)` (for optimisers);
    `supports`: motion of pinned nodes.
    Raises TypeError, ValueError.
    """

    structure: Structure
    control: Control | None = None
    segments: int | Sequence[int] = 1
    ends: Literal["interior", "lumped"] = "interior"
    gravity: Gravity | None = None
    ground: Ground | None = None
    pressure: Pressure | None = None
    forces: NodalForce | None = None
    slack: Slack = field(default_factory=Clip)
    supports: SupportMotion | None = None
    fractions: Sequence[float] | None = None

    def __post_init__(self) -> None:
        instance("Scene.structure", self.structure, Structure, "a tenscasadi.Structure")
        for name, kind in {"gravity": Gravity, "ground": Ground, "pressure": Pressure, "forces": NodalForce, "supports": SupportMotion}.items():
            value = getattr(self, name)
            if value is not None:
                instance(f"Scene.{name}", value, kind, f"a tenscasadi.{kind.__name__} or None")
        if self.control is not None:
            instance("Scene.control", self.control, (ForceDensity, RestLength), "ForceDensity(), RestLength() or None")
        instance("Scene.slack", self.slack, (Clip, Smooth), "Clip() or Smooth(width)")
        for load in (self.pressure, self.forces):
            if load is not None:
                load.check(len(self.structure.nodes))
        if self.supports is not None:
            self.supports.check(self.structure)
        _ = self.modelled  # subdivides now, so that a fault shows here

    @cached_property
    def modelled(self) -> Structure:
        """The structure with its strings cut into `segments`: what the model's nodes and strings are."""
        return self.structure.subdivide(self.segments, self.ends, self.fractions)

    @property
    def has_clock(self) -> bool:
        """Whether anything depends on time."""
        return self.supports is not None or (self.forces is not None and self.forces.varies)

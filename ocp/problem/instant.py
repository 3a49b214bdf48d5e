"""What a plan is at one instant: nodes, lengths, forces, as CasADi expressions that are built only where something asks for them."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from tenscasadi.dynamics.model import Model


class Instant:
    """state (nx), control γ (α,) N/m and time s of `model`, CasADi or numbers, and what follows from them."""

    def __init__(self, model: Model, state: Any, control: Any, time: Any) -> None:
        self.model, self.state, self.control, self.time = model, state, control, time

    @property
    def symbols(self) -> tuple[Any, Any, Any]:
        """State, control and time."""
        return self.state, self.control, self.time

    @cached_property
    def nodes(self) -> Any:
        """Nodes 3×n of the scene's structure, m."""
        return self.model.nodes(self.state)[:, : len(self.model.scene.structure.nodes)]

    @cached_property
    def velocities(self) -> Any:
        """Velocities 3×n of these nodes, m/s."""
        return self.model.velocities(self.state)[:, : len(self.model.scene.structure.nodes)]

    @cached_property
    def lengths(self) -> Any:
        """Distances (α,) between the ends of the strings, m."""
        return norms(self._across(self.nodes, self.model.scene.structure.strings))

    @cached_property
    def rates(self) -> Any:
        """How fast these distances grow (α,), m/s."""
        strings = self.model.scene.structure.strings
        return ca.sum1(self._across(self.nodes, strings) * self._across(self.velocities, strings)).T / self.lengths

    @cached_property
    def tension(self) -> Any:
        """Tensions of the modelled strings, N: one for each segment, in the order of `model.structure.strings`."""
        return self.model.tension(self.state, self.control)

    @cached_property
    def bar_force(self) -> Any:
        """Forces of the bars (β,), N, positive in compression: λ ‖b‖."""
        b = self._across(self.nodes, self.model.scene.structure.bars)
        return self.model.multiplier_function(self.state, self.control)[0] * norms(b)

    def rest_lengths(self, stiffness: Any) -> Any:
        """ρ (α,), m, that give γ to strings of `stiffness` (α,), N/m (Eq. 99); summed over the segments of a string."""
        s = self.model.structure
        along = norms(self._across(self.model.nodes(self.state), s.strings))
        whole = ca.DM(np.asarray(stiffness)[s.string_parent] / s.string_fraction)
        parts = along - self.tension / whole  # s (1 − γ/k)
        gather = ca.DM((np.arange(len(self.model.scene.structure.strings))[:, None] == s.string_parent[None]).astype(float))
        return ca.mtimes(ca.sparsify(gather), parts)

    def _across(self, columns: Any, pairs: Any) -> Any:
        return columns[:, pairs[:, 1].tolist()] - columns[:, pairs[:, 0].tolist()]


def norms(vectors: Any) -> Any:
    """Lengths (m,) of the columns of a 3×m expression."""
    return ca.sqrt(ca.sum1(vectors * vectors)).T


def symbolic(model: Model) -> Instant:
    """An instant of symbols: SX where the model's equations are, MX for large ones."""
    kind: Any = ca.SX if model.ode.is_a("SXFunction") and model.observe.is_a("SXFunction") else ca.MX
    return Instant(model, kind.sym("x", model.nx), kind.sym("u", model.nu), kind.sym("t"))

"""What constraints cost at an optimum: multipliers by name, in physical units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscasadi.util.validate import Array, instance


@dataclass(frozen=True, eq=False)
class Duals:
    """Multipliers λ of J + Σ λ c, with J the objective and c what is limited: > 0 where an upper limit holds, < 0 where a lower one does.

    Where a limit, or the value that a goal wants, rises by δ, the least J changes by −λ δ, to first order. names (m,), values (m,): first
    limits and the motion, then goals, then the n unknowns of the program. Units: J per unit of what is limited (N/m, N, m, m/s); of goals
    per m or m/s, as far as bars and momenta let them give; of the motion with `MultipleShooting` per unit of the state (costates), with
    others in the scale of their rows. point (n,): the unknowns at the optimum.
    """

    names: tuple[str, ...]
    values: Array
    point: Array

    def __repr__(self) -> str:
        return f"Duals({len(self.names)} multipliers, {len(self.point)} unknowns)"

    def __getitem__(self, name: str) -> Array:
        """All multipliers of one name, in the order of time: duals["tension of string 3"]. Raises TypeError, KeyError."""
        instance("Duals[name]", name, str, 'one of Duals.names, such as duals["tension of string 3"]')
        found = [k for k, own in enumerate(self.names) if own == name or own.startswith(f"{name}, ")]
        if not found:
            examples = sorted({own.split(",")[0] for own in self.names if own.split(" ")[0] == name.split(" ")[0]})
            raise KeyError(f"{name!r} has no multiplier: give " + (" or ".join(map(repr, examples[:3])) if examples else "one of Duals.names"))
        return np.asarray(self.values[found])

"""Instruction counts of Functions and of right-hand-side terms."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi as ca

from tenscasadi.dynamics import forces
from tenscasadi.dynamics.force_element import NodeMotion
from tenscasadi.scene.dissipation import is_damped

if TYPE_CHECKING:
    from tenscasadi.dynamics.state_space import StateSpace


class TermCounts(dict[str, int]):
    """Instruction counts by term, which print as a table.

    Attributes
    ----------
    advice : str
        Recommendation of cheaper coordinates, or "".
    """

    advice: str = ""

    def __str__(self) -> str:
        width = max(map(len, self), default=0)
        rows = [f"{name:<{width}}  {count:>8}" for name, count in self.items()]
        return "\n".join([*rows, self.advice] if self.advice else rows)


def count_instructions(function: ca.Function) -> int:
    """Count the instructions of a Function, including called Functions."""
    count = int(function.n_instructions())
    if function.class_name() != "MXFunction":
        return count
    for k in range(function.n_instructions()):
        if function.instruction_id(k) == ca.OP_CALL:
            count += count_instructions(function.instruction_MX(k).which_function())
    return count


def count_terms(space: StateSpace, ode: ca.Function, advice: str) -> TermCounts:
    """Count the instructions of each term of the right-hand side.

    `space` is the model without its Functions, `ode` its right-hand side, and `advice` the
    recommendation that the result shows.
    """
    scene = space.scene
    x, u = space.symbols(not space.mechanism.large)
    mech = space.with_masses(u, inverse=False)
    N, V, time = space.unpack(x)
    at, built = NodeMotion(N, V, time), {}
    for element in forces.build_elements(scene, mech, space.extend_inputs(x, u)):
        name = element.name
        if isinstance(element, forces.StringForces):
            name = (
                f"string {scene.control.quantity}"
                if scene.control and scene.commands_forces
                else "string elasticity"
            )
            if is_damped(scene):
                built[name], name = replace(element, damped=False).forces(at), "string damping"
        built[name] = built.get(name, 0) + element.forces(at)
    counts = TermCounts()
    outputs: dict[str, Any] = {}
    before = 0
    for name, expression in built.items():
        if name == "string damping":  # counted as the difference of the whole law to elasticity
            outputs.pop("string elasticity")
        # forces on pinned nodes are not needed
        outputs[name] = mech.generalized_forces(expression)
        count = ca.Function("terms", [x, u], ca.cse(list(outputs.values()))).n_instructions()
        counts[name] = count - before
        before = count
    total = count_instructions(ode)
    rest = "inverse mass"
    if mech.constrained:
        rest = "bars (λ)" + (" and joints (Ω)" if mech.joints else "") + " and inverse mass"
    counts[rest] = max(total - before, 0)
    counts["total"] = total
    counts.advice = advice
    return counts

"""The step of a Runge-Kutta method as C++: one pass over the state for each stage, where CasADi's vector operations take one for each term."""

from __future__ import annotations

from tenscasadi.integrators.runge_kutta import SEVERAL, equal_weights, needed_stages
from tenscasadi.integrators.tableaux import Tableau

_STAGE = "  if (arg1[0] = {at}, arg1[1] = arg[1], res1[0] = k{i}, motion_ode(arg1, res1, iw, rest, mem)) return 1;"


def write_step(tableau: Tableau) -> str:
    """Write `motion_step` (z, w, h) -> z_next, which calls `motion_ode` (z, w) -> zdot, to the rounding of `runge_kutta.build_step`."""
    lines = [
        "  const lanes *x = arg[0], h = *arg[2], *arg1[SIZE_ARG];",
        "  lanes *end = res[0], *res1[SIZE_RES];",
        "  enum { NZ = NX + WORK };",
    ]
    stages = sorted(needed_stages(tableau))
    lines += [f"  lanes *k{i} = w + {place} * NZ;" for place, i in enumerate(stages)]
    lines += [f"  lanes *y = w + {len(stages)} * NZ, *rest = y + NZ;"]
    for i in stages:
        moves = any(tableau.a[i])
        lines += [_pass("y", tableau.a[i])] if moves else []
        lines += [_STAGE.format(at="y" if moves else "x", i=i)]
    lines += [_pass("end", tableau.b), "  return 0;"]
    body = "\n".join(lines)
    return f"static int motion_step(const lanes **arg, lanes **res, casadi_int *iw, lanes *w, int mem) {{\n{body}\n}}"


def work_size(tableau: Tableau, size: int) -> int:
    """Count the numbers that `write_step`'s function needs to work beside those of `motion_ode`, for a state of this size."""
    return (len(needed_stages(tableau)) + 1) * size


def _pass(target: str, weights: tuple[float, ...]) -> str:
    """Write target = x + h Σ weight · slope, its terms in the order of `runge_kutta`."""
    used = {
        weight: " + ".join(f"k{k}[i]" for k in stages)
        for weight, stages in equal_weights(weights).items()
    }
    factors = "".join(
        f"const lanes c{j} = lanes({weight!r}) * h; " for j, weight in enumerate(used)
    )
    terms = [f"c{j} * ({slopes})" for j, slopes in enumerate(used.values())]
    if len(used) > SEVERAL:
        terms = ["(" + " + ".join(["lanes(0.0)", *terms]) + ")"]
    return f"  {{ {factors}for (int i = 0; i < NZ; ++i) {target}[i] = {' + '.join(['x[i]', *terms])}; }}"

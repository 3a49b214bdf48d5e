"""Solver of convex quadratic programs as a CasADi expression."""

from __future__ import annotations

from typing import Any

import casadi as ca

NEWTON_STEPS = 30  # most programs need twenty


def solve_qp(H: Any, g: Any, G: Any, b: Any, start: Any) -> Any:
    """Build the solution of a convex quadratic program.

    It minimizes ½ xᵀH x + gᵀx over x (n,) subject to G x ≤ b (m,), as a CasADi expression with a
    fixed number of iterations. H is positive definite, and b is finite. The start need not be
    feasible. The method is Mehrotra's predictor-corrector (SIAM J. Optim. 1992, 2, 575).
    """
    step = _build_step(H.shape[0], G.sparsity())
    x = start
    s = ca.fmax(b - ca.mtimes(G, x), 1.0)  # slacks
    z = 1 / s  # duals
    for _ in range(NEWTON_STEPS):
        x, s, z = step(x, s, z, H, g, G, b)
    return x


def _build_step(n: int, limits: ca.Sparsity) -> ca.Function:
    m = limits.size1()
    x, s, z, H, g, b = (
        ca.MX.sym(name, *size)
        for name, size in (
            ("x", (n,)),
            ("s", (m,)),
            ("z", (m,)),
            ("H", (n, n)),
            ("g", (n,)),
            ("b", (m,)),
        )
    )
    G = ca.MX.sym("G", limits)
    dual, primal, mean = (
        ca.mtimes(H, x) + g + ca.mtimes(G.T, z),
        ca.mtimes(G, x) + s - b,
        ca.dot(s, z) / m,
    )
    weights = z / s
    M = ca.densify(H + ca.mtimes(G.T, G * ca.repmat(weights, 1, n)))

    def direction(product: Any) -> tuple[Any, Any, Any]:
        """Compute the Newton step of x, slacks s and duals z.

        The complementarity products s z are reduced by `product`.
        """
        dx = ca.solve(M, -dual + ca.mtimes(G.T, product / s - weights * primal), "ldl")
        ds = -primal - ca.mtimes(G, dx)
        return dx, ds, -(product + z * ds) / s

    def length(ds: Any, dz: Any) -> Any:
        """Compute the step length that keeps slacks and duals positive."""
        return 1 / ca.fmax(1.0, ca.mmax(-ca.vertcat(ds / s, dz / z)))

    _, ds, dz = direction(s * z)
    part = length(ds, dz)
    center = (ca.dot(s + part * ds, z + part * dz) / m / mean) ** 3
    dx, ds, dz = direction(s * z + ds * dz - center * mean)
    part = 0.99 * length(ds, dz)
    new = [old + part * change for old, change in ((x, dx), (s, ds), (z, dz))]
    # the point is kept at a complementarity of rounding; comparisons with NaN are false
    better = ca.logic_and(mean > 1e-14, ca.mmax(ca.fabs(ca.vertcat(*new))) < 1e30)
    return ca.Function(
        "step",
        [x, s, z, H, g, G, b],
        [ca.if_else(better, after, old) for after, old in zip(new, (x, s, z), strict=True)],
    )

"""A solver of convex quadratic programs as a CasADi expression, which generates C without a library."""

from __future__ import annotations

from typing import Any

import casadi as ca

NEWTON_STEPS = 30  # of Newton's method; most need twenty
LEAST_COMPLEMENTARITY = 1e-14  # mean complementarity at which the point is kept
STEP_SHARE = 0.99  # share of the way to the nearest limit


def solve_qp(H: Any, g: Any, G: Any, b: Any, start: Any) -> Any:
    """Return x (n,) with the least ½ xᵀH x + gᵀx among those with G x ≤ b (m,): Mehrotra's predictor and corrector, SIAM J. Optim. 1992, 2, 575.

    H is positive definite; entries of b are finite. start: x to begin with, which need not keep the
    limits.
    """
    step = _step(H.shape[0], G.sparsity())
    x = start
    s = ca.fmax(b - ca.mtimes(G, x), 1.0)  # slacks
    z = 1 / s  # multipliers
    for _ in range(NEWTON_STEPS):
        x, s, z = step(x, s, z, H, g, G, b)
    return x


def _step(n: int, limits: ca.Sparsity) -> ca.Function:
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
        """Return changes of x, s and z towards s z = s z − `product`."""
        dx = ca.solve(M, -dual + ca.mtimes(G.T, product / s - weights * primal), "ldl")
        ds = -primal - ca.mtimes(G, dx)
        return dx, ds, -(product + z * ds) / s

    def length(ds: Any, dz: Any) -> Any:
        """How far slacks and multipliers stay positive, at most 1."""
        return 1 / ca.fmax(1.0, ca.mmax(-ca.vertcat(ds / s, dz / z)))

    _, ds, dz = direction(s * z)
    part = length(ds, dz)
    centre = (ca.dot(s + part * ds, z + part * dz) / m / mean) ** 3
    dx, ds, dz = direction(s * z + ds * dz - centre * mean)
    part = STEP_SHARE * length(ds, dz)
    new = [old + part * change for old, change in ((x, dx), (s, ds), (z, dz))]
    better = ca.logic_and(
        mean > LEAST_COMPLEMENTARITY, ca.mmax(ca.fabs(ca.vertcat(*new))) < 1e30
    )  # false also of what is not a number
    return ca.Function(
        "step",
        [x, s, z, H, g, G, b],
        [ca.if_else(better, after, old) for after, old in zip(new, (x, s, z), strict=True)],
    )

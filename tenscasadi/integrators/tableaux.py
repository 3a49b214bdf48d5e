"""Explicit Runge-Kutta methods as coefficients, and the step that any such coefficients make."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

import casadi as ca
import numpy as np

from tenscasadi.util.validate import Array, finite_array

SEVERAL = 3  # weights: more are faster as one product of matrices, in building and in running


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method with s stages for an ode without explicit time.

    `a` holds s rows, row i with the i weights of the earlier stages; `b` holds the s weights of the result; each row of `errors`
    holds s weights of an estimate of the step's error (the result minus that of an embedded method), none for methods without.
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    errors: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or any(len(row) != i for i, row in enumerate(self.a)):
            rows = [len(row) for row in self.a]
            raise ValueError(f"a has rows of {rows} weights: give rows of {list(range(len(self.b)))} for {len(self.b)} stages (b)")
        for i, row in enumerate((*self.a, self.b)):
            finite_array("b" if i == len(self.a) else f"a[{i}]", row, (len(row),))
        for i, row in enumerate(self.errors):
            finite_array(f"errors[{i}]", row, (len(self.b),))

    @property
    def c(self) -> tuple[float, ...]:
        """Times of the stages, as fractions of the step: the row sums of `a`."""
        return tuple(sum(row) for row in self.a)

    def stability_polynomial(self) -> Array:
        """Coefficients, lowest power first, of R(z) = 1 + Σ z^(k+1) bᵀ aᵏ 1, shape (s + 1,)."""
        stages = len(self.b)
        a = np.array([list(row) + [0.0] * (stages - len(row)) for row in self.a])
        coefficients, vector = [1.0], np.ones(stages)
        for _ in range(stages):
            coefficients.append(float(np.dot(self.b, vector)))
            vector = a @ vector
        return np.array(coefficients)

    def step(self, ode: ca.Function) -> ca.Function:
        """One step of the method: Function "step" (x, u, h) -> x_next that calls `ode` once a stage that counts."""
        x, u, h = ca.MX.sym("x", ode.sparsity_in(0)), ca.MX.sym("u", ode.sparsity_in(1)), ca.MX.sym("h")
        slopes = self._slopes(ode, x, u, h, _needed(self.a, (self.b,)))
        return ca.Function("step", [x, u, h], [_advance(x, h, self.b, slopes)], ["x", "u", "h"], ["x_next"])

    def trial(self, ode: ca.Function) -> ca.Function:
        """One step and its estimated errors: Function "trial" (x, u, h) -> (x_next, errors (nx, rows of `errors`), slopes at x and x_next)."""
        x, u, h = ca.MX.sym("x", ode.sparsity_in(0)), ca.MX.sym("u", ode.sparsity_in(1)), ca.MX.sym("h")
        slopes = self._slopes(ode, x, u, h, set(range(len(self.b))))
        errors = ca.horzcat(*(_advance(ca.MX(x.shape[0], 1), h, row, slopes) for row in self.errors))
        after = _advance(x, h, self.b, slopes)
        same_as_last = self.a[-1] == self.b[:-1] and self.b[-1] == 0
        outputs = [after, ca.densify(errors), slopes[0], slopes[-1] if same_as_last else ode(after, u)]
        return ca.Function("trial", [x, u, h], outputs, ["x", "u", "h"], ["x_next", "errors", "slope", "slope_next"])

    def _slopes(self, ode: ca.Function, x: ca.MX, u: ca.MX, h: ca.MX, needed: set[int]) -> list[ca.MX]:
        # Calls instead of inlined copies: code stays as small as ode's, and compiles and runs faster than one unrolled graph.
        slopes: list[ca.MX] = []
        for i, row in enumerate(self.a):
            slopes.append(ode(_advance(x, h, row, slopes), u) if i in needed else ca.MX(x.shape[0], 1))
        return slopes


def _needed(a: tuple[tuple[float, ...], ...], results: tuple[tuple[float, ...], ...]) -> set[int]:
    """Stages on which a result depends: the last one of a pair with "first same as last" serves its error alone."""
    needed: set[int] = set()
    for i in reversed(range(len(a))):
        later = [a[k] for k in needed]
        if any(row[i] for row in (*results, *later)):
            needed.add(i)
    return needed


def _advance(x: ca.MX, h: ca.MX, weights: tuple[float, ...], slopes: list[ca.MX]) -> ca.MX:
    """x + h Σ weight · slope, with slopes of equal weight added first: each product is a pass over the state. Many are one product."""
    used = {weight: [slope for slope, own in zip(slopes, weights, strict=True) if own == weight] for weight in weights if weight}
    if len(used) > SEVERAL:
        return x + ca.mtimes(ca.horzcat(*(reduce(add, equal) for equal in used.values())), h * ca.DM(list(used)))
    for weight, equal in used.items():
        x = x + (weight * h) * reduce(add, equal)
    return x


# The classical method: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, Table II.1.2.
CLASSICAL = Tableau(a=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)), b=(1 / 6, 1 / 3, 1 / 3, 1 / 6))

# The explicit midpoint rule, ibid. Table II.1.1 (Runge).
MIDPOINT = Tableau(a=((), (1 / 2,)), b=(0.0, 1.0))

# Dormand and Prince, order 5 with an estimate of order 4, first same as last: ibid. Table II.5.2.
_B5 = (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84)
DORMAND_PRINCE_54 = Tableau(
    a=(
        (),
        (1 / 5,),
        (3 / 40, 9 / 40),
        (44 / 45, -56 / 15, 32 / 9),
        (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
        (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        _B5,
    ),
    b=(*_B5, 0.0),
    errors=((71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40),),
)

# Dormand and Prince, order 8, with estimates of orders 5 and 3 by Hairer and Wanner: DOP853, ibid. section II.5 and its program.
_B8 = (
    0.054293734116568765,
    0.0,
    0.0,
    0.0,
    0.0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
)
_B3 = {0: 0.24409448818897641, 8: 0.733846688281611857, 11: 0.0220588235294117647}  # of the method of order 3
DORMAND_PRINCE_853 = Tableau(
    a=(
        (),
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402, 0.008273789163814023),
        (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894, -43.48988418106996),
        (
            0.47766253643826434,
            0.0,
            0.0,
            -2.4881146199716677,
            -0.590290826836843,
            21.230051448181193,
            15.279233632882423,
            -33.28821096898486,
            -0.020331201708508627,
        ),
        (
            -0.9371424300859873,
            0.0,
            0.0,
            5.186372428844064,
            1.0914373489967295,
            -8.149787010746927,
            -18.52006565999696,
            22.739487099350505,
            2.4936055526796523,
            -3.0467644718982196,
        ),
        (
            2.273310147516538,
            0.0,
            0.0,
            -10.53449546673725,
            -2.0008720582248625,
            -17.9589318631188,
            27.94888452941996,
            -2.8589982771350235,
            -8.87285693353063,
            12.360567175794303,
            0.6433927460157636,
        ),
    ),
    b=_B8,
    errors=(
        (
            0.01312004499419488,
            0.0,
            0.0,
            0.0,
            0.0,
            -1.2251564463762044,
            -0.4957589496572502,
            1.6643771824549864,
            -0.35032884874997366,
            0.3341791187130175,
            0.08192320648511571,
            -0.022355307863886294,
        ),
        tuple(weight - _B3.get(i, 0.0) for i, weight in enumerate(_B8)),
    ),
)

"""Coefficients of explicit Runge-Kutta methods, as data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tenscasadi.util.validate import Array, finite_array


@dataclass(frozen=True)
class Tableau:
    """Coefficients of an explicit Runge-Kutta method.

    The method has s stages and no explicit time. `a` holds s rows; row i has i weights of the
    earlier stages. `b` holds the s weights of the result. Each row of `errors` holds s weights of
    an error estimate, the result minus that of an embedded method.
    """

    a: tuple[tuple[float, ...], ...]
    b: tuple[float, ...]
    errors: tuple[tuple[float, ...], ...] = ()

    def __post_init__(self) -> None:
        if len(self.a) != len(self.b) or any(len(row) != i for i, row in enumerate(self.a)):
            rows = [len(row) for row in self.a]
            raise ValueError(
                f"a has rows of {rows} weights: give rows of {list(range(len(self.b)))} for {len(self.b)} stages (b)"
            )
        for i, row in enumerate((*self.a, self.b)):
            finite_array("b" if i == len(self.a) else f"a[{i}]", row, (len(row),))
        for i, row in enumerate(self.errors):
            finite_array(f"errors[{i}]", row, (len(self.b),))

    @property
    def c(self) -> tuple[float, ...]:
        """Times of the stages as fractions of the step.

        They are the row sums of `a`.
        """
        return tuple(sum(row) for row in self.a)

    def stability_polynomial(self) -> Array:
        """Compute the coefficients of R(z), lowest power first.

        R(z) = 1 + Σ z^(k+1) bᵀ aᵏ 1. The shape is (s + 1,).
        """
        stages = len(self.b)
        a = np.array([list(row) + [0.0] * (stages - len(row)) for row in self.a])
        coefficients, vector = [1.0], np.ones(stages)
        for _ in range(stages):
            coefficients.append(float(np.dot(self.b, vector)))
            vector = a @ vector
        return np.array(coefficients)


# The classical method: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, Table
# II.1.2.
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

# Dormand and Prince, order 8, with estimates of orders 5 and 3 by Hairer and Wanner: DOP853, ibid.
# section II.5 and its program.
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
_B3 = {
    0: 0.24409448818897641,
    8: 0.733846688281611857,
    11: 0.0220588235294117647,
}  # of the method of order 3
DORMAND_PRINCE_853 = Tableau(
    a=(
        (),
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (
            0.03709200011850479,
            0.0,
            0.0,
            0.17038392571223998,
            0.10726203044637328,
            -0.015319437748624402,
            0.008273789163814023,
        ),
        (
            0.6241109587160757,
            0.0,
            0.0,
            -3.3608926294469414,
            -0.868219346841726,
            27.59209969944671,
            20.154067550477894,
            -43.48988418106996,
        ),
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

# Suzuki's composition of order 4 by five steps of order 2: Hairer, Lubich, Wanner, Geometric Numerical
# Integration, (II.4.5).
SUZUKI = np.array([1.0, 1.0, -(4 ** (1 / 3)), 1.0, 1.0]) / (4 - 4 ** (1 / 3))

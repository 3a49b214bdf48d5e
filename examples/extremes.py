"""The extremes: what the simulator gives where numbers get hard, against answers known on paper. Prints the table.

python examples/extremes.py
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import tenscasadi as tc
from tenscasadi.util.validate import Array


class Row(NamedTuple):
    """One extreme: the error that was measured, relative unless the name says a unit, and the one that is stated to hold."""

    extreme: str
    check: str
    error: float
    stated: float


def oscillator(
    stiffness: float, masses: tuple[float, float], periods: int = 10, steps: int = 200
) -> float:
    """Error of two masses on a taut string after some periods, relative to the amplitude: x = ρ + a cos(ωt), ω² = k (1/m₁ + 1/m₂)."""
    rest, amplitude = 1.0, 0.01
    pair = tc.Structure(
        [(0, 0, 0), (rest + 2 * amplitude, 0, 0)],
        strings=[(0, 1)],
        node_mass=masses,
        stiffness=stiffness,
        rest_length=rest,
    )
    omega = np.sqrt(stiffness * (1 / masses[0] + 1 / masses[1]))
    # taut throughout: the string swings between ρ and ρ + 2a about its middle only under a pull
    # along it
    pull = np.array([(-stiffness * amplitude, 0, 0), (stiffness * amplitude, 0, 0)])
    model = tc.Model(tc.Scene(pair, forces=tc.NodalForce(pull)))
    period = 2 * np.pi / omega
    run = tc.simulate(model, periods * period, period / steps, compiled=False)
    length = np.linalg.norm(run.nodes[:, 1] - run.nodes[:, 0], axis=1)
    exact = rest + amplitude + amplitude * np.cos(omega * run.time)
    return float(abs(length - exact).max() / amplitude)


def string_node(ratio: float) -> float:
    """The same for a string node of `ratio` times a bar's mass, pulling the bar along its axis; relative to the amplitude."""
    rest, amplitude, k = 1.0, 0.01, 100.0
    tug = tc.Structure(
        [(-1, 0, 0), (0, 0, 0), (rest + 2 * amplitude, 0, 0)],
        [(0, 1)],
        [(1, 2)],
        node_mass=[0, 0, ratio],
        stiffness=k,
        rest_length=rest,
    )
    pull = k * amplitude * np.array([(0, 0, 0), (-1, 0, 0), (1, 0, 0)])
    omega = np.sqrt(k * (1 + 1 / ratio))
    period = 2 * np.pi / omega
    run = tc.simulate(
        tc.Model(tc.Scene(tug, forces=tc.NodalForce(pull))),
        10 * period,
        period / 200,
        compiled=False,
    )
    length = np.linalg.norm(run.nodes[:, 2] - run.nodes[:, 1], axis=1)
    return float(abs(length - rest - amplitude * (1 + np.cos(omega * run.time))).max() / amplitude)


def scaled(length: float, mass: float, time: float) -> Array:
    """A prism under gravity after a second, in other units: nodes divided by the unit of length."""
    prism = tc.shapes.prism(prestress=30.0)
    other = tc.Structure(
        prism.nodes * length, prism.bars, prism.strings, bar_mass=mass, stiffness=prism.stiffness * mass / time**2, damping=mass / time,
        rest_length=prism.rest_length * 0.9 * length,
    )  # fmt: skip
    gravity = tc.Gravity((0, 0, -9.81 * length / time**2))
    run = tc.simulate(
        tc.Model(tc.Scene(other, gravity=gravity)),
        time,
        1e-3 * time,
        correction=tc.Projection(),
        compiled=False,
    )
    return np.asarray(run.nodes[-1] / length)


def spin(rate: float, advance: float = 0.01) -> float:
    """Error of a free bar after ten turns at `rate` rad/s, with steps that turn it by `advance` rad; relative to its length."""
    bar = tc.Structure([(-0.5, 0, 0), (0.5, 0, 0)], [(0, 1)])
    model = tc.Model(tc.Scene(bar))
    start = model.state(bar.nodes, [(0, -rate / 2, 0), (0, rate / 2, 0)])
    run = tc.simulate(
        model, 20 * np.pi / rate, advance / rate, state=start, correction=tc.Projection()
    )
    angle = rate * run.time
    exact = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    return float(abs(run.nodes[:, 1] - run.nodes[:, 0] - exact).max())


def through_nothing() -> float:
    """Two masses that a string throws at each other: it goes slack, its length passes through zero, and they come back; relative."""
    pair = tc.Structure(
        [(0, 0, 0), (1.2, 0, 0)], strings=[(0, 1)], node_mass=1.0, stiffness=50.0, rest_length=1.0
    )
    omega = np.sqrt(100.0)
    speed = 0.2 * omega  # at which they meet, and leave each other, relative
    period = 2 * (
        np.pi / omega + 2 * 1.0 / speed
    )  # two swings of the taut string, two flights of 2 ρ
    run = tc.simulate(tc.Model(tc.Scene(pair)), period / 2, period / 40_000, compiled=False)
    exact = np.array([(1.2, 0, 0), (0, 0, 0)])  # they have changed sides
    return float(abs(run.nodes[-1] - exact).max() / 1.2)


def all_slack() -> float:
    """A ball with loose strings thrown in gravity: its center of mass flies a parabola and no string pulls; relative to the height."""
    ball = tc.shapes.six_bar_ball()
    model = tc.Model(
        tc.Scene(ball.replace(rest_length=10 * ball.string_lengths), gravity=tc.Gravity())
    )
    run = tc.simulate(
        model,
        1.0,
        1e-3,
        state=model.state(ball.nodes, np.tile([1.0, 0, 5.0], (12, 1))),
        compiled=False,
    )
    fall = run.nodes[-1].mean(axis=0) - ball.nodes.mean(axis=0) - [1.0, 0, 5.0 - 9.81 / 2]
    return float(max(abs(fall).max(), run.tension.max()))


def at_rest_length() -> float:
    """Every string exactly at its rest length: nothing moves; relative to the size."""
    ball = tc.shapes.six_bar_ball()
    run = tc.simulate(tc.Model(tc.Scene(ball)), 1.0, 1e-3, compiled=False)
    return float(abs(run.nodes - ball.nodes).max())


def redundant() -> float:
    """Six bars between four points in a plane, one too many, turning as a rigid body; relative to the side."""
    square = np.array([(0.5, 0.5, 0), (-0.5, 0.5, 0), (-0.5, -0.5, 0), (0.5, -0.5, 0)])
    frame = tc.Structure(square, [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.RedundantConstraints)
        model = tc.Model(tc.Scene(frame))
    start = model.state(square, np.cross([0, 0, 1.0], square))
    run = tc.simulate(
        model, 2 * np.pi, 1e-3, state=start, correction=tc.Projection(), compiled=False
    )
    return float(abs(run.nodes[-1] - square).max())


def nearly_redundant(gap: float) -> float:
    """Two bars in a line but for `gap`, pinned at both ends, swinging about that line under gravity: frequency of a pendulum; relative."""
    bars = tc.Structure([(0, 0, 0), (1, 0, -gap), (2, 0, 0)], [(0, 1), (1, 2)], pinned=(0, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tc.RedundantConstraints)
        model = tc.Model(tc.Scene(bars, gravity=tc.Gravity()))
    speed = 1e-3 * gap
    omega = np.sqrt(1.5 * 9.81 / gap)  # ⅔ m gap² φ'' = − m g gap φ for the two bars of mass m
    start = model.state(bars.nodes, [(0, 0, 0), (0, speed, 0), (0, 0, 0)])
    run = tc.simulate(
        model,
        np.pi / 2 / omega,
        1e-3 / omega,
        state=start,
        correction=tc.Projection(),
        compiled=False,
    )
    return float(abs(run.nodes[-1, 1, 1] / (speed / omega) - 1))


def fold() -> tuple[float, float]:
    """A D-bar that folds flat (a singular shape at 0.66 s) and opens again: worst bar or joint, and energy; relative."""
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]) - 0.5
    d_bar = tc.Structure(
        square,
        [(0, 1), (1, 2), (2, 3), (3, 0)],
        [(0, 2), (1, 3)],
        rest_length=(1.0, 0.5),
        pinned={0: "xyz", 1: "z", 2: "z", 3: "z"},
    )
    run = tc.simulate(
        tc.Model(tc.Scene(d_bar)), 1.0, 1e-4, correction=tc.Projection(), compiled=False
    )
    if not run.success:
        raise RuntimeError(run.message)
    return float(max(run.bar_length_error.max(), run.joint_error.max())), float(
        abs(run.energy_error).max() / run.energy[0]
    )


def long_run(steps: int) -> tuple[float, float]:
    """A vibrating prism over many steps: worst bar length, and energy, relative."""
    prism = tc.shapes.prism(prestress=30.0)
    model = tc.Model(tc.Scene(prism.replace(rest_length=prism.rest_length * 0.97)))
    run = tc.simulate(model, steps * 1e-3, 1e-3, correction=tc.Projection())
    return float(run.bar_length_error.max()), float(abs(run.energy_error).max() / run.energy[0])


def large(prisms: int) -> tuple[float, float]:
    """A chain of many prisms in free fall: distance from the parabola of the center of mass, and bar lengths; relative."""
    one = tc.shapes.prism(prestress=30.0)
    nodes = np.concatenate([one.nodes + [1.5 * k, 0, 0] for k in range(prisms)])
    bars = np.concatenate([one.bars + 6 * k for k in range(prisms)])
    links = [(6 * k, 6 * k + 6) for k in range(prisms - 1)]
    strings = [*np.concatenate([one.strings + 6 * k for k in range(prisms)]), *links]
    rest = np.concatenate([np.tile(one.rest_length, prisms), np.full(len(links), 1.4)])
    model = tc.Model(
        tc.Scene(tc.Structure(nodes, bars, strings, rest_length=rest), gravity=tc.Gravity())
    )
    run = tc.simulate(model, 0.1, 1e-3, correction=tc.Projection(), compiled=False)
    fall = (run.nodes[-1] - nodes).mean(axis=0) - [0, 0, -9.81 * 0.1**2 / 2]
    return float(abs(fall).max()), float(run.bar_length_error.max())


def both_stiffnesses(scheme: Any, step: float) -> float:
    """Two masses in a row on strings of 1e9 and 1 N/m, taut throughout: the two modes of a linear chain; relative to the amplitude."""
    stiffness, pull, amplitude = np.array([1e9, 1.0]), 1.0, 0.1
    still = np.cumsum(1.0 + pull / stiffness)  # where the pull alone would hold them
    chain = tc.Structure(
        [(0, 0, 0), (still[0], 0, 0), (still[1] + amplitude, 0, 0)],
        strings=[(0, 1), (1, 2)], node_mass=1.0, stiffness=stiffness, rest_length=1.0, pinned=[0],
    )  # fmt: skip
    run = tc.simulate(
        tc.Model(tc.Scene(chain, forces=tc.NodalForce([(0, 0, 0), (0, 0, 0), (pull, 0, 0)]))),
        10.0,
        step,
        scheme,
    )
    squares, modes = np.linalg.eigh(
        [[stiffness.sum(), -stiffness[1]], [-stiffness[1], stiffness[1]]]
    )
    exact = (modes[1] * amplitude * np.cos(np.sqrt(squares) * run.time[:, None])) @ modes.T
    return float(abs(run.nodes[:, 1:, 0] - still - exact).max() / amplitude)


def unlike_bars(masses: tuple[float, float]) -> float:
    """Two hinged bars in a line that turn once about their common center of mass: nothing bends them; relative to their length."""
    line = tc.Structure([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1), (1, 2)], bar_mass=masses)
    model = tc.Model(tc.Scene(line))
    center = np.array([np.average([0.5, 1.5], weights=masses), 0, 0])
    start = model.state(line.nodes, np.cross([0, 0, 1.0], line.nodes - center))
    run = tc.simulate(model, 2 * np.pi, 2 * np.pi / 1000, state=start, compiled=False)
    return float(abs(run.nodes[-1] - line.nodes).max())


def no_stiffness() -> float:
    """A prism whose strings have none falls as a rigid body; meters and newtons."""
    prism = tc.shapes.prism().replace(stiffness=0.0, damping=0.0)
    run = tc.simulate(tc.Model(tc.Scene(prism, gravity=tc.Gravity())), 1.0, 1e-2, compiled=False)
    return float(max(abs(run.nodes[-1] - prism.nodes - [0, 0, -9.81 / 2]).max(), run.tension.max()))


def picoseconds() -> float:
    """A bar flies for a nanosecond in steps of 1e-12 s, each of which moves it by some 1e4 roundings of its coordinates; relative to the way."""
    bar = tc.Structure([(-0.5, 0, 0), (0.5, 0, 0)], [(0, 1)])
    model = tc.Model(tc.Scene(bar, gravity=tc.Gravity()))
    run = tc.simulate(
        model, 1e-9, 1e-12, state=model.state(bar.nodes, [(1.0, 0, 2.0)] * 2), compiled=False
    )
    return float(abs((run.nodes[-1] - bar.nodes) / 2e-9 - [0.5, 0, 1]).max())


def bounce(stiffness: float) -> float:
    """A mass falls by 1 m onto stiff ground and is back after two falls and the contact between, which lasts for milliseconds; m."""
    omega, fall = np.sqrt(stiffness), np.sqrt(2 / 9.81)
    contact = 2 * (np.pi - np.arctan2(np.sqrt(2 * 9.81) * omega, 9.81)) / omega
    mass = tc.Structure([(0, 0, 1.0)], node_mass=1.0)
    model = tc.Model(tc.Scene(mass, gravity=tc.Gravity(), ground=tc.Ground(stiffness=stiffness)))
    run = tc.simulate(
        model, 2 * fall + contact, scheme=tc.DormandPrince853(rtol=1e-9), compiled=False
    )
    return float(abs(run.nodes[-1, 0] - [0, 0, 1]).max())


def late(clock: float) -> float:
    """A mass under a force cos(t − clock), whose clock starts there: back and forth in ten seconds; m."""
    mass = tc.Structure([(0, 0, 0)], node_mass=1.0)
    model = tc.Model(tc.Scene(mass, forces=tc.NodalForce(lambda t: [(ca.cos(t - clock), 0, 0)])))
    run = tc.simulate(model, 10.0, 1e-3, state=np.append(np.zeros(6), clock), compiled=False)
    return float(abs(run.nodes[-1, 0, 0] - (1 - np.cos(10.0))))


def far(distance: float) -> float:
    """A vibrating prism that far from the origin, against the same at the origin; m."""
    prism = tc.shapes.prism(prestress=30.0)
    prism = prism.replace(rest_length=0.9 * prism.rest_length)
    there = prism.replace(nodes=prism.nodes + distance)
    here, moved = (
        tc.simulate(tc.Model(tc.Scene(each)), 1.0, 1e-3, compiled=False).nodes[-1]
        for each in (prism, there)
    )
    return float(abs(moved - distance - here).max())


def rows() -> Iterator[Row]:
    """All extremes, measured one after the other."""
    for k in (10.0**e for e in range(10)):
        yield Row(
            f"stiffness {k:.0e} N/m",
            "oscillator, 10 periods of 200 steps",
            oscillator(k, (1.0, 1.0)),
            1e-5,
        )
    for ratio in (1.0, 1e-2, 1e-4, 1e-6, 1e-8):
        yield Row(
            f"string node of {ratio:.0e} bar masses",
            "oscillator, 10 periods of 200 steps",
            string_node(ratio),
            1e-5,
        )
    for scheme, step in ((tc.RungeKutta4(), 5e-5), (tc.Collocation(2), 0.05)):
        check = f"both modes, {type(scheme).__name__}, steps of {step:g} s"
        yield Row("stiffness 1e9 and 1 N/m", check, both_stiffnesses(scheme, step), 1e-5)
    for masses in ((1e4, 1e-4), (1e-4, 1e4)):
        yield Row(
            "hinged bars of {:.0e} and {:.0e} kg".format(*masses),
            "they turn once in a line",
            unlike_bars(masses),
            1e-8,
        )
    plain = scaled(1.0, 1.0, 1.0)
    for name, units in {
        "bars of 1 mm": (1e-3, 1, 1), "bars of 1 km": (1e3, 1, 1), "milligrams": (1, 1e-6, 1), "tonnes": (1, 1e3, 1), "microseconds": (1, 1, 1e-6),
        "mm, mg and ms": (1e-3, 1e-6, 1e-3),
    }.items():  # fmt: skip
        yield Row(
            name,
            "the motion in meters, kilograms and seconds",
            float(abs(scaled(*units) - plain).max()),
            1e-12,
        )
    for rate in (1.0, 1e2, 1e4):
        yield Row(
            f"spin of {rate:.0e} rad/s",
            "ten turns of a free bar, 0.01 rad a step",
            spin(rate),
            1e-7,
        )
    yield Row("steps of 1e-12 s", "flight of a nanosecond", picoseconds(), 1e-4)
    yield Row("clock at 1e6 s", "force that depends on time (m)", late(1e6), 1e-5)
    yield Row("1000 km from the origin", "the motion at the origin (m)", far(1e6), 1e-7)
    yield Row("ground of 1e6 N/m", "bounce of a mass, error control (m)", bounce(1e6), 1e-7)
    yield Row("strings of no stiffness", "rigid fall (m), no tension (N)", no_stiffness(), 1e-12)
    yield Row("string length through 0", "two masses change sides", through_nothing(), 1e-9)
    yield Row("all strings slack", "parabola (m), no tension (N)", all_slack(), 1e-12)
    yield Row("all strings at rest length", "nothing moves (m)", at_rest_length(), 1e-12)
    yield Row("redundant constraints", "planar K4 turns once (m)", redundant(), 1e-12)
    for gap, stated in ((1e-3, 1e-8), (1e-6, 1e-1)):
        yield Row(
            f"bars {gap:.0e} m from aligned",
            "quarter swing of a pendulum",
            nearly_redundant(gap),
            stated,
        )
    worst, energy = fold()
    yield Row("D-bar through its fold", "bars and joints", worst, 1e-14)
    yield Row("D-bar through its fold", "energy", energy, 1e-6)
    worst, energy = long_run(1_000_000)
    yield Row("1,000,000 steps", "bars", worst, 1e-14)
    yield Row("1,000,000 steps", "energy", energy, 1e-6)
    parabola, bars = large(1667)
    yield Row("5,001 bars", "center of mass falls (m)", parabola, 1e-12)
    yield Row("5,001 bars", "bars, at up to 2500 m from the origin", bars, 1e-11)


def main() -> list[Row]:
    """Prints the table and returns its rows."""
    print(f"{'extreme':<36}{'check':<52}{'error':>10}{'stated':>10}")
    table = []
    for row in rows():
        print(
            f"{row.extreme:<36}{row.check:<52}{row.error:>10.1e}{row.stated:>10.0e}{'' if row.error <= row.stated else '  exceeded'}",
            flush=True,
        )
        table.append(row)
    return table


if __name__ == "__main__":
    main()

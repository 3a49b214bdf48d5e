"""How cost grows with size: chains of prisms from 9 to 5 000 bars, membranes and chains of joined bars, as models and as compiled code."""

from __future__ import annotations

import os

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before NumPy is loaded: small matrices gain nothing from threads

import sys
import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import tenscasadi as tc
from tenscasadi.dynamics.instruction_count import count_instructions
from tenscasadi.util.compile import compile_function, find_compiler

CHAINS = (3, 10, 33, 100, 333, 1000, 1667)  # prisms, of three bars each
MEMBRANES = ((4, 3), (8, 5), (16, 9), (40, 21), (80, 41), (100, 67))  # (p, q)
LINKS = (10, 100, 1000, 5000)  # bars that share nodes


class Row(NamedTuple):
    """One structure. Seconds to build the model's right-hand side and to compile it, its instructions, and ns a member for one evaluation
    (NaN: no compiler); MB of memory that the process has needed at most up to then (NaN where the
    system does not tell).
    """

    name: str
    bars: int
    members: int
    build: float
    instructions: int
    compile: float
    virtual_machine: float
    compiled: float
    memory: float


def chain(prisms: int) -> tc.Structure:
    """Prisms in a row along z, 0.2 m apart, each triangle tied to the next by six strings. Class 1."""
    one = tc.shapes.prism(prestress=30.0, stiffness=1000.0)
    first = 6 * np.arange(prisms)[:, None, None]
    nodes = one.nodes + 1.2 * np.arange(prisms)[:, None, None] * (0.0, 0.0, 1.0)
    ties = [(3 + k, 6 + (k + turn) % 3) for k in range(3) for turn in (0, 1)]
    strings = np.concatenate(
        [(first + one.strings).reshape(-1, 2), (first[:-1] + ties).reshape(-1, 2)]
    )
    return tc.Structure(
        nodes.reshape(-1, 3),
        (first + one.bars).reshape(-1, 2),
        strings,
        stiffness=1000.0,
        damping=1.0,
    )


def links(bars: int) -> tc.Structure:
    """A zigzag chain of joined bars that hangs from its first node. Class 2, without strings."""
    steps = np.arange(bars + 1)
    nodes = np.column_stack([steps, np.zeros(bars + 1), 0.1 * (steps % 2)])
    return tc.Structure(nodes, np.column_stack([steps[:-1], steps[1:]]), pinned=[0])


def measure(name: str, structure: tc.Structure) -> Row:
    """Builds, compiles and times the right-hand side of one structure under gravity."""
    began = time.perf_counter()
    # Joined bars: Ω couples neighbors only, while λ of reduced coordinates couples all bars that
    # hang together.
    model = tc.Model(
        tc.Scene(structure, gravity=tc.Gravity()),
        coordinates="full" if len(structure.pinned) else "reduced",
    )
    ode = model.ode
    built = time.perf_counter() - began
    members = len(structure.bars) + len(structure.strings)
    copies = max(1, 3000 // members)  # in one call: the cost of a call does not show
    several = ode.map(copies)
    states = np.repeat(model.initial_state[:, None], copies, axis=1)
    share = 1e9 / (copies * members)
    virtual, compiled, compiling = share * seconds(several, states), np.nan, np.nan
    if find_compiler():
        began = time.perf_counter()
        machine_code = compile_function(several)
        compiling = time.perf_counter() - began
        compiled = share * seconds(machine_code, states)
    return Row(
        name,
        len(structure.bars),
        members,
        built,
        count_instructions(ode),
        compiling,
        virtual,
        compiled,
        memory(),
    )


def seconds(function: ca.Function, states: np.ndarray) -> float:
    """The median time of an evaluation, on memory that is prepared once."""
    buffer: Any
    buffer, evaluate = function.buffer()
    inputs, outputs = np.asfortranarray(states), np.empty(states.shape, order="F")
    buffer.set_arg(0, inputs.ravel(order="K").data)
    buffer.set_res(0, outputs.ravel(order="K").data)
    evaluate()
    times: list[float] = []
    while sum(times) < 0.05 or len(times) < 5:
        times.append(clock(evaluate))
    return median(times)


def clock(call: Callable[[], object]) -> float:
    """Seconds of the processor that a call takes, whatever else runs on the machine."""
    began = time.process_time()
    call()
    return time.process_time() - began


def memory() -> float:
    """MB that this process has needed at most so far."""
    if sys.platform == "win32":
        return float("nan")
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (
        1e6 if sys.platform == "darwin" else 1e3
    )


def main(quick: bool = False) -> list[Row]:
    """Prints the table and returns its rows, from small to large. `quick`: three structures of a few hundred members."""
    cases: list[tuple[int, str, Callable[[], tc.Structure]]] = []
    cases += [(18 * n, f"chain of {n} prisms", partial(chain, n)) for n in CHAINS]
    cases += [
        (3 * p * q, f"membrane ({p}, {q})", partial(tc.shapes.membrane, p, q, damping=1.0))
        for p, q in MEMBRANES
    ]
    cases += [(n, f"{n} joined bars, full", partial(links, n)) for n in LINKS]
    rows = []
    print(
        f"{'':23}{'bars':>6}{'members':>9}{'build s':>9}{'instructions':>14}{'compile s':>11}{'v.m. ns':>9}{'C ns':>7}{'peak MB':>9}"
    )
    for size, name, make in sorted(cases, key=lambda case: case[0]):
        if quick and not 150 < size < 1000:
            continue
        row = measure(name, make())
        rows.append(row)
        shown = f"{row.name:23}{row.bars:6}{row.members:9}{row.build:9.3f}{row.instructions:14}{row.compile:11.2f}"
        print(f"{shown}{row.virtual_machine:9.1f}{row.compiled:7.1f}{row.memory:9.0f}")
    print(
        "v.m., C: nanoseconds a member for one evaluation, in CasADi's virtual machine and compiled"
    )
    return rows


if __name__ == "__main__":
    main()

"""Times of two installed versions, measured in turns in one run on one core.

Each version is a Python interpreter that imports it. Without arguments only the own version is
measured: python examples/benchmark_versions.py OTHER_PYTHON

Times are seconds of the processor, which other work on the machine hardly lengthens. Each one is
the median of repeated calls after a first one, which compiles.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # read when NumPy is loaded
IMPORT = (
    "import time; t = time.process_time(); import tenscasadi, ocp; print(time.process_time() - t)"
)
MOTIONS, STEPS = 1024, 1000


class Row(NamedTuple):
    """Median seconds of this version and of the other one, and the median of their ratios."""

    name: str
    seconds: float
    other: float
    ratio: float


def clock(function: Callable[[], Any]) -> float:
    """Measure the time of the processor in a call [s]."""
    began = time.process_time()
    function()
    return time.process_time() - began


def measure(name: str) -> float:
    """Measure one entry of the table with the version of this interpreter."""
    kind, _, what = name.partition(", ")
    return measure_plan(what) if kind == "plan" else measure_motion(kind, what)


def measure_plan(name: str) -> float:
    """Measure a default plan, from the problem to its replay."""
    from ocp_problems.shape_changes import ball, free_prism, free_tower

    import ocp

    ocp.solve(free_prism(3, 0.8, 0.88))  # loads what every plan needs
    if name == "prism":
        problem = free_prism(3, 0.8, 0.88)
    elif name == "ball":
        problem = ball(0.95)
    else:
        problem = free_tower(int(name.split()[2]) // 3)
    return clock(lambda: ocp.solve(problem))


def measure_motion(kind: str, name: str) -> float:
    """Measure a call of `simulate` or `rollouts` of a spinning structure with elastic strings."""
    import numpy as np

    import tenscasadi as tc

    shapes: dict[str, Any] = {"prism": tc.shapes.prism, "ball": tc.shapes.six_bar_ball}
    structure = shapes[name](stiffness=1000.0, prestress=50.0)
    model = tc.Model(tc.Scene(structure))
    state = model.state(structure.nodes, np.cross([0.0, 0.0, 1.0], structure.nodes))
    starts = np.tile(state, (MOTIONS, 1))

    def call() -> object:
        if kind == "simulate":
            return tc.simulate(model, 1e-3 * STEPS, step=1e-3, state=state)
        return tc.rollouts(model, 1e-3 * STEPS, 1e-3, states=starts, threads=1)

    call()
    return median(clock(call) for _ in range(5))


NAMES = [
    *("import", "simulate, prism", "simulate, ball", "rollouts, prism", "rollouts, ball"),
    *("plan, prism", "plan, ball"),
    *(f"plan, tower of {bars} bars" for bars in (12, 24, 48)),
]


def run(python: str, name: str) -> float:
    """Measure an entry in another process."""
    code = ["-c", IMPORT] if name == "import" else [__file__, "--measure", name]
    own = {} if python == sys.executable else {"PYTHONPATH": ""}  # the other one finds its own
    found = subprocess.run(
        [python, "-W", "ignore", *code],
        env=os.environ | ONE_THREAD | own,
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return float(json.loads(found.stdout.splitlines()[-1]))


def main(other: str | None = None, quick: bool = False) -> list[Row]:
    """Measure both versions in turns, print the table, and return its rows.

    `quick`: some entries, once.
    """
    rows, repeats = [], 1 if quick else 5
    print(f"{'':28}{'this [s]':>10}{'other [s]':>10}{'this / other':>14}")
    for name in NAMES[:2] + NAMES[5:6] if quick else NAMES:
        count = max(repeats - 2, 1) if name.endswith("48 bars") else repeats
        pairs = [
            (run(sys.executable, name), run(other, name) if other else float("nan"))
            for _ in range(count)
        ]
        own, others, ratio = (
            median(values)
            for values in zip(*((one, two, one / two) for one, two in pairs), strict=True)
        )
        rows.append(Row(name, own, others, ratio))
        print(f"{name:28}{own:10.4g}{others:10.4g}{ratio:14.2f}", flush=True)
    return rows


if __name__ == "__main__":
    if sys.argv[1:2] == ["--measure"]:
        print(measure(sys.argv[2]))
    else:
        main(sys.argv[1] if len(sys.argv) > 1 else None)

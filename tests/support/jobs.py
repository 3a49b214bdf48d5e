"""Functions of one case that worker processes import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import tenscasadi as tc


def square(case: Any) -> Any:
    """Compute the square of a number; also return the process that did."""
    if case["x"] == "raise":
        raise ZeroDivisionError("on purpose")
    if case["x"] == "interrupt":
        raise KeyboardInterrupt
    if case["x"] == 4.5:
        time.sleep(1.0)  # is running when its neighbour dies
    if case["x"] == "die":
        time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGKILL)
    if case["x"] == "odd":
        return {"model": object()}
    threads = [os.environ[name] for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")]
    return {"square": case["x"] ** 2, "process": os.getpid(), "threads": threads}


def interrupt(case: Any) -> Any:
    """Send Ctrl-C to the parent process in the third case."""
    if case["number"] == 2:
        while not list(Path(case["folder"]).glob("*.npz")):
            time.sleep(0.005)
        os.kill(os.getppid(), signal.SIGINT)
        time.sleep(60)
    return case["number"]


def vibrate(case: Any) -> Any:
    """Compiled motion, begun when all cases have begun."""
    folder = Path(case["folder"])
    (folder / f"begun-{case['number']}").touch()
    for _ in range(2000):
        if len(list(folder.glob("begun-*"))) == case["of"]:
            break
        time.sleep(0.005)
    run = tc.simulate(
        tc.Model(tc.Scene(tc.shapes.prism(stiffness=321.0))), 0.1, 1e-3, compiled=True
    )
    return {"nodes": run.nodes[-1], "process": os.getpid()}


def slow(case: Any) -> Any:
    """Wait for some tenths of a second."""
    time.sleep(0.3)
    return {"double": 2 * case, "process": os.getpid()}

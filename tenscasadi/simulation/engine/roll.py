"""Computation of runs, from checked inputs to result arrays."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tenscasadi.integrators.scheme import Scheme, extent
from tenscasadi.integrators.stabilization import Correction
from tenscasadi.simulation.engine.build import build_kernel
from tenscasadi.simulation.engine.kernel import Kernel, Watch
from tenscasadi.simulation.engine.request import MEASURED, STOPPED, Rolled
from tenscasadi.simulation.engine.step_code import Account, Measured
from tenscasadi.simulation.inputs.run_inputs import RunInputs
from tenscasadi.util.compile import Compiled, Single
from tenscasadi.util.validate import Array, Indices

COMPARED = 64  # least number of compared rows


class Request(NamedTuple):
    """Inputs and options of runs.

    The `correction` restores constraints between steps of the `scheme`. Every `every`-th step is
    saved. `measured` selects the errors and energies of saved rows, and `account` the energies to
    integrate. `compiled` is whether machine code is required, with None for a choice. It uses
    `lanes` of SIMD registers and several `threads`. The `deadline` is a time of `time.monotonic`,
    `time_limit` seconds after the call. With `compare`, copies of a run take longer steps in unused
    lanes where the code has them.
    """

    inputs: RunInputs
    scheme: Scheme
    correction: Correction | None
    every: int
    account: Account
    measured: Measured
    compiled: Compiled = None
    lanes: int | None = None
    threads: int = 1
    time_limit: float = np.inf
    deadline: float = np.inf
    compare: bool = False

    @property
    def compare_every(self) -> int:
        """Number of steps between comparisons with longer steps.

        It is 0 if no copies of the run with longer steps are computed.
        """
        grid = self.inputs.grid
        if not self.compare or (grid.counts % 4).any() or self.inputs.feedback is not None:
            return 0
        return 4 * max(1, grid.steps // (4 * COMPARED))

    @property
    def rounding(self) -> float:
        """Position error that rounding can cause [m]."""
        digits = 1e-5 if isinstance(self.compiled, Single) else 1e-9
        return digits * extent(self.inputs.model)

    @property
    def balanced(self) -> bool:
        """Whether the energy balance includes all exchanged energies."""
        model, feedback = self.inputs.model, self.inputs.feedback
        varies = self.inputs.controls.shape[1] > 1 or feedback is not None
        return (self.account.power or model.power is None) and (self.account.jumps or not varies)


class Runs(NamedTuple):
    """Result `rolled` of computed runs, with their request.

    `kernel` has computed it in `seconds` of wall time. `late` means that the deadline stopped it.
    """

    request: Request
    rolled: Rolled
    kernel: Kernel
    seconds: float
    late: bool

    @property
    def saved(self) -> Array:
        """States of the saved rows (n, T, nx)."""
        if self.rolled.saved is None:
            raise RuntimeError("the kernel has saved no rows")
        return self.rolled.saved

    @property
    def measured(self) -> Array:
        """Errors and energies of the saved rows (n, T, M + 1).

        The last column is the external work [J].
        """
        if self.rolled.measured is None:
            raise RuntimeError("the kernel has measured nothing")
        return self.rolled.measured

    @property
    def stopped(self) -> bool:
        """Whether Ctrl-C or the deadline stopped a run."""
        return bool(np.any(self.rolled.status == STOPPED))

    def last_step(self, k: int) -> int:
        """Return the number of the last valid step of run k."""
        rolled, total = self.rolled, self.request.inputs.grid.steps
        status = rolled.status[k]
        return int(total if not status else rolled.good[k] if status < STOPPED else rolled.fault[k])

    def saved_steps(self, k: int) -> Indices:
        """Find the step numbers (T,) of the valid saved rows of run k."""
        last, every = self.last_step(k), self.request.every
        lost = 0 < self.rolled.status[k] < STOPPED
        steps = np.arange(0, last + 1, every)
        return steps if lost or steps[-1] == last else np.append(steps, last)

    def times(self, steps: Any) -> Array:
        """Compute the times (T,) at the start of steps [s].

        `steps` are step numbers (T,).
        """
        return self.request.inputs.grid.times(np.asarray(steps))


def roll(request: Request, progress: bool = False) -> Runs:
    """Compute the runs of a request.

    With `progress`, a progress bar is shown. Raises CompileError, ValueError.
    """
    _check_memory(request)
    inputs = request.inputs
    kernel = make_kernel(request)
    total = inputs.runs * inputs.grid.steps
    controls = inputs.controls
    feedback = _feedback_arrays(inputs)
    intervals = inputs.grid.intervals
    if inputs.model.has_clock:
        intervals = intervals._replace(clock=inputs.first + inputs.grid.edges[:-1])
    if feedback:
        intervals = intervals._replace(row=np.zeros_like(intervals.row))
    with contextlib.ExitStack() as stack:
        watch = Watch(deadline=request.deadline)
        if progress:
            from tqdm import tqdm  # its import takes 6 ms

            bar = stack.enter_context(tqdm(total=total, unit=" steps", unit_scale=True))
            watch = watch._replace(seen=lambda done: bar.update(done - bar.n))
        began = time.perf_counter()
        rolled = kernel.run(
            inputs.starts,
            controls,
            intervals,
            request.every,
            look_every=max(1, inputs.grid.steps // 100),
            longest=inputs.grid.longest,
            parameters=inputs.parameters,
            feedback=feedback,
            threads=request.threads,
            watch=watch,
            compare_every=request.compare_every,
        )
        seconds = time.perf_counter() - began
    return Runs(request, rolled, kernel, seconds, time.monotonic() > request.deadline)


def _check_memory(request: Request) -> None:
    """Check that the saved rows fit into memory.

    They are those of a request. Raises ValueError.
    """
    inputs, every = request.inputs, request.every
    rows = 1 - (-inputs.grid.steps // every) if every else 1
    numbers = 2 * inputs.model.nx + len(MEASURED) + 3  # including derived arrays
    needed, free = 8.0 * inputs.runs * rows * numbers, _free_memory()
    if needed > free:
        raise ValueError(
            f"save_every is {every}: {inputs.runs * rows:.3g} rows take {needed / 1e9:.3g} GB, "
            f"{free / 1e9:.3g} GB are free: give a larger save_every or a larger step, or fewer "
            "motions at a time"
        )


def _free_memory() -> float:
    """Read the free memory in bytes; inf if unknown."""
    try:
        told = Path("/proc/meminfo").read_text(encoding="ascii")
        return 1024.0 * float(told.split("MemAvailable:")[1].split()[0])
    except (OSError, IndexError, ValueError):
        try:
            return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
        except (AttributeError, ValueError, OSError):
            return np.inf


def make_kernel(request: Request) -> Kernel:
    """Build the time loop (kernel) for a request.

    Raises CompileError, ValueError.
    """
    return build_kernel(
        request.inputs.model,
        request.scheme,
        request.correction,
        measured=request.measured,
        account=request.account,
        lanes=request.lanes,
        compiled=request.compiled,
        lazily=True,
        companions=request.compare,
    )


def _feedback_arrays(inputs: RunInputs) -> dict[str, Any]:
    """Collect the arrays of state feedback, if `inputs` have any.

    Their names are those of `engine.hpp`. After the end of the plan, the last gain acts on
    deviations from the last state.
    """
    plan, rows = inputs.feedback, inputs.grid.rows
    if plan is None:
        return {}
    size, referred, last = len(plan.controls), inputs.model.moving.stop, [len(plan.controls) - 1]
    arrays = {
        "decides": np.concatenate([[1], np.diff(rows) != 0]).astype(np.int64),
        "decision": np.minimum(rows, size).astype(np.int64),
        "given": np.concatenate([plan.controls, plan.controls[last]]),
        "reference": plan.states[:, :referred],
        "gains": np.concatenate([plan.gains, plan.gains[last]])[:, :, :referred],
        "lower": plan.lower,
        "upper": plan.upper,
    }
    contiguous = {name: np.ascontiguousarray(value) for name, value in arrays.items()}
    return {**contiguous, "referred": referred}
